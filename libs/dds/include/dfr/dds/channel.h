#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "dfr/dds/messages.h"
#include "dfr/dds/participant.h"

namespace dfr::dds {

/// Purpose of a topic, which determines its quality of service. All roles except kSensorImage are
/// reliable. Publishers of a role match subscribers of the same role, and both match a plain ROS 2
/// peer, except where noted.
enum class Role {
  /// Set-points at a high rate. Only the newest is kept. The publisher offers a deadline of 40 ms
  /// and a liveliness lease of 100 ms, which each write renews. Samples expire 50 ms after sending,
  /// which requires the clocks of two machines to agree within a few milliseconds. Like a console,
  /// the subscriber requests no deadline or liveliness.
  kCommand,
  /// Measured state. The publisher keeps 100 samples; the subscriber keeps only the newest.
  kState,
  /// Rare messages that must not be lost (operating_state, error). The publisher keeps the last 100
  /// messages for late joiners.
  kEvent,
  /// One-time requests (state_command, hold). Late joiners receive no earlier sample, because a
  /// console must not execute an old `home`.
  kRequest,
  /// Images. Only the newest is kept. Another thread sends the image; in a secured network, Write()
  /// sends it.
  kImage,
  /// Images without retransmission (best effort), as in ROS 2's sensor data profile. A kImage
  /// subscriber refuses such a publisher.
  kSensorImage,
  /// Latched emergency stop. Late joiners receive the last ten samples within 200 ms.
  kEmergencyStop,
};

/// State of the connection between a subscriber and its publishers.
struct Health {
  /// Number of currently matched publishers. A command topic must not have more than one.
  int publishers = 0;
  /// Number of publishers matched since the start; a rediscovered publisher counts twice.
  int found = 0;
  int incompatible = 0;  ///< Number of publishers refused since the start because of their QoS.
};

/// Sends messages of type T (see messages.h) to a ROS 2 topic. One object belongs to one thread at
/// a time.
template <typename T>
class Publisher {
 public:
  /// @param topic  ROS 2 name, for example "/PSM1/servo_cp".
  /// @throws std::invalid_argument if the topic does not begin with a slash; std::runtime_error if
  ///   DDS cannot create the writer (the topic has another type, or permission is missing).
  Publisher(Participant& participant, const std::string& topic, Role role);
  ~Publisher();
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;

  /// Sends a message. Returns false if DDS could not accept it within 100 ms.
  bool Write(const T& message) noexcept;
  /// Waits up to `timeout_s` for all subscribers to acknowledge all written samples. Returns true
  /// if they did. Destroying a publisher discards the samples that a subscriber has not received.
  bool WaitUntilReceived(double timeout_s) noexcept;
  /// Returns the number of currently matched subscribers.
  [[nodiscard]] int num_subscribers() const noexcept;
  /// Returns the origin that Subscriber::Take() reports for this publisher's samples.
  [[nodiscard]] Origin origin() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Receives messages of type T from a ROS 2 topic by polling, without callbacks. One object belongs
/// to one thread at a time.
template <typename T>
class Subscriber {
 public:
  /// @throws as Publisher.
  Subscriber(Participant& participant, const std::string& topic, Role role);
  ~Subscriber();
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  /// Takes the oldest unread sample. Returns false, with `message` unchanged, if there is none.
  bool Take(T& message) noexcept;
  /// Overload that also sets `from` to the sender.
  bool Take(T& message, Origin& from) noexcept;
  /// Takes all samples and keeps the newest. Returns false, with `message` unchanged, if there is
  /// none.
  bool TakeNewest(T& message) noexcept;
  /// Waits up to `timeout_s` for a sample. Returns true if one is available.
  bool Wait(double timeout_s) noexcept;
  [[nodiscard]] Health health() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Server of a ROS 2 service, compatible with ROS 2's Fast DDS middleware. One object belongs to
/// one thread at a time.
template <typename Query, typename Answer>
class Service {
 public:
  /// @param name  ROS 2 name, for example "/PSM1/forward_kinematics".
  /// @throws as Publisher.
  Service(Participant& participant, const std::string& name);
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  /// Answers all pending queries. Returns their number.
  int Serve(const std::function<Answer(const Query&)>& answer);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

extern template class Publisher<PoseStamped>;
extern template class Publisher<TwistStamped>;
extern template class Publisher<JointState>;
extern template class Publisher<OperatingState>;
extern template class Publisher<StringStamped>;
extern template class Publisher<Joy>;
extern template class Publisher<Image>;
extern template class Publisher<CompressedImage>;
extern template class Publisher<CameraInfo>;
extern template class Publisher<Text>;
extern template class Publisher<Flag>;
extern template class Publisher<Signal>;
extern template class Publisher<WrenchStamped>;
extern template class Publisher<CartesianState>;
extern template class Publisher<Number>;
extern template class Publisher<Matrix>;
extern template class Subscriber<PoseStamped>;
extern template class Subscriber<TwistStamped>;
extern template class Subscriber<JointState>;
extern template class Subscriber<OperatingState>;
extern template class Subscriber<StringStamped>;
extern template class Subscriber<Joy>;
extern template class Subscriber<Image>;
extern template class Subscriber<CompressedImage>;
extern template class Subscriber<CameraInfo>;
extern template class Subscriber<Text>;
extern template class Subscriber<Flag>;
extern template class Subscriber<Signal>;
extern template class Subscriber<WrenchStamped>;
extern template class Subscriber<CartesianState>;
extern template class Subscriber<Number>;
extern template class Subscriber<Matrix>;
extern template class Service<ForwardKinematicsQuery, ForwardKinematicsAnswer>;
extern template class Service<InverseKinematicsQuery, InverseKinematicsAnswer>;

}  // namespace dfr::dds
