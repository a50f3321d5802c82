#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <string_view>

namespace dfr::recording {

/// At most N bytes of text, without an allocation. What does not fit is cut off.
template <std::size_t N>
class Text {
 public:
  Text() noexcept = default;
  Text(std::string_view text) noexcept  // NOLINT(google-explicit-constructor): is a text
      : size_(std::min(text.size(), N)) {
    std::copy_n(text.data(), size_, bytes_.data());  // memcpy() takes no null, whatever the size
  }
  Text(const char* text) noexcept  // NOLINT(google-explicit-constructor): is a text
      : Text(std::string_view(text)) {}

  [[nodiscard]] std::string_view view() const noexcept { return {bytes_.data(), size_}; }
  bool operator==(const Text& other) const noexcept { return view() == other.view(); }

 private:
  std::array<char, N> bytes_{};
  std::size_t size_ = 0;
};

/// At most N numbers, without an allocation.
template <std::size_t N>
class Numbers {
 public:
  static constexpr std::size_t kCapacity = N;

  /// False, and none is kept, if there are more than kCapacity: check sizes at set-up.
  bool Assign(std::span<const double> values) noexcept {
    size_ = values.size() <= N ? values.size() : 0;
    std::copy_n(values.begin(), size_, values_.begin());
    return size_ == values.size();
  }
  [[nodiscard]] std::span<const double> view() const noexcept { return {values_.data(), size_}; }

 private:
  std::array<double, N> values_{};
  std::size_t size_ = 0;
};

/// One decision of a control loop: what it saw, what it chose, and on what grounds. Times are in ns
/// since the Unix epoch. Words rather than numbers stand for modes, so that a log is understood
/// without the program that wrote it.
struct StepRecord {
  std::int64_t time_ns = 0;    ///< When the decision was made.
  std::uint64_t episode = 0;   ///< Counts from 0.
  std::uint64_t seed = 0;      ///< The controller's Reset() seed in this episode.
  std::int32_t t = 0;          ///< The time step whose support and policy were used.
  std::int32_t iteration = 0;  ///< Iteration within the recovery under way.
  Text<24> mode;               ///< control::Name(Mode)
  Text<40> cause;              ///< control::Name(HaltCause)
  Text<24> machine;            ///< State of the machine around the controller: "running", ...
  bool applied = false;        ///< The command was handed to the robot.
  bool filtered = false;       ///< control::Step::filtered
  bool certified = false;      ///< control::Step::certified
  double g = std::numeric_limits<double>::quiet_NaN();
  double log_g = std::numeric_limits<double>::quiet_NaN();
  double threshold = std::numeric_limits<double>::quiet_NaN();
  double decision_s = std::numeric_limits<double>::quiet_NaN();  ///< Time that it took.
  Numbers<64> state;
  Numbers<16> command;
  std::uint64_t image_sequence = 0;  ///< The picture that the state was taken from; 0: none.
  std::int64_t image_time_ns = 0;    ///< When that was taken.
};

/// A change of the machine around the controller.
struct TransitionRecord {
  std::int64_t time_ns = 0;
  Text<24> from;
  Text<24> to;
  Text<200> cause;  ///< In words for the operator.
};

/// How the arm stood at one moment, and what the operator's stop said.
struct ArmRecord {
  std::int64_t time_ns = 0;      ///< When it was taken, since the Unix epoch.
  std::int64_t measured_ns = 0;  ///< The stamp of what was measured.
  Numbers<8> position;           ///< Measured joints, rad (insertion: m).
  Numbers<8> velocity;           ///< The same per s.
  Numbers<8> setpoint;           ///< What the console was last sent; empty while not armed.
  Numbers<8> console_setpoint;   ///< What the console says that its set-point is.
  Text<16> operating_state;      ///< "ENABLED", ...
  bool homed = false;
  bool busy = false;
  Text<24> machine;  ///< State of the machine around the controller.
  Text<96> fault;    ///< What speaks against moving; empty: nothing.
  Text<24> stop;     ///< The emergency stop: "released", "pressed", "silent", "none".
};

/// Where a run came from: what it takes to repeat its decisions.
struct RecordingMetadata {
  std::string program;  ///< And its version.
  std::string commit;
  std::string model;           ///< Path of the policy and its support.
  std::string model_checksum;  ///< Checksum() of that path.
  std::string method;
  std::uint64_t seed = 0;
  std::string configuration;  ///< Whole text of the configuration file.
  std::map<std::string, std::string> more;
  bool operator==(const RecordingMetadata&) const = default;
};

/// 16 hexadecimal digits that tell a file, or all files below a folder with their names, from other
/// ones (FNV-1a, 64 bits: by accident, not by malice).
/// @throws std::runtime_error naming the file that cannot be read.
[[nodiscard]] std::string Checksum(const std::filesystem::path& path);

}  // namespace dfr::recording
