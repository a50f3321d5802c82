#include "dfr/core/files/provenance.h"

#include <algorithm>
#include <array>
#include <ctime>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::core {
namespace {

constexpr std::array kOrigins = {Origin::kUnknown, Origin::kSimulated, Origin::kReal};
constexpr std::array<std::pair<const char*, std::string Provenance::*>, 4> kTexts = {
    {{"arm", &Provenance::arm},
     {"serial", &Provenance::serial},
     {"camera", &Provenance::camera},
     {"date", &Provenance::date}}};

void Set(Provenance& provenance, std::string_view key, std::string_view value) {
  if (key == "origin") {
    const auto* const found = std::find_if(kOrigins.begin(), kOrigins.end(),
                                           [&](Origin origin) { return value == Name(origin); });
    DFR_THROW_UNLESS(
        found != kOrigins.end(),
        "provenance: origin must be unknown, simulated or real, not '" << value << "'");
    provenance.origin = *found;
    return;
  }
  const auto* const found = std::find_if(kTexts.begin(), kTexts.end(),
                                         [&](const auto& text) { return key == text.first; });
  DFR_THROW_UNLESS(found != kTexts.end(), "provenance: unknown key '" << key << "'");
  provenance.*found->second = value;
}

}  // namespace

const char* Name(Origin origin) noexcept {
  switch (origin) {
    case Origin::kUnknown:
      return "unknown";
    case Origin::kSimulated:
      return "simulated";
    case Origin::kReal:
      return "real";
  }
  return "unknown";
}

std::string ToText(const Provenance& provenance) {
  if (provenance == Provenance()) return {};
  std::string text = std::string("origin=") + Name(provenance.origin) + '\n';
  for (const auto& [key, member] : kTexts) {
    const std::string& value = provenance.*member;
    DFR_THROW_UNLESS(
        std::none_of(value.begin(), value.end(),
                     [](char c) { return static_cast<unsigned char>(c) < ' ' || c == '\x7f'; }),
        "provenance: " << key << " holds a control character");
    text.append(key).append("=").append(value).append("\n");
  }
  return text;
}

Provenance ParseProvenance(std::string_view text) {
  Provenance provenance;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    const std::size_t equals = line.find('=');
    DFR_THROW_UNLESS(equals != std::string_view::npos,
                     "provenance: '" << line << "' does not have the form key=value");
    Set(provenance, line.substr(0, equals), line.substr(equals + 1));
  }
  return provenance;
}

std::string Today() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  std::array<char, 16> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%d", &utc);
  return text.data();
}

}  // namespace dfr::core
