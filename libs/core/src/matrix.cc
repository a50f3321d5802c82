#include "dfr/core/matrix.h"

// Programs compiled for other vector units reference another name.
const char DFR_EIGEN_ALIGNMENT(EIGEN_MAX_ALIGN_BYTES, EIGEN_MALLOC_ALREADY_ALIGNED) = 0;
