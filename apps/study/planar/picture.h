#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "apps/study/planar/methods.h"
#include "apps/study/planar/task.h"
#include "dfr/control/controller.h"
#include "dfr/control/rollout.h"
#include "dfr/core/trajectory.h"

namespace dfr::study::planar {

/// One applied control of one method, as pictures show it.
struct Shot {
  std::vector<double> x;  ///< The state before the control; the last shot has no control.
  std::vector<double> u;
  control::Step step;
};

/// One method's episode.
struct Episode {
  std::string method;
  std::vector<Shot> shots;
  core::Outcome outcome = core::Outcome::kHalted;
  std::string cause;
};

/// Records an observed rollout as an Episode.
class EpisodeRecorder final : public control::RolloutObserver {
 public:
  explicit EpisodeRecorder(Episode& episode) : episode_(&episode) {}
  void OnStart(std::span<const double> x) override;
  void OnControl(const control::RolloutEvent& event) override;
  void OnEnd(const control::RolloutResult& result) override;

 private:
  Episode* episode_;
  std::vector<double> last_;
};

/// Rolls each method out from the start state of `start_seed`.
[[nodiscard]] std::vector<Episode> Record(const Task& task, const Methods& methods,
                                          const std::vector<std::string>& names,
                                          std::uint64_t start_seed);

/// Part of the plane shown in pictures.
struct View {
  double left, right, bottom, top;
};
[[nodiscard]] View ViewOf(const Task& task);

/// Distance that one control can move the point or disc.
[[nodiscard]] double Reach(const Task& task, std::span<const double> control);

/// The task's plane and its moving bodies, without demonstrations and supports.
class PlanePicture {
 public:
  explicit PlanePicture(const Task& task);

  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }
  /// Writes the state x as height() x width() RGB bytes, top row first.
  void Draw(std::span<const double> x, std::span<std::uint8_t> rgb) const;

 private:
  Task task_;
  View view_;
  double scale_;
  int width_, height_;
  std::vector<std::uint8_t> background_;  ///< Stay-out regions and goal, BGR, below a caption.
};

/// Draws episodes as in the paper's Fig. 2: the stay-out regions, the demonstrations, level sets of
/// the support at the current time step (over positions of the point, or of the pushed object with
/// the pusher at its present position), the path so far, and the circle that the control can reach.
class Painter {
 public:
  Painter(const Task& task, const Methods& methods);

  /// Draws frame `frame` of an episode: BGR, height() x width(). Frames beyond the end show the
  /// end.
  [[nodiscard]] std::vector<std::uint8_t> Draw(const Episode& episode, int frame) const;
  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }

  /// Writes the frames of an episode, stacked vertically.
  /// @throws std::runtime_error naming the file that cannot be written, as WriteVideo() does.
  void WritePng(const Episode& episode, std::span<const int> frames,
                const std::filesystem::path& path) const;
  /// Writes all episodes stacked vertically, frame by frame.
  void WriteVideo(const std::vector<Episode>& episodes, const std::filesystem::path& path) const;

 private:
  const Task* task_;
  const Methods* methods_;
  View view_;
  double scale_;
  int width_, height_;
  std::vector<std::uint8_t> background_;  ///< Stay-out regions and demonstrations.
};

}  // namespace dfr::study::planar
