#include "dfr/core/error.h"

#include <gtest/gtest.h>

#include <type_traits>

namespace dfr::core {
namespace {

static_assert(std::is_nothrow_copy_constructible_v<Error>);

TEST(ErrorTest, WhatJoinsTheProblemAndTheRemedyIfThereIsOne) {
  const Error error("a.avi: cannot be opened; twice", "is the path right?");
  EXPECT_EQ(error.problem(), "a.avi: cannot be opened; twice") << "a separator within is kept";
  EXPECT_EQ(error.remedy(), "is the path right?");
  EXPECT_STREQ(error.what(), "a.avi: cannot be opened; twice; is the path right?");
  const Error alone("a.avi: cannot be opened");
  EXPECT_EQ(alone.remedy(), "");
  EXPECT_STREQ(alone.what(), "a.avi: cannot be opened");
}

}  // namespace
}  // namespace dfr::core
