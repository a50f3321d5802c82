#include "dfr/core/features/features.h"

// Selects features of a lab's state by name.
int main() {
  dfr::core::StateLayout layout;
  layout.Add("joints", 7);
  layout.Add("object", 3);
  return dfr::core::FeatureSelection(layout, "object").num_features() == 3 ? 0 : 1;
}
