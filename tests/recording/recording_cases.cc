// Writes a finished log, and a second file with the log's content and numbers as bits, for
// log_peer.mjs. usage: recording_cases FOLDER
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <span>
#include <string>

#include "dfr/recording/recorder.h"
#include "tests/recording/example.h"

namespace {

constexpr std::uint32_t kSteps = 200;
constexpr std::uint32_t kPictures = 3;

std::string Bits(double value) {
  return '"' + std::to_string(std::bit_cast<std::uint64_t>(value)) + '"';
}

std::string Bits(std::span<const double> values) {
  std::string text = "[";
  for (const double value : values) text += (text.size() > 1 ? "," : "") + Bits(value);
  return text + "]";
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 2) return EXIT_FAILURE;
  const std::filesystem::path folder = argv[1];
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  dfr::recording::Recorder recorder(folder / "log.mcap", dfr::test::ExampleMetadata());
  std::ofstream out(folder / "log.json");
  out << "{\"pictures\":" << kPictures << ",\"steps\":[";
  for (std::uint32_t i = 0; i < kSteps; ++i) {
    const auto step = dfr::test::ExampleStep(i);
    recorder.Record(step);
    out << (i == 0 ? "" : ",\n") << "{\"time_ns\":\"" << step.time_ns << "\",\"episode\":\""
        << step.episode << "\",\"seed\":\"" << step.seed << "\",\"t\":" << step.t
        << ",\"iteration\":" << step.iteration << ",\"mode\":\"" << step.mode.view()
        << "\",\"cause\":\"" << step.cause.view() << "\",\"machine\":\"" << step.machine.view()
        << "\",\"applied\":" << step.applied << ",\"filtered\":" << step.filtered
        << ",\"certified\":" << step.certified << ",\"g\":" << Bits(step.g)
        << ",\"log_g\":" << Bits(step.log_g) << ",\"threshold\":" << Bits(step.threshold)
        << ",\"decision_s\":" << Bits(step.decision_s) << ",\"state\":" << Bits(step.state.view())
        << ",\"command\":" << Bits(step.command.view()) << ",\"image_sequence\":\""
        << step.image_sequence << "\",\"image_time_ns\":\"" << step.image_time_ns << "\"}";
  }
  out << "],\"transitions\":[";
  for (std::uint32_t i = 0; i < 2; ++i) {
    const auto transition = dfr::test::ExampleTransition(i);
    recorder.Transition(transition);
    out << (i == 0 ? "" : ",") << "{\"from_state\":\"" << transition.from.view()
        << "\",\"to_state\":\"" << transition.to.view() << "\",\"cause\":\""
        << transition.cause.view() << "\"}";
  }
  out << "],\"arm\":[";
  for (std::uint32_t i = 0; i < 2; ++i) {
    const auto arm = dfr::test::ExampleArm(i);
    recorder.Arm(arm);
    out << (i == 0 ? "" : ",") << "{\"time_ns\":\"" << arm.time_ns << "\",\"measured_ns\":\""
        << arm.measured_ns << "\",\"position\":" << Bits(arm.position.view())
        << ",\"velocity\":" << Bits(arm.velocity.view())
        << ",\"setpoint\":" << Bits(arm.setpoint.view())
        << ",\"console_setpoint\":" << Bits(arm.console_setpoint.view())
        << ",\"operating_state\":\"" << arm.operating_state.view() << "\",\"machine\":\""
        << arm.machine.view() << "\",\"fault\":\"" << arm.fault.view() << "\",\"stop\":\""
        << arm.stop.view() << "\",\"homed\":" << arm.homed << ",\"busy\":" << arm.busy << "}";
  }
  for (std::uint32_t i = 0; i < kPictures; ++i) {
    recorder.Picture(dfr::test::ExamplePicture(i, dfr::test::ExamplePixels(i)));
  }
  out << "]}\n";
  recorder.Finish();
  return out.good() && recorder.dropped() == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
} catch (const std::exception& e) {
  std::cerr << e.what() << '\n';
  return EXIT_FAILURE;
}
