#pragma once

#include "apps/study/pictures/detect.h"

namespace CLI {
class App;
}

namespace dfr::study {

/// Adds the options of the command detect.
void AddOptions(CLI::App& command, Detection& detection);

}  // namespace dfr::study
