#include "dfr/safety/task_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/published/lambda.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/safety/damaged.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::safety {
namespace {

using control::HaltCause;
using control::Mode;
using testing::HasSubstr;

// A policy that drifts sideways.
const test::ConstantPolicy& Drifting() {
  static const test::ConstantPolicy policy(test::Action(0.09, 0.04));
  return policy;
}

std::vector<core::Trajectory> Demonstrations(int count = 20, int steps = 20) {
  return test::CorridorDemonstrations(1, count, steps);
}

TaskOptions Options(bool published) {
  TaskOptions options;
  options.guided_features = "tip";
  if (published) {
    // Published features that differ from guided recovery's features, to distinguish the two.
    options.published_features = "tip[1:2]";
    options.published.emplace().svm.gamma = 5.0;
  }
  options.horizon = 25;
  return options;
}

TaskModel Fit(bool published) {
  return {test::CorridorLayout(), Demonstrations(), Options(published)};
}

// Folder for the test, removed at its end.
class TaskModelTest : public testing::Test {
 protected:
  TaskModelTest()
      : folder_(dfr::test::ProcessFolder() /
                (std::string("task_model_") +
                 testing::UnitTest::GetInstance()->current_test_info()->name())) {}
  ~TaskModelTest() override { std::filesystem::remove_all(folder_); }

  [[nodiscard]] std::string Content() const {
    std::ostringstream out;
    out << std::ifstream(folder_ / "task.dfr", std::ios::binary).rdbuf();
    return out.str();
  }
  void Replace(const std::string& content) const {
    std::ofstream(folder_ / "task.dfr", std::ios::binary | std::ios::trunc) << content;
  }
  // Returns Load()'s error.
  [[nodiscard]] std::string Refusal(
      const core::StateLayout& layout = test::CorridorLayout()) const {
    return test::MessageOf<std::runtime_error>(
        [&] { static_cast<void>(TaskModel::Load(folder_, layout)); });
  }

  const std::filesystem::path folder_;
};

void ExpectSameDecisions(const TaskModel& ours, const TaskModel& theirs) {
  EXPECT_EQ(ours.lambda(), theirs.lambda());
  EXPECT_EQ(ours.horizon(), theirs.horizon());
  EXPECT_EQ(ours.published_features(), theirs.published_features());
  EXPECT_EQ(ours.published() == nullptr, theirs.published() == nullptr);
  core::Random random(3);
  for (int t = 0; t < 25; ++t) {
    const std::vector<double> x = {random.Normal(), 0.1 * t, 0.2 * random.Normal()};
    EXPECT_EQ(ours.support().Decision(t, x), theirs.support().Decision(t, x));
    EXPECT_EQ(ours.guided_support().LogDecision(t, x, {}),
              theirs.guided_support().LogDecision(t, x, {}));
  }
}

// Runs both controllers through an episode. Returns the number of controls that the controller
// changes or chooses itself.
int ExpectSameEpisode(control::Controller& ours, control::Controller& theirs) {
  ours.Reset(5);
  theirs.Reset(5);
  test::CorridorPlant plant;
  std::vector<double> u(2);
  std::vector<double> same(2);
  int others = 0;
  for (int i = 0; i < 80; ++i) {
    const control::Step a = ours.Next(plant.x, u);
    const control::Step b = theirs.Next(plant.x, same);
    EXPECT_EQ(a.mode, b.mode) << "control " << i;
    EXPECT_EQ(a.cause, b.cause);
    EXPECT_EQ(a.t, b.t);
    EXPECT_EQ(u, same);
    others += a.mode != Mode::kPolicy || a.filtered ? 1 : 0;
    plant.Apply(u);
  }
  return others;
}

void ExpectSameControllers(const TaskModel& ours, const TaskModel& theirs) {
  for (const std::string_view name : {"baseline", "early-stopping", "dfr", "dfr-fine", "controller",
                                      "controller-without-filter+exit-level"}) {
    SCOPED_TRACE(name);
    const Method method = ParseMethod(name);
    const auto a = ours.MakeController(method, Drifting());
    const auto b = theirs.MakeController(method, Drifting());
    const int others = ExpectSameEpisode(*a, *b);
    EXPECT_GT(others, 0) << "the episode must need changes";
  }
}

TEST_F(TaskModelTest, AFolderKeepsAllBits) {
  TaskOptions whole_states = Options(true);
  whole_states.guided_features = "";
  whole_states.published_features = "";
  TaskOptions single = Options(false);
  single.guided.single_precision = true;
  for (const TaskOptions& options : {Options(false), Options(true), whole_states, single}) {
    const TaskModel model(test::CorridorLayout(), Demonstrations(), options);
    model.Save(folder_);
    const TaskModel loaded = TaskModel::Load(folder_, test::CorridorLayout());
    EXPECT_EQ(loaded.single_precision(), options.guided.single_precision);
    ExpectSameDecisions(model, loaded);
    if (!options.guided_features.empty()) ExpectSameControllers(model, loaded);
    const std::string before = Content();
    loaded.Save(folder_);
    EXPECT_EQ(Content(), before);
    std::filesystem::remove_all(folder_);
  }
}

// Without the map, a loaded model would treat an angle of 2 pi as a distant state.
TEST_F(TaskModelTest, AFolderDoesNotLoseTheMapOfAngles) {
  const TaskModel fitted = Fit(true);
  const core::StateMap map({}, {{1, 0.0, 6.283185307179586}});
  TaskParts parts{.features = fitted.features(),
                  .support = fitted.feature_support(),
                  .levels = fitted.levels(),
                  .response = fitted.response(),
                  .lambda = fitted.lambda()};
  TaskParts published = parts;
  parts.features = {fitted.features().selection().Mapped(map), fitted.features().offset(),
                    fitted.features().scale()};
  published.published = {core::FeatureSelection(test::CorridorLayout(), "tip[1:2]").Mapped(map),
                         *fitted.published()};
  for (const TaskParts& mapped : {parts, published}) {
    const TaskModel model(mapped);
    EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { model.Save(folder_); }),
                testing::AllOf(HasSubstr("task.dfr"), HasSubstr("angles")));
    EXPECT_FALSE(std::filesystem::exists(folder_));
  }
}

