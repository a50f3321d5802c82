#pragma once

#include <memory>
#include <string>

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {

/// A window that shows a line tracking plant from outside; the mouse turns, moves and zooms the
/// view. Open it before creating the first plant with Observation::kVision on its thread. The
/// plant's endoscope is then drawn in the window's OpenGL context.
class LineTrackingWindow {
 public:
  /// @throws std::runtime_error if there is no display; the message explains rendering without one.
  explicit LineTrackingWindow(const std::string& title);
  ~LineTrackingWindow();
  LineTrackingWindow(const LineTrackingWindow&) = delete;
  LineTrackingWindow& operator=(const LineTrackingWindow&) = delete;

  /// Draws the plant with up to two lines of text and an optional picture of 320 x 240 RGB bytes,
  /// top row first, at the lower right. Handles input for `seconds`. @return false once closed.
  bool Show(const LineTrackingPlant& plant, const std::string& first_line,
            const std::string& second_line, double seconds, std::span<const std::uint8_t> rgb = {});

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
