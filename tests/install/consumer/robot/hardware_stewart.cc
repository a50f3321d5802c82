#include <stdexcept>

#include "dfr/hardware/sprk_driver.h"

// Succeeds if the driver reports an absent port.
int main() try {
  const dfr::hardware::SprkDriver driver({.device = "/dev/no-such-port"});
  return 1;
} catch (const std::runtime_error&) {
  return 0;
}
