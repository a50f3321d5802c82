#pragma once

#include <span>
#include <string>
#include <string_view>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/published/switching_controller.h"

namespace dfr::safety {

/// Who is in control of an episode.
struct Method {
  enum class Kind {
    kSwitching,  ///< Algorithm 1, Baseline and early stopping included.
    kGuided,     ///< Guided recovery: demonstrations drive.
    kGuard,      ///< The same with least_intervention: the policy drives.
    kOther,      ///< One of the caller's own names.
  };
  std::string name;
  Kind kind = Kind::kSwitching;
  control::Recovery recovery = control::Recovery::kNone;  ///< kSwitching: at the boundary.
  bool published_dfr = false;  ///< "dfr-fine": DFR with the constants of the paper's simulations.
  std::string without = {};    ///< kGuided: what control::Without() takes out.
};

/// Parses "baseline", "early-stopping", "dfr", "dfr-fine", "guard", "guided",
/// "guided-without-<part>" (parts of control::GuidedPartNames(), several joined by "+"), or one of
/// `others`.
/// @throws std::invalid_argument naming what is unknown and what there is.
[[nodiscard]] Method ParseMethod(std::string_view name,
                                 std::span<const std::string_view> others = {});

/// All that ParseMethod() takes, for help texts: "baseline, early-stopping, ...".
[[nodiscard]] std::string MethodNames(std::span<const std::string_view> others = {});

}  // namespace dfr::safety
