#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"

namespace dfr::sim {
namespace {

using Clock = std::chrono::steady_clock;
using testing::HasSubstr;
using testing::StartsWith;

DvrkSceneOptions SceneOptions(bool lock_step) {
  DvrkSceneOptions options;
  options.arm.homing_s = 0.1;
  options.linger_s = lock_step ? 0.0 : 0.05;
  options.world.disturbance.wave = Wave::kRandom;
  return options;
}

// A served scene and a client's ends of its topics.
class DvrkSceneServerTest : public testing::Test {
 protected:
  void Serve(bool lock_step, bool camera) {
    DvrkSceneServerOptions options;
    options.lock_step = lock_step;
    options.camera = camera;
    lock_step_ = lock_step;
    scene_ = std::make_unique<DvrkScene>(SceneOptions(lock_step));
    server_ = std::make_unique<DvrkSceneServer>(participant_, participant_, *scene_, options);
  }

  // Lets the server do its work until `condition`.
  bool Until(const std::function<bool()>& condition) {
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (!condition()) {
      if (Clock::now() > end) return false;
      if (lock_step_) {
        server_->Serve(1e-3);
      } else {
        server_->Tick(1e-3);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
    }
    return true;
  }

  // The reply, or what is missing.
  std::string Ask(const std::string& text) {
    if (!Until([&] { return request_.num_subscribers() == 1 && reply_.health().publishers == 1; }))
      return "nobody is there";
    const dds::Stamp id = {++asked_, 0};
    request_.Write({id, "", text});
    dds::StringStamped reply;
    if (!Until([&] { return reply_.Take(reply) && reply.stamp == id; })) return "no reply";
    return reply.text;
  }

  // Of a reply "ok NOW".
  static dds::Stamp Now(const std::string& reply) {
    if (reply.rfind("ok ", 0) != 0) return {};
    return dds::Stamp::FromNanoseconds(std::stoll(reply.substr(3)));
  }

  dds::Participant participant_{{.domain = test::OwnDomain()}};
  dds::Participant client_{{.domain = test::OwnDomain()}};
  bool lock_step_ = false;
  std::int32_t asked_ = 0;
  std::unique_ptr<DvrkScene> scene_;
  std::unique_ptr<DvrkSceneServer> server_;
  dds::Publisher<dds::StringStamped> request_{client_, "/simulator/request", dds::Role::kRequest};
  dds::Subscriber<dds::StringStamped> reply_{client_, "/simulator/reply", dds::Role::kRequest};
  dds::Subscriber<dds::JointState> joints_{client_, "/PSM1/measured_js", dds::Role::kState};
  dds::Subscriber<dds::OperatingState> state_{client_, "/PSM1/operating_state", dds::Role::kEvent};
  dds::Subscriber<dds::PoseStamped> platform_{client_, "/SPRK/measured_cp", dds::Role::kState};
  dds::Subscriber<dds::PoseStamped> platform_goal_{client_, "/SPRK/setpoint_cp", dds::Role::kState};
  dds::Publisher<dds::JointState> servo_jp_{client_, "/PSM1/servo_jp", dds::Role::kCommand};
};

// The episode that the plant goes through in one process, over the wire, to the bit: state and
// pictures.
TEST_F(DvrkSceneServerTest, InLockStepTheWireChangesNothing) {
  Serve(true, true);
  dds::Subscriber<dds::Image> images(client_, "/ECM/image_raw", dds::Role::kImage);
  LineTrackingOptions world = SceneOptions(true).world;
  LineTrackingPlant plant(world);
  std::vector<std::uint8_t> expected(plant.endoscope().image_size());
  ASSERT_TRUE(Until([&] {
    return servo_jp_.num_subscribers() == 1 && joints_.health().publishers == 1 &&
           images.health().publishers == 1;
  }));
  plant.Reset(7);
  dds::Stamp now = Now(Ask("reset 7"));
  ASSERT_TRUE(now.valid());
  std::uint64_t pictures = 0;
  dds::JointState measured;
  const auto arrived = [&] { return joints_.TakeNewest(measured) && measured.stamp == now; };
  ASSERT_TRUE(Until(arrived));

  for (int i = 0; i < 5; ++i) {
    const Eigen::Matrix<double, 6, 1> from =
        Eigen::Map<const Eigen::Matrix<double, 6, 1>>(measured.position.data());
    const std::array<double, 2> u = {0.7, 0.2 * std::sin(i)};
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    const Eigen::Matrix<double, 6, 1> to = plant.reported_joints();
    const Eigen::Vector3d step(LineTrackingPlant::kStep * u[0], LineTrackingPlant::kStep * u[1],
                               0.0);
    const double duration_s = step.norm() / LineTrackingPlant::kSpeed;
    const int samples = static_cast<int>(std::ceil(duration_s / 0.02));
    const auto send = [&](const Eigen::Matrix<double, 6, 1>& goal) {
      dds::JointState message;
      message.position.assign(goal.data(), goal.data() + goal.size());
      ASSERT_TRUE(servo_jp_.Write(message));
    };
    for (int k = 1; k <= samples; ++k) {
      send(from + (to - from) * (static_cast<double>(k) / samples));
      std::ostringstream run;
      run.precision(17);
      run << "run " << duration_s / samples << " 1";
      now = Now(Ask(run.str()));
      ASSERT_TRUE(now.valid());
    }
    send(to);
    ASSERT_TRUE(Now(Ask("run 0 1")).valid());  // it has come
    now = Now(Ask("rest"));
    ASSERT_TRUE(Until(arrived));
    EXPECT_EQ(scene_->plant().TrueState(), plant.TrueState());

    const dds::Stamp taken = Now(Ask("look"));
    dds::Image image;
    ASSERT_TRUE(Until([&] { return images.TakeNewest(image) && image.stamp == taken; }));
    EXPECT_EQ(image.encoding, "bgr8");
    EXPECT_EQ(image.width, 640U);
    EXPECT_EQ(image.height, 480U);
    plant.RenderPicture(++pictures, expected);
    EXPECT_EQ(image.data, expected);
  }
  std::istringstream truth(Ask("truth"));
  std::string ok;
  int completed = -1;
  int collided = -1;
  double progress = 0.0;
  double distance = 0.0;
  Eigen::Vector3d tip;
  truth >> ok >> completed >> collided >> progress >> distance >> tip.x() >> tip.y() >> tip.z();
  EXPECT_EQ(ok, "ok");
  EXPECT_EQ(completed, 0);
  EXPECT_EQ(collided, plant.collided() ? 1 : 0);
  EXPECT_EQ(progress, plant.truth().progress_m);
  EXPECT_EQ(distance, plant.truth().distance_m);
  EXPECT_EQ(tip, plant.truth().tip_m);
}

TEST_F(DvrkSceneServerTest, InLockStepTimeStandsStillUnlessItIsAskedToGoOn) {
  Serve(true, false);
  const dds::Stamp start = Now(Ask("reset 1"));
  server_->Serve(0.05);
  EXPECT_EQ(Now(Ask("rest")), start);
  const dds::Stamp later = Now(Ask("run 0.25"));
  EXPECT_EQ(later.nanoseconds() - start.nanoseconds(), 250'000'000);
  dds::PoseStamped measured;
  dds::PoseStamped goal;
  ASSERT_TRUE(Until([&] { return platform_.TakeNewest(measured) && measured.stamp == later; }));
  ASSERT_TRUE(Until([&] { return platform_goal_.TakeNewest(goal) && goal.stamp == later; }));
  EXPECT_EQ(measured.frame_id, "SPRK_base");
  // The arm rests, so the platform does.
  EXPECT_EQ(measured.position_m, goal.position_m);
}

TEST_F(DvrkSceneServerTest, WhatCannotBeDoneIsAnsweredWithTheReason) {
  Serve(true, false);
  EXPECT_THAT(Ask("dance"), StartsWith("error: there is no request 'dance'"));
  EXPECT_THAT(Ask("reset"), StartsWith("error: the seed must be a whole number, not ''"));
  EXPECT_THAT(Ask("reset -1"), StartsWith("error: the seed"));
  EXPECT_THAT(Ask("run soon"), StartsWith("error: the time to run must be a number, not 'soon'"));
  EXPECT_THAT(Ask("run -1"), StartsWith("error: the time to run must lie in [0, 60] s"));
  EXPECT_THAT(Ask("run nan"), StartsWith("error: the time to run must lie in"));
  EXPECT_THAT(Ask("run 0.01 2"), StartsWith("error: only 0 of 2 commands have come"));
  EXPECT_THAT(Ask("look"), StartsWith("error: there is no camera"));
  EXPECT_THAT(Ask("fault dust 1"), HasSubstr("there is no fault 'dust'; there are: delay"));
  EXPECT_THAT(Ask("fault freeze maybe"), HasSubstr("freeze is switched on by 1 and off by 0"));
  EXPECT_THAT(Ask("fault drop 2"), HasSubstr("drop must lie in [0, 1]"));
  EXPECT_THAT(Ask("fault camera upside_down"), HasSubstr("there is no camera fault"));
  server_.reset();
  Serve(false, false);
  EXPECT_THAT(Ask("run 0.01"), StartsWith("error: run is for lock-step alone"));
  EXPECT_THROW(server_->SetFault("dust", "1"), std::invalid_argument);
  DvrkSceneServerOptions bad;
  bad.jpeg_quality = 0;
  EXPECT_THROW(DvrkSceneServer(participant_, participant_, *scene_, bad), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
