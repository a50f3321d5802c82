#include "dfr/core/matrix.h"

// A program that was compiled for other vector units looks for another name.
const char DFR_EIGEN_ALIGNMENT(EIGEN_MAX_ALIGN_BYTES, EIGEN_MALLOC_ALREADY_ALIGNED) = 0;
