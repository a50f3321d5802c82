#include "apps/study/runner.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "apps/rollout_video.h"
#include "apps/study/imitator.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard.h"

namespace dfr::study {
namespace {

// Progress of an episode: the latest time step of the demonstrations whose support contained an
// observed state.
class Progress final : public control::RolloutObserver {
 public:
  explicit Progress(const core::LogDecisionFunction& support)
      : tracker_(support), last_(support.num_steps() - 1) {}
  void OnStart(std::span<const double> x) override { Follow(x); }
  void OnControl(const control::RolloutEvent& event) override { Follow(event.next_x); }
  // Returns the last phase reached, as a fraction of the last time step.
  [[nodiscard]] double share() const {
    return last_ > 0 ? static_cast<double>(reached_) / static_cast<double>(last_) : 1.0;
  }

 private:
  void Follow(std::span<const double> x) {
    if (tracker_.Follow(x) >= 0.0) reached_ = std::max(reached_, tracker_.phase());
  }

  control::PhaseTracker tracker_;
  int last_;
  int reached_ = 0;
};

experiment::DisturbanceOptions WithNoise(const Condition& condition, const Task& task) {
  experiment::DisturbanceOptions disturbance = condition.disturbance;
  disturbance.observation_noise = condition.noise * task.length;
  return disturbance;
}

}  // namespace

// A policy, alone or with a guard.
class Guarded final : public control::Controller, public LearnsOnline {
 public:
  /// The guard receives the state, or pictures of it from `camera`.
  Guarded(std::shared_ptr<Imitator> policy, const safety::GuardModel& model,
          const std::string& strategy, int state_dim, std::optional<Camera> camera)
      : policy_(std::move(policy)),
        camera_(std::move(camera)),
        state_dim_(state_dim),
        control_dim_(model.action_dim()),
        horizon_(model.settings().horizon) {
    if (strategy == kAlone) return;
    safety::GuardSettings settings = model.settings();
    settings.strategy = safety::ParseStrategy(strategy);
    guard_ = std::make_unique<safety::Guard>(model.With(settings));
    monitors_ = settings.strategy == safety::Strategy::kMonitor;
    if (camera_) picture_.resize(Camera::kSize);
  }
  [[nodiscard]] int state_dim() const noexcept override { return state_dim_; }
  [[nodiscard]] int control_dim() const noexcept override { return control_dim_; }
  void Applied(std::span<const double> u) noexcept override { policy_->Applied(u); }
  [[nodiscard]] Imitator& policy() noexcept { return *policy_; }
  // Source of the last control: "policy", or the guard's reason.
  [[nodiscard]] const char* chooser() const noexcept { return chooser_; }
  [[nodiscard]] bool monitors() const noexcept { return monitors_; }
  [[nodiscard]] bool alarmed() const noexcept { return alarmed_; }

 private:
  void DoReset(std::uint64_t seed) noexcept override {
    if (guard_ != nullptr) guard_->Reset(seed);
    if (camera_) camera_->Reset(seed);
    t_ = 0;
    chooser_ = "policy";
    alarmed_ = false;
  }
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    if (guard_ == nullptr && t_ == horizon_) return {.cause = control::HaltCause::kTimeUp};
    policy_->Control(t_, x, u);
    if (guard_ == nullptr) {
      policy_->Applied(u);
      return {.mode = control::Mode::kPolicy, .t = t_++};
    }
    if (camera_) camera_->See(x, picture_);
    const safety::Verdict verdict =
        guard_->Filter(t_++, camera_ ? std::span<const double>(picture_) : x, u, u);
    policy_->Applied(u);
    alarmed_ = alarmed_ || verdict.alarm;
    const bool unchanged = verdict.mode == control::Mode::kPolicy && !verdict.changed;
    chooser_ = unchanged ? "policy" : verdict.reason();
    return {.mode = verdict.mode,
            .cause = verdict.cause,
            .t = verdict.step,
            .g = verdict.g,
            .threshold = verdict.threshold,
            .filtered = verdict.changed,
            .change = verdict.change,
            .certified = verdict.certified};
  }

  std::shared_ptr<Imitator> policy_;
  std::unique_ptr<safety::Guard> guard_;  // null: the policy without a guard
  std::optional<Camera> camera_;
  std::vector<double> picture_;
  int state_dim_, control_dim_, horizon_;
  bool monitors_ = false;
  int t_ = 0;
  const char* chooser_ = "policy";
  bool alarmed_ = false;
};

void CheckKind(const Task& task, Kind kind) {
  DFR_THROW_UNLESS(kind != Kind::kPlane || task.plane,
                   "'" << task.name << "' is not a planar task");
  DFR_THROW_UNLESS(kind != Kind::kGuards || task.small != nullptr,
                   "guards run on tasks of the gallery only, not on '" << task.name << "'");
}

Prepared Prepare(const Task& task, Kind kind, int demonstrations, std::uint64_t seed, int trial,
                 const planar::MethodOptions& plane, const PictureOptions& pictures) {
  const auto stream = static_cast<std::uint64_t>(trial);
  const std::uint64_t shown = core::DeriveSeed(seed, {2, stream});
  const std::uint64_t learned = core::DeriveSeed(seed, {3, stream});
  Prepared prepared;
  if (kind == Kind::kControllers) {
    prepared.model = std::make_unique<const LearnedModel>(task.learn(demonstrations, shown));
  } else if (kind == Kind::kPlane) {
    prepared.plane = std::make_unique<const planar::Methods>(
        *task.plane, planar::Demonstrate(*task.plane, demonstrations, shown), plane, learned);
  } else {
    prepared.demonstrations = sim::Demonstrate(*task.small, demonstrations, shown);
    prepared.seed = learned;
    prepared.guard =
        FittedTask::Fit(task.small->plant->layout(), prepared.demonstrations, task.small->features);
    if (!pictures.features.empty()) {
      prepared.seeing = safety::GuardModel::Fit(
          PictureLayout(), Pictures(*task.small, prepared.demonstrations, pictures.shown),
          {.features = pictures.features, .accept_any = true});
    }
  }
  return prepared;
}

