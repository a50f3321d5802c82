#pragma once

#include <sstream>
#include <stdexcept>

/// Throws std::invalid_argument with `message`, a chain of << operands, unless `condition` holds.
/// For calls at set-up only. The control loop reports through PlantStatus and never throws.
#define DFR_THROW_UNLESS(condition, message)                  \
  do {                                                        \
    if (!(condition)) {                                       \
      std::ostringstream dfr_contract_stream;                 \
      dfr_contract_stream << message; /* NOLINT: a chain */   \
      throw std::invalid_argument(dfr_contract_stream.str()); \
    }                                                         \
  } while (false)
