// Records a step every millisecond and a picture every 33 ms, until it is killed. The size of
// PROGRESS is the number of recorded steps. usage: recording_system_child LOG PROGRESS
#include <fcntl.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <thread>

#include "dfr/recording/recorder.h"
#include "tests/recording/example.h"

int main(int argc, char** argv) try {
  if (argc != 3) return EXIT_FAILURE;
  const int progress = ::open(argv[2], O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  dfr::recording::Recorder recorder(argv[1], dfr::test::ExampleMetadata());
  const auto pixels = dfr::test::ExamplePixels(0);
  auto next = std::chrono::steady_clock::now();
  for (std::uint32_t i = 0;; ++i) {
    if (!recorder.Record(dfr::test::ExampleStep(i))) return EXIT_FAILURE;
    if (::write(progress, ".", 1) != 1) return EXIT_FAILURE;
    if (i % 33 == 0) recorder.Picture(dfr::test::ExamplePicture(i, pixels));
    next += std::chrono::milliseconds(1);
    std::this_thread::sleep_until(next);
  }
} catch (const std::exception& e) {
  std::cerr << e.what() << '\n';
  return EXIT_FAILURE;
}