TEST_F(TaskModelTest, APublishedSupportOfAnEarlierModelIsIgnored) {
  Fit(true).Save(folder_);
  Fit(false).Save(folder_);
  EXPECT_EQ(TaskModel::Load(folder_, test::CorridorLayout()).published(), nullptr);
}

TEST_F(TaskModelTest, Algorithm1UsesThePublishedSupportOrElseTheGuidedOne) {
  const auto demonstrations = Demonstrations();
  const std::vector<double> x = {0.0, 0.4, 0.05};
  const TaskModel with = Fit(true);
  ASSERT_NE(with.published(), nullptr);
  EXPECT_EQ(with.published_features(), "tip[1:2]");
  EXPECT_EQ(with.support().Decision(4, x), with.published()->Decision(4, std::vector{0.05}));
  EXPECT_NE(with.support().Decision(4, x), with.guided_support().Decision(4, x));
  EXPECT_EQ(with.lambda(), control::EstimateLambda(with.support(), demonstrations));

  const TaskModel without = Fit(false);
  EXPECT_EQ(without.published(), nullptr);
  EXPECT_EQ(without.published_features(), "");
  EXPECT_EQ(&without.support(), &without.guided_support());
  EXPECT_EQ(without.lambda(), control::EstimateLambda(without.support(), demonstrations));

  // Guided recovery does not depend on the published support.
  EXPECT_EQ(with.guided_support().Decision(4, x), without.guided_support().Decision(4, x));
}

TEST_F(TaskModelTest, DfrFineHasTheConstantsOfThePaper) {
  const TaskModel model = Fit(true);
  ControllerOptions options;
  options.dfr.probe_fraction = 0.1;
  options.dfr.step_fraction = 0.5;
  const auto fine = model.MakeController(ParseMethod("dfr-fine"), Drifting(), options);
  const auto published = model.MakeController(ParseMethod("dfr"), Drifting());
  EXPECT_GT(ExpectSameEpisode(*fine, *published), 0);
}

