#include "dfr/study/controller_factory.h"

int main() {
  const auto name = dfr::study::Split("controller@lwr/density");
  return name.policy == "lwr" && name.support == "density" ? 0 : 1;
}
