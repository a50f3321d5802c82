#include "dfr/control/guided/guided_options.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

constexpr std::array<std::string_view, 7> kParts = {
    "filter", "exit-level", "demonstrated", "online-jacobian", "drift", "observer", "disturbance"};

}  // namespace

std::span<const std::string_view> GuidedPartNames() noexcept { return kParts; }

GuidedOptions Without(GuidedOptions options, std::string_view parts) {
  while (!parts.empty()) {
    const std::string_view part = parts.substr(0, parts.find('+'));
    parts.remove_prefix(std::min(parts.size(), part.size() + 1));
    if (part == "filter") {
      options.iterations = 0;
    } else if (part == "exit-level") {
      options.max_exit_ratio = 0.0;
    } else if (part == "demonstrated") {
      options.demonstrated = false;
    } else if (part == "online-jacobian") {
      options.online_weight = 0.0;
      options.probe_size = 0.0;  // A probe without a measurement has no use.
    } else if (part == "drift") {
      options.drift = false;
    } else if (part == "observer") {
      options.observer = false;
    } else if (part == "disturbance") {
      options.disturbance_model = {};
    } else {
      std::string known;
      for (const std::string_view name : kParts) {
        known.append(known.empty() ? "" : ", ").append(name);
      }
      DFR_THROW_UNLESS(false, "guided recovery has no part '" << part << "'; it has: " << known);
    }
  }
  return options;
}

StepLimits Limits(const GuidedOptions& options, int control_dim, double control_unit) {
  return ScaledLimits(options.control_limit, control_dim, control_unit, options.iterations);
}

void Check(const GuidedOptions& options) {
  DFR_THROW_UNLESS(options.horizon > 0, "horizon must be positive, not " << options.horizon);
  DFR_THROW_UNLESS(options.first_step >= 0 && options.first_step < options.horizon,
                   "first_step must lie in [0, horizon), not " << options.first_step);
  DFR_THROW_UNLESS(options.max_controls > 0,
                   "max_controls must be positive, not " << options.max_controls);
  for (const double limit : options.control_limit) {
    DFR_THROW_UNLESS(limit >= 0.0, "control_limit must not be negative: " << limit);
  }
  DFR_THROW_UNLESS(options.iterations >= 0,
                   "iterations must not be negative: " << options.iterations);
  DFR_THROW_UNLESS(options.patience > 0, "patience must be positive, not " << options.patience);
  DFR_THROW_UNLESS(options.probe_size >= 0.0 && std::isfinite(options.probe_size),
                   "probe_size must be finite and not negative: " << options.probe_size);
  DFR_THROW_UNLESS(options.max_exit_ratio >= 0.0 && std::isfinite(options.max_exit_ratio),
                   "max_exit_ratio must be finite and not negative: " << options.max_exit_ratio);
  DFR_THROW_UNLESS(options.online_weight >= 0.0 && std::isfinite(options.online_weight),
                   "online_weight must be finite and not negative: " << options.online_weight);
}

}  // namespace dfr::control
