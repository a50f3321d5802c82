#include <array>

#include "dfr/core/random.h"
#include "dfr/imitation/mlp.h"

int main() {
  dfr::core::Random random(1);
  const dfr::imitation::Mlp mlp({3, 8, 2}, random);
  std::array<double, 2> y{};
  mlp.Forward(std::array{0.1, 0.2, 0.3}, y);
  return y[0] != 0.0 ? 0 : 1;
}
