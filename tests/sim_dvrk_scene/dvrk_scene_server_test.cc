#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
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

  // The reply, or what is missing. A question that changes nothing comes first, again and again:
  // that this side has found the other does not mean that the other has found this side.
  std::string Ask(const std::string& text) {
    if (!known_) {
      known_ = Until([&] {
        if (asked_ % 100 == 0) request_.Write({{-1, 0}, "", "truth"});
        dds::StringStamped reply;
        return (++asked_, reply_.Take(reply));
      });
    }
    const dds::Stamp id = {++asked_, 0};
    request_.Write({id, "", text});
    dds::StringStamped reply;
    if (!Until([&] { return reply_.Take(reply) && reply.stamp == id; })) return "no reply";
    return reply.text;
  }

  // The time in a reply "ok NOW".
  static dds::Stamp Now(const std::string& reply) {
    if (reply.rfind("ok ", 0) != 0) return {};
    return dds::Stamp::FromNanoseconds(std::stoll(reply.substr(3)));
  }

  dds::Participant participant_{{.domain = test::OwnDomain()}};
  dds::Participant client_{{.domain = test::OwnDomain()}};
  bool lock_step_ = false;
  bool known_ = false;
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
  ASSERT_TRUE(
      Until([&] { return joints_.health().publishers == 1 && images.health().publishers == 1; }));
  bool heard = false;  // by the console
  for (int i = 0; i < 20 && !heard; ++i) {
    servo_jp_.Write({});
    heard = Now(Ask("run 0 1")).valid();
  }
  ASSERT_TRUE(heard);
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
  EXPECT_THAT(Ask("run nan"), StartsWith("error: the time to run must be a number, not 'nan'"));
  EXPECT_THAT(Ask("run 0.01 2"), StartsWith("error: only 0 of 2 commands have come"));
  EXPECT_THAT(Ask("look"), StartsWith("error: there is no camera"));
  EXPECT_THAT(Ask("fault dust 1"), HasSubstr("there is no fault 'dust'; there are: delay"));
  EXPECT_THAT(Ask("fault freeze maybe"), HasSubstr("freeze is switched on by 1 and off by 0"));
  EXPECT_THAT(Ask("fault drop 2"), HasSubstr("drop must lie in [0, 1]"));
  EXPECT_THAT(Ask("fault camera upside_down"), HasSubstr("there is no camera fault"));
  server_.reset();
  known_ = false;
  Serve(false, false);
  EXPECT_THAT(Ask("run 0.01"), StartsWith("error: run is for lock-step alone"));
  EXPECT_THROW(server_->SetFault("dust", "1"), std::invalid_argument);
  DvrkSceneServerOptions bad;
  bad.jpeg_quality = 0;
  EXPECT_THROW(DvrkSceneServer(participant_, participant_, *scene_, bad), std::invalid_argument);
}

// What the camera of a real-time scene shows to a client.
class SceneCameraTest : public DvrkSceneServerTest {
 protected:
  void SetUp() override {
    Serve(false, true);
    ASSERT_TRUE(Until([&] { return images_.TakeNewest(image_); }));
  }

  // The next picture that was taken after all that has been said so far.
  bool Next() {
    const dds::Stamp now = dds::Stamp::Now();
    return Until([&] {
      return images_.TakeNewest(image_) && image_.stamp.nanoseconds() > now.nanoseconds();
    });
  }
  [[nodiscard]] double Brightness() const {
    double sum = 0.0;
    for (const std::uint8_t value : image_.data) sum += value;
    return sum / static_cast<double>(image_.data.size());
  }

  dds::Subscriber<dds::Image> images_{client_, "/ECM/image_raw", dds::Role::kImage};
  dds::Image image_;
};

TEST_F(SceneCameraTest, PicturesComeWithTheirCompressedFormAndTheCamera) {
  dds::Subscriber<dds::CompressedImage> compressed(client_, "/ECM/image_raw/compressed",
                                                   dds::Role::kImage);
  dds::Subscriber<dds::CameraInfo> infos(client_, "/ECM/camera_info", dds::Role::kState);
  dds::CompressedImage jpeg;
  dds::CameraInfo info;
  ASSERT_TRUE(Until([&] {
    images_.TakeNewest(image_);
    compressed.TakeNewest(jpeg);
    infos.TakeNewest(info);
    return image_.stamp == jpeg.stamp && image_.stamp == info.stamp;
  }));
  EXPECT_EQ(image_.frame_id, "ECM");
  EXPECT_EQ(image_.encoding, "bgr8");
  EXPECT_EQ(image_.step, 1920U);
  EXPECT_EQ(image_.data.size(), std::size_t{480} * 1920);
  EXPECT_THAT(jpeg.format, HasSubstr("jpeg"));
  // Start and end of a JPEG file, a tenth of the size or less.
  ASSERT_GT(jpeg.data.size(), 1000U);
  EXPECT_LT(jpeg.data.size(), image_.data.size() / 5);
  EXPECT_EQ(jpeg.data[0], 0xff);
  EXPECT_EQ(jpeg.data[1], 0xd8);
  EXPECT_EQ(jpeg.data[jpeg.data.size() - 2], 0xff);
  EXPECT_EQ(jpeg.data[jpeg.data.size() - 1], 0xd9);
  const vision::CameraModel& camera = scene_->plant().calibration().camera;
  EXPECT_EQ(info.width, 640U);
  EXPECT_EQ(info.height, 480U);
  EXPECT_EQ(info.distortion_model, "plumb_bob");
  EXPECT_EQ(info.k,
            (std::array<double, 9>{camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1}));
  EXPECT_EQ(info.d, std::vector<double>(camera.distortion.begin(), camera.distortion.end()));
}