// Returns the number of controls until kTimeUp, with a policy whose controls always pass.
int Horizon(const TaskModel& model, std::string_view method, const ControllerOptions& options) {
  const test::ConstantPolicy policy({0.0, 0.0});
  const auto controller = model.MakeController(ParseMethod(method), policy, options);
  controller->Reset(1);
  std::vector<double> u(2);
  for (int i = 0;; ++i) {
    // Mean of the demonstrations at this time step.
    const std::vector<double> x = {0.0, test::kSpeed * (options.first_step + i), 0.0};
    const control::Step step = controller->Next(x, u);
    if (step.mode != Mode::kHalt) continue;
    EXPECT_EQ(step.cause, HaltCause::kTimeUp);
    return i;
  }
}

TEST_F(TaskModelTest, AHorizonOfZeroMeansThatOfTheModel) {
  TaskOptions task = Options(false);
  task.horizon = 17;
  const TaskModel model(test::CorridorLayout(), Demonstrations(), task);
  EXPECT_EQ(model.horizon(), 17);
  for (const std::string_view method : {"baseline", "controller"}) {
    SCOPED_TRACE(method);
    EXPECT_EQ(Horizon(model, method, {}), 17);
    EXPECT_EQ(Horizon(model, method, {.horizon = 9}), 9);
    EXPECT_EQ(Horizon(model, method, {.first_step = 5}), 12);
    EXPECT_EQ(Horizon(model, method, {.horizon = 9, .first_step = 5}), 4);
  }
}

TEST_F(TaskModelTest, ControllersOutliveAMoveOfTheModel) {
  for (const bool published : {false, true}) {
    SCOPED_TRACE(published ? "with a published support" : "without one");
    const TaskModel reference = Fit(published);
    TaskModel first = Fit(published);
    const auto dfr = first.MakeController(ParseMethod("dfr"), Drifting());
    const auto guided = first.MakeController(ParseMethod("controller"), Drifting());
    TaskModel second = std::move(first);
    {
      TaskModel third = Fit(!published);
      third = std::move(second);
      second = std::move(third);
    }
    first = Fit(!published);  // a moved-from model can be assigned to
    EXPECT_EQ(first.published() != nullptr, !published);
    ExpectSameDecisions(reference, second);
    ExpectSameControllers(reference, second);
    const auto their_dfr = reference.MakeController(ParseMethod("dfr"), Drifting());
    const auto their_guided = reference.MakeController(ParseMethod("controller"), Drifting());
    ExpectSameEpisode(*dfr, *their_dfr);
    ExpectSameEpisode(*guided, *their_guided);
  }
}

