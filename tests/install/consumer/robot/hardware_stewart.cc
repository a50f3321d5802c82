#include <stdexcept>

#include "dfr/hardware/sprk_driver.h"

// An absent port.
int main() try {
  const dfr::hardware::SprkDriver driver({.device = "/dev/no-such-port"});
  return 1;
} catch (const std::runtime_error&) {
  return 0;
}
