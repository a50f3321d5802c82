#include "dfr/sim/dvrk_scene/dvrk_scene_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/support/eventually.h"

namespace dfr::sim {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

DvrkSceneOptions SceneOptions(bool lock_step) {
  DvrkSceneOptions options;
  options.arm.homing_s = 0.1;
  options.linger_s = lock_step ? 0.0 : 0.05;
  options.world.disturbance.wave = Wave::kRandom;
  return options;
}

// A scene with its server, and a client's publishers and subscribers.
class DvrkSceneServerTest : public testing::Test {
 protected:
  void Serve(bool lock_step, bool camera) {
    DvrkSceneServerOptions options;
    options.lock_step = lock_step;
    options.camera = camera;
    options.command_timeout_s = command_timeout_s_;
    lock_step_ = lock_step;
    scene_ = std::make_unique<DvrkScene>(SceneOptions(lock_step));
    server_ = std::make_unique<DvrkSceneServer>(participant_, participant_, *scene_, options);
  }

  // Runs the server until `condition` holds.
  void Until(const std::function<bool()>& condition) {
    test::Eventually([&] {
      if (condition()) return true;
      if (lock_step_) {
        server_->Serve(0.0);
      } else {
        server_->Tick(1e-3);
      }
      return false;
    });
  }

  // Returns the reply. First repeats a request without effect, because discovery is not symmetric.
  std::string Ask(const std::string& text) {
    dds::StringStamped reply;
    if (!known_) {
      Until([&] {
        request_.Write({{-1, 0}, "", "truth"});
        return reply_.Take(reply);
      });
      known_ = true;
    }
    const dds::Stamp id = {++asked_, 0};
    request_.Write({id, "", text});
    Until([&] { return reply_.Take(reply) && reply.stamp == id; });
    return reply.text;
  }

  // Same as Ask() for a run with a command. Repeats the command until it arrives, because a busy
  // machine loses commands.
  std::string AskWith(const dds::JointState& command, const std::string& run) {
    std::string reply;
    do {
      servo_jp_.Write(command);
      reply = Ask(run);
    } while (reply.rfind("error: only 0 of 1", 0) == 0);
    return reply;
  }

  // Returns the time of a reply "ok NOW".
  static dds::Stamp Now(const std::string& reply) {
    if (reply.rfind("ok ", 0) != 0) return {};
    return dds::Stamp::FromNanoseconds(std::stoll(reply.substr(3)));
  }

