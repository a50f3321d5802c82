#pragma once

#include <memory>
#include <string>
#include <string_view>

// MuJoCo's own types, declared by name only.
struct mjModel_;
struct mjData_;

namespace dfr::sim {

struct MjDeleter {
  void operator()(mjModel_* model) const noexcept;
  void operator()(mjData_* data) const noexcept;
};
using MjModelPtr = std::unique_ptr<mjModel_, MjDeleter>;
using MjDataPtr = std::unique_ptr<mjData_, MjDeleter>;

/// Compiles an MJCF text that is part of a library. Error messages call it `name`. Thread-safe.
/// @throws std::runtime_error if the text is not a valid model, with MuJoCo's reason, or if
///   MuJoCo's version at run time differs from the build's.
[[nodiscard]] MjModelPtr LoadMujocoModel(std::string_view xml, const std::string& name);

/// Returns the index of an object of type `type`, an mjtObj.
/// @throws std::runtime_error if the model has no object of this name.
[[nodiscard]] int MujocoId(const mjModel_& model, int type, const std::string& name);

}  // namespace dfr::sim
