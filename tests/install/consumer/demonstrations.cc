#include "dfr/imitation/demonstrations.h"

#include <stdexcept>

// Succeeds if the library rejects a file that does not exist.
int main() try {
  (void)dfr::imitation::OpenDemonstrations("absent.hdf5");
  return 1;
} catch (const std::runtime_error&) {
  return 0;
}
