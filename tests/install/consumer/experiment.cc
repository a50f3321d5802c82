#include "dfr/experiment/intervals.h"

// No success in 60 trials: the exact upper bound is 1 - 0.025^(1/60).
int main() {
  const auto interval = dfr::experiment::ClopperPearsonInterval(0, 60);
  return interval.high > 0.0596 && interval.high < 0.0597 ? 0 : 1;
}
