#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "dfr/dds/participant.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "dfr/sim/dvrk_scene/dvrk_scene.h"

namespace dfr::sim {

/// Options for DvrkSceneServer.
struct DvrkSceneServerOptions {
  /// The server replaces `clock`.
  PsmConsoleServerOptions console;
  bool lock_step = false;
  /// Maximum time that a run waits for its commands, s, in [0, 60].
  double command_timeout_s = 1.0;
  bool camera = true;
  double image_period_s = 1.0 / 30.0;  ///< Period of pictures in real time, > 0.
  int jpeg_quality = 90;               ///< In [1, 100].
  std::string camera_name = "ECM";     ///< First part of the camera's topics, and its frame.
  std::string platform_name = "SPRK";  ///< First part of the platform's topics, and its frame.
};

/// Publishes a DvrkScene on the topics of PsmConsoleServer and on
///   ECM/image_raw  ECM/image_raw/compressed  ECM/camera_info   bgr8 640 x 480 and JPEG, 30 Hz
///   SPRK/measured_cp  SPRK/setpoint_cp                         platform pose, with the arm's state
/// Pictures are drawn only while one of the camera's topics has a subscriber.
///
/// The simulator has an additional interface, which no console has. A client sends a StringStamped
/// to /simulator/request and receives one on /simulator/reply with the same timestamp. The reply's
/// text starts with "ok", or is "error: " and the reason. Requests:
///   reset SEED          the next episode: DvrkScene::Reset(). "ok NOW"
///   truth               "ok COMPLETED COLLIDED PROGRESS_M DISTANCE_M TIP_X TIP_Y TIP_Z", flags as
///                       0 or 1, the tip in the world frame, m
///   arm                 "ok NAME", the name of the console's arm
///   fault NAME VALUE    any of ConsoleFaults; camera none|frozen|black|overexposed|no_line|no_tip|
///                       silent|frozen_noisy|late; platform M_PER_S; unheard hold|free; arm_fault
///                       REASON; none (ends all except arm_fault and unheard). "ok"
/// and in lock-step:
///   run DT_S [COMMANDS] takes all pending commands, advances by DT_S in equal steps of at most
///                       20 ms, and publishes the state once. With COMMANDS it first waits, for
///                       command_timeout_s at most, for this number of motion commands since the
///                       last run, reset or rest. On a timeout it does nothing and replies with an
///                       error. The wait is needed because topics have no common order. "ok NOW"
///   rest                DvrkScene::Rest(); publishes the state. "ok NOW"
///   look                takes the next picture and publishes it. "ok NOW"
/// NOW is the timestamp of the published state or picture, in nanoseconds since the epoch. In
/// lock-step, time starts at a whole second near the current time and advances only with runs.
/// Numbers in replies are the shortest text that reads back as the same value.
///
/// Each object belongs to the thread that made it.
class DvrkSceneServer {
 public:
  /// Borrows all arguments, which must outlive it. `images` is for the camera and may be the same
  /// as `participant`.
  /// @throws std::invalid_argument naming the option out of range; std::runtime_error if DDS
  ///   refuses a topic or, with a camera, if rendering is not possible on this machine.
  DvrkSceneServer(dds::Participant& participant, dds::Participant& images, DvrkScene& scene,
                  const DvrkSceneServerOptions& options = {});
  ~DvrkSceneServer();
  DvrkSceneServer(const DvrkSceneServer&) = delete;
  DvrkSceneServer& operator=(const DvrkSceneServer&) = delete;

  /// Real time: takes all pending input, advances by `dt_s`, and publishes all due messages. Call
  /// about every millisecond. @pre 0 <= dt_s <= 0.1
  void Tick(double dt_s);
  /// Lock-step: waits up to `timeout_s` for requests and answers all pending ones. Takes commands
  /// meanwhile, but does not move anything.
  void Serve(double timeout_s);

  /// Applies the request "fault".
  /// @throws std::invalid_argument naming the unknown name or value and listing the valid ones.
  void SetFault(std::string_view name, std::string_view value);

  [[nodiscard]] std::uint64_t states_published() const noexcept;
  [[nodiscard]] std::uint64_t images_published() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
