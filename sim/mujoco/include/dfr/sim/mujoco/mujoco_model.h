#pragma once

#include <memory>
#include <string>
#include <string_view>

// MuJoCo's own types, by name only.
struct mjModel_;
struct mjData_;

namespace dfr::sim {

struct MjDeleter {
  void operator()(mjModel_* model) const noexcept;
  void operator()(mjData_* data) const noexcept;
};
using MjModelPtr = std::unique_ptr<mjModel_, MjDeleter>;
using MjDataPtr = std::unique_ptr<mjData_, MjDeleter>;

/// Compiles an MJCF text that a library carries with it. `name` is what messages call it.
/// Thread-safe.
/// @throws std::runtime_error if the text is no model, with MuJoCo's reason, or if the MuJoCo found
///   at run time is not the one that this was built against.
[[nodiscard]] MjModelPtr LoadMujocoModel(std::string_view xml, const std::string& name);

/// The index of an object of type `type`, an mjtObj.
/// @throws std::runtime_error if the model has none of this name.
[[nodiscard]] int MujocoId(const mjModel_& model, int type, const std::string& name);

}  // namespace dfr::sim
