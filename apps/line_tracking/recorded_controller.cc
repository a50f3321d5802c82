#include "recorded_controller.h"

#include <bit>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/inputs.h"
#include "dfr/core/build_info.h"
#include "dfr/core/text/format.h"
#include "dfr/recording/read_recording.h"
#include "dfr/runtime/periodic_timer.h"
#include "model.h"

namespace dfr::apps::line_tracking {
namespace {

bool Same(double a, double b) {
  return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b) || (a != a && b != b);
}

// Describes the difference between a recorded and a repeated decision; empty if they agree.
std::string Difference(const recording::StepRecord& was, const control::Step& step,
                       std::span<const double> u) {
  const auto number = [](const char* name, double then, double now) {
    return core::Format("%s %.17g, now %.17g", name, then, now);
  };
  if (was.mode.view() != control::Name(step.mode)) {
    return "mode " + std::string(was.mode.view()) + ", now " + control::Name(step.mode);
  }
  if (was.cause.view() != control::Name(step.cause)) {
    return "cause " + std::string(was.cause.view()) + ", now " + control::Name(step.cause);
  }
  if (was.t != step.t) return number("t", was.t, step.t);
  if (was.iteration != step.iteration) return number("iteration", was.iteration, step.iteration);
  if (!Same(was.g, step.g)) return number("g", was.g, step.g);
  if (!Same(was.log_g, step.log_g)) return number("log g", was.log_g, step.log_g);
  if (!Same(was.threshold, step.threshold)) {
    return number("threshold", was.threshold, step.threshold);
  }
  const std::span<const double> command = was.command.view();
  if (command.size() != u.size()) return "different number of control entries";
  for (std::size_t i = 0; i < u.size(); ++i) {
    if (!Same(command[i], u[i])) return number("control", command[i], u[i]);
  }
  return {};
}

}  // namespace

void RecordedController::DoReset(std::uint64_t seed) noexcept {
  seed_ = seed;
  controller_->Reset(seed);
}

control::Step RecordedController::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  const std::int64_t start_ns = runtime::SteadyNow();
  const control::Step step = controller_->Next(x, u);
  decision_s_ = 1e-9 * static_cast<double>(runtime::SteadyNow() - start_ns);
  if (on_decision) on_decision(step);
  Record(step, x, u);
  return step;
}

void RecordedController::Record(const control::Step& step, std::span<const double> x,
                                std::span<const double> u) noexcept {
  if (recorder_ == nullptr) return;
  recording::StepRecord record;
  record.time_ns = runtime::WallNow();
  record.episode = episode_;
  record.seed = seed_;
  record.t = step.t;
  record.iteration = step.iteration;
  record.mode = control::Name(step.mode);
  record.cause = control::Name(step.cause);
  record.applied = step.mode != control::Mode::kHalt;
  record.filtered = step.filtered;
  record.certified = step.certified;
  record.g = step.g;
  record.log_g = step.log_g;
  record.threshold = step.threshold;
  record.decision_s = decision_s_;
  record.state.Assign(x);
  record.command.Assign(u);
  if (describe) describe(record);
  static_cast<void>(recorder_->Record(record));
}

bool ReplayRecording(const std::filesystem::path& path, const std::filesystem::path& model_folder) {
  MustExist(path, "Run `line_tracking run` first, which writes logs, or name another log");
  const recording::Recording log = recording::ReadRecording(path);
  const std::filesystem::path folder =
      model_folder.empty() ? std::filesystem::path(log.metadata.model) : model_folder;
  if (!std::filesystem::exists(folder)) {
    throw std::runtime_error(folder.string() +
                             ": the recording's model does not exist; name it with "
                             "--model");
  }
  std::cout << path.string() << ": " << log.steps.size() << " decisions by "
            << core::Printable(log.metadata.method) << ", seed " << log.metadata.seed << ", commit "
            << core::Printable(log.metadata.commit) << '\n';
  if (log.metadata.commit != core::BuildCommit()) {
    std::cout << "  this program is of commit " << core::BuildCommit()
              << ", whose methods may decide differently\n";
  }
  if (!log.finished) {
    std::cout << "  it is incomplete: its program was killed, or is still running\n";
  }
  if (log.dropped_records > 0) {
    std::cout << "  " << log.dropped_records << " records are missing\n";
  }
  for (const std::string& damage : log.damage) {
    std::cout << "  it is " << core::Printable(damage) << '\n';
  }
  if (log.steps.empty()) {
    throw std::runtime_error(path.string() + " contains no decision to repeat");
  }
  if (recording::Checksum(folder) != log.metadata.model_checksum) {
    std::cout << "  the model in " << core::Printable(folder.string())
              << " is not the recording's model\n";
  }
  const LineModel model = LineModel::Load(folder);
  const std::unique_ptr<control::Controller> controller = model.MakeController(log.metadata.method);
  std::vector<double> u(static_cast<std::size_t>(controller->control_dim()));
  constexpr int kShown = 10;
  int differences = 0;
  const recording::StepRecord* last = nullptr;
  // Decisions depend on earlier decisions of the episode. After a missing decision the rest of
  // the episode cannot be repeated.
  bool gap = false;
  int left_out = 0;
  std::uint32_t number = 0;
  for (std::size_t i = 0; i < log.steps.size(); ++i) {
    const recording::StepRecord& record = log.steps[i];
    gap = gap || log.step_numbers[i] != number + 1;
    number = log.step_numbers[i];
    if (last == nullptr || last->episode != record.episode) {
      gap = gap && record.t != 0;
      controller->Reset(record.seed);
    }
    last = &record;
    if (gap) {
      ++left_out;
      continue;
    }
    const control::Step step = controller->Next(record.state.view(), u);
    const std::string difference = Difference(record, step, u);
    if (difference.empty()) continue;
    if (++differences <= kShown) {
      std::cout << "  episode " << record.episode << ", t " << record.t << ": "
                << core::Printable(difference) << '\n';
    }
  }
  if (differences > kShown) std::cout << "  and " << differences - kShown << " more\n";
  if (left_out > 0) {
    std::cout << "  " << left_out << " decisions follow a missing one, and were skipped\n";
  }
  if (left_out == static_cast<int>(log.steps.size())) {
    throw std::runtime_error(path.string() +
                             " contains no episode that can be repeated from its beginning");
  }
  std::cout << (differences == 0 ? "all decisions are the same\n"
                                 : std::to_string(differences) + " decisions differ\n");
  return differences == 0;
}

}  // namespace dfr::apps::line_tracking
