#pragma once

#include <cstdint>
#include <vector>

#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "dfr/vision/calibration_frame.h"

namespace dfr::sim {

/// Returns the prior knowledge before a calibration: the manufacturer's data for the lens and the
/// mounting, without distortion and with errors of a few millimetres and degrees, and an arm
/// without correction.
[[nodiscard]] line_task::LineCalibration NominalCalibration();

/// Moves the platform and the arm through `frames` random poses, and leaves the plant in the last
/// pose. The tip touches the gauze in every other pose. Records joints and features of the
/// endoscope's view, found with NominalCalibration() only. Omits poses in which the marks are not
/// found.
/// @throws std::invalid_argument unless frames > 0.
[[nodiscard]] std::vector<vision::CalibrationFrame> RecordCalibrationMotion(
    LineTrackingPlant& plant, int frames, std::uint64_t seed);

/// Returns the tip errors in mm at `poses` new random poses of the arm: the distances in the
/// camera's frame from the true tip to the calibration's estimate from the arm's readings.
[[nodiscard]] std::vector<double> HeldOutTipErrors(LineTrackingPlant& plant,
                                                   const line_task::LineCalibration& calibration,
                                                   int poses, std::uint64_t seed);

}  // namespace dfr::sim
