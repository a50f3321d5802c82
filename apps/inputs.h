#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>
#include <system_error>

#include "dfr/core/features/features.h"

namespace dfr::apps {

/// @throws std::runtime_error naming the file and `remedy` if nothing has this path. `remedy` is
/// the command that writes the file, or the option that names another.
inline void MustExist(const std::filesystem::path& file, const std::string& remedy) {
  std::error_code error;
  if (std::filesystem::exists(file, error) || error) return;
  throw std::runtime_error(file.string() + ": no such file. " + remedy);
}

/// Shape of demonstrations.
struct DemonstratedShape {
  core::StateLayout layout;
  int control_dim = 0;
  bool operator==(const DemonstratedShape&) const = default;
};

/// @throws std::runtime_error naming the file and both shapes if `found` differs from `wanted`.
/// `command` writes demonstrations of the wanted shape.
inline void MustBeOfTask(const std::filesystem::path& file, const DemonstratedShape& found,
                         const DemonstratedShape& wanted, const std::string& command) {
  if (found == wanted) return;
  const auto text = [](const DemonstratedShape& shape) {
    std::string list;
    for (const core::StateLayout::Block& block : shape.layout.blocks) {
      list.append(list.empty() ? "" : ",").append(block.name);
      list.append("[0:").append(std::to_string(block.size)).append("]");
    }
    return "states of " + list + " and controls of " + std::to_string(shape.control_dim) +
           " entries";
  };
  throw std::runtime_error(file.string() + ": demonstrates another task: it has " + text(found) +
                           ", not " + text(wanted) + ". `" + command +
                           "` writes such demonstrations");
}

}  // namespace dfr::apps
