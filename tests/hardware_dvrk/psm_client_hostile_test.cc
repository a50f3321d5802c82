// A console that sends anything, in any order.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <limits>
#include <optional>

#include "dfr/core/random.h"
#include "tests/hardware_dvrk/psm_client_fixture.h"

namespace dfr::hardware {
namespace {

class HostileConsoleTest : public PsmClientTest {
 protected:
  bool Chance(std::uint64_t in) { return random_.Below(in) == 0; }

  double Strange() {
    constexpr std::array kValues = {
        kNan, std::numeric_limits<double>::infinity(), -1e300, 1e-310, 0.0, 3.0, -0.2};
    return kValues[random_.Below(kValues.size())];
  }

  // Zero, long ago, in the future, at the beginning and at the end of time, or shortly before.
  dds::Stamp StrangeStamp() {
    const std::array<std::int64_t, 6> kTimes = {0,
                                                kWall - 3600'000 * kMs,
                                                kWall + 3600'000 * kMs,
                                                1,
                                                std::numeric_limits<std::int64_t>::max(),
                                                kWall + now_ns_ - 30 * kMs};
    return dds::Stamp::FromNanoseconds(kTimes[random_.Below(kTimes.size())]);
  }

  void Spoil(std::optional<PsmJointSample>& sample) {
    if (!sample) return;
    switch (random_.Below(6)) {
      case 0:
        return sample.reset();
      case 1:
        sample->position[static_cast<Eigen::Index>(random_.Below(6))] = Strange();
        return;
      case 2:
        sample->velocity[static_cast<Eigen::Index>(random_.Below(6))] = Strange();
        return;
      case 3:
        sample->well_formed = false;
        return;
      case 4:
        sample->has_velocity = false;
        return;
      default:
        sample->stamp = StrangeStamp();
    }
  }

  void Spoil(std::optional<PsmPoseSample>& sample) {
    if (!sample) return;
    switch (random_.Below(4)) {
      case 0:
        return sample.reset();
      case 1:
        sample->position_m[static_cast<Eigen::Index>(random_.Below(3))] = Strange();
        return;
      case 2:
        sample->orientation.coeffs()[static_cast<Eigen::Index>(random_.Below(4))] = Strange();
        return;
      default:
        sample->stamp = StrangeStamp();
    }
  }

  void Spoil(std::optional<PsmJawSample>& sample) {
    if (!sample) return;
    if (Chance(2)) {
      sample->angle = Strange();
    } else {
      sample->stamp = StrangeStamp();
    }
  }

  void Spoil(PsmInput& input) {
    switch (random_.Below(12)) {
      case 0:
        return Spoil(input.measured_js);
      case 1:
        return Spoil(input.setpoint_js);
      case 2:
        return Spoil(input.measured_cp);
      case 3:
        return Spoil(input.local_measured_cp);
      case 4:
        return Spoil(input.jaw_setpoint);
      case 5:
        return Spoil(input.jaw_measured);
      case 6:
        input.state_publishers = static_cast<int>(random_.Below(3));
        return;
      case 7:
        input.operating_state =
            PsmOperatingState{.state = static_cast<PsmConsoleState>(random_.Below(5)),
                              .homed = Chance(2),
                              .busy = Chance(2),
                              .lapses = static_cast<std::uint32_t>(random_.Below(3)),
                              .last_lapse = PsmStatus::kDisabled};
        return;
      case 8:
        input.errors = input.newcomers = static_cast<int>(random_.Below(2));
        return;
      case 9:
        input.foreign_messages = static_cast<int>(random_.Below(2));
        return;
      case 10:
        input.instrument = static_cast<PsmInstrument>(random_.Below(3));
        return;
      default:
        input = PsmInput();  // The console is absent in this step.
    }
  }

  core::Random random_{7};
};

TEST_F(HostileConsoleTest, NothingMovesWithoutTheOperatorsWord) {
  int sent = 0;
  int holds = 0;
  bool armed = false;
  const auto step = [&](std::uint64_t one_in) {
    const auto before = client_.setpoint();
    const PsmOutput output = Step([&](PsmInput& input) {
      while (Chance(one_in)) Spoil(input);
    });
    if (output.hold || client_.phase() != PsmPhase::kArmed) armed = false;
    EXPECT_TRUE(armed || !(output.servo || output.servo_jaw)) << num_steps_;
    if (output.servo) {
      ++sent;
      EXPECT_TRUE(output.servo_cp.matrix().allFinite() && output.twist.allFinite()) << num_steps_;
      // The largest speed of a joint is below 2.4 rad/s.
      EXPECT_LT((client_.setpoint() - before).cwiseAbs().maxCoeff(), 0.012) << num_steps_;
    }
    holds += output.hold;
    EXPECT_TRUE(client_.setpoint().allFinite());
  };
  for (int round = 0; round < 1500; ++round) {
    // The operator arms only sometimes. Programs give all other commands.
    if (Chance(3)) armed = client_.Arm() == PsmStatus::kOk || armed;
    on_cart_ = Chance(4) ? !on_cart_ : on_cart_;
    static_cast<void>(client_.MoveTo(Yaw(random_.Uniform(-0.1, 0.1)), 1.0));
    static_cast<void>(client_.MoveJaw(0.1 + random_.Uniform(0.0, 0.2), 1.0));
    const std::uint64_t one_in = Chance(2) ? 4 : 60;
    for (int i = 0; i < 40; ++i) step(one_in);
    // The console returns.
    Become(PsmConsoleState::kEnabled, true, false);
    for (int i = 0; i < 200; ++i) step(std::numeric_limits<std::uint64_t>::max());
  }
  EXPECT_GT(sent, 1000);
  EXPECT_GT(holds, 100);
}

}  // namespace
}  // namespace dfr::hardware
