#include "dfr/sim/gallery/gallery.h"

int main() {
  const auto demonstration = dfr::sim::DemonstrateOnce(dfr::sim::FindGalleryTask("reach"), 1);
  return demonstration.outcome == dfr::core::Outcome::kCompleted ? 0 : 1;
}