  dds::Participant participant_{{.domain = test::OwnDomain()}};
  dds::Participant client_{{.domain = test::OwnDomain()}};
  bool lock_step_ = false;
  double command_timeout_s_ = 1.0;  // longer than the lifetime of a command
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

// An episode over the network has the same states and pictures as the plant in one process, bit for
// bit.
TEST_F(DvrkSceneServerTest, InLockStepTheNetworkChangesNothing) {
  Serve(true, true);
  dds::Subscriber<dds::Image> images(client_, "/ECM/image_raw", dds::Role::kImage);
  LineTrackingOptions world = SceneOptions(true).world;
  LineTrackingPlant plant(world);
  std::vector<std::uint8_t> expected(plant.endoscope().image_size());
  Until([&] { return joints_.health().publishers == 1 && images.health().publishers == 1; });
  ASSERT_TRUE(Now(AskWith({}, "run 0 1")).valid());
  plant.Reset(7);
  dds::Stamp now = Now(Ask("reset 7"));
  ASSERT_TRUE(now.valid());
  std::uint64_t pictures = 0;
  dds::JointState measured;
  const auto arrived = [&] { return joints_.TakeNewest(measured) && measured.stamp == now; };
  Until(arrived);

  for (int i = 0; i < 2; ++i) {
    const Eigen::Matrix<double, 6, 1> from =
        Eigen::Map<const Eigen::Matrix<double, 6, 1>>(measured.position.data());
    const std::array<double, 2> u = {0.7, 0.2 * std::sin(i)};
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    const Eigen::Matrix<double, 6, 1> to = plant.reported_joints();
    const Eigen::Vector3d step(LineTrackingPlant::kStep * u[0], LineTrackingPlant::kStep * u[1],
                               0.0);
    const double duration_s = step.norm() / LineTrackingPlant::kSpeed;
    const int samples = static_cast<int>(std::ceil(duration_s / 0.02));
    const auto run_with = [&](const Eigen::Matrix<double, 6, 1>& goal, const std::string& run) {
      dds::JointState message;
      message.position.assign(goal.data(), goal.data() + goal.size());
      return Now(AskWith(message, run));
    };
    for (int k = 1; k <= samples; ++k) {
      std::ostringstream run;
      run.precision(17);
      run << "run " << duration_s / samples << " 1";
      now = run_with(from + (to - from) * (static_cast<double>(k) / samples), run.str());
      ASSERT_TRUE(now.valid());
    }
    ASSERT_TRUE(run_with(to, "run 0 1").valid());
    now = Now(Ask("rest"));
    Until(arrived);
    EXPECT_EQ(scene_->plant().TrueState(), plant.TrueState());

    const dds::Stamp taken = Now(Ask("look"));
    dds::Image image;
    Until([&] { return images.TakeNewest(image) && image.stamp == taken; });
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

TEST_F(DvrkSceneServerTest, InLockStepTimeAdvancesOnlyOnRequest) {
  Serve(true, false);
  const dds::Stamp start = Now(Ask("reset 1"));
  server_->Serve(0.0);
  EXPECT_EQ(Now(Ask("rest")), start);
  EXPECT_EQ(Ask("arm"), "ok PSM1");
  const dds::Stamp later = Now(Ask("run 0.25"));
  EXPECT_EQ(later.nanoseconds() - start.nanoseconds(), 250'000'000);
  dds::PoseStamped measured;
  dds::PoseStamped goal;
  Until([&] { return platform_.TakeNewest(measured) && measured.stamp == later; });
  Until([&] { return platform_goal_.TakeNewest(goal) && goal.stamp == later; });
  EXPECT_EQ(measured.frame_id, "SPRK_base");
  // The arm rests, and therefore the platform rests.
  EXPECT_EQ(measured.position_m, goal.position_m);
}

TEST_F(DvrkSceneServerTest, ImpossibleRequestsAreAnsweredWithTheReason) {
  command_timeout_s_ = 0.0;
  Serve(true, false);
  const std::pair<const char*, const char*> rows[] = {
      {"dance", "unknown request 'dance'"},
      {"reset", "the seed must be a whole number, not ''"},
      {"reset -1", "the seed"},
      {"run soon", "the time to run must be a number, not 'soon'"},
      {"run -1", "the time to run must lie in [0, 60] s"},
      {"run nan", "the time to run must be a number, not 'nan'"},
      {"run 0.01 2", "only 0 of 2 commands have arrived"},
      {"look", "this simulator has no camera"},
      {"fault dust 1", "unknown fault 'dust'; valid: delay"},
      {"fault freeze maybe", "freeze must be 0 or 1, not 'maybe'"},
      {"fault drop 2", "drop must lie in [0, 1]"},
      {"fault platform 5", "platform speed must lie in [0, 0.2] m/s"},
      {"fault unheard jump", "unheard must be hold or free, not 'jump'"},
      {"fault camera upside_down", "unknown camera fault"}};
  for (const auto& [request, words] : rows) {
    EXPECT_THAT(Ask(request), AllOf(StartsWith("error: "), HasSubstr(words)));
  }
  server_.reset();
  known_ = false;
  Serve(false, false);
  EXPECT_THAT(Ask("run 0.01"), StartsWith("error: run requires lock-step"));
  EXPECT_THROW(server_->SetFault("dust", "1"), std::invalid_argument);
  DvrkSceneServerOptions bad;
  bad.jpeg_quality = 0;
  EXPECT_THROW(DvrkSceneServer(participant_, participant_, *scene_, bad), std::invalid_argument);
}

TEST_F(DvrkSceneServerTest, InRealTimePicturesHaveACompressedFormAndCameraInfo) {
  Serve(false, true);
  dds::Subscriber<dds::Image> images(client_, "/ECM/image_raw", dds::Role::kImage);
  dds::Subscriber<dds::CompressedImage> compressed(client_, "/ECM/image_raw/compressed",
                                                   dds::Role::kImage);
  dds::Subscriber<dds::CameraInfo> infos(client_, "/ECM/camera_info", dds::Role::kState);
  dds::Image image;
  dds::CompressedImage jpeg;
  dds::CameraInfo info;
  Until([&] {
    images.TakeNewest(image);
    compressed.TakeNewest(jpeg);
    infos.TakeNewest(info);
    return image.stamp.valid() && image.stamp == jpeg.stamp && image.stamp == info.stamp;
  });
  EXPECT_EQ(image.frame_id, "ECM");
  EXPECT_EQ(image.encoding, "bgr8");
  EXPECT_EQ(image.step, 1920U);
  EXPECT_EQ(image.data.size(), std::size_t{480} * 1920);
  EXPECT_THAT(jpeg.format, HasSubstr("jpeg"));
  // A JPEG file has these first and last bytes, and less than a fifth of the size.
  ASSERT_GT(jpeg.data.size(), 1000U);
  EXPECT_LT(jpeg.data.size(), image.data.size() / 5);
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

// LineTrackingPicturesTest tests the pictures with faults.
TEST_F(DvrkSceneServerTest, CameraFaultsAreSetByTheirNames) {
  Serve(true, true);
  dds::Subscriber<dds::Image> images(client_, "/ECM/image_raw", dds::Role::kImage);
  dds::Image image;
  Until([&] { return images.health().publishers == 1; });
  Until([&] {  // until the server has also found this client
    Ask("look");
    return images.TakeNewest(image);
  });
  const auto look = [&](const std::string& fault) {
    EXPECT_EQ(Ask("fault " + fault), "ok");
    EXPECT_TRUE(Now(Ask("run 0.03")).valid());
    const dds::Stamp taken = Now(Ask("look"));
    Until([&] { return images.TakeNewest(image) && image.stamp == taken; });
  };
  look("none");
  const dds::Image before = image;
  look("camera frozen");
  EXPECT_EQ(image.data, before.data);
  EXPECT_NE(image.stamp, before.stamp) << "a grabber does not stamp its pictures";
  look("camera black");
  EXPECT_LT(std::accumulate(image.data.begin(), image.data.end(), 0.0),
            5.0 * static_cast<double>(image.data.size()));  // noise of the sensor
  for (const auto& [name, fault] :
       {std::pair("overexposed", CameraFault::kOverexposed),
        std::pair("no_line", CameraFault::kNoLine), std::pair("no_tip", CameraFault::kNoTip)}) {
    EXPECT_EQ(Ask(std::string("fault camera ") + name), "ok");
    EXPECT_EQ(scene_->camera_fault(), fault);
  }
  ASSERT_EQ(Ask("fault camera silent"), "ok");
  const std::uint64_t published = server_->images_published();
  EXPECT_TRUE(Now(Ask("look")).valid());
  EXPECT_EQ(server_->images_published(), published);
  look("none");
  EXPECT_EQ(scene_->camera_fault(), CameraFault::kNone);
}

TEST_F(DvrkSceneServerTest, FaultsOfTheArmAndTheClockAreSetByRequest) {
  Serve(true, false);
  ASSERT_TRUE(Now(Ask("reset 2")).valid());
  // The faults stand for commands of another client that only the console receives.
  dds::Subscriber<dds::Text> stated(client_, "/PSM1/status", dds::Role::kEvent);
  dds::Subscriber<dds::Signal> holds(client_, "/PSM1/hold", dds::Role::kRequest);
  for (const auto& [command, control] : {std::pair("hold", "JOINT_SPACE/POSITION_MODE"),
                                         std::pair("free", "JOINT_SPACE/EFFORT_MODE")}) {
    EXPECT_EQ(Ask(std::string("fault unheard ") + command), "ok");
    dds::Text text;
    Until([&, says = std::string("PSM1: control ") + control] {
      return stated.Take(text) && text.text == says;
    });
  }
  dds::Signal signal;
  EXPECT_FALSE(holds.Take(signal));
  dds::Subscriber<dds::Text> errors(client_, "/PSM1/error", dds::Role::kEvent);
  EXPECT_EQ(Ask("fault arm_fault encoder of joint 2 lost"), "ok");
  dds::Text error;
  Until([&] { return errors.TakeNewest(error); });
  EXPECT_EQ(error.text, "PSM1: encoder of joint 2 lost");
  dds::OperatingState state;
  Until([&] { return state_.TakeNewest(state) && state.state == "FAULT"; });
  const std::int64_t before = Now(Ask("run 0")).nanoseconds();
  EXPECT_EQ(Ask("fault clock_jump 1000"), "ok");
  EXPECT_EQ(Now(Ask("run 0")).nanoseconds() - before, 1'000'000'000'000);
  EXPECT_EQ(Ask("fault none"), "ok");
  EXPECT_EQ(Now(Ask("reset 2")).nanoseconds(), before);
  Until([&] { return state_.TakeNewest(state) && state.state == "ENABLED"; });
}

TEST_F(DvrkSceneServerTest, ThePlatformMovesBackAndForthAcrossTheLine) {
  Serve(false, false);
  ASSERT_TRUE(Now(Ask("reset 2")).valid());
  const auto y = [&] { return scene_->plant().truth().p_world_gauze.translation().y(); };
  const double before = y();
  ASSERT_EQ(Ask("fault platform 0.05"), "ok");
  double least = before;
  double most = before;
  for (int i = 0; i < 1000; ++i) {  // one second: 50 mm; the amplitude is 10 mm from side to side
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

}  // namespace
}  // namespace dfr::sim
