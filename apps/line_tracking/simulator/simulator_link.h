#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "dfr/dds/channel.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {

/// True state of dvrk_simulator's world, unknown on a robot.
struct SimulatorTruth {
  bool completed = false;
  bool collided = false;
  double progress_m = 0.0;
  double distance_m = 0.0;
  Eigen::Vector3d tip_m = Eigen::Vector3d::Zero();  ///< World frame.
};

/// Requests to dvrk_simulator for which a robot's console has no topic: episodes, the truth, and in
/// lock-step the advance of time. Calls wait for the answer. One object belongs to one thread.
class SimulatorLink {
 public:
  /// @param answer_s  timeout for an answer: drawing a picture may take a while.
  /// @param steady_ns  a monotonic clock.
  explicit SimulatorLink(dds::Participant& participant, double answer_s = 5.0,
                         std::function<std::int64_t()> steady_ns = runtime::SteadyNow);

  /// @throws std::runtime_error if there is no simulator after `timeout_s`, or if its arm is not
  ///   `arm`. An empty `arm` permits any.
  void Await(double timeout_s, const std::string& arm = {});
  /// Begins a new episode, like sim::LineTrackingPlant::Reset(seed).
  void Reset(std::uint64_t seed);
  [[nodiscard]] SimulatorTruth Truth();
  /// Overload that calls `go_on` repeatedly until the answer arrives. Returns false as soon as
  /// `go_on` does, with `truth` unchanged.
  [[nodiscard]] bool Truth(SimulatorTruth& truth, const std::function<bool()>& go_on);
  /// Injects the fault `name` with `value`, as DvrkSceneServer::SetFault() does.
  void Fault(const std::string& name, const std::string& value);
  /// In lock-step, advances time after `commands` motion commands have arrived since the last call.
  /// If fewer arrive, returns false and does not advance time: set-points expire after 50 ms, and a
  /// busy machine can delay commands.
  [[nodiscard]] bool Run(double dt_s, int commands);
  void Rest();  ///< Runs until everything is at rest.
  void Look();  ///< Takes and publishes the next picture.

  /// Simulator's time at its last answer to Reset(), Run(), Rest() or Look(), ns since the epoch.
  [[nodiscard]] std::int64_t now_ns() const noexcept { return now_ns_; }

 private:
  // Returns the answer after "ok". @throws std::runtime_error for an error or without an answer.
  std::string Ask(const std::string& request);
  void Begin(const std::string& request);
  std::optional<std::string> Poll();
  [[noreturn]] static void FailUnanswered(const std::string& request);
  // Returns the answer, or nothing if there is none in time.
  std::optional<std::string> TryAsk(const std::string& request, double timeout_s);
  void AskForTime(const std::string& request);
  [[nodiscard]] std::int64_t In(double seconds) const;

  dds::Participant* participant_;
  double answer_s_;
  std::function<std::int64_t()> steady_ns_;
  dds::Publisher<dds::StringStamped> request_;
  dds::Subscriber<dds::StringStamped> reply_;
  std::int64_t last_id_ = 0;
  std::int64_t now_ns_ = 0;
};

}  // namespace dfr::apps::line_tracking
