// Our client and a console written with CycloneDDS, an independent implementation.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <string>

#include "dfr/dds/channel.h"
#include "dfr/hardware/psm_driver.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/all_close.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

using kinematics::PsmJoints;

// Client and console use this test's time.
class CycloneConsoleTest : public testing::Test {
 protected:
  // Advances the time by 10 ms and waits until the console's measurement has arrived and the
  // console has the set-point of an armed driver: a busy machine may lose samples.
  void Step() {
    now_ns_ += 10'000'000;
    const PsmClient& client = driver_.client();
    const std::uint64_t before = client.num_samples();
    const dds::Stamp now = dds::Stamp::FromNanoseconds(now_ns_);
    test::Eventually([&] {
      time_.Write({1e-9 * static_cast<double>(now_ns_)});
      driver_.Flush();
      driver_.Tick(now_ns_, now_ns_);
      driver_.Flush();
      if (!client.operating_state().homed) return client.num_samples() > before;
      if (driver_.phase() == PsmPhase::kArmed &&
          !test::AllClose(client.setpoint_js().position, client.setpoint(), 1e-6)) {
        return false;
      }
      return client.measured_js().stamp == now && client.measured_cp().stamp == now &&
             client.setpoint_js().stamp == now;
    });
  }

  void Until(const std::function<bool()>& condition) {
    while (!condition()) Step();
  }

  std::int64_t now_ns_ = 1'000'000'000'000;
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  dds::Publisher<dds::Number> time_{participant_, "/test/time", dds::Role::kRequest};
  PsmDriver driver_{participant_, {}};
};

TEST_F(CycloneConsoleTest, IsHomedAndMoved) {
  const test::PeerProcess console({DFR_CYCLONE_CONSOLE, std::to_string(test::OwnDomain())});
  ASSERT_EQ(BringUp(driver_, 60.0, {}, {},
                    {.steady_ns = [this] { return now_ns_; },
                     .wall_ns = [this] { return now_ns_; },
                     .wait = [this] { Step(); }}),
            PsmStatus::kOk)
      << driver_.Explain();
  EXPECT_TRUE(test::AllClose(driver_.client().measured_cp().position_m,
                             Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
  PsmJoints goal;
  goal << 0.05, -0.03, 0.125, 0.1, 0.05, -0.05;
  ASSERT_EQ(driver_.MoveTo(goal, 0.5), PsmStatus::kOk);
  Until([&] { return driver_.at_rest() || driver_.phase() != PsmPhase::kArmed; });
  ASSERT_EQ(driver_.status(), PsmStatus::kOk) << driver_.Explain();
  Until([&] { return test::AllClose(driver_.client().measured_js().position, goal, 1e-9); });
}

}  // namespace
}  // namespace dfr::hardware
