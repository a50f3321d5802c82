#include "dfr/safety/method.h"

#include <algorithm>
#include <array>

#include "dfr/core/text/suggest.h"

namespace dfr::safety {
namespace {

constexpr std::array kRecoveries = {control::Recovery::kNone, control::Recovery::kEarlyStopping,
                                    control::Recovery::kDfr};
constexpr std::string_view kDfrFine = "dfr-fine";
constexpr std::string_view kGuard = "guard";
constexpr std::string_view kController = "controller";
constexpr std::string_view kWithout = "controller-without-";

}  // namespace

Method ParseMethod(std::string_view name, std::span<const std::string_view> others) {
  Method method{.name = std::string(name)};
  for (const control::Recovery recovery : kRecoveries) {
    method.recovery = recovery;
    if (name == control::Name(recovery)) return method;
  }
  method.published_dfr = name == kDfrFine;
  if (method.published_dfr) return method;
  if (name == kGuard) {
    method.kind = Method::Kind::kGuard;
    method.recovery = control::Recovery::kNone;
    return method;
  }
  // Without() accepts an empty list of parts, but a name must contain at least one part.
  const bool without = name.starts_with(kWithout) && name != kWithout && !name.ends_with('+');
  if (name == kController || without) {
    method.kind = Method::Kind::kController;
    method.recovery = control::Recovery::kNone;
    method.without = name.substr(std::min(name.size(), kWithout.size()));
    static_cast<void>(control::Without({}, method.without));
    return method;
  }
  if (std::find(others.begin(), others.end(), name) != others.end()) {
    method.kind = Method::Kind::kOther;
    method.recovery = control::Recovery::kNone;
    return method;
  }
  throw core::UnknownName("method", method.name, MethodNames(others));
}

std::string MethodNames(std::span<const std::string_view> others) {
  std::string names;
  for (const control::Recovery recovery : kRecoveries) names.append(Name(recovery)).append(", ");
  names.append(kDfrFine).append(", ").append(kGuard).append(", ").append(kController);
  for (const std::string_view other : others) names.append(", ").append(other);
  for (const std::string_view part : control::GuidedPartNames()) {
    names.append(", ").append(kWithout).append(part);
  }
  return names;
}

}  // namespace dfr::safety