Runner::Runner(const Place& place, std::shared_ptr<const Prepared> prepared,
               const std::vector<std::string>& methods)
    : PlaceboRunner(place.variant->make(), WithNoise(*place.condition, *place.task)),
      task_(place.task),
      nuisances_(place.condition->nuisances),
      prepared_(std::move(prepared)) {
  const auto* model = prepared_->model.get();
  AddAll(
      methods, [this](const std::string& method) { return MakeController(method); },
      prepared_->fit(),
      model != nullptr ? model->demonstrations().trajectories : prepared_->demonstrations);
}

std::unique_ptr<control::Controller> Runner::MakeController(const std::string& method) {
  if (prepared_->model != nullptr) {
    return prepared_->model->controllers().Make(method, &driven(), task_->controllers);
  }
  if (prepared_->plane != nullptr) return prepared_->plane->Make(method, driven());
  const auto [strategy, policy, support] = Split(method);
  auto& imitator = imitators_[std::string(policy)];
  if (imitator == nullptr) {
    imitator = std::make_shared<Imitator>(Imitate(*task_->small, prepared_->demonstrations,
                                                  prepared_->fit(), driven(), std::string(policy),
                                                  prepared_->seed));
  }
  std::optional<Camera> camera;
  if (!support.empty()) camera.emplace(task_->small->plant, nuisances_);
  auto guarded = std::make_unique<Guarded>(
      imitator, camera ? *prepared_->seeing : *prepared_->guard->guard(), std::string(strategy),
      task_->small->plant->state_dim(), std::move(camera));
  guarded_.push_back(guarded.get());
  if (guarded->monitors()) {
    for (const auto outcome : {core::Outcome::kCompleted, core::Outcome::kCollided}) {
      alarms_[AlarmsIn(outcome, method)] = 0.0;
    }
  }
  return guarded;
}

Runner::~Runner() = default;

void Runner::Begin(int method, std::uint64_t start_seed) {
  PlaceboRunner::Begin(method, start_seed);
  method_ = method;
  if (!guarded_.empty()) guarded_[static_cast<std::size_t>(method)]->policy().Reset(start_seed);
}

experiment::EpisodeResult Runner::Run(int method, std::uint64_t start_seed,
                                      std::uint64_t controller_seed) {
  experiment::EpisodeResult result = PlaceboRunner::Run(method, start_seed, controller_seed);
  if (guarded_.empty()) return result;
  const Guarded& guarded = *guarded_[static_cast<std::size_t>(method)];
  if (guarded.monitors() && guarded.alarmed() && result.outcome != core::Outcome::kHalted) {
    ++alarms_[AlarmsIn(result.outcome, MethodName(method))];
  }
  return result;
}

bool Runner::Film(const std::vector<int>& methods, std::uint64_t start_seed,
                  std::uint64_t controller_seed, const std::filesystem::path& path) {
  if (!task_->draw || path.extension() == ".html") {
    return RolloutRunner::Film(methods, start_seed, controller_seed, path);
  }
  const Drawing drawing = task_->draw(world());
  std::vector<apps::RolloutVideo> videos;
  videos.reserve(methods.size());
  for (const int method : methods) {
    apps::RolloutVideoRecorder recorder(MethodName(method), drawing.width, drawing.height,
                                        drawing.draw, prepared_->fit().model().support());
    RunObserved(method, start_seed, controller_seed, &recorder);
    videos.push_back(recorder.Take());
  }
  apps::WriteVideo(path, videos);
  return true;
}

double Runner::Credit(int method, std::uint64_t start_seed, std::uint64_t controller_seed,
                      const experiment::EpisodeCredit& credit) {
  Progress progress(prepared_->fit().model().guided_support());
  const auto episode = ResultOf(RunObserved(method, start_seed, controller_seed, &progress));
  return credit(episode.outcome, progress.share());
}

std::string Runner::CauseOf(const control::RolloutResult& result) const {
  std::string cause = PlaceboRunner::CauseOf(result);
  if (cause == "placebo") return cause;
  if (!guarded_.empty() && result.outcome == core::Outcome::kCollided) {
    return guarded_[static_cast<std::size_t>(method_)]->chooser();
  }
  const bool filtered = prepared_->plane != nullptr && result.last_step.filtered;
  if (result.outcome == core::Outcome::kCollided && filtered) return "filter";
  return cause;
}

bool Runner::Inside(std::span<const double> x) const {
  return prepared_->plane == nullptr || prepared_->plane->Begins(x);
}

std::map<std::string, std::vector<int>> Runner::Counts() {
  std::map<std::string, std::vector<int>> counts;
  for (std::size_t m = 0; prepared_->plane != nullptr && m < recovery_lengths().size(); ++m) {
    counts[MethodName(static_cast<int>(m))] = recovery_lengths()[m];
  }
  return counts;
}

bool Runner::CollidesAfterHalt() {
  if (task_->settle) task_->settle(world());
  return world().collided();
}

std::string AlarmsIn(core::Outcome outcome, const std::string& method) {
  return std::string("alarms, ") + core::Name(outcome) + ": " + method;
}

}  // namespace dfr::study
