#pragma once

#include <functional>
#include <utility>
#include <vector>

#include "apps/study/planar/methods.h"

namespace CLI {
class App;
}

namespace dfr::study {

/// Commands of a program, each with the function that runs it.
using Commands = std::vector<std::pair<CLI::App*, std::function<void()>>>;

}  // namespace dfr::study

namespace dfr::study::planar {

// Adds the gamma of the whitened support.
void AddGamma(CLI::App& command, MethodOptions& options);
void AddMethodOptions(CLI::App& command, MethodOptions& options);

// Commands for certificates, bounds of fits and pictures in the plane.
void AddProof(CLI::App& app, Commands& commands);
void AddCoverage(CLI::App& app, Commands& commands);
void AddCertificate(CLI::App& app, Commands& commands);
void AddFigure(CLI::App& app, Commands& commands);

}  // namespace dfr::study::planar
