#include "apps/study/pictures/detect.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <numeric>
#include <ostream>
#include <span>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "apps/study/study.h"
#include "apps/usage_error.h"
#include "dfr/core/contract.h"
#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/numerics/quantile.h"
#include "dfr/core/random.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/intervals.h"
#include "dfr/reduction/state_reduction.h"
#include "dfr/study/detectors.h"

namespace dfr::study {
namespace {

constexpr std::size_t kLeastDemonstrations = 10;
constexpr double kFitted = 0.5;
constexpr double kCalibrating = 0.2;
// State blocks with more entries than this are reduced if a guard on all features is rejected.
constexpr int kLargeBlock = 8;

struct Parts {
  imitation::DemonstrationSet fitted;
  std::vector<core::Trajectory> calibrating;
  std::vector<core::Trajectory> left_out;
};

Parts Split(const imitation::DemonstrationSet& all, std::uint64_t seed) {
  std::vector<std::size_t> order(all.trajectories.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  core::Random random(seed);
  random.Shuffle(std::span(order));
  const auto count = static_cast<double>(order.size());
  const auto fitted = static_cast<std::size_t>(std::lround(kFitted * count));
  const auto calibrating = static_cast<std::size_t>(std::lround(kCalibrating * count));
  Parts parts{.fitted = {.layout = all.layout,
                         .control_dim = all.control_dim,
                         .environment = all.environment,
                         .trajectories = {},
                         .note = {}},
              .calibrating = {},
              .left_out = {}};
  for (std::size_t i = 0; i < order.size(); ++i) {
    auto& part = i < fitted                 ? parts.fitted.trajectories
                 : i < fitted + calibrating ? parts.calibrating
                                            : parts.left_out;
    part.push_back(all.trajectories[order[i]]);
  }
  return parts;
}

// Returns the features with "pca:" before each large block and the others unchanged; empty if there
// is no large block.
std::string Reduced(const core::StateLayout& layout) {
  std::string features;
  bool large = false;
  for (const core::StateLayout::Block& block : layout.blocks) {
    features += features.empty() ? "" : ",";
    if (block.size > kLargeBlock) features += "pca:";
    large = large || block.size > kLargeBlock;
    features += block.name;
  }
  return large ? features : "";
}

// Returns the guard on `features`, or on principal components if these features are rejected.
// Reports the choice and the reason in `text`.
std::shared_ptr<const safety::GuardModel> FitOrReduce(const imitation::DemonstrationSet& set,
                                                      const std::string& features,
                                                      std::ostream& text) {
  try {
    return safety::GuardModel::Fit(set.layout, set.trajectories, {.features = features});
  } catch (const std::invalid_argument& refused) {
    const std::string reduced = features.empty() ? Reduced(set.layout) : "";
    if (reduced.empty()) throw;
    text << "refused: " << refused.what() << "\n";
    auto guard =
        safety::GuardModel::Fit(set.layout, set.trajectories,
                                {.features = reduced, .strategy = safety::Strategy::kMonitor});
    text << "reduced to " << guard->task().features().num_features() << " features, " << reduced
         << ": " << guard->summary().components_reason << "\n";
    return guard;
  }
}

void ReduceStates(const safety::GuardModel& guard, std::vector<core::Trajectory>& episodes) {
  for (core::Trajectory& episode : episodes) episode.states = guard.TaskStates(episode.states);
}

std::vector<ScoredEpisode> Score(const Detector& detector,
                                 std::span<const core::Trajectory> episodes, bool labelled) {
  std::vector<ScoredEpisode> scored;
  scored.reserve(episodes.size());
  for (const core::Trajectory& episode : episodes) {
    scored.push_back({detector.Scores(episode.states),
                      labelled && episode.outcome != core::Outcome::kCompleted});
  }
  return scored;
}

// Formats a share in per cent, with its interval.
std::string ShareOf(int count, int of) {
  if (of == 0) return "-";
  const auto interval = experiment::ProportionInterval(count, of);
  return core::Format("%.0f [%.0f, %.0f]", 100.0 * count / of, 100.0 * interval.low,
                      100.0 * interval.high);
}

std::vector<std::string> RowOf(const std::string& name, const DetectorRates& left_out,
                               const DetectorRates& further) {
  DetectorRates all = further;
  all.successes += left_out.successes;
  all.alarmed_successes += left_out.alarmed_successes;
  const auto accuracy = all.balanced_accuracy();
  const auto lead = all.lead();
  return {name,
          ShareOf(left_out.alarmed_successes, left_out.successes),
          ShareOf(further.alarmed_successes, further.successes),
          ShareOf(further.alarmed_failures, further.failures),
          accuracy ? core::Format("%.0f", 100.0 * *accuracy) : "-",
          lead ? core::Format("%.0f", *lead) : "-"};
}

std::vector<core::Trajectory> RunPolicy(const Detection& detection) {
  Study study = Study::OfGuards();
  study.tasks = {detection.task};
  study.policies = {detection.policy};
  study.controllers = {};
  study.demonstrations = detection.demonstrations;
  study.seed = core::DeriveSeed(detection.seed, {1});
  std::vector<core::Trajectory> episodes;
  for (experiment::FilmedEpisode& episode : RecordStudy(study, detection.episodes)) {
    if (episode.method != "alone") continue;
    core::Trajectory& further = episodes.emplace_back();
    further.states = std::move(episode.states);
    further.outcome = episode.result.outcome;
  }
  return episodes;
}

imitation::DemonstrationSet Load(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) {
    throw std::runtime_error(file.string() + ": no such file.\n" + DetectionSources());
  }
  return imitation::LoadDemonstrations(file);
}

}  // namespace

const char* DetectionSources() noexcept {
  return "This program ships no third-party data. It reads robomimic's and Minari's HDF5 and "
         "LeRobot's "
         "datasets:\n"
         "  Push-T         pip install lerobot, dataset lerobot/pusht_keypoints (206 human "
         "episodes)\n"
         "  Adroit door    pip install minari, minari download D4RL/door/human-v2 (25 human "
         "episodes)\n"
         "  Isaac stack    Isaac Lab's recorded HDF5, whose attribute `success` labels episodes\n"
         "Without a file, `study detect --task pick` compares detectors in the gallery.\n";
}

DetectionSet LoadDetection(const Detection& detection) {
  DetectionSet set{.demonstrations = {}, .further = {}, .features = detection.features};
  const auto check_features = [&detection](const core::StateLayout& layout) {
    apps::ValueOf("--features",
                  [&] { reduction::StateReduction::CheckFeatures(layout, detection.features); });
  };
  if (detection.files.empty()) {
    const sim::GalleryTask& task = sim::FindGalleryTask(detection.task);
    check_features(task.plant->layout());
    set.demonstrations = {.layout = task.plant->layout(),
                          .control_dim = task.plant->control_dim(),
                          .environment = task.name,
                          .trajectories = sim::Demonstrate(task, detection.demonstrations,
                                                           core::DeriveSeed(detection.seed, {0})),
                          .note = {}};
    if (set.features.empty()) set.features = task.features;
    set.further = RunPolicy(detection);
    return set;
  }
  set.demonstrations = Load(detection.files[0]);
  check_features(set.demonstrations.layout);
  std::vector<core::Trajectory>& all = set.demonstrations.trajectories;
  const auto load_more = [&](const std::filesystem::path& file) {
    imitation::DemonstrationSet more = Load(file);
    if (more.layout != set.demonstrations.layout ||
        more.control_dim != set.demonstrations.control_dim) {
      throw std::runtime_error(file.string() + ": states or actions differ in size or name from " +
                               "those of " + detection.files[0].string());
    }
    return std::move(more.trajectories);
  };
  for (std::size_t i = 1; i < detection.files.size(); ++i) {
    std::ranges::move(load_more(detection.files[i]), std::back_inserter(all));
  }
  const auto absolute = core::FindAbsoluteActions(all);
  for (core::Trajectory& d : all) core::ToDifferences(absolute, d);
  if (detection.failures.empty()) return set;
  set.further = load_more(detection.failures);
  for (core::Trajectory& episode : set.further) {
    if (detection.unlike) episode.outcome = core::Outcome::kHalted;
  }
  return set;
}

DetectionReport Detect(const DetectionSet& set, const Detection& detection) {
  DFR_THROW_UNLESS(set.demonstrations.trajectories.size() >= kLeastDemonstrations,
                   "a comparison of detectors needs at least "
                       << kLeastDemonstrations << " demonstrations, not "
                       << set.demonstrations.trajectories.size());
  Parts parts = Split(set.demonstrations, core::DeriveSeed(detection.seed, {2}));
  std::vector<core::Trajectory> further = set.further;
  std::ostringstream text;
  auto guard = FitOrReduce(parts.fitted, set.features, text);
  text << parts.fitted.trajectories.size() << " demonstrations fitted, " << parts.calibrating.size()
       << " for thresholds, " << parts.left_out.size() << " left out, " << further.size()
       << " further episodes; " << guard->task().features().num_features() << " features; "
       << parts.fitted.layout.state_dim() << " entries of a state\n";
  if (guard->reduction() != nullptr) {
    for (auto* episodes :
         {&parts.fitted.trajectories, &parts.calibrating, &parts.left_out, &further}) {
      ReduceStates(*guard, *episodes);
    }
    parts.fitted.layout = guard->task_layout();
    guard = safety::GuardModel::Fit(parts.fitted.layout, parts.fitted.trajectories,
                                    {.accept_any = true});
  }
  const FittedTask fit(guard);
  std::vector<double> durations;
  for (const core::Trajectory& d : parts.fitted.trajectories) durations.push_back(d.num_steps());
  const int until = static_cast<int>(core::Quantile(durations, 0.5));
  DetectionReport report;
  report.table.header = {"detector", "left out",          "completed",
                         "failed",   "balanced accuracy", "lead"};
  report.table.caption = core::Format(
      "Episodes with an alarm in the first %d controls, in %%. Thresholds are set for %.0f %% of "
      "demonstrations. Lead: median number of controls from the alarm to the end of a failure.",
      until, 100.0 * detection.false_alarms);
  int states = 0;
  int inside = 0;
  for (const std::string_view name : kDetectors) {
    const auto detector =
        MakeDetector(name, fit, parts.fitted, core::DeriveSeed(detection.seed, {3}));
    const double threshold = CalibratedThreshold(Score(*detector, parts.calibrating, false), until,
                                                 detection.false_alarms);
    const auto left_out = Score(*detector, parts.left_out, false);
    report.table.rows.push_back(RowOf(std::string(name), RatesOf(left_out, threshold, until),
                                      RatesOf(Score(*detector, further, true), threshold, until)));
    if (name != "guard") continue;
    for (const ScoredEpisode& episode : left_out) {
      states += static_cast<int>(episode.scores.size());
      inside += static_cast<int>(
          std::ranges::count_if(episode.scores, [](double score) { return score <= 0.0; }));
    }
  }
  text << core::Format("left-out states inside the guard's support: %.0f %%\n",
                       states > 0 ? 100.0 * inside / states : 0.0);
  report.text = core::Printable(text.str());
  return report;
}

}  // namespace dfr::study
