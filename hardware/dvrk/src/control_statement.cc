#include "dfr/hardware/control_statement.h"

namespace dfr::hardware {
namespace {

constexpr std::string_view kControl = ": control ";

}  // namespace

PsmControl ControlStatedBy(std::string_view text) noexcept {
  const std::size_t at = text.find(kControl);
  if (at == std::string_view::npos) return PsmControl::kUnstated;
  text.remove_prefix(at + kControl.size());
  const std::size_t slash = text.find('/');
  if (slash == std::string_view::npos) return PsmControl::kUnstated;
  const std::string_view space = text.substr(0, slash);
  const std::string_view mode = text.substr(slash + 1);
  if (space.starts_with("CARTESIAN") && mode.starts_with("POSITION")) return PsmControl::kPoses;
  if (space.starts_with("UNDEFINED") && mode.starts_with("UNDEFINED")) return PsmControl::kNone;
  return PsmControl::kOther;
}

}  // namespace dfr::hardware
