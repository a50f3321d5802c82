// Commands that only the console receives, over DDS.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "tests/hardware_dvrk/psm_driver_fixture.h"

namespace dfr::hardware {
namespace {

using testing::HasSubstr;

class UnheardCommandTest : public PsmDriverTest {
 protected:
  // Returns a driver armed and in motion, after the time in which the console may still state its
  // previous control.
  std::unique_ptr<PsmDriver> UnderWay() {
    auto driver = Armed();
    for (int i = 0; i < 20; ++i) Step(*driver);
    EXPECT_EQ(driver->MoveTo(Yaw(0.3), 4.0), PsmStatus::kOk);
    for (int i = 0; i < 100; ++i) Step(*driver);
    EXPECT_TRUE(driver->moving()) << driver->Explain();
    return driver;
  }
};

TEST_F(UnheardCommandTest, TheConsolesStatementHoldsAndIsTheReason) {
  const std::function<void()> commands[] = {[&] { console_.Hold(); }, [&] { console_.Free(); }};
  const char* const stated[] = {"PSM1: control JOINT_SPACE/POSITION_MODE",
                                "PSM1: control JOINT_SPACE/EFFORT_MODE"};
  for (std::size_t i = 0; i < 2; ++i) {
    SCOPED_TRACE(stated[i]);
    const auto driver = UnderWay();
    const Eigen::Vector3d there = console_.measured_pose().translation();
    commands[i]();
    ExpectHolds(*driver, PsmStatus::kForeignControl);
    EXPECT_TRUE(driver->held_by_others());
    EXPECT_EQ(driver->who(), stated[i]);
    EXPECT_THAT(driver->Explain(), HasSubstr("obeyed a hold, free or other command"));
    EXPECT_THAT(driver->Explain(), HasSubstr(stated[i]));
    for (int n = 0; n < 50; ++n) Step(*driver);
    EXPECT_LT((console_.measured_pose().translation() - there).norm(), 1e-3);
  }
}

// The driver also reads suppressed messages.
TEST_F(UnheardCommandTest, AFloodOfTextsHidesNoStatement) {
  dds::Participant other({.domain = test::OwnDomain()});
  dds::Publisher<dds::Text> status(other, "/PSM1/status", dds::Role::kEvent);
  Meet(other);
  const auto driver = UnderWay();
  for (int i = 0; i < 50; ++i) {
    status.Write({"nothing"});
    Tick(*driver);
  }
  ASSERT_EQ(driver->phase(), PsmPhase::kArmed) << driver->Explain();
  console_.Hold();
  ExpectHolds(*driver, PsmStatus::kForeignControl);
}

}  // namespace
}  // namespace dfr::hardware
