#include <filesystem>

#include "dfr/recording/read_recording.h"
#include "dfr/recording/recorder.h"

// Writes an empty log.
int main() {
  const auto file = std::filesystem::temp_directory_path() / "dfr-consumer.mcap";
  std::filesystem::remove(file);
  dfr::recording::Recorder(file, {.program = "consumer"}).Finish();
  return dfr::recording::ReadRecording(file).finished ? 0 : 1;
}
