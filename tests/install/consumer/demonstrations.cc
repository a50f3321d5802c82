#include "dfr/imitation/demonstrations.h"

#include <stdexcept>
#include <string>

int main() {
  try {
    (void)dfr::imitation::OpenDemonstrations("absent.hdf5");
  } catch (const std::runtime_error& e) {
    return std::string(e.what()).find("absent.hdf5") == std::string::npos ? 1 : 0;
  }
  return 1;
}
