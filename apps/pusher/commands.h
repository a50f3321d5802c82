#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "model.h"

namespace dfr::apps::pusher {

// One struct and one function per command. main.cc fills the struct and calls the function. All
// functions throw std::exception with a message for the user.

struct DemonstrateOptions {
  std::filesystem::path supervisor;  ///< Empty: ShippedSupervisor().
  std::filesystem::path out = "demonstrations.hdf5";
  int count = 120;
  int horizon = 60;
  std::uint64_t seed = 1;
  sim::PusherOptions plant;
};
void RunDemonstrate(const DemonstrateOptions& options);

struct FitOptions {
  std::filesystem::path demonstrations = "demonstrations.hdf5";
  std::filesystem::path out = "model";
  int use = 0;  ///< 0: all demonstrations.
  std::string learner = "8";
  ModelOptions model;
};
void RunFit(const FitOptions& options);

struct EvaluateOptions {
  std::filesystem::path model = "model";
  std::vector<std::string> methods = {"baseline", "early-stopping", "dfr", "controller"};
  int episodes = 60;
  std::uint64_t seed = 1001;
  sim::PusherOptions plant;
};
void RunEvaluate(const EvaluateOptions& options);

struct ExperimentOptions : experiment::ExperimentOptions {
  ExperimentOptions() { out = "out/pusher"; }
  std::filesystem::path supervisor;  ///< Empty: the shipped supervisors.
  /// Number of supervisors that take turns; 0: the preset's number.
  int supervisors = 0;
  bool convergence = true;
  // If empty, the preset's learners and numbers of demonstrations apply.
  std::vector<std::string> learners;
  std::vector<int> demonstrations;
  ModelOptions model;
  sim::PusherOptions plant;
};
void RunExperiment(const ExperimentOptions& options);

struct RenderOptions {
  std::filesystem::path model = "model";
  std::vector<std::string> methods = {"baseline", "dfr", "controller"};
  std::uint64_t seed = 1;  ///< Seed of the start state.
  std::filesystem::path out = "rollout.mp4";
  int width = 640;
  int height = 480;
  sim::PusherOptions plant;
};
void RunRender(const RenderOptions& options);

}  // namespace dfr::apps::pusher