TEST_F(TaskModelTest, WrongArgumentsAreNamed) {
  const auto layout = test::CorridorLayout();
  const auto fit = [&](int count, const TaskOptions& options) {
    return test::MessageOf<std::invalid_argument>(
        [&] { TaskModel(layout, Demonstrations(count), options); });
  };
  EXPECT_THAT(fit(2, Options(false)), HasSubstr("3"));
  TaskOptions options = Options(true);
  options.guided_features = "gripper";
  EXPECT_THAT(fit(20, options), HasSubstr("'gripper'"));
  options = Options(true);
  options.published_features = "gripper";
  EXPECT_THAT(fit(20, options), HasSubstr("'gripper'"));
  for (const int horizon : {0, -1, 1'000'001}) {
    options = Options(false);
    options.horizon = horizon;
    EXPECT_THAT(fit(20, options), HasSubstr("horizon must lie in [1, 1000000]"));
  }

  const TaskModel model = Fit(false);
  const auto make = [&](const auto&... arguments) {
    return test::MessageOf<std::invalid_argument>(
        [&] { static_cast<void>(model.MakeController(arguments...)); });
  };
  const Method other{.name = "oracle", .kind = Method::Kind::kOther};
  EXPECT_THAT(make(other, Drifting()), HasSubstr("'oracle'"));
  for (const std::string_view name : {"baseline", "dfr", "controller"}) {
    SCOPED_TRACE(name);
    const auto with = [&](const ControllerOptions& controller) {
      return make(ParseMethod(name), Drifting(), controller);
    };
    EXPECT_THAT(with({.horizon = -1}), HasSubstr("horizon must be positive"));
    EXPECT_THAT(with({.first_step = -1}), HasSubstr("first_step"));
    EXPECT_THAT(with({.first_step = 25}), HasSubstr("first_step"));
  }
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] {
                static_cast<void>(
                    model.MakeController(std::unique_ptr<control::RecoveryStrategy>(), Drifting()));
              }),
              HasSubstr("null"));

  const auto parts = [&](const std::vector<double>& lambda) {
    return TaskParts{.features = model.features(),
                     .support = model.feature_support(),
                     .levels = model.levels(),
                     .response = model.response(),
                     .lambda = lambda};
  };
  const auto refusal = [](const TaskParts& wrong) {
    return test::MessageOf<std::invalid_argument>([&] { TaskModel{wrong}; });
  };
  for (const std::vector<double>& lambda :
       {std::vector<double>{}, {1.0, 0.0}, {-1.0}, {std::numeric_limits<double>::quiet_NaN()}}) {
    EXPECT_THAT(refusal(parts(lambda)), HasSubstr("lambda"));
  }
  TaskParts wrong = parts({1.0});
  wrong.published = {core::FeatureSelection(layout, "tip"), *Fit(true).published()};
  EXPECT_THAT(refusal(wrong), HasSubstr("there are 2 features, but the decision function takes 1"));
  wrong = parts({1.0});
  wrong.features = core::FeatureTransform::Identity(core::FeatureSelection(layout, "tip[1:2]"));
  EXPECT_THAT(refusal(wrong), HasSubstr("there are 1 features, but the decision function takes 2"));
}

TEST_F(TaskModelTest, WrongContentWithAValidChecksumIsRefusedOrUsable) {
  TaskModel(test::CorridorLayout(), Demonstrations(4, 3), Options(true)).Save(folder_);
  const std::string content = Content();
  core::Random random(12);
  int refused = 0;
  for (int i = 0; i < 200; ++i) {
    Replace(test::Damaged(content, random));
    try {
      const TaskModel model = TaskModel::Load(folder_, test::CorridorLayout());
      for (const std::string_view name : {"dfr", "controller"}) {
        const auto controller = model.MakeController(ParseMethod(name), Drifting());
        controller->Reset(1);
        std::vector<double> u(2);
        for (int t = 0; t < 6; ++t) {
          static_cast<void>(controller->Next(std::vector{0.0, 0.1 * t, 0.05}, u));
          for (const double entry : u) ASSERT_TRUE(std::isfinite(entry));
        }
      }
    } catch (const std::runtime_error& e) {
      ASSERT_THAT(e.what(), HasSubstr(folder_.string()));
      ++refused;
    } catch (const std::invalid_argument&) {
      // MakeController() rejects a model whose number of controls differs from the policy's number.
      ++refused;
    }
  }
  EXPECT_GT(refused, 20);
  EXPECT_LT(refused, 200);
}

TEST_F(TaskModelTest, MissingFilesAndOtherStatesAreNamed) {
  EXPECT_THAT(Refusal(), HasSubstr((folder_ / "task.dfr").string()));
  Fit(true).Save(folder_);
  core::StateLayout other;
  other.Add("gripper", 3);
  EXPECT_THAT(Refusal(other), testing::AllOf(HasSubstr((folder_ / "task.dfr").string()),
                                             HasSubstr("does not fit the other files")));
  std::filesystem::remove(folder_ / "support.dfr");
  EXPECT_THAT(Refusal(), HasSubstr((folder_ / "support.dfr").string()));
  core::ArchiveWriter("task-model", 6).Save(folder_ / "task.dfr");
  EXPECT_THAT(Refusal(), HasSubstr("version 6; this program reads version 5"));
}

TEST_F(TaskModelTest, AFolderThatCannotBeCreatedIsNamed) {
  std::ofstream(folder_) << "a file";
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { Fit(false).Save(folder_ / "model"); }),
              HasSubstr((folder_ / "model").string()));
}

}  // namespace
}  // namespace dfr::safety
