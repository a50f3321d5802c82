// Results are reproducible: every bit with one instruction set, every outcome with all of them.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <ios>
#include <map>
#include <span>
#include <sstream>
#include <string>
#include <vector>

#include "apps/pusher/trial_runner.h"
#include "apps/study/study.h"
#include "dfr/core/random.h"
#include "dfr/experiment/ledger.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/method.h"
#include "dfr/sim/gallery/gallery.h"
#include "gaussian/gaussian_sum.h"
#include "tests/support/temp_folder.h"

namespace dfr::test {

// Results of a run: hashes of all bits, and the outcome of each episode.
struct Golden {
  std::map<std::string, std::string> hashes;
  std::map<std::string, std::vector<core::Outcome>> outcomes;
};

// A file of numbers, hashed like the input files of experiments.
class Numbers {
 public:
  explicit Numbers(const std::filesystem::path& path) : path_(path), out_(path, std::ios::binary) {}
  void Add(std::span<const double> values) {
    out_.write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(values.size_bytes()));
  }
  std::string Hash() {
    out_.close();
    return experiment::HashOfFile(path_);
  }

 private:
  std::filesystem::path path_;
  std::ofstream out_;
};

inline std::string Fits(const std::filesystem::path& folder) {
  Numbers numbers(folder / "fits");
  core::Random random(5);
  core::Matrix samples(400, 9);
  for (double& entry : samples.reshaped()) entry = random.Normal();
  for (const double gamma : {1.0 / 9.0, 5.0}) {
    const auto svm = kernel::OneClassSvm::Fit(samples, {.nu = 0.1, .gamma = gamma});
    numbers.Add(std::span(svm.alpha().data(), static_cast<std::size_t>(svm.alpha().size())));
    numbers.Add(
        std::vector{svm.rho(), svm.InSinglePrecision().Decision(std::span(samples.data(), 9))});
  }
  return numbers.Hash();
}

inline std::string GuardFile(const std::filesystem::path& folder) {
  const sim::GalleryTask& task = sim::FindGalleryTask("push");
  const auto guard = safety::GuardModel::Fit(task.plant->layout(), sim::Demonstrate(task, 20, 6));
  guard->Save(folder / "push.guard");
  return experiment::HashOfFile(folder / "push.guard");
}

inline void Gallery(const std::filesystem::path& folder, int episodes, Golden& golden) {
  study::Study study = study::Study::OfGuards();
  study.controllers = {"dfr", "guard", "controller", "certified"};
  study.policies = {"weak"};
  study.demonstrations = 20;
  study.trials = 1;
  study.seed = 7;
  for (const std::string task : {"push", "balance", "two-ways"}) {
    study.tasks = {task};
    Numbers numbers(folder / task);
    for (const auto& recording : study::RecordStudy(study, episodes)) {
      numbers.Add(
          std::span(recording.states.data(), static_cast<std::size_t>(recording.states.size())));
      golden.outcomes[task + " " + recording.method].push_back(recording.result.outcome);
    }
    golden.hashes["episodes of " + task] = numbers.Hash();
  }
}

inline void Pusher(const std::filesystem::path& folder, int episodes, Golden& golden) {
  apps::pusher::TrialRunnerOptions options;
  for (const char* name : {"baseline", "early-stopping", "dfr", "controller"}) {
    options.methods.push_back(safety::ParseMethod(name));
  }
  options.most_demonstrations = 20;
  options.seed = 8;
  apps::pusher::TrialRunnerFactory factory({imitation::GaussianPolicy::Load(DFR_SUPERVISOR)},
                                           options, 1);
  const auto runner = factory.Make({.trial = 0, .demonstrations = 20, .learner = "8"});
  Numbers numbers(folder / "pusher");
  for (int m = 0; m < static_cast<int>(options.methods.size()); ++m) {
    for (std::uint64_t start = 0; start < static_cast<std::uint64_t>(episodes); ++start) {
      const experiment::EpisodeResult result = runner->Run(m, start, 100 + start);
      numbers.Add(std::vector{static_cast<double>(result.controls),
                              static_cast<double>(result.recovery_controls)});
      std::vector<double> state(static_cast<std::size_t>(runner->plant().state_dim()));
      runner->plant().Observe(state);
      numbers.Add(state);
      golden.outcomes["pusher " + options.methods[static_cast<std::size_t>(m)].name].push_back(
          result.outcome);
    }
  }
  golden.hashes["episodes of pusher"] = numbers.Hash();
  runner->model().Save(folder / "model");
  for (const auto& file : std::filesystem::directory_iterator(folder / "model")) {
    // The HDF5 file contains its time of writing.
    if (file.path().extension() == ".hdf5") continue;
    golden.hashes["pusher's " + file.path().filename().string()] =
        experiment::HashOfFile(file.path());
  }
}

/// Returns results of `episodes` episodes of each strategy. Target 0: the machine's best.
inline Golden ResultsWith(std::int64_t target, int episodes) {
  const TempFolder created;
  const std::filesystem::path& folder = created.path;
  kernel::internal::ForceTarget(target);
  Golden golden;
  golden.hashes["fits"] = Fits(folder);
  golden.hashes["guard file"] = GuardFile(folder);
  Gallery(folder, episodes, golden);
  Pusher(folder, episodes, golden);
  kernel::internal::ForceTarget(0);
  return golden;
}

inline std::int64_t TargetNamed(const std::string& name) {
  for (const std::int64_t target : kernel::internal::SupportedTargets()) {
    if (kernel::internal::TargetName(target) == name) return target;
  }
  return 0;
}

inline std::string Lines(const std::map<std::string, std::string>& hashes) {
  std::ostringstream lines;
  for (const auto& [name, hash] : hashes) lines << hash << "  " << name << "\n";
  return lines.str();
}

/// If a hash changes, users get other results from the same seed. Name the change in CHANGELOG.md
/// and replace the lines of the file.
inline void ExpectRecordedBits(const char* recorded_in, int episodes) {
#if __GNUC__ != 12 || defined(__clang__) || !defined(__OPTIMIZE__) || \
    defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the hashes are those of GCC 12: each compiler fuses other products and sums";
#endif
  const std::int64_t avx2 = TargetNamed("AVX2");
  if (avx2 == 0) GTEST_SKIP() << "this processor has no AVX2";
  std::ifstream file(recorded_in);
  std::stringstream recorded;
  recorded << file.rdbuf();
  EXPECT_EQ(Lines(ResultsWith(avx2, episodes).hashes), recorded.str());
}

}  // namespace dfr::test
