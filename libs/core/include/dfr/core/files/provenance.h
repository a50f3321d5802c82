#pragma once

#include <string>
#include <string_view>

namespace dfr::core {

/// Source of the data.
enum class Origin {
  kUnknown,    ///< Not recorded: the file is older than this field or from another program.
  kSimulated,  ///< A simulation, in this process or behind a console.
  kReal,       ///< A robot.
};
/// Returns "unknown", "simulated" or "real".
[[nodiscard]] const char* Name(Origin origin) noexcept;

/// Origin of a file's data. Files store it as one text.
struct Provenance {
  Origin origin = Origin::kUnknown;
  std::string arm;     ///< Name on the console, for example "PSM1".
  std::string serial;  ///< Identifies this arm among others of its kind.
  std::string camera;  ///< Identifies this camera.
  std::string date;    ///< UTC, for example "2026-11-23".

  bool operator==(const Provenance&) const = default;
};

/// Returns the text for a file: one line "key=value" for each member, empty if nothing is known.
/// @throws std::invalid_argument naming the member that holds a control character.
[[nodiscard]] std::string ToText(const Provenance& provenance);
/// Parses the text of ToText() without loss.
/// @throws std::invalid_argument naming the invalid line.
[[nodiscard]] Provenance ParseProvenance(std::string_view text);

/// Returns today's date in UTC, in the format of Provenance.
[[nodiscard]] std::string Today();

}  // namespace dfr::core
