#include <algorithm>
#include <iostream>
#include <iterator>

#include "commands.h"
#include "dfr/core/build_info.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/experiment/summary.h"
#include "trial_runner.h"

namespace dfr::apps::pusher {

void RunEvaluate(const EvaluateOptions& options) {
  std::vector<safety::Method> methods;
  for (const std::string& name : options.methods) {
    methods.push_back(study::ParseMethod(name, study::kLoadedMethods));
  }
  const Model model = Model::Load(options.model);
  const std::vector<int>& sizes = model.policy().mlp().sizes();
  const Learner learner{.hidden = {sizes.begin() + 1, sizes.end() - 1}};

  experiment::EvaluationPlan plan;
  plan.methods = options.methods;
  std::ranges::copy_if(plan.methods, std::back_inserter(plan.policies), study::IsPolicy);
  plan.learners = {learner.Name()};
  plan.demonstrations = {static_cast<int>(model.demonstrations().trajectories.size())};
  plan.trials = 1;
  plan.episodes = options.episodes;
  plan.seed = options.seed;
  experiment::ProgressBar bar("evaluate");
  experiment::EvaluationOptions evaluation;
  evaluation.progress = [&](const experiment::Progress& p) { bar.Show(p); };
  const auto results = experiment::Evaluate(
      plan,
      [&](const experiment::EvaluationUnit&) {
        return std::make_unique<PusherTrialRunner>(Model::Load(options.model), methods,
                                                   options.plant, std::map<std::string, double>());
      },
      evaluation);
  experiment::PrintTable(
      experiment::Summarize(
          plan, results,
          {.experiment = "pusher", .preset = "evaluate", .commit = core::BuildCommit()}),
      std::cout);
}

}  // namespace dfr::apps::pusher
