#pragma once

#include <string>
#include <string_view>

namespace dfr::core {

/// Where data were made.
enum class Origin {
  kUnknown,    ///< Nobody has said so: files of others, and of before there was provenance.
  kSimulated,  ///< In a simulation, whether in this process or behind a console.
  kReal,       ///< On a robot.
};
/// "unknown", "simulated" or "real".
[[nodiscard]] const char* Name(Origin origin) noexcept;

/// Where a file's data are from. Files hold it as one text.
struct Provenance {
  Origin origin = Origin::kUnknown;
  std::string arm;     ///< Its name on the console: "PSM1".
  std::string serial;  ///< What tells this arm from others of its kind.
  std::string camera;  ///< What tells this camera from others.
  std::string date;    ///< UTC: "2026-11-23".

  bool operator==(const Provenance&) const = default;
};

/// The text of a file: a line "key=value" for each member; empty for what is not known at all.
/// @throws std::invalid_argument naming the member that holds a control character.
[[nodiscard]] std::string ToText(const Provenance& provenance);
/// What ToText() wrote, to the bit.
/// @throws std::invalid_argument saying which line is none of its.
[[nodiscard]] Provenance ParseProvenance(std::string_view text);

/// The date, UTC, as Provenance has it.
[[nodiscard]] std::string Today();

}  // namespace dfr::core
