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
  /// Its clock is not used: in lock-step, time stands still unless it is asked to go on.
  PsmConsoleServerOptions console;
  bool lock_step = false;
  /// How long a run waits for its commands, s, in [0, 60].
  double command_timeout_s = 1.0;
  bool camera = true;
  double image_period_s = 1.0 / 30.0;  ///< From one picture to the next in real time, > 0.
  int jpeg_quality = 90;               ///< In [1, 100].
  std::string camera_name = "ECM";     ///< First part of the camera's topics, and its frame.
  std::string platform_name = "SPRK";  ///< The same of the platform.
};

/// A DvrkScene on topics: those of PsmConsoleServer, and
///   ECM/image_raw  ECM/image_raw/compressed  ECM/camera_info   bgr8 640 x 480 and JPEG, 30 Hz
///   SPRK/measured_cp  SPRK/setpoint_cp                         the platform's pose, with the state
/// Pictures are drawn only while one of the camera's topics has a subscriber.
///
/// And the simulator's own, which no console has: who sends a StringStamped to /simulator/request
/// gets one on /simulator/reply with the same stamp, whose text begins with "ok", or is "error: "
/// and why. The requests:
///   reset SEED          the next episode: DvrkScene::Reset(). "ok NOW"
///   truth               "ok COMPLETED COLLIDED PROGRESS_M DISTANCE_M TIP_X TIP_Y TIP_Z", flags as
///   0
///                       or 1, the tip in the world frame, m
///   fault NAME VALUE    any of SetFault(); camera none|frozen|black|overexposed|no_line|no_tip|
///                       silent|frozen_noisy|late; arm_fault REASON (the arm fails); none (all
///                       faults end). "ok"
/// and in lock-step:
///   run DT_S [COMMANDS] takes all commands that have come, goes on by DT_S in equal steps of at
///                       most 20 ms, and publishes the state once. With COMMANDS it first waits,
///                       for command_timeout_s at most, until so many motion commands have come
///                       since the last run, reset or rest, and is an error with nothing done if
///                       they do not: topics do not keep each other's order. "ok NOW"
///   rest                DvrkScene::Rest(); publishes the state. "ok NOW"
///   look                takes the next picture and publishes it. "ok NOW"
/// NOW, in nanoseconds since the epoch, is what time it is for stamps: those of the state or
/// picture that was published. In lock-step time begins at a whole second near the present and goes
/// on with runs alone. Numbers in replies are the shortest that read back the same.
///
/// One object belongs to the thread that made it.
class DvrkSceneServer {
 public:
  /// Borrows all, which must outlive it. `images` is for the camera, and may be the same as
  /// `participant`.
  /// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if
  ///   DDS refuses a topic, or with a camera nothing can be drawn here.
  DvrkSceneServer(dds::Participant& participant, dds::Participant& images, DvrkScene& scene,
                  const DvrkSceneServerOptions& options = {});
  ~DvrkSceneServer();
  DvrkSceneServer(const DvrkSceneServer&) = delete;
  DvrkSceneServer& operator=(const DvrkSceneServer&) = delete;

  /// Real time: takes what has come, goes on by `dt_s`, publishes what is due. To be called every
  /// millisecond or so. @pre 0 <= dt_s <= 0.1
  void Tick(double dt_s);
  /// Lock-step: waits up to `timeout_s` for requests, and answers those that have come. Commands
  /// are taken meanwhile, but nothing moves.
  void Serve(double timeout_s);

  /// As the request "fault".
  /// @throws std::invalid_argument naming what is unknown, and what there is.
  void SetFault(std::string_view name, std::string_view value);

  [[nodiscard]] std::uint64_t states_published() const noexcept;
  [[nodiscard]] std::uint64_t images_published() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
