#include "dfr/reduction/reduction.h"

#include <array>
#include <cmath>

// Reduces rows along a line to one component: their position along the line.
int main() {
  dfr::core::Matrix rows(3, 2);
  rows << 0.0, 0.0, 1.0, 1.0, 2.0, 2.0;
  const auto fit = dfr::reduction::FitPrincipalComponents(dfr::reduction::MatrixRows({&rows, 1}));
  const auto reduction = dfr::reduction::Reduction::Principal(fit, 1);
  std::array<double, 1> z;
  reduction.Apply(std::array{1.0, 1.0}, z);
  return std::abs(z[0]) < 1e-6 ? 0 : 1;
}
