#include "home.h"

#include <cstdlib>

#include "dfr/core/error.h"
#include "dfr/hardware/sprk_driver.h"

namespace dfr::apps::hardware_app {
namespace {

void Command(const std::string& platform, hardware::SprkStatus status) {
  if (status == hardware::SprkStatus::kOk) return;
  throw core::Error(platform + ": the platform cannot be commanded: " + hardware::Name(status),
                    "cut its power: its state is unknown");
}

}  // namespace

int RunHome(const HomeOptions& options) {
  Clock& clock = *options.clock;
  hardware::SprkDriver driver({.device = options.platform, .clock_s = [&clock] {
                                 return 1e-9 * static_cast<double>(clock.SteadyNs());
                               }});
  if (!options.confirms(
          "The platform at " + options.platform +
              " will move to its home position, and only cutting its power stops it on the way. If "
              "nothing touches the gauze, type platform.",
          "platform")) {
    options.say("Not confirmed: nothing was sent.");
    return EXIT_FAILURE;
  }
  Command(options.platform, driver.Home());
  const bool interrupted = Within(clock, hardware::SprkDriver::kHomeTime, [&options] {
    return options.interrupted != nullptr && *options.interrupted;
  });
  if (interrupted) {
    options.say(
        "Interrupted, but the platform continues to its home position: only cutting its power stops"
        "it.");
    return EXIT_FAILURE;
  }
  options.say(
      "The platform was told to go home and had enough time. Its firmware never answers: check its "
      "position. If it is not at home, switch its power off and on and plug it in again.");
  return EXIT_SUCCESS;
}

}  // namespace dfr::apps::hardware_app
