// A peer written with CycloneDDS, which shares with dfr only the names and types of the topics. It
// answers every sample on /peer/ask/X with a changed sample on /peer/answer/X, until it is killed:
//   cyclone_peer DOMAIN
// pose: position + (1, 2, 3), quaternion reversed; joints: names and values reversed, velocities
// doubled; state: text reversed, flags swapped; image: bytes inverted, width and height swapped;
// twist: linear and angular swapped; compressed: format and bytes reversed; camera: k, r and p
// reversed, distortion negated, width and height, binning, offsets and sizes of the region swapped.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <iterator>
#include <string>
#include <utility>

#include "ros2_types.h"
#include "tests/dds/cyclone.h"

namespace {

using dfr::test::Check;
using dfr::test::MakeReader;
using dfr::test::MakeWriter;

void Change(geometry_msgs_msg_dds__PoseStamped_& m) {
  m.pose_.position_.x_ += 1.0;
  m.pose_.position_.y_ += 2.0;
  m.pose_.position_.z_ += 3.0;
  std::swap(m.pose_.orientation_.x_, m.pose_.orientation_.w_);
  std::swap(m.pose_.orientation_.y_, m.pose_.orientation_.z_);
}

void Change(sensor_msgs_msg_dds__JointState_& m) {
  std::reverse(m.name_._buffer, m.name_._buffer + m.name_._length);
  std::reverse(m.position_._buffer, m.position_._buffer + m.position_._length);
  for (std::uint32_t i = 0; i < m.velocity_._length; ++i) m.velocity_._buffer[i] *= 2.0;
}

void Change(crtk_msgs_msg_dds__OperatingState_& m) {
  std::reverse(m.state_, m.state_ + std::strlen(m.state_));
  std::swap(m.is_homed_, m.is_busy_);
}

void Change(sensor_msgs_msg_dds__Image_& m) {
  std::swap(m.width_, m.height_);
  for (std::uint32_t i = 0; i < m.data_._length; ++i) {
    m.data_._buffer[i] = static_cast<std::uint8_t>(~m.data_._buffer[i]);
  }
}

void Change(geometry_msgs_msg_dds__TwistStamped_& m) {
  std::swap(m.twist_.linear_, m.twist_.angular_);
}

void Change(sensor_msgs_msg_dds__CompressedImage_& m) {
  std::reverse(m.format_, m.format_ + std::strlen(m.format_));
  std::reverse(m.data_._buffer, m.data_._buffer + m.data_._length);
}

void Change(sensor_msgs_msg_dds__CameraInfo_& m) {
  std::swap(m.width_, m.height_);
  for (std::uint32_t i = 0; i < m.d_._length; ++i) m.d_._buffer[i] *= -1.0;
  std::reverse(std::begin(m.k_), std::end(m.k_));
  std::reverse(std::begin(m.r_), std::end(m.r_));
  std::reverse(std::begin(m.p_), std::end(m.p_));
  std::swap(m.binning_x_, m.binning_y_);
  std::swap(m.roi_.x_offset_, m.roi_.y_offset_);
  std::swap(m.roi_.width_, m.roi_.height_);
  m.roi_.do_rectify_ = !m.roi_.do_rectify_;
}

template <typename T>
class Answerer {
 public:
  Answerer(const dds_topic_descriptor_t& type, const std::string& name)
      : reader_(MakeReader(type, "rt/peer/ask/" + name, 10)),
        writer_(MakeWriter(type, "rt/peer/answer/" + name, 10)) {}

  void Poll() const {
    dfr::test::Take<T>(reader_, [this](T& message) {
      // The stamp's two parts are swapped as well.
      auto& stamp = message.header_.stamp_;
      const auto sec = static_cast<std::uint32_t>(stamp.sec_);
      stamp.sec_ = static_cast<std::int32_t>(std::exchange(stamp.nanosec_, sec));
      Change(message);
      Check(dds_write(writer_, &message));
    });
  }

 private:
  dds_entity_t reader_;
  dds_entity_t writer_;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return EXIT_FAILURE;
  dfr::test::Join(argv[1]);
  const Answerer<geometry_msgs_msg_dds__PoseStamped_> pose(geometry_msgs_msg_dds__PoseStamped__desc,
                                                           "pose");
  const Answerer<sensor_msgs_msg_dds__JointState_> joints(sensor_msgs_msg_dds__JointState__desc,
                                                          "joints");
  const Answerer<crtk_msgs_msg_dds__OperatingState_> state(crtk_msgs_msg_dds__OperatingState__desc,
                                                           "state");
  const Answerer<sensor_msgs_msg_dds__Image_> image(sensor_msgs_msg_dds__Image__desc, "image");
  const Answerer<geometry_msgs_msg_dds__TwistStamped_> twist(
      geometry_msgs_msg_dds__TwistStamped__desc, "twist");
  const Answerer<sensor_msgs_msg_dds__CompressedImage_> compressed(
      sensor_msgs_msg_dds__CompressedImage__desc, "compressed");
  const Answerer<sensor_msgs_msg_dds__CameraInfo_> camera(sensor_msgs_msg_dds__CameraInfo__desc,
                                                          "camera");
  for (;;) {
    pose.Poll();
    joints.Poll();
    state.Poll();
    image.Poll();
    twist.Poll();
    compressed.Poll();
    camera.Poll();
    dds_sleepfor(DDS_MSECS(2));
  }
}
