// A program that fails to link if its vector flags make Eigen allocate differently from the
// libraries.
#include "dfr/core/matrix.h"

int main() {
  const dfr::core::Matrix m = dfr::core::Matrix::Identity(3, 3);
  return static_cast<int>(m.sum()) - 3;
}
