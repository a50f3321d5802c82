#include "home.h"

#include <cstdlib>

#include "dfr/core/error.h"
#include "dfr/hardware/sprk_driver.h"

namespace dfr::apps::hardware_app {
namespace {

void Command(const std::string& platform, hardware::SprkStatus status) {
  if (status == hardware::SprkStatus::kOk) return;
  throw core::Error(platform + ": the platform cannot be commanded: " + hardware::Name(status),
                    "cut its power: what it does now nobody knows");
}

}  // namespace

int RunHome(const HomeOptions& options) {
  Clock& clock = *options.clock;
  hardware::SprkDriver driver({.device = options.platform, .clock_s = [&clock] {
                                 return 1e-9 * static_cast<double>(clock.SteadyNs());
                               }});
  if (!options.confirms("The platform at " + options.platform +
                            " goes home. Where nothing touches the gauze, type platform: it moves.",
                        "platform")) {
    options.say("Nobody asked for it: nothing was sent.");
    return EXIT_FAILURE;
  }
  Command(options.platform, driver.Home());
  const bool interrupted = Within(clock, hardware::SprkDriver::kHomeTime, [&options] {
    return options.interrupted != nullptr && *options.interrupted;
  });
  if (interrupted) {
    Command(options.platform, driver.Hold());
    options.say("Interrupted: it was told to stop where it was.");
    return EXIT_FAILURE;
  }
  options.say(
      "It was told to go home and had the time. Its firmware never answers: look whether it is "
      "there. If it is not, power and plug it anew.");
  return EXIT_SUCCESS;
}

}  // namespace dfr::apps::hardware_app
