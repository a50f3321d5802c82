#include "dfr/imitation/trpo.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "checks.h"
#include "dfr/core/contract.h"
#include "dfr/core/text/format.h"
#include "mlp/adam.h"
#include "regression.h"
#include "trpo_options.h"
#include "trust_region.h"

namespace dfr::imitation {
namespace {

constexpr std::string_view kCheckpointKind = "trpo-checkpoint";
constexpr int kCheckpointVersion = 2;

// Purposes of the random streams.
enum Purpose : std::uint64_t { kWeights, kCriticWeights, kEpisode, kNoise, kShuffle };

// The line search tries the full step, then multiplies the step by this factor at each attempt.
constexpr double kBacktrack = 0.8;
constexpr int kMaxBacktracks = 15;

std::vector<int> Sizes(int inputs, const std::vector<int>& hidden, int outputs) {
  std::vector<int> sizes = {inputs};
  sizes.insert(sizes.end(), hidden.begin(), hidden.end());
  sizes.push_back(outputs);
  return sizes;
}

// Mean and variance of all rows so far, updated batch by batch (Chan, Golub and LeVeque, 1983).
struct Moments {
  double count = 0.0;
  Eigen::RowVectorXd mean;
  Eigen::RowVectorXd squares;  // sums of squared deviations from the mean

  explicit Moments(int dim)
      : mean(Eigen::RowVectorXd::Zero(dim)), squares(Eigen::RowVectorXd::Zero(dim)) {}

  void Add(const core::Matrix& rows) {
    const auto n = static_cast<double>(rows.rows());
    const Eigen::RowVectorXd batch_mean = rows.colwise().mean();
    const Eigen::RowVectorXd shift = batch_mean - mean;
    squares += (rows.rowwise() - batch_mean).array().square().matrix().colwise().sum() +
               shift.cwiseAbs2() * (count * n / (count + n));
    mean += shift * (n / (count + n));
    count += n;
  }

  [[nodiscard]] Whitening whitening() const {
    Eigen::VectorXd scale = (squares / count).cwiseSqrt().transpose();
    for (Eigen::Index i = 0; i < scale.size(); ++i) {
      if (!(scale[i] > 1e-9 * std::abs(mean[i]))) scale[i] = 1.0;  // constant so far
    }
    return {mean.transpose(), scale};
  }
};

// Steps of several whole episodes, one step per row.
struct Batch {
  core::Matrix features;  // not whitened
  core::Matrix controls;  // before clipping
  std::vector<double> rewards;
  std::vector<int> lengths;  // lengths of the episodes
  int completed = 0;
  int collided = 0;

  [[nodiscard]] Eigen::Index size() const { return static_cast<Eigen::Index>(rewards.size()); }
};

}  // namespace

class Trpo::Learner {
 public:
  Learner(Environment& environment, TrpoOptions options)
      : environment_(&environment),
        options_(internal::CheckedTrpoOptions(std::move(options))),
        selection_(core::FeatureSelection::Of(environment.plant().layout(), options_.features)),
        mlp_(Network(kWeights, selection_.num_features(), options_.hidden,
                     environment.plant().control_dim(), 0.01)),
        log_std_(
            Eigen::VectorXd::Constant(environment.plant().control_dim(), options_.initial_log_std)),
        critic_(
            Network(kCriticWeights, selection_.num_features() + 1, options_.critic_hidden, 1, 1.0)),
        critic_adam_(critic_.num_parameters(), options_.critic_learning_rate),
        moments_(selection_.num_features()),
        whitening_(Whitening::Identity(selection_.num_features())) {}

  TrpoProgress Iterate();
  [[nodiscard]] GaussianPolicy policy() const;
  [[nodiscard]] std::int64_t steps() const noexcept { return steps_; }
  [[nodiscard]] const TrpoOptions& options() const noexcept { return options_; }
  void Save(const std::filesystem::path& checkpoint) const;
  void LoadState(core::ArchiveReader& archive);

