// A peer written with CycloneDDS that knows only the names and types of the topics. It answers
// every sample on /peer/ask/X with a changed one on /peer/answer/X, until it is killed:
//   cyclone_peer DOMAIN
// pose: position + (1, 2, 3), quaternion reversed; joints: names and values reversed, velocities
// doubled; state: text reversed, flags swapped; image: bytes inverted, width and height swapped;
// twist: linear and angular swapped; compressed: format and bytes reversed; camera: k, r and p
// reversed, distortion negated, width and height, binning, offsets and sizes of the region swapped.
#include <dds/dds.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <iterator>
#include <string>
#include <utility>

#include "ros2_types.h"

namespace {

void Check(dds_return_t code) {
  if (code < 0) std::exit(EXIT_FAILURE);
}

dds_entity_t Topic(dds_entity_t participant, const dds_topic_descriptor_t& type,
                   const std::string& name) {
  const dds_entity_t topic =
      dds_create_topic(participant, &type, ("rt" + name).c_str(), nullptr, nullptr);
  Check(topic);
  return topic;
}

// Settings of a ROS 2 node that uses all defaults.
dds_qos_t* RosDefaults() {
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_durability(qos, DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  return qos;
}

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
  Answerer(dds_entity_t participant, const dds_topic_descriptor_t& type, const std::string& name)
      : type_(&type) {
    dds_qos_t* qos = RosDefaults();
    reader_ =
        dds_create_reader(participant, Topic(participant, type, "/peer/ask/" + name), qos, nullptr);
    writer_ = dds_create_writer(participant, Topic(participant, type, "/peer/answer/" + name), qos,
                                nullptr);
    Check(reader_);
    Check(writer_);
    dds_delete_qos(qos);
  }

  void Poll() {
    void* sample = nullptr;  // allocated by the take
    dds_sample_info_t info;
    const dds_return_t count = dds_take(reader_, &sample, &info, 1, 1);
    Check(count);
    if (count > 0 && info.valid_data) {
      T& message = *static_cast<T*>(sample);
      // The stamp's two parts are swapped as well.
      const auto sec = message.header_.stamp_.sec_;
      message.header_.stamp_.sec_ = static_cast<std::int32_t>(message.header_.stamp_.nanosec_);
      message.header_.stamp_.nanosec_ = static_cast<std::uint32_t>(sec);
      Change(message);
      Check(dds_write(writer_, sample));
    }
    if (count > 0) dds_return_loan(reader_, &sample, count);
  }

 private:
  const dds_topic_descriptor_t* type_;
  dds_entity_t reader_ = 0;
  dds_entity_t writer_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return EXIT_FAILURE;
  const dds_entity_t participant = dds_create_participant(
      static_cast<dds_domainid_t>(std::strtoul(argv[1], nullptr, 10)), nullptr, nullptr);
  Check(participant);
  Answerer<geometry_msgs_msg_dds__PoseStamped_> pose(
      participant, geometry_msgs_msg_dds__PoseStamped__desc, "pose");
  Answerer<sensor_msgs_msg_dds__JointState_> joints(
      participant, sensor_msgs_msg_dds__JointState__desc, "joints");
  Answerer<crtk_msgs_msg_dds__OperatingState_> state(
      participant, crtk_msgs_msg_dds__OperatingState__desc, "state");
  Answerer<sensor_msgs_msg_dds__Image_> image(participant, sensor_msgs_msg_dds__Image__desc,
                                              "image");
  Answerer<geometry_msgs_msg_dds__TwistStamped_> twist(
      participant, geometry_msgs_msg_dds__TwistStamped__desc, "twist");
  Answerer<sensor_msgs_msg_dds__CompressedImage_> compressed(
      participant, sensor_msgs_msg_dds__CompressedImage__desc, "compressed");
  Answerer<sensor_msgs_msg_dds__CameraInfo_> camera(
      participant, sensor_msgs_msg_dds__CameraInfo__desc, "camera");
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
