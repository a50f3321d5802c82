#include "dfr/experiment/experiment.h"

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <future>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "arrays.h"
#include "dfr/core/features/features.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/random.h"
#include "dfr/experiment/command_line.h"
#include "dfr/experiment/episodes.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/ledger.h"
#include "dfr/experiment/report.h"

namespace py = pybind11;

namespace dfr::python {
namespace {

using Value = std::variant<bool, std::int64_t, double, std::string>;
using Values = std::map<std::string, Value>;
using Settings = std::map<std::string, std::string>;

// A unit that runs in Python, in a separate process. Threads of the engine call it.
class PythonRunner final : public experiment::TrialRunner {
 public:
  PythonRunner(py::object runner, const std::vector<std::string>& methods)
      : runner_(std::move(runner)), methods_(methods) {}
  // Python's C interface does not throw. NOLINTNEXTLINE(bugprone-exception-escape)
  ~PythonRunner() override {
    WithLock([this] {
      PyObject* ended = PyObject_CallMethod(runner_.ptr(), "close", nullptr);
      if (ended == nullptr) PyErr_WriteUnraisable(runner_.ptr());
      Py_XDECREF(ended);
      Py_DECREF(runner_.release().ptr());
    });
  }
  PythonRunner(const PythonRunner&) = delete;
  PythonRunner& operator=(const PythonRunner&) = delete;

  bool Accepts(std::uint64_t start_seed) override {
    return WithLock([&] { return runner_.attr("accepts")(start_seed).cast<bool>(); });
  }

  experiment::EpisodeResult Run(int method, std::uint64_t start_seed,
                                std::uint64_t controller_seed) override {
    return WithLock(
        [&] { return ResultOf(runner_.attr("run")(method, start_seed, controller_seed)); });
  }

  // Writes a page (.html) with the plant's pictures, if any, and the states. For a .png, writes the
  // pictures alone.
  bool Film(const std::vector<int>& methods, std::uint64_t start_seed,
            std::uint64_t controller_seed, const std::filesystem::path& path) override {
    const bool alone = path.extension() == ".png";
    std::vector<experiment::FilmedEpisode> episodes;
    std::string pictures;
    WithLock([&] {
      const auto film = runner_.attr("film")(methods, start_seed, controller_seed, alone)
                            .cast<std::pair<py::list, py::bytes>>();
      pictures = film.second;
      for (std::size_t i = 0; i < methods.size(); ++i) {
        const auto [result, states, recovery] =
            film.first[i].cast<std::tuple<py::object, Array, std::vector<bool>>>();
        episodes.push_back({.method = methods_.at(static_cast<std::size_t>(methods[i])),
                            .result = ResultOf(result),
                            .states = Rows(states, "states"),
                            .recovery = recovery});
      }
    });
    std::vector<experiment::ReportMedia> media;
    if (!pictures.empty()) {
      std::string caption;
      for (const experiment::FilmedEpisode& episode : episodes) {
        caption.append(caption.empty() ? "Left to right: " : ", ").append(episode.method);
      }
      media.push_back({"film.png", caption, pictures});
    }
    if (alone) {
      core::ReplaceFile(path, pictures);
      return true;
    }
    core::StateLayout layout;
    layout.Add("state", static_cast<int>(episodes.front().states.cols()));
    experiment::SaveFilm("Episodes from one start state", layout, episodes, path, "", media);
    return true;
  }

 private:
  static experiment::EpisodeResult ResultOf(const py::object& told) {
    const auto [outcome, cause, controls, recovery_controls, changed_controls, seconds] =
        told.cast<std::tuple<std::string, std::string, int, int, int, double>>();
    experiment::EpisodeResult result{.cause = cause,
                                     .controls = controls,
                                     .recovery_controls = recovery_controls,
                                     .changed_controls = changed_controls,
                                     .seconds = seconds};
    for (const auto known :
         {core::Outcome::kCompleted, core::Outcome::kHalted, core::Outcome::kCollided}) {
      if (outcome == core::Name(known)) result.outcome = known;
    }
    return result;
  }