TEST_F(SceneCameraTest, FaultsOfTheCameraAreSeen) {
  ASSERT_TRUE(Next());
  const double lit = Brightness();
  EXPECT_GT(lit, 30.0);
  ASSERT_EQ(Ask("fault camera frozen"), "ok");
  ASSERT_TRUE(Next());
  const std::vector<std::uint8_t> frozen = image_.data;
  const dds::Stamp first = image_.stamp;
  ASSERT_TRUE(Next());
  EXPECT_EQ(image_.data, frozen);
  EXPECT_NE(image_.stamp, first);  // a grabber does not know
  ASSERT_EQ(Ask("fault camera black"), "ok");
  ASSERT_TRUE(Next());
  EXPECT_LT(Brightness(), 5.0);  // the sensor's noise
  ASSERT_EQ(Ask("fault camera overexposed"), "ok");
  ASSERT_TRUE(Next());
  const auto white = std::count(image_.data.begin(), image_.data.end(), std::uint8_t{255});
  EXPECT_GT(white, static_cast<std::ptrdiff_t>(image_.data.size() / 4));  // all of the gauze
  ASSERT_EQ(Ask("fault camera silent"), "ok");
  images_.TakeNewest(image_);
  const std::uint64_t published = server_->images_published();
  for (int i = 0; i < 200; ++i) {
    server_->Tick(1e-3);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_LE(server_->images_published(), published + 1);  // one was being drawn
  ASSERT_EQ(Ask("fault none"), "ok");
  ASSERT_TRUE(Next());
  EXPECT_NEAR(Brightness(), lit, 0.3 * lit);  // the light wanders
}

TEST_F(DvrkSceneServerTest, FaultsOfTheArmAndTheClockAreSetByRequest) {
  Serve(false, false);
  ASSERT_TRUE(Now(Ask("reset 2")).valid());
  dds::Subscriber<dds::Text> errors(client_, "/PSM1/error", dds::Role::kEvent);
  EXPECT_EQ(Ask("fault arm_fault encoder of joint 2 lost"), "ok");
  dds::Text error;
  ASSERT_TRUE(Until([&] { return errors.TakeNewest(error); }));
  EXPECT_EQ(error.text, "PSM1: encoder of joint 2 lost");
  dds::OperatingState state;
  ASSERT_TRUE(Until([&] { return state_.TakeNewest(state) && state.state == "FAULT"; }));
  EXPECT_EQ(Ask("fault clock_jump 1000"), "ok");
  dds::JointState joints;
  ASSERT_TRUE(Until([&] {
    return joints_.TakeNewest(joints) &&
           joints.stamp.nanoseconds() > dds::Stamp::Now().nanoseconds() + 900'000'000'000;
  }));
  EXPECT_EQ(Ask("fault none"), "ok");
  const dds::Stamp now = Now(Ask("reset 2"));
  EXPECT_LT(now.nanoseconds(), dds::Stamp::Now().nanoseconds() + 1);
  ASSERT_TRUE(Until([&] { return state_.TakeNewest(state) && state.state == "ENABLED"; }));
}

TEST_F(DvrkSceneServerTest, ThePlatformGoesToAndFroAcrossTheLine) {
  Serve(false, false);
  ASSERT_TRUE(Now(Ask("reset 2")).valid());
  EXPECT_THAT(Ask("fault platform 5"), HasSubstr("platform must lie in [0, 0.2] m/s"));
  const auto y = [&] { return scene_->plant().truth().p_world_gauze.translation().y(); };
  const double before = y();
  ASSERT_EQ(Ask("fault platform 0.05"), "ok");
  double least = before;
  double most = before;
  for (int i = 0; i < 1000; ++i) {  // a second: 50 mm, of which there are 10 from side to side
    server_->Tick(1e-3);
    least = std::min(least, y());
    most = std::max(most, y());
  }
  EXPECT_NEAR(most - least, 0.01, 1e-3);
  ASSERT_EQ(Ask("fault none"), "ok");
  const double after = y();
  for (int i = 0; i < 100; ++i) server_->Tick(1e-3);
  EXPECT_NEAR(y(), after, 1e-3);
}

// Pictures take tens of milliseconds to draw, states are due every ten: no tick waits for them.
TEST_F(SceneCameraTest, DrawingDoesNotDelayTheState) {
  // Time of the thread alone, so that a busy machine does not count.
  const auto thread_s = [] {
    timespec t;
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
  };
  const std::uint64_t before = server_->images_published();
  std::vector<double> ticks;
  while (server_->images_published() < before + 10 && ticks.size() < 20000) {
    const double start = thread_s();
    server_->Tick(1e-3);
    ticks.push_back(thread_s() - start);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ASSERT_GE(server_->images_published(), before + 10);
  std::nth_element(ticks.begin(), ticks.end() - 1, ticks.end());
  EXPECT_LT(ticks.back(), 5e-3);
}

}  // namespace
}  // namespace dfr::sim
