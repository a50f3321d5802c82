#pragma once

#include "apps/study/pictures/detect.h"

namespace CLI {
class App;
}

namespace dfr::study {

void AddOptions(CLI::App& command, Detection& detection);

}  // namespace dfr::study
