#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "dfr/dds/messages.h"
#include "dfr/dds/participant.h"

namespace dfr::dds {

/// What a topic is for, which decides its quality of service. All but kSensorImage are reliable.
/// Publishers of every role match subscribers of the same role, and both match a plain ROS 2 peer,
/// except where noted.
enum class Role {
  /// Set-points in quick succession: only the newest counts. The publisher offers a deadline of
  /// 40 ms and liveliness by writing with a lease of 100 ms. Samples that were not taken expire
  /// 50 ms after they were sent, so clocks of two machines must agree to a few milliseconds. The
  /// subscriber asks for nothing, as a console does.
  kCommand,
  /// The same, and the subscriber asks for deadline and liveliness: its Health() then tells within
  /// 100 ms that the publisher has died or hangs. Refuses a plain ROS 2 publisher.
  kOwnCommand,
  /// Measured state: the publisher keeps 100 samples, the subscriber the newest.
  kState,
  /// What changes seldom and may not be missed (operating_state, error): the publisher keeps the
  /// last
  /// 100 for late joiners.
  kEvent,
  /// What is asked for once (state_command, hold): nothing is kept, so that who joins late does not
  /// get a `home` of long ago.
  kRequest,
  /// Images: the newest alone.
  kImage,
  /// Images that are not sent again when they are lost (best effort), as ROS 2's sensor data: a
  /// subscriber of kImage refuses their publisher.
  kSensorImage,
  /// The latched emergency stop: the last ten reach late joiners within 200 ms.
  kEmergencyStop,
};

/// How a subscriber stands with its publishers.
struct Health {
  int publishers = 0;  ///< Matched now. More than one on a command topic is one too many.
  int found = 0;  ///< Matched since the start; one that was forgotten and found again counts twice.
  int alive = 0;  ///< Matched publishers that kept their liveliness.
  int missed_deadlines = 0;  ///< Since the start.
  int incompatible = 0;      ///< Publishers refused because of what they offer, since the start.
};

/// Sends T = one of messages.h to a ROS 2 topic. One object belongs to one thread at a time.
template <typename T>
class Publisher {
 public:
  /// @param topic  as ROS 2 calls it, "/PSM1/servo_cp".
  /// @throws std::invalid_argument if the topic does not begin with a slash; std::runtime_error if
  ///   DDS refuses to make the writer (another type under this name, no permission).
  Publisher(Participant& participant, const std::string& topic, Role role);
  ~Publisher();
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;

  /// Sends. False if DDS could not take it within 100 ms.
  bool Write(const T& message) noexcept;
  /// Subscribers matched now.
  [[nodiscard]] int num_subscribers() const noexcept;
  /// What Subscriber::Take() says of its samples.
  [[nodiscard]] Origin origin() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Receives T from a ROS 2 topic. Never calls back: samples wait to be taken. One object belongs to
/// one thread at a time.
template <typename T>
class Subscriber {
 public:
  /// @throws as Publisher.
  Subscriber(Participant& participant, const std::string& topic, Role role);
  ~Subscriber();
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  /// Takes the oldest sample that has not been taken. False, with `message` unchanged, if there is
  /// none.
  bool Take(T& message) noexcept;
  /// The same, and who sent it.
  bool Take(T& message, Origin& from) noexcept;
  /// Takes all samples and keeps the newest. False, with `message` unchanged, if there is none.
  bool TakeNewest(T& message) noexcept;
  /// Waits until there is a sample to take, for `timeout_s` at most. True if there is.
  bool Wait(double timeout_s) noexcept;
  [[nodiscard]] Health health() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The server of a ROS 2 service, as Fast DDS' middleware for ROS 2 has them. One object belongs to
/// one thread at a time.
template <typename Query, typename Answer>
class Service {
 public:
  /// @param name  as ROS 2 calls it, "/PSM1/forward_kinematics".
  /// @throws as Publisher.
  Service(Participant& participant, const std::string& name);
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  /// Answers all queries that have come. Returns how many.
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
