#include <filesystem>

#include "dfr/recording/read_recording.h"
#include "dfr/recording/recorder.h"

// Writes a log of one step.
int main() {
  const auto file = std::filesystem::temp_directory_path() / "dfr-consumer.mcap";
  std::filesystem::remove(file);
  dfr::recording::Recorder recorder(file, {.program = "consumer"});
  dfr::recording::StepRecord step;
  step.mode = "policy";
  recorder.Record(step);
  recorder.Finish();
  const auto recording = dfr::recording::ReadRecording(file);
  return recording.finished && recording.steps.at(0).mode == step.mode ? 0 : 1;
}
