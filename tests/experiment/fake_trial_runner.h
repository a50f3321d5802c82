#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <utility>

#include "dfr/core/random.h"
#include "dfr/experiment/paired_evaluation.h"
#include "tests/support/temp_folder.h"

namespace dfr::test {

/// A runner whose episodes are hashes of unit, method and seeds. Methods after the first collide
/// less and complete less.
class FakeTrialRunner final : public experiment::TrialRunner {
 public:
  explicit FakeTrialRunner(experiment::EvaluationUnit unit) : unit_(std::move(unit)) {}

  bool Accepts(std::uint64_t start_seed) override {
    return core::Random(core::DeriveSeed(start_seed, {Demonstrations()})).Uniform() < 0.7;
  }

  experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                std::uint64_t controller_seed) override {
    core::Random random(core::DeriveSeed(
        start_seed ^ controller_seed,
        {static_cast<std::uint64_t>(method), Demonstrations(), unit_.learner.size()}));
    const double draw = random.Uniform();
    experiment::EpisodeResult result;
    if (draw < (method == 0 ? 0.5 : 0.3)) {
      result.outcome = core::Outcome::kCompleted;
    } else if (draw < (method == 0 ? 0.6 : 0.95)) {
      result.outcome = core::Outcome::kHalted;
      result.cause = method == 0 ? "time-up" : "outside-support";
    } else {
      result.outcome = core::Outcome::kCollided;
      result.cause = "policy";
    }
    result.controls = 20 + static_cast<int>(random.Below(10));
    result.recovery_controls = method == 0 ? 0 : static_cast<int>(random.Below(20));
    result.seconds = method == 0 ? 0.001 : 0.01;
    return result;
  }

  std::map<std::string, double> Measures() override {
    return {{"overlap", 0.01 * (unit_.trial + 1)}};
  }

 private:
  std::uint64_t Demonstrations() const { return static_cast<std::uint64_t>(unit_.demonstrations); }
  experiment::EvaluationUnit unit_;
};

inline experiment::EvaluationPlan FakePlan() {
  experiment::EvaluationPlan plan;
  plan.methods = {"baseline", "dfr"};
  plan.learners = {"8", "64-64"};
  plan.demonstrations = {6, 60};
  plan.trials = 5;
  plan.episodes = 12;
  plan.seed = 3;
  return plan;
}

inline std::unique_ptr<experiment::TrialRunner> MakeFakeTrialRunner(
    const experiment::EvaluationUnit& unit) {
  return std::make_unique<FakeTrialRunner>(unit);
}

/// Returns the content of a file.
inline std::string Read(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

/// Returns an empty folder for the running test.
inline std::filesystem::path EmptyFolder(const std::string& name) {
  std::filesystem::path path = dfr::test::ProcessFolder() / ("dfr_" + name);
  std::filesystem::remove_all(path);
  std::filesystem::create_directories(path);
  return path;
}

}  // namespace dfr::test
