#include <gtest/gtest.h>
#include <time.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <thread>

#include "dfr/dds/channel.h"
#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"
#include "tests/dds/domain.h"

namespace dfr::sim {
namespace {

// Pictures take tens of milliseconds to draw, and states are due every ten: no tick waits for
// pictures.
TEST(DvrkSceneServerSystemTest, DrawingDoesNotDelayTheState) {
  DvrkSceneOptions options;
  options.arm.homing_s = 0.1;
  DvrkScene scene(options);
  dds::Participant participant({.domain = test::OwnDomain()});
  DvrkSceneServer server(participant, participant, scene, {});
  dds::Participant client({.domain = test::OwnDomain()});
  const dds::Subscriber<dds::Image> images(client, "/ECM/image_raw", dds::Role::kImage);
  // Measures CPU time of the thread, which is independent of the machine's load.
  const auto thread_s = [] {
    timespec t;
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
  };
  const auto tick = [&] {
    const double start = thread_s();
    server.Tick(1e-3);
    const double took = thread_s() - start;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return took;
  };
  while (server.images_published() == 0) tick();
  const std::uint64_t before = server.images_published();
  double longest = 0.0;
  while (server.images_published() < before + 10) longest = std::max(longest, tick());
  // The longest tick takes 0.35 ms on an idle machine. The limit is 14 times as long, and a
  // fraction of the time of a drawing.
  EXPECT_LT(longest, 5e-3);
}

}  // namespace
}  // namespace dfr::sim
