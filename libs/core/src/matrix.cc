#include "dfr/core/matrix.h"

// Programs compiled for other vector units need a variable of another name and do not link.
const char DFR_EIGEN_ALIGNMENT(EIGEN_MAX_ALIGN_BYTES, EIGEN_MALLOC_ALREADY_ALIGNED) = 0;
