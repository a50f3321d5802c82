// Exchanges messages in both directions with CycloneDDS, an independent implementation, which
// changes each field of our samples and sends them back.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/dds/picture.h"
#include "tests/dds/repeat.h"
#include "tests/support/eventually.h"

namespace dfr::dds {
namespace {

class InteroperabilityTest : public testing::Test {
 protected:
  // Repeats the question until the peer answers, because the first questions precede discovery. The
  // first pictures are empty.
  template <typename T>
  T Ask(const std::string& name, Role role, const T& question) {
    Publisher<T> ask(participant_, "/peer/ask/" + name, role);
    Subscriber<T> answers(participant_, "/peer/answer/" + name, role);
    test::Eventually([&] { return ask.num_subscribers() > 0 && answers.health().publishers > 0; });
    T answer;
    const bool picture = role == Role::kImage;
    test::Eventually([&] {
      ask.Write(picture ? T{} : question);
      return answers.Take(answer);
    });
    if (!picture) return answer;
    test::RepeatUntilHeard([&] { ask.Write(question); },
                           [&](double wait_s) {
                             return answers.Wait(wait_s) && answers.Take(answer) &&
                                    answer.stamp.valid();
                           });
    return answer;
  }

  Participant participant_{{.domain = test::OwnDomain()}};
  test::PeerProcess peer_{{DFR_CYCLONE_PEER, std::to_string(test::OwnDomain())}};
};

TEST_F(InteroperabilityTest, EveryFieldArrivesAndReturns) {
  {
    SCOPED_TRACE("PoseStampedAsMeasuredState");
    PoseStamped question;
    question.stamp = {17, 42};
    question.frame_id = "PSM1_base";
    question.position_m << 0.1, -0.2, 0.3;
    question.orientation = Eigen::Quaterniond(0.4, 0.1, 0.2, 0.3);  // w, x, y, z
    const PoseStamped answer = Ask("pose", Role::kState, question);
    EXPECT_EQ(answer.stamp, (Stamp{42, 17}));
    EXPECT_EQ(answer.frame_id, "PSM1_base");
    EXPECT_EQ(answer.position_m, Eigen::Vector3d(0.1 + 1.0, -0.2 + 2.0, 0.3 + 3.0));
    EXPECT_EQ(answer.orientation.coeffs(), Eigen::Vector4d(0.4, 0.3, 0.2, 0.1));  // x, y, z, w
    // A plain ROS 2 reader matches a command publisher, although the publisher also offers deadline
    // and liveliness.
    EXPECT_EQ(Ask("pose", Role::kCommand, question).position_m, answer.position_m);
  }
  {
    SCOPED_TRACE("TwistStamped");
    TwistStamped question;
    question.stamp = {5, 6};
    question.frame_id = "PSM1_base";
    question.linear_m_s << 0.1, -0.2, 0.3;
    question.angular_rad_s << 1.0, 2.0, -3.0;
    const TwistStamped answer = Ask("twist", Role::kState, question);
    EXPECT_EQ(answer.stamp, (Stamp{6, 5}));
    EXPECT_EQ(answer.frame_id, "PSM1_base");
    EXPECT_EQ(answer.linear_m_s, question.angular_rad_s);
    EXPECT_EQ(answer.angular_rad_s, question.linear_m_s);
  }
  {
    SCOPED_TRACE("JointState");
    JointState question;
    question.stamp = {1, 2};
    question.name = {"yaw", "pitch", "insertion"};
    question.position = {0.1, 0.2, 0.3};
    question.velocity = {-1.0, 0.0, 1e-300};
    const JointState answer = Ask("joints", Role::kState, question);
    EXPECT_EQ(answer.stamp, (Stamp{2, 1}));
    EXPECT_EQ(answer.name, (std::vector<std::string>{"insertion", "pitch", "yaw"}));
    EXPECT_EQ(answer.position, (std::vector<double>{0.3, 0.2, 0.1}));
    EXPECT_EQ(answer.velocity, (std::vector<double>{-2.0, 0.0, 2e-300}));
    EXPECT_TRUE(answer.effort.empty());
  }
  {
    SCOPED_TRACE("OperatingState");
    OperatingState question;
    question.state = "ENABLED";
    question.is_homed = true;
    // A subscriber that asks for samples kept for late joiners refuses the peer's plain publisher.
    const OperatingState answer = Ask("state", Role::kState, question);
    EXPECT_EQ(answer.state, "DELBANE");
    EXPECT_FALSE(answer.is_homed);
    EXPECT_TRUE(answer.is_busy);
  }
  {
    SCOPED_TRACE("CameraInfo");
    CameraInfo question;
    question.stamp = {9, 10};
    question.frame_id = "ECM";
    question.height = 480;
    question.width = 640;
    question.distortion_model = "plumb_bob";
    question.d = {-0.2, 0.05, 1e-3, -1e-3, 0.25};
    question.k = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    question.r = {11, 12, 13, 14, 15, 16, 17, 18, 19};
    question.p = {21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32};
    question.binning_x = 1;
    question.binning_y = 2;
    question.roi_x_offset = 3;
    question.roi_y_offset = 4;
    question.roi_height = 5;
    question.roi_width = 6;
    question.roi_do_rectify = true;
    const CameraInfo answer = Ask("camera", Role::kState, question);
    EXPECT_EQ(answer.stamp, (Stamp{10, 9}));
    EXPECT_EQ(answer.frame_id, "ECM");
    EXPECT_EQ(answer.height, 640U);
    EXPECT_EQ(answer.width, 480U);
    EXPECT_EQ(answer.distortion_model, "plumb_bob");
    EXPECT_EQ(answer.d, (std::vector<double>{0.2, -0.05, -1e-3, 1e-3, -0.25}));
    EXPECT_EQ(answer.k, (std::array<double, 9>{9, 8, 7, 6, 5, 4, 3, 2, 1}));
    EXPECT_EQ(answer.r, (std::array<double, 9>{19, 18, 17, 16, 15, 14, 13, 12, 11}));
    EXPECT_EQ(answer.p, (std::array<double, 12>{32, 31, 30, 29, 28, 27, 26, 25, 24, 23, 22, 21}));
    EXPECT_EQ(answer.binning_x, 2U);
    EXPECT_EQ(answer.binning_y, 1U);
    EXPECT_EQ(answer.roi_x_offset, 4U);
    EXPECT_EQ(answer.roi_y_offset, 3U);
    EXPECT_EQ(answer.roi_height, 6U);
    EXPECT_EQ(answer.roi_width, 5U);
    EXPECT_FALSE(answer.roi_do_rectify);
  }
  {
    SCOPED_TRACE("Image640By480");
    const Image question = test::LargePicture();
    const Image answer = Ask("image", Role::kImage, question);
    EXPECT_EQ(answer.height, 640U);
    EXPECT_EQ(answer.width, 480U);
    EXPECT_EQ(answer.encoding, "bgr8");
    EXPECT_EQ(answer.step, 1920U);
    ASSERT_EQ(answer.data.size(), question.data.size());
    std::vector<std::uint8_t> inverted = question.data;
    for (std::uint8_t& byte : inverted) byte = static_cast<std::uint8_t>(~byte);
    EXPECT_TRUE(answer.data == inverted);
  }
  {
    SCOPED_TRACE("CompressedImage");
    CompressedImage question;
    question.stamp = {7, 8};
    question.frame_id = "ECM";
    question.format = "jpeg";
    question.data = {0xff, 0xd8, 1, 2, 3};
    const CompressedImage answer = Ask("compressed", Role::kImage, question);
    EXPECT_EQ(answer.stamp, (Stamp{8, 7}));
    EXPECT_EQ(answer.frame_id, "ECM");
    EXPECT_EQ(answer.format, "gepj");
    EXPECT_EQ(answer.data, (std::vector<std::uint8_t>{3, 2, 1, 0xd8, 0xff}));
  }
  // A plain publisher keeps no messages for late joiners.
  const Subscriber<PoseStamped> subscriber(participant_, "/peer/answer/pose", Role::kEvent);
  test::Eventually([&] { return subscriber.health().incompatible > 0; });
  EXPECT_EQ(subscriber.health().incompatible, 1);
  EXPECT_EQ(subscriber.health().publishers, 0);
}

}  // namespace
}  // namespace dfr::dds
