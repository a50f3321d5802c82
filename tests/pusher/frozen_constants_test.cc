#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <regex>
#include <sstream>
#include <string>

#include "apps/pusher/model.h"
#include "dfr/control/certified/certified_options.h"
#include "dfr/control/certified/constants.h"
#include "dfr/control/constants.h"
#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/guided/levels.h"
#include "dfr/control/guided/state_observer.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/control/published/derivative_free_recovery.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/imitation/locally_weighted_policy.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/constants.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "dfr/study/baselines.h"
#include "dfr/study/policies.h"

namespace dfr::apps {
namespace {

std::string Page() {
  std::ifstream file(DFR_FROZEN_CONSTANTS);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

std::map<std::string, double> InTheCode() {
  const control::GuidedOptions guided;
  const control::LevelOptions levels;
  const control::ResponseOptions jacobian;
  const control::CertifiedOptions certified;
  const kernel::WhitenedSupportOptions support;
  const pusher::ModelOptions pusher;
  const control::DfrOptions dfr;
  const sim::PusherOptions scene;
  const imitation::LocallyWeightedOptions lwr;
  return {{"GuidedOptions::iterations", guided.iterations},
          {"GuidedOptions::max_exit_ratio", guided.max_exit_ratio},
          {"GuidedOptions::patience", guided.patience},
          {"GuidedOptions::probe_size", guided.probe_size},
          {"GuidedOptions::online_weight", guided.online_weight},
          {"LevelOptions::gate_quantile", levels.gate_quantile},
          {"LevelOptions::pass_quantile", levels.pass_quantile},
          {"LevelOptions::edge_quantile", levels.edge_quantile},
          {"LevelOptions::slack", levels.slack},
          {"ResponseOptions::ridge", jacobian.ridge},
          {"ResponseOptions::drift_ridge", jacobian.drift_ridge},
          {"ResponseOptions::slope_ridge", jacobian.slope_ridge},
          {"ResponseOptions::prior_weight", jacobian.prior_weight},
          {"ResponseOptions::window", jacobian.window},
          {"ResponseOptions::max_per_step", jacobian.max_per_step},
          {"ResponseOptions::forgetting", jacobian.forgetting},
          {"TransitionStore::kBandwidth", control::TransitionStore::kBandwidth},
          {"TransitionStore::kNearest", control::TransitionStore::kNearest},
          {"TransitionStore::kSpread", control::TransitionStore::kSpread},
          {"guided::kMostLeft", control::guided::kMostLeft},
          {"guided::kSlackQuantile", control::guided::kSlackQuantile},
          {"guided::kMostError", control::guided::kMostError},
          {"guided::kNoiseRidge", control::guided::kNoiseRidge},
          {"guided::kWeightFloor", control::guided::kWeightFloor},
          {"guided::kDemonstratedRidge", control::guided::kDemonstratedRidge},
          {"guided::kMostWorse", control::guided::kMostWorse},
          {"guided::kNearness", control::guided::kNearness},
          {"guided::kPowerIterations", control::guided::kPowerIterations},
          {"guided::kLeastWeight", control::guided::kLeastWeight},
          {"guided::kEvidence", control::guided::kEvidence},
          {"guided::kNegligible", control::guided::kNegligible},
          {"guided::kLeastGain", control::guided::kLeastGain},
          {"guided::kEdgeMemory", control::guided::kEdgeMemory},
          {"guided::kEdgeStayQuantile", control::guided::kEdgeStayQuantile},
          {"guided::kLeastEdgeStay", control::guided::kLeastEdgeStay},
          {"guided::kEdgeRamp", control::guided::kEdgeRamp},
          {"guided::kMostRelocations", control::guided::kMostRelocations},
          {"guided::kWorthRaising", control::guided::kWorthRaising},
          {"guided::kMostFew", control::guided::kMostFew},
          {"guided::kLeastRepeated", control::guided::kLeastRepeated},
          {"guided::kLeastProbe", control::guided::kLeastProbe},
          {"guided::kLeastHedged", control::guided::kLeastHedged},
          {"guided::kAgreementStride", control::guided::kAgreementStride},
          {"guided::kIdle", control::guided::kIdle},
          {"guided::kIdleAtRest", control::guided::kIdleAtRest},
          {"guided::kRestDrift", control::guided::kRestDrift},
          {"guided::kPassDepthQuantile", control::guided::kPassDepthQuantile},
          {"guided::kPredictionQuantile", control::guided::kPredictionQuantile},
          {"guided::kShallowDepth", control::guided::kShallowDepth},
          {"guided::kResting", control::guided::kResting},
          {"guided::kDepthCorrections", control::guided::kDepthCorrections},
          {"guided::kLeadsAway", control::guided::kLeadsAway},
          {"guided::kMostAway", control::guided::kMostAway},
          {"guided::kLocalReach", control::guided::kLocalReach},
          {"guided::kClearSign", control::guided::kClearSign},
          {"guided::kUnknown", control::guided::kUnknown},
          {"guided::kMaxExitLevel", control::guided::kMaxExitLevel},
          {"StateObserver::kMaxLag", control::StateObserver::kMaxLag},
          {"PhaseTracker::kWindow", control::PhaseTracker::kWindow},
          {"PhaseTracker::kPenalty", control::PhaseTracker::kPenalty},
          {"fit::kFolds", safety::fit::kFolds},
          {"fit::kMostInGaps", safety::fit::kMostInGaps},
          {"fit::kMostDoublings", safety::fit::kMostDoublings},
          {"fit::kCoarseSteps", safety::fit::kCoarseSteps},
          {"fit::kLeftOutside", safety::fit::kLeftOutside},
          {"fit::kWantedInside", safety::fit::kWantedInside},
          {"fit::kMostWidenings", safety::fit::kMostWidenings},
          {"fit::kActionsPerStep", safety::fit::kActionsPerStep},
          {"fit::kActionReach", safety::fit::kActionReach},
          {"fit::kLeastMoved", safety::fit::kLeastMoved},
          {"fit::kProportional", safety::fit::kProportional},
          {"fit::kSameEffect", safety::fit::kSameEffect},
          {"fit::kContextUnit", safety::fit::kContextUnit},
          {"fit::kPassedExplain", safety::fit::kPassedExplain},
          {"fit::kSteeredExplain", safety::fit::kSteeredExplain},
          {"fit::kLeftVariance", safety::fit::kLeftVariance},
          {"fit::kLeastInside", safety::fit::kLeastInside},
          {"fit::kLeastInsideReduced", safety::fit::kLeastInsideReduced},
          {"fit::kMostBelowPassReduced", safety::fit::kMostBelowPassReduced},
          {"fit::kFeaturesOfGamma", safety::fit::kFeaturesOfGamma},
          {"fit::kMostByActions", safety::fit::kMostByActions},
          {"fit::kMostOutsideReduced", safety::fit::kMostOutsideReduced},
          {"fit::kLeastTold", safety::fit::kLeastTold},
          {"fit::kLeastExplainedReduced", safety::fit::kLeastExplainedReduced},
          {"fit::kFewestDemonstrations", safety::fit::kFewestDemonstrations},
          {"fit::kLeastAcceptance", safety::fit::kLeastAcceptance},
          {"fit::kMostChanged", safety::fit::kMostChanged},
          {"fit::kMostOutside", safety::fit::kMostOutside},
          {"fit::kLowestAlarm", safety::fit::kLowestAlarm},
          {"fit::kMostOvershoot", safety::fit::kMostOvershoot},
          {"fit::kLeastReach", safety::fit::kLeastReach},
          {"fit::kUnlikely", safety::fit::kUnlikely},
          {"fit::kLeastDrift", safety::fit::kLeastDrift},
          {"fit::kLeastResponse", safety::fit::kLeastResponse},
          {"fit::kLagGain", safety::fit::kLagGain},
          {"fit::kClockError", safety::fit::kClockError},
          {"fit::kConstantTolerance", safety::fit::kConstantTolerance},
          {"fit::kStandstillFactor", safety::fit::kStandstillFactor},
          {"fit::kStandstillMargin", safety::fit::kStandstillMargin},
          {"CertifiedOptions::iterations", certified.iterations},
          {"CertifiedOptions::patience", certified.patience},
          {"CertifiedOptions::probe_size", certified.probe_size},
          {"certified::kMaxExitRatio", control::certified::kMaxExitRatio},
          {"certified::kRounds", control::certified::kRounds},
          {"certified::kOvershoot", control::certified::kOvershoot},
          {"certified::kLeastPart", control::certified::kLeastPart},
          {"certified::kLeastShare", control::certified::kLeastShare},
          {"certified::kMaxStalls", control::certified::kMaxStalls},
          {"WhitenedSupportOptions::svm.nu", support.svm.nu},
          {"WhitenedSupportOptions::svm.gamma", support.svm.gamma},
          {"WhitenedSupportOptions::window", support.window},
          {"WhitenedSupportOptions::phase_ridge", support.phase_ridge},
          {"WhitenedSupportOptions::window_share", support.window_share},
          {"WhitenedSupportOptions::least_share", support.least_share},
          {"WhiteningOptions::ridge", core::WhiteningOptions().ridge},
          {"ModelOptions::epochs", pusher.epochs},
          {"ModelOptions::nu", pusher.nu},
          {"ModelOptions::gamma", pusher.gamma},
          {"ModelOptions::horizon", pusher.horizon},
          {"Learner::learning_rate", pusher.learner.learning_rate},
          {"DfrOptions::probe_fraction", dfr.probe_fraction},
          {"DfrOptions::step_fraction", dfr.step_fraction},
          {"PusherOptions::red_y", scene.red_y},
          {"PusherOptions::start_x_min", scene.start_x_min},
          {"PusherOptions::start_x_max", scene.start_x_max},
          {"PusherOptions::start_y", scene.start_y},
          {"EnsemblePolicy::kMembers", study::EnsemblePolicy::kMembers},
          {"NearestNeighbourPolicy::kNeighbours", study::NearestNeighbourPolicy::kNeighbours},
          {"LocallyWeightedOptions::window", lwr.window},
          {"LocallyWeightedOptions::width", lwr.width},
          {"LocallyWeightedOptions::ridge", lwr.ridge},
          {"LocallyWeightedOptions::max_per_step", lwr.max_per_step}};
}

// Fails if a constant differs from the page, or is added only to the page or only to this list.
TEST(FrozenConstantsTest, PageMatchesTheCode) {
  const std::string page = Page();
  ASSERT_FALSE(page.empty()) << DFR_FROZEN_CONSTANTS;
  std::map<std::string, double> frozen;
  const std::regex row(R"(\| (\w+::[\w.]+) \| ([-\d.e]+) \|)");
  for (std::sregex_iterator i(page.begin(), page.end(), row), end; i != end; ++i) {
    frozen[(*i)[1]] = std::stod((*i)[2]);
  }
  EXPECT_EQ(frozen, InTheCode());
}

TEST(FrozenConstantsTest, TheHeadlinesSeedIsTheirDate) {
  const std::string page = Page();
  std::smatch found;
  ASSERT_TRUE(std::regex_search(
      page, found,
      std::regex(
          R"(Frozen on (\d{4})-(\d{2})-(\d{2})(?:, change (\d))?, headline's seed (\d+)\.)")));
  EXPECT_EQ(found[1].str() + found[2].str() + found[3].str() + found[4].str(), found[5].str());
}

}  // namespace
}  // namespace dfr::apps
