#include "stale_memory.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <unistd.h>
#include <utime.h>

#include <ctime>
#include <filesystem>
#include <fstream>
#include <string>

#include "tests/support/temp_folder.h"

namespace dfr::dds::internal {
namespace {

class StaleMemoryTest : public testing::Test {
 protected:
  void Make(const std::string& name, std::time_t age_s) const {
    std::ofstream(folder_ / name) << "x";
    const utimbuf times{kNow - age_s, kNow - age_s};
    ASSERT_EQ(::utime((folder_ / name).c_str(), &times), 0);
  }
  [[nodiscard]] bool There(const std::string& name) const {
    return std::filesystem::exists(folder_ / name);
  }

  static constexpr std::time_t kNow = 1'700'000'000;
  const test::TempFolder temp_;
  const std::filesystem::path folder_ = temp_.path;
};

TEST_F(StaleMemoryTest, RemovesOnlySegmentsWithoutAnOwner) {
  const std::string dead = "fastrtps_0123456789abcdef";
  const std::string alive = "fastrtps_1123456789abcdef";
  const std::string young = "fastrtps_2123456789abcdef";
  for (const std::string& name : {dead, alive}) {
    Make(name, 11);
    Make(name + "_el", 11);
  }
  Make(young, 10);
  Make(young + "_el", 10);
  Make("fastrtps_port12413_el", 60);
  Make("fastrtps_0123456789abcdeX_el", 60);
  Make("another_0123456789abcdef_el", 60);
  const int owner = ::open((folder_ / (alive + "_el")).c_str(), O_RDONLY | O_CLOEXEC);
  ASSERT_GE(owner, 0);
  ASSERT_EQ(::flock(owner, LOCK_EX), 0);
  RemoveStaleSegments(folder_, kNow);
  EXPECT_FALSE(There(dead));
  EXPECT_FALSE(There(dead + "_el"));
  for (const std::string& name :
       {alive, alive + "_el", young, young + "_el", std::string("fastrtps_port12413_el"),
        std::string("fastrtps_0123456789abcdeX_el"), std::string("another_0123456789abcdef_el")}) {
    EXPECT_TRUE(There(name)) << name;
  }
  ::close(owner);
  RemoveStaleSegments(folder_, kNow);
  EXPECT_FALSE(There(alive));
  RemoveStaleSegments(folder_ / "none", kNow);
  EXPECT_FALSE(There("none"));
}

}  // namespace
}  // namespace dfr::dds::internal
