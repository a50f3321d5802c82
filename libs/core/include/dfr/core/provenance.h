#pragma once

#include <string>
#include <string_view>

namespace dfr::core {

/// Source of the data.
enum class Origin {
  kUnknown,    ///< Nobody has said so: files of others, and of before there was provenance.
  kSimulated,  ///< In a simulation, whether in this process or behind a console.
  kReal,       ///< On a robot.
};
/// Returns "unknown", "simulated" or "real".
[[nodiscard]] const char* Name(Origin origin) noexcept;

/// Origin of a file's data. Files store it as one text.
struct Provenance {
  Origin origin = Origin::kUnknown;
  std::string arm;     ///< Its name on the console: "PSM1".
  std::string serial;  ///< What tells this arm from others of its kind.
  std::string camera;  ///< What tells this camera from others.
  std::string date;    ///< UTC: "2026-11-23".

  bool operator==(const Provenance&) const = default;
};

/// Returns the text for a file: one line "key=value" for each member, empty if nothing is known.
/// @throws std::invalid_argument naming the member that holds a control character.
[[nodiscard]] std::string ToText(const Provenance& provenance);
/// Parses the text of ToText(), to the bit.
/// @throws std::invalid_argument naming the invalid line.
[[nodiscard]] Provenance ParseProvenance(std::string_view text);

/// Returns the date in UTC, in the format of Provenance.
[[nodiscard]] std::string Today();

}  // namespace dfr::core
