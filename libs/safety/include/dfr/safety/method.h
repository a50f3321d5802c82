#pragma once

#include <span>
#include <string>
#include <string_view>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/published/switching_controller.h"

namespace dfr::safety {

/// A method that controls an episode.
struct Method {
  enum class Kind {
    kSwitching,   ///< Algorithm 1, including Baseline and early stopping.
    kController,  ///< Guided recovery, in which demonstrations drive.
    kGuard,       ///< Guided recovery with least_intervention, in which the policy drives.
    kOther,       ///< A method of the caller.
  };
  std::string name;
  Kind kind = Kind::kSwitching;
  control::Recovery recovery =
      control::Recovery::kNone;  ///< kSwitching: behaviour at the boundary.
  bool published_dfr = false;    ///< "dfr-fine": DFR with the constants of the paper's simulations.
  std::string without = {};      ///< kController: parts that control::Without() removes.
};

/// Parses "baseline", "early-stopping", "dfr", "dfr-fine", "guard", "controller",
/// "controller-without-<part>" (parts of control::GuidedPartNames(), several joined by "+"), or one
/// of `others`.
/// @throws std::invalid_argument naming the unknown word and the valid ones.
[[nodiscard]] Method ParseMethod(std::string_view name,
                                 std::span<const std::string_view> others = {});

/// Returns all names for ParseMethod(), for help texts: "baseline, early-stopping, ...".
[[nodiscard]] std::string MethodNames(std::span<const std::string_view> others = {});

}  // namespace dfr::safety
