#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "dfr/dds/channel.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/eventually.h"
#include "tests/support/no_alloc.h"

namespace dfr::hardware {

inline kinematics::PsmJoints Yaw(double angle) { return test::PsmHomeWith(0, angle); }

/// A simulated console and drivers in lock-step: the test's time advances only after the console's
/// samples have arrived.
class PsmDriverTest : public testing::Test {
 protected:
  explicit PsmDriverTest(const sim::PsmConsoleOptions& console = {.arm = "PSM1", .homing_s = 0.2})
      : console_(console) {}

  [[nodiscard]] std::int64_t wall_ns() const { return 1'700'000'000'000'000'000 + now_ns_; }

  // No tick of any test allocates.
  void Tick(PsmDriver& driver) {
    driver.Flush();
    {
      const test::NoAlloc guard;
      driver.Tick(now_ns_, wall_ns());
    }
    driver.Flush();
  }

  // Waits until the console's present measurement has arrived.
  [[nodiscard]] bool Heard(const PsmDriver& driver) const {
    const PsmClient& client = driver.client();
    const dds::Stamp now = server_.now();
    return client.measured_js().stamp == now && client.setpoint_js().stamp == now &&
           client.measured_cp().stamp == now;
  }

  // Waits until both sides have found each other.
  void Connect(PsmDriver& driver) {
    const sim::PsmConsole as_it_is = console_;
    const auto until = [&](const std::function<bool()>& condition) {
      test::Eventually([&] {
        server_.TakeCommands();
        server_.Publish(0.0, true);
        Tick(driver);
        return condition();
      });
    };
    console_.Place(test::PsmHome());  // measurements before homing have no stamp
    until([&] {
      return Heard(driver) && driver.request_subscribers() > 0 && driver.servo_subscribers() > 0 &&
             driver.hold_subscribers() > 0 && server_.status_subscribers() > 0;
    });
    console_ = as_it_is;
    until([&] {
      const PsmOperatingState& state = driver.client().operating_state();
      return std::string_view(Name(state.state)) == Name(console_.state()) &&
             state.homed == console_.homed() &&
             driver.client().measured_js().stamp.valid() == console_.valid();
    });
  }

  std::unique_ptr<PsmDriver> Connected(const PsmDriverOptions& options = {}) {
    auto driver = std::make_unique<PsmDriver>(participant_, options);
    Connect(*driver);
    return driver;
  }
  // Returns a connected driver whose arm is homed and armed.
  std::unique_ptr<PsmDriver> Armed(const PsmDriverOptions& options = {}) {
    console_.Place(test::PsmHome());
    auto driver = Connected(options);
    Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
    return driver;
  }

  // Advances the driver and the console by `dt_s`.
  void Step(PsmDriver& driver, double dt_s = 0.01) {
    now_ns_ += std::llround(1e9 * dt_s);
    const std::uint64_t before = driver.client().num_samples();
    server_.Tick(dt_s);
    test::Eventually([&] { return server_.WaitUntilReceived(1.0); });
    test::Eventually([&] {
      Tick(driver);
      return console_.valid() ? Heard(driver) : driver.client().num_samples() > before;
    });
  }

  void Until(PsmDriver& driver, const std::function<bool()>& condition) {
    while (!condition()) Step(driver);
  }

  void ExpectHolds(PsmDriver& driver, PsmStatus cause) {
    Until(driver, [&] { return driver.phase() == PsmPhase::kHolding; });
    EXPECT_EQ(driver.status(), cause) << driver.Explain();
  }

  // Waits until the driver's participant has found the other.
  void Meet(dds::Participant& other) {
    const dds::Publisher<dds::Text> here(other, "/here", dds::Role::kRequest);
    test::Eventually([&] {
      return !participant_.OthersPublishers([](std::string_view topic) { return topic == "/here"; })
                  .empty();
    });
  }

  BringUpClock InStep(PsmDriver& driver) {
    return {.steady_ns = [this] { return now_ns_; },
            .wall_ns = [this] { return wall_ns(); },
            .wait = [this, &driver] { Step(driver); }};
  }

  std::int64_t now_ns_ = 0;
  sim::PsmConsole console_;
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  // Publishes a state with each tick.
  sim::PsmConsoleServer server_{
      server_participant_, console_, {.state_period_s = 1e-3, .clock = [this] {
                                        return dds::Stamp::FromNanoseconds(wall_ns());
                                      }}};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
};

}  // namespace dfr::hardware
