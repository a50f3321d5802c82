// Does not link where its vector flags make Eigen allocate otherwise than the libraries do.
#include "dfr/core/matrix.h"

int main() {
  const dfr::core::Matrix m = dfr::core::Matrix::Identity(3, 3);
  return static_cast<int>(m.sum()) - 3;
}
