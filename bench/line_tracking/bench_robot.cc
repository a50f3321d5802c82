#include "bench_robot.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdio>
#include <iostream>
#include <limits>
#include <memory>
#include <stdexcept>

#include "commands/commands.h"
#include "dfr/control/rollout.h"
#include "dfr/runtime/periodic_timer.h"
#include "recorded_controller.h"
#include "robot/robot_plant.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

std::atomic<bool> policy_is_broken = false;

// Returns the controls of another controller, and NaN while the policy is broken.
class BreakingPolicy final : public control::Controller {
 public:
  explicit BreakingPolicy(control::Controller& inner) : inner_(&inner) {}
  [[nodiscard]] int state_dim() const noexcept override { return inner_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return inner_->control_dim(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override { inner_->Reset(seed); }
  [[nodiscard]] control::Step DoNext(std::span<const double> x,
                                     std::span<double> u) noexcept override {
    const control::Step step = inner_->Next(x, u);
    if (!policy_is_broken) said_ = false;
    if (policy_is_broken) {
      if (!said_) {
        std::printf("%lld broken none\n", static_cast<long long>(runtime::SteadyNow()));
        std::fflush(stdout);
      }
      said_ = true;
      std::fill(u.begin(), u.end(), std::numeric_limits<double>::quiet_NaN());
    }
    return step;
  }
  control::Controller* inner_;
  bool said_ = false;
};

RobotConfig Configuration(int domain, dds::Discovery discovery) {
  RobotConfig config;
  config.robot = RobotPlace::kDds;
  config.network.domain = domain;
  config.network.discovery = discovery;
  config.simulator = true;
  return config;
}

// Runs the loop for 20 ms. Returns true if the input then has a line.
bool IsAskedToGo(RobotPlant& plant) {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  plant.loop().Idle(0.02);
  std::array<char, 64> text;
  return poll(&input, 1, 0) > 0 && read(STDIN_FILENO, text.data(), text.size()) > 0;
}

// Homes the arm. After an error, prints its reason and waits for "go" before the next attempt.
void BringUp(RobotPlant& plant) {
  for (;;) {
    try {
      plant.BringUp({}, [](std::string_view, std::string_view word) { return word == "platform"; });
      return;
    } catch (const std::runtime_error&) {
      std::printf("%lld faulted %s none\n", static_cast<long long>(runtime::SteadyNow()),
                  runtime::Name(plant.loop().blocking()));
      std::fflush(stdout);
    }
    while (!IsAskedToGo(plant)) {
    }
    static_cast<void>(plant.Clear());
  }
}

}  // namespace

void BreakPolicy() noexcept { policy_is_broken = true; }

void RunRobot(const std::filesystem::path& folder, int domain, double image_age_s,
              dds::Discovery discovery, const std::string& platform) {
  const LineModel model = LineModel::Load(folder / "model");
  RobotConfig config = Configuration(domain, discovery);
  config.image_max_age_s = image_age_s;
  if (!platform.empty()) {
    config.platform.device = platform;
    config.platform.wave = hardware::SprkWaveKind::kSine;
    config.platform.motion.amplitude.translation_m.x() = 0.00254;
    config.platform.motion.frequency_hz[0] = 0.1;
  }
  if (const std::string refused = runtime::AskForRealTime(config.priority); !refused.empty()) {
    std::cout << "note " << refused << std::endl;
  }
  RunOperator screen;
  screen.on_transition = [](const runtime::Transition& t) {
    std::printf("%lld %s %s %s\n", static_cast<long long>(t.steady_ns), runtime::Name(t.to),
                runtime::Name(t.reason), t.detail.data());
    std::fflush(stdout);
  };
  RobotPlant plant(config, line_task::LineCalibration::Load(folder / "calibration.dfr"), nullptr,
                   screen);
  static_cast<void>(runtime::AskForRealTime(config.priority + 1));
  BringUp(plant);
  const std::unique_ptr<control::Controller> guided = model.MakeController("controller");
  BreakingPolicy breaking(*guided);
  RecordedController controller(breaking, nullptr);
  controller.on_decision = [&plant](const control::Step& step) { plant.loop().Decided(step); };
  for (std::uint64_t episode = 0;; ++episode) {
    try {
      const control::RolloutResult result =
          control::Rollout(plant, controller, {.plant_seed = episode, .controller_seed = episode});
      if (result.halt_cause == control::HaltCause::kControlInvalid) {
        plant.loop().Hold(runtime::HoldReason::kControlInvalid,
                          "the policy's control is not finite");
      }
    } catch (const std::runtime_error& e) {  // not started: retry
      std::cerr << "robot: " << e.what() << std::endl;
    }
    if (const runtime::PeriodicTimer* timer = plant.timer()) {
      std::printf("loop %lld %lld %.3f\n", static_cast<long long>(timer->periods()),
                  static_cast<long long>(timer->missed()), 1e3 * timer->worst());
      std::fflush(stdout);
    }
    while (!plant.loop().ended_regularly()) {
      if (!IsAskedToGo(plant)) continue;
      policy_is_broken = false;
      if (plant.loop().state() == runtime::RunState::kFaulted && !plant.Clear()) continue;
      break;
    }
  }
}

}  // namespace dfr::apps::line_tracking
