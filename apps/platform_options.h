#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "apps/command_line.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::apps {

/// Adds --wave, --amplitude and --frequency of the simulated platform to a program or command;
/// --help lists them in `group`.
inline void AddWave(CLI::App& command, sim::DisturbanceOptions& disturbance,
                    const std::string& group = "Options") {
  using sim::Wave;
  command
      .add_option("--wave", disturbance.wave,
                  "motion of the platform: none, sine, breath or random")
      ->transform(OneOf<Wave>({{"none", Wave::kNone},
                               {"sine", Wave::kSine},
                               {"breath", Wave::kBreath},
                               {"random", Wave::kRandom}}))
      ->type_name("TEXT")
      ->default_str(sim::Name(disturbance.wave))
      ->group(group);
  command
      .add_option("--amplitude", disturbance.amplitude,
                  "amplitudes of x, y, z [m], roll, pitch, yaw [rad]; six numbers")
      ->check(CLI::Range(-1.0, 1.0))
      ->delimiter(',')
      ->group(group);
  command
      .add_option("--frequency", disturbance.frequency,
                  "frequencies of these entries [Hz; breath: rad/s]; six numbers")
      ->check(CLI::Range(0.0, 100.0))
      ->delimiter(',')
      ->group(group);
}

}  // namespace dfr::apps