 private:
  [[nodiscard]] Mlp Network(Purpose purpose, int inputs, const std::vector<int>& hidden,
                            int outputs, double output_scale) const {
    core::Random random(core::DeriveSeed(options_.seed, {purpose}));
    return {Sizes(inputs, hidden, outputs), random, output_scale};
  }

  [[nodiscard]] Batch Collect(int min_steps, core::Random& noise);
  [[nodiscard]] core::Matrix CriticInputs(const Batch& batch, const core::Matrix& whitened) const;
  void UpdatePolicy(const core::Matrix& whitened, const Batch& batch,
                    const Eigen::VectorXd& advantages, TrpoProgress& progress);
  void FitCritic(const core::Matrix& inputs, const Eigen::VectorXd& targets);
  void RescaleCritic(double mean, double scale);

  Environment* environment_;
  TrpoOptions options_;
  core::FeatureSelection selection_;
  Mlp mlp_;
  Eigen::VectorXd log_std_;
  Mlp critic_;  // the value is critic_mean_ + critic_scale_ * output
  double critic_mean_ = 0.0;
  double critic_scale_ = 1.0;
  internal::Adam critic_adam_;
  Moments moments_;
  Whitening whitening_;
  int iteration_ = 0;
  std::int64_t steps_ = 0;
  std::int64_t episodes_ = 0;
};

Batch Trpo::Learner::Collect(int min_steps, core::Random& noise) {
  const core::Plant& plant = environment_->plant();
  const auto state_dim = static_cast<std::size_t>(plant.state_dim());
  const auto control_dim = static_cast<std::size_t>(plant.control_dim());
  const auto num_features = static_cast<std::size_t>(selection_.num_features());
  std::vector<double> state(state_dim), features(num_features), whitened(num_features);
  std::vector<double> control(control_dim), clipped(control_dim);
  std::vector<double> all_features, all_controls;
  const std::size_t room =
      static_cast<std::size_t>(min_steps) + static_cast<std::size_t>(options_.horizon);
  all_features.reserve(room * num_features);
  all_controls.reserve(room * control_dim);
  const Eigen::ArrayXd std = log_std_.array().exp();
  Batch batch;

  while (batch.size() < min_steps) {
    const std::uint64_t seed =
        core::DeriveSeed(options_.seed, {kEpisode, static_cast<std::uint64_t>(episodes_++)});
    environment_->Reset(seed);
    int length = 0;
    for (bool ended = false; !ended && length < options_.horizon; ++length) {
      plant.Observe(state);
      selection_.Apply(state, features);
      if (!core::AllFinite(features)) {
        throw std::runtime_error("the environment's state is not finite at step " +
                                 std::to_string(length) + " of the episode with seed " +
                                 std::to_string(seed));
      }
      whitening_.Apply(features, whitened);
      mlp_.Forward(whitened, control);
      for (std::size_t i = 0; i < control_dim; ++i) {
        control[i] += std[static_cast<Eigen::Index>(i)] * noise.Normal();
        clipped[i] = std::clamp(control[i], -options_.control_limit, options_.control_limit);
      }
      const Environment::StepResult result = environment_->Step(clipped);
      if (!std::isfinite(result.reward)) {
        throw std::runtime_error("the environment's reward is not finite at step " +
                                 std::to_string(length) + " of the episode with seed " +
                                 std::to_string(seed));
      }
      all_features.insert(all_features.end(), features.begin(), features.end());
      all_controls.insert(all_controls.end(), control.begin(), control.end());
      batch.rewards.push_back(result.reward);
      ended = result.terminal;
    }
    batch.lengths.push_back(length);
    if (plant.collided()) {
      ++batch.collided;
    } else if (plant.completed()) {
      ++batch.completed;
    }
  }
  steps_ += batch.size();
  batch.features =
      Eigen::Map<const core::Matrix>(all_features.data(), batch.size(), selection_.num_features());
  batch.controls =
      Eigen::Map<const core::Matrix>(all_controls.data(), batch.size(), plant.control_dim());
  return batch;
}

core::Matrix Trpo::Learner::CriticInputs(const Batch& batch, const core::Matrix& whitened) const {
  core::Matrix inputs(whitened.rows(), whitened.cols() + 1);
  inputs.leftCols(whitened.cols()) = whitened;
  Eigen::Index row = 0;
  for (const int length : batch.lengths) {
    for (int t = 0; t < length; ++t) {
      inputs(row++, whitened.cols()) = static_cast<double>(t) / options_.horizon;
    }
  }
  return inputs;
}

TrpoProgress Trpo::Learner::Iterate() {
  core::Random noise(
      core::DeriveSeed(options_.seed, {kNoise, static_cast<std::uint64_t>(iteration_)}));
  if (iteration_ == 0) {
    moments_.Add(Collect(std::max(2, options_.batch_steps / 4), noise).features);
    whitening_ = moments_.whitening();
  }
  const Batch batch = Collect(options_.batch_steps, noise);
  const core::Matrix whitened = whitening_.Apply(batch.features);
  const core::Matrix critic_inputs = CriticInputs(batch, whitened);

  Mlp::Workspace workspace;
  const Eigen::VectorXd values =
      (critic_mean_ + critic_scale_ * critic_.Forward(critic_inputs, workspace).col(0).array());
  Eigen::VectorXd advantages(batch.size());
  std::size_t first = 0;
  for (const int length : batch.lengths) {
    const auto count = static_cast<std::size_t>(length);
    GeneralizedAdvantages(std::span(batch.rewards).subspan(first, count),
                          core::AsSpan(values).subspan(first, count), options_.discount,
                          options_.gae_lambda, core::AsSpan(advantages).subspan(first, count));
    first += count;
  }
  const Eigen::VectorXd targets = advantages + values;
  const auto variance = [](const Eigen::VectorXd& v) {
    return (v.array() - v.mean()).square().mean();
  };

  TrpoProgress progress;
  progress.episodes = static_cast<int>(batch.lengths.size());
  progress.mean_return = core::AsVector(batch.rewards).sum() / progress.episodes;
  progress.mean_length = static_cast<double>(batch.size()) / progress.episodes;
  progress.completed = static_cast<double>(batch.completed) / progress.episodes;
  progress.collided = static_cast<double>(batch.collided) / progress.episodes;
  const double target_variance = variance(targets);
  if (!std::isfinite(target_variance)) {
    throw std::runtime_error(core::Format(
        "the squares of the returns are not finite: scale the rewards down, or choose a smaller "
        "critic_learning_rate than %g",
        options_.critic_learning_rate));
  }
  progress.explained_variance =
      target_variance > 0.0 ? 1.0 - variance(targets - values) / target_variance : 0.0;

  const double spread = std::sqrt(variance(advantages));
  if (spread > 0.0) {  // otherwise all controls were equally good
    const Eigen::VectorXd normalised = (advantages.array() - advantages.mean()) / spread;
    UpdatePolicy(whitened, batch, normalised, progress);
  }
  FitCritic(critic_inputs, targets);
  moments_.Add(batch.features);
  whitening_ = moments_.whitening();

  progress.iteration = ++iteration_;
  progress.steps = steps_;
  progress.entropy =
      (log_std_.array() + 0.5 * std::log(2.0 * std::numbers::pi * std::numbers::e)).sum();
  return progress;
}

void Trpo::Learner::UpdatePolicy(const core::Matrix& whitened, const Batch& batch,
                                 const Eigen::VectorXd& advantages, TrpoProgress& progress) {
  internal::TrustRegionProblem problem(mlp_, log_std_, whitened, batch.controls, advantages);
  const Eigen::Index network = mlp_.num_parameters();
  Eigen::VectorXd gradient = problem.gradient();
  for (Eigen::Index i = 0; i < log_std_.size(); ++i) {
    // At the minimum, a step further down would only consume the KL bound.
    if (log_std_[i] <= options_.min_log_std)
      gradient[network + i] = std::max(0.0, gradient[network + i]);
  }
  const auto damped_fisher = [&](const Eigen::VectorXd& v, Eigen::VectorXd& product) {
    problem.FisherVectorProduct(v, product);
    product += options_.cg_damping * v;
  };
  const Eigen::VectorXd direction =
      internal::ConjugateGradient(damped_fisher, gradient, options_.cg_iterations);
  Eigen::VectorXd image(direction.size());
  damped_fisher(direction, image);
  const double curvature = direction.dot(image);
  if (!(curvature > 0.0)) return;

  double step = std::sqrt(2.0 * options_.max_kl / curvature);
  for (int i = 0; i < kMaxBacktracks; ++i, step *= kBacktrack) {
    Eigen::VectorXd theta = problem.theta() + step * direction;
    theta.tail(log_std_.size()) = theta.tail(log_std_.size()).cwiseMax(options_.min_log_std);
    if (!theta.allFinite()) continue;
    const auto [gain, kl] = problem.Evaluate(theta);
    if (gain > 0.0 && kl <= options_.max_kl) {
      mlp_.SetParameters(theta.head(network));
      log_std_ = theta.tail(log_std_.size());
      progress.kl = kl;
      progress.surrogate_gain = gain;
      progress.accepted = true;
      return;
    }
  }
}

// Changes mean and scale of the critic's output without changing the value function. Adam's targets
// then have unit scale (van Hasselt et al., 2016).
void Trpo::Learner::RescaleCritic(double mean, double scale) {
  Eigen::VectorXd parameters = critic_.parameters();
  const int last_hidden = critic_.sizes()[critic_.sizes().size() - 2];
  auto weights = parameters.segment(parameters.size() - 1 - last_hidden, last_hidden);
  double& bias = parameters[parameters.size() - 1];
  weights *= critic_scale_ / scale;
  bias = (critic_scale_ * bias + critic_mean_ - mean) / scale;
  critic_.SetParameters(parameters);
  critic_mean_ = mean;
  critic_scale_ = scale;
}

void Trpo::Learner::FitCritic(const core::Matrix& inputs, const Eigen::VectorXd& targets) {
  const double mean = targets.mean();
  const double scale = std::sqrt((targets.array() - mean).square().mean());
  RescaleCritic(mean, scale > 0.0 ? scale : 1.0);

  const core::Matrix whitened = (targets.array() - critic_mean_) / critic_scale_;
  core::Random random(
      core::DeriveSeed(options_.seed, {kShuffle, static_cast<std::uint64_t>(iteration_)}));
  try {
    internal::FitByAdam(inputs, whitened, options_.critic_epochs, options_.critic_batch,
                        /*weight_decay=*/0.0, critic_adam_, random, critic_);
  } catch (const std::invalid_argument& e) {
    throw std::runtime_error(
        core::Format("the critic diverges: choose a smaller critic_learning_rate than %g: %s",
                     options_.critic_learning_rate, e.what()));
  }
}

GaussianPolicy Trpo::Learner::policy() const {
  return {MlpPolicy(environment_->plant().layout(), options_.features, whitening_, mlp_,
                    Eigen::VectorXd::Constant(mlp_.output_dim(), options_.control_limit)),
          log_std_};
}

void Trpo::Learner::Save(const std::filesystem::path& checkpoint) const {
  core::ArchiveWriter archive(kCheckpointKind, kCheckpointVersion);
  internal::SaveTrpoOptions(options_, archive);
  mlp_.Save(archive);
  archive.Numbers(core::AsSpan(log_std_));
  critic_.Save(archive);
  archive.Number(critic_mean_);
  archive.Number(critic_scale_);
  critic_adam_.Save(archive);
  archive.Number(moments_.count);
  archive.Numbers({moments_.mean.data(), static_cast<std::size_t>(moments_.mean.size())});
  archive.Numbers({moments_.squares.data(), static_cast<std::size_t>(moments_.squares.size())});
  archive.Integer(iteration_);
  archive.Integer(steps_);
  archive.Integer(episodes_);
  archive.Save(checkpoint);
}

void Trpo::Learner::LoadState(core::ArchiveReader& archive) {
  const auto network = [&](const Mlp& like, const char* name) {
    Mlp mlp = Mlp::Load(archive);
    if (mlp.sizes() != like.sizes()) {
      archive.Fail(std::string("the ") + name +
                   " does not belong to this environment and these options");
    }
    return mlp;
  };
  const auto numbers = [&](Eigen::Index size, const char* name) -> Eigen::VectorXd {
    const std::vector<double> values = archive.Numbers();
    if (core::AsVector(values).size() != size || !core::AllFinite(values)) {
      archive.Fail(std::string("the ") + name + " are not " + std::to_string(size) +
                   " finite numbers");
    }
    return core::AsVector(values);
  };
  mlp_ = network(mlp_, "policy");
  log_std_ = numbers(log_std_.size(), "log standard deviations");
  critic_ = network(critic_, "critic");
  const auto number = [&](const char* name, double low) {
    const double value = archive.Number();
    if (!std::isfinite(value) || value < low) {
      archive.Fail(core::Format("the %s is %g", name, value));
    }
    return value;
  };
  critic_mean_ = number("critic's mean", std::numeric_limits<double>::lowest());
  critic_scale_ = number("critic's scale", std::numeric_limits<double>::min());
  critic_adam_.Load(archive);
  moments_.count = number("number of observed states", 0.0);
  moments_.mean = numbers(moments_.mean.size(), "feature means").transpose();
  moments_.squares = numbers(moments_.squares.size(), "feature deviations").transpose();
  iteration_ = archive.IntegerIn(0, std::numeric_limits<int>::max());
  steps_ = archive.Integer();
  episodes_ = archive.Integer();
  archive.End();
  if (iteration_ > 0) whitening_ = moments_.whitening();
}

Trpo::Trpo(Environment& environment, TrpoOptions options)
    : learner_(std::make_unique<Learner>(environment, std::move(options))) {}

Trpo::Trpo(std::unique_ptr<Learner> learner) : learner_(std::move(learner)) {}

Trpo Trpo::Resume(Environment& environment, const std::filesystem::path& checkpoint) {
  core::ArchiveReader archive(checkpoint, kCheckpointKind, kCheckpointVersion);
  try {
    auto learner = std::make_unique<Learner>(environment, internal::LoadTrpoOptions(archive));
    learner->LoadState(archive);
    return Trpo(std::move(learner));
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

Trpo::Trpo(Trpo&&) noexcept = default;
Trpo& Trpo::operator=(Trpo&&) noexcept = default;
Trpo::~Trpo() = default;

TrpoProgress Trpo::Iterate() {
  Learner next = *learner_;
  const TrpoProgress progress = next.Iterate();
  *learner_ = std::move(next);
  return progress;
}
GaussianPolicy Trpo::policy() const { return learner_->policy(); }
std::int64_t Trpo::steps() const noexcept { return learner_->steps(); }
const TrpoOptions& Trpo::options() const noexcept { return learner_->options(); }
void Trpo::Save(const std::filesystem::path& checkpoint) const { learner_->Save(checkpoint); }

void GeneralizedAdvantages(std::span<const double> rewards, std::span<const double> values,
                           double discount, double lambda, std::span<double> advantages) noexcept {
  double next_value = 0.0;
  double next_advantage = 0.0;
  for (std::size_t t = rewards.size(); t-- > 0;) {
    const double residual = rewards[t] + discount * next_value - values[t];
    next_advantage = residual + discount * lambda * next_advantage;
    next_value = values[t];
    advantages[t] = next_advantage;
  }
}

}  // namespace dfr::imitation
