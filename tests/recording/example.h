#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/recording/recorder.h"
#include "dfr/recording/records.h"

namespace dfr::test {

/// Returns step number `i` of an example: every field differs between steps, and numbers cover all
/// kinds of doubles, including a NaN with a payload.
inline recording::StepRecord ExampleStep(std::uint64_t i) {
  core::Random random(core::DeriveSeed(1, {i}));
  recording::StepRecord step;
  step.time_ns = 1'700'000'000'000'000'000 + static_cast<std::int64_t>(i) * 10'000'001;
  step.episode = i / 7;
  step.seed = random();
  step.t = static_cast<std::int32_t>(i % 50);
  step.iteration = static_cast<std::int32_t>(i % 3);
  step.mode = i % 5 == 4 ? "halt" : "policy";
  step.cause = i % 5 == 4 ? "the support ends here" : "none";
  step.machine = "running";
  step.applied = i % 5 != 4;
  step.filtered = i % 3 == 0;
  step.certified = i % 2 == 0;
  const std::array<double, 8> special = {std::numeric_limits<double>::quiet_NaN(),
                                         std::bit_cast<double>(0x7ff8000000000123ULL),
                                         std::numeric_limits<double>::infinity(),
                                         -std::numeric_limits<double>::infinity(),
                                         -0.0,
                                         std::numeric_limits<double>::denorm_min(),
                                         std::numeric_limits<double>::max(),
                                         1.0 / 3.0};
  step.g = special[i % special.size()];
  step.log_g = random.Normal();
  step.threshold = random.Normal();
  step.decision_s = random.Uniform();
  std::vector<double> numbers(i % (step.state.kCapacity + 1));
  for (double& number : numbers) number = random.Normal();
  if (!numbers.empty()) numbers.back() = special[i % special.size()];
  step.state.Assign(numbers);
  numbers.resize(i % (step.command.kCapacity + 1));
  step.command.Assign(numbers);
  step.image_sequence = i / 3;
  step.image_time_ns = step.time_ns - 12'345'678;
  return step;
}

inline recording::TransitionRecord ExampleTransition(std::uint64_t i) {
  recording::TransitionRecord transition;
  transition.time_ns = ExampleStep(i).time_ns;
  transition.from = i % 2 == 0 ? "armed" : "running";
  transition.to = i % 2 == 0 ? "running" : "holding";
  transition.cause =
      i % 2 == 0 ? "the operator said so" : "no image for 0.1 s: Kamera dunkel, 5 µm";
  return transition;
}

inline recording::ArmRecord ExampleArm(std::uint64_t i) {
  core::Random random(core::DeriveSeed(2, {i}));
  recording::ArmRecord arm;
  arm.time_ns = ExampleStep(i).time_ns + 1'000'000;
  arm.measured_ns = arm.time_ns - 3'000'000;
  for (auto* numbers : {&arm.position, &arm.velocity, &arm.setpoint, &arm.console_setpoint}) {
    std::array<double, 6> joints{};
    for (double& joint : joints) joint = random.Normal();
    numbers->Assign(joints);
  }
  if (i % 2 == 1) arm.setpoint.Assign({});
  arm.operating_state = i % 2 == 0 ? "ENABLED" : "PAUSED";
  arm.homed = true;
  arm.busy = i % 3 == 0;
  arm.machine = i % 2 == 0 ? "running" : "holding";
  arm.fault = i % 2 == 0 ? "" : "arm-not-ready: the arm is PAUSED";
  arm.stop = "released";
  return arm;
}

inline recording::RecordingMetadata ExampleMetadata() {
  return {.program = "example 1.0",
          .commit = "0123456789ab",
          .model = "models/example",
          .model_checksum = "00000000deadbeef",
          .method = "controller",
          .seed = 18'446'744'073'709'551'615U,
          .configuration = "[robot]\narm = \"PSM1\"\n",
          .more = {{"operator", "nobody"}}};
}

/// Returns the pixels of a 64 x 48 picture, bgr8. It is smooth, so JPEG changes the pixels little.
inline std::vector<std::uint8_t> ExamplePixels(std::uint32_t i) {
  std::vector<std::uint8_t> pixels(std::size_t{64} * 48 * 3);
  for (std::size_t k = 0; k < pixels.size(); ++k) {
    pixels[k] = static_cast<std::uint8_t>(60 + k / (64 * 3) + (k % 3) * 20 + i % 50);
  }
  return pixels;
}

inline recording::PictureView ExamplePicture(std::uint32_t i,
                                             const std::vector<std::uint8_t>& pixels) {
  return {.time_ns = ExampleStep(i).time_ns,
          .sequence = i,
          .format = recording::PictureFormat::kBgr8,
          .width = 64,
          .height = 48,
          .step = 64 * 3,
          .data = pixels};
}

}  // namespace dfr::test
