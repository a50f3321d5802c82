#include "dfr/core/files/provenance.h"

#include <gtest/gtest.h>

#include <stdexcept>

namespace dfr::core {
namespace {

TEST(ProvenanceTest, ParsingRestoresWhatWasWritten) {
  EXPECT_EQ(ToText({}), "");
  EXPECT_EQ(ParseProvenance(""), Provenance());
  const Provenance made = {Origin::kReal, "PSM1", "A = 7", "left eye, \"new\"", "2026-11-23"};
  EXPECT_EQ(ParseProvenance(ToText(made)), made);
  Provenance part;
  part.origin = Origin::kSimulated;
  EXPECT_EQ(ParseProvenance(ToText(part)), part);
}

TEST(ProvenanceTest, InvalidTextIsRefused) {
  for (const char* text : {"origin", "origin=dreamt\n", "origin=real\nowner=me\n", "\n"}) {
    EXPECT_THROW(static_cast<void>(ParseProvenance(text)), std::invalid_argument) << text;
  }
  Provenance made;
  made.serial = "A7\norigin=real";
  EXPECT_THROW(static_cast<void>(ToText(made)), std::invalid_argument);
}

TEST(ProvenanceTest, DatesHaveTenCharacters) {
  EXPECT_EQ(Today().size(), 10U);
  EXPECT_EQ(Today()[4], '-');
}

}  // namespace
}  // namespace dfr::core
