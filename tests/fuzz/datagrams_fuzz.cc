// RTPS messages before Fast DDS receives them: the accepted part is a prefix of the message, and is
// itself accepted whole.
#include <cstdlib>
#include <span>

#include "guarded_transport.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(datagrams) {
  const std::span<const std::uint8_t> message(data, size);
  const std::size_t safe = dfr::dds::internal::SafeSize(message);
  if (safe > size || dfr::dds::internal::SafeSize(message.first(safe)) != safe) std::abort();
  return 0;
}
