#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <stdexcept>

#include "dfr/imitation/demonstrations.h"

namespace dfr::imitation {
namespace {

TEST(EndlessFileTest, AnEndlessFileIsAnError) {
  const std::filesystem::path path =
      std::filesystem::path(DFR_REGRESSIONS) / "hdf5_demonstrations" / "hdf5_global_heap_hang.hdf5";
  const auto start = std::chrono::steady_clock::now();
  EXPECT_THAT([&] { (void)LoadDemonstrations(path); },
              testing::ThrowsMessage<std::runtime_error>(
                  testing::HasSubstr("libhdf5 did not finish reading it")));
  // An idle machine takes 2 s. The limit is 45 times as long.
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(90));
}

}  // namespace
}  // namespace dfr::imitation