  py::object runner_;
  std::vector<std::string> methods_;
};

std::string TextOf(const Value& value) {
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  if (const auto* truth = std::get_if<bool>(&value)) return *truth ? "true" : "false";
  if (const auto* whole = std::get_if<std::int64_t>(&value)) return std::to_string(*whole);
  return experiment::Exactly(std::get<double>(value));
}

// Returns the plan with the class's defaults, which options of the command line may replace.
experiment::EvaluationPlan PlanOf(const py::dict& defaults) {
  experiment::EvaluationPlan plan;
  plan.methods = defaults["methods"].cast<std::vector<std::string>>();
  plan.learners = defaults["learners"].cast<std::vector<std::string>>();
  plan.demonstrations = defaults["demonstrations"].cast<std::vector<int>>();
  plan.trials = defaults["trials"].cast<int>();
  plan.episodes = defaults["episodes"].cast<int>();
  return plan;
}

// Runs the command line `arguments` of an experiment in the file `program`. Returns the exit code
// if nothing else remains to be done, otherwise the summary's text, or None for a shard. Calls
// `begin` with the chosen settings before there are threads. `begin` returns (settings, make, end),
// where make(trial, demonstrations, learner) creates the callable of a PythonRunner, and end() ends
// all of them after Ctrl-C.
py::object RunExperiment(const std::vector<std::string>& arguments, const std::string& name,
                         const std::string& program, const std::string& title,
                         const py::dict& defaults, const Values& parameters,
                         const py::function& begin) {
  CLI::App app(title, program);
  app.require_subcommand(1);
  experiment::EvaluationPlan plan = PlanOf(defaults);
  experiment::ExperimentOptions options;
  options.out = "out/" + name;
  options.seed = 1;
  Values chosen = parameters;
  CLI::App* command =
      app.add_subcommand("experiment", "Compare all methods from the same start states");
  experiment::AddRunOptions(*command, options);
  command->option_defaults()->always_capture_default();
  command->add_option("--methods", plan.methods, "methods; the first is the reference")
      ->delimiter(',');
  command->add_option("--learners", plan.learners, "kinds of learned policies")->delimiter(',');
  command
      ->add_option("--demonstrations", plan.demonstrations, "numbers of demonstrations, ascending")
      ->delimiter(',');
  command->add_option("--trials", plan.trials, "number of independent repetitions");
  command->add_option("--episodes", plan.episodes,
                      "number of start states per trial and number of demonstrations");
  for (auto& [parameter, value] : chosen) {
    std::visit([&, &key = parameter](auto& choice) { command->add_option("--" + key, choice); },
               value);
  }
  std::vector<const char*> words = {program.c_str()};
  for (const std::string& argument : arguments) words.push_back(argument.c_str());
  if (const auto code =
          experiment::Parse(app, static_cast<int>(words.size()), words.data(), {".html", ".png"})) {
    return py::int_(*code);
  }
  plan.seed = options.seed;
  const auto units = options.rerun.episode.empty() ? experiment::UnitsOf(plan).size() : 1;
  const std::size_t wanted = options.threads > 0
                                 ? static_cast<std::size_t>(options.threads)
                                 : std::max(1u, std::thread::hardware_concurrency());
  const std::size_t processes = std::clamp<std::size_t>(units, 1, wanted);
  options.threads = static_cast<int>(processes);
  const auto [settings, make, end] = begin(chosen, plan.seed, plan.methods, processes)
                                         .cast<std::tuple<Settings, py::function, py::function>>();
  const experiment::MakeTrialRunner make_runner = [&make = make,
                                                   &plan](const experiment::EvaluationUnit& unit) {
    return WithLock([&] {
      return std::make_unique<PythonRunner>(make(unit.trial, unit.demonstrations, unit.learner),
                                            plan.methods);
    });
  };
  const Unlocked unlocked;
  const experiment::OutputFolder folder(options, plan);
  std::optional<experiment::ExperimentResult> found;
  // This thread handles Python's signals, so the engine has another one. Its future has no value:
  // the module would export the symbols of a future of a type of this library.
  auto engine = std::async(std::launch::async, [&, &settings = settings] {
    found = experiment::RunExperiment(name, plan, make_runner, settings, options);
  });
  while (engine.wait_for(std::chrono::milliseconds(100)) != std::future_status::ready) {
    const bool interrupted = WithLock([&end = end] {
      if (PyErr_CheckSignals() == 0) return false;
      const py::error_scope interrupt;
      end();
      return true;
    });
    if (!interrupted) continue;
    engine.wait();
    WithLock([] { throw py::error_already_set(); });
  }
  engine.get();
  std::string text;
  if (found) {
    experiment::PrintTable(found->summary, std::cout);
    std::cout.flush();
    if (!options.out.empty()) {
      experiment::ReportOptions report{.title = title, .program = program};
      report.settings.assign(settings.begin(), settings.end());
      experiment::SaveReport(found->summary, report, options.out / "report.html");
    }
    text = experiment::ToJson(found->summary);
  }
  return WithLock([&] { return found ? py::object(py::str(text)) : py::none(); });
}

// Returns one episode of a ledger and the settings of its run.
py::dict FindEpisode(const std::filesystem::path& folder, const std::string& name) {
  const experiment::RecordedEpisode episode = experiment::FindEpisode(folder, name);
  py::dict found;
  found["trial"] = episode.id.unit.trial;
  found["demonstrations"] = episode.id.unit.demonstrations;
  found["learner"] = episode.id.unit.learner;
  found["method"] = episode.id.method;
  found["start_seed"] = episode.start_seed;
  found["controller_seed"] = episode.controller_seed;
  found["seed"] = episode.header.plan.seed;
  found["settings"] = episode.header.settings;
  found["commit"] = episode.header.commit;
  return found;
}

std::uint64_t DeriveSeed(std::uint64_t seed, std::uint64_t stream, std::uint64_t trial,
                         std::uint64_t index) {
  return core::DeriveSeed(seed, {stream, trial, index});
}

}  // namespace

void AddExperiment(py::module_& module) {
  module.def("run_experiment", &RunExperiment);
  module.def("find_episode", &FindEpisode);
  module.def("derive_seed", &DeriveSeed);
  module.def("setting_of", &TextOf);
}

}  // namespace dfr::python
