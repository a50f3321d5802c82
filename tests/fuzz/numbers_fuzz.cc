// Numbers and features as users write them. Compares numbers with the C library's.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <stdexcept>
#include <string>

#include "dfr/core/features/features.h"
#include "dfr/core/text/numbers.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(numbers) {
  const std::string text(dfr::fuzz::AsText(data, size));
  const bool decimal = text.find_first_not_of("0123456789+-.eE") == std::string::npos;
  if (const auto value = dfr::core::ParseNumber(text)) {
    if (!decimal || !std::isfinite(*value)) std::abort();
    if (std::strtod(text.c_str(), nullptr) != *value) std::abort();
    if (!dfr::core::LooksLikeNumber(text)) std::abort();
  } else if (decimal && !text.empty()) {
    // Rejected text is not a number or is outside the range of double.
    char* end = nullptr;
    const double peer = std::strtod(text.c_str(), &end);
    if (*end == '\0' && std::isfinite(peer)) std::abort();
  }
  if (const auto value = dfr::core::ParseInteger<int>(text)) {
    if (std::strtol(text.c_str(), nullptr, 10) != *value) std::abort();
  }
  dfr::core::StateLayout layout;
  layout.Add("object", 3);
  layout.Add("tip", 2);
  try {
    const dfr::core::FeatureSelection selection(layout, text);
    if (selection.num_features() < 1 || selection.num_features() > 5) std::abort();
  } catch (const std::invalid_argument&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
