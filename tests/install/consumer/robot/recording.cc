#include <unistd.h>

#include <filesystem>
#include <string>

#include "dfr/recording/read_recording.h"
#include "dfr/recording/recorder.h"

// Writes an empty log.
int main() {
  const auto file = std::filesystem::temp_directory_path() /
                    ("dfr-consumer-" + std::to_string(getpid()) + ".mcap");
  dfr::recording::Recorder(file, {.program = "consumer"}).Finish();
  const bool finished = dfr::recording::ReadRecording(file).finished;
  std::filesystem::remove(file);
  return finished ? 0 : 1;
}
