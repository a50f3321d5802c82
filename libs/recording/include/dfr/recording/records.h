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

/// Text of at most N bytes, without allocation. Longer text is truncated.
template <std::size_t N>
class Text {
 public:
  Text() noexcept = default;
  Text(std::string_view text) noexcept  // NOLINT(google-explicit-constructor): a string
      : size_(std::min(text.size(), N)) {
    std::copy_n(text.data(), size_,
                bytes_.data());  // unlike memcpy(), accepts a null pointer for size 0
  }
  Text(const char* text) noexcept  // NOLINT(google-explicit-constructor): a string
      : Text(std::string_view(text)) {}

  [[nodiscard]] std::string_view view() const noexcept { return {bytes_.data(), size_}; }
  bool operator==(const Text& other) const noexcept { return view() == other.view(); }

 private:
  std::array<char, N> bytes_{};
  std::size_t size_ = 0;
};

/// At most N numbers, without allocation.
template <std::size_t N>
class Numbers {
 public:
  static constexpr std::size_t kCapacity = N;

  /// Returns false, and stores nothing, for more than kCapacity values: check sizes at set-up.
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

/// One decision of a control loop: its inputs, the chosen command and the reasons. Times are in ns
/// since the Unix epoch. Modes are stored as words, to keep a log readable without the program that
/// wrote it.
struct StepRecord {
  std::int64_t time_ns = 0;    ///< Time of the decision.
  std::uint64_t episode = 0;   ///< Number of the episode, from 0.
  std::uint64_t seed = 0;      ///< Seed of the controller's Reset() in this episode.
  std::int32_t t = 0;          ///< Time step of the support and policy used.
  std::int32_t iteration = 0;  ///< Iteration within the active recovery.
  Text<24> mode;               ///< control::Name(Mode)
  Text<40> cause;              ///< control::Name(HaltCause)
  Text<24> machine;            ///< State of the state machine around the controller: "running", ...
  bool applied = false;        ///< The command was sent to the robot.
  bool filtered = false;       ///< control::Step::filtered
  bool certified = false;      ///< control::Step::certified
  double g = std::numeric_limits<double>::quiet_NaN();
  double log_g = std::numeric_limits<double>::quiet_NaN();
  double threshold = std::numeric_limits<double>::quiet_NaN();
  double decision_s = std::numeric_limits<double>::quiet_NaN();  ///< Duration of the decision.
  Numbers<64> state;
  Numbers<16> command;
  std::uint64_t image_sequence = 0;  ///< Picture from which the state was estimated; 0: none.
  std::int64_t image_time_ns = 0;    ///< Time of the picture `image_sequence`.
};

/// A transition of the state machine around the controller.
struct TransitionRecord {
  std::int64_t time_ns = 0;
  Text<24> from;
  Text<24> to;
  Text<200> cause;  ///< Description for the operator.
};

/// State of the arm and the emergency stop at one moment.
struct ArmRecord {
  std::int64_t time_ns = 0;      ///< Time of the record, since the Unix epoch.
  std::int64_t measured_ns = 0;  ///< Stamp of the measurement.
  Numbers<8> position;           ///< Measured joints, rad (insertion: m).
  Numbers<8> velocity;           ///< Joint velocities, in the same units per s.
  Numbers<8> setpoint;           ///< Last set-point sent to the console; empty while not armed.
  Numbers<8> console_setpoint;   ///< Set-point reported by the console.
  Text<16> operating_state;      ///< "ENABLED", ...
  bool homed = false;
  bool busy = false;
  Text<24> machine;  ///< State of the state machine around the controller.
  Text<96> fault;    ///< Reason that prevents motion; empty: none.
  Text<24> stop;     ///< The emergency stop: "released", "pressed", "silent", "none".
};

/// Origin of a run: everything needed to reproduce its decisions.
struct RecordingMetadata {
  std::string program;  ///< Program and version.
  std::string commit;
  std::string model;           ///< Path of the policy and its support.
  std::string model_checksum;  ///< Checksum() of `model`.
  std::string method;
  std::uint64_t seed = 0;
  std::string configuration;  ///< Full text of the configuration file.
  std::map<std::string, std::string> more;
  bool operator==(const RecordingMetadata&) const = default;
};

/// Returns 16 hexadecimal digits that identify a file, or all files below a folder and their names
/// (FNV-1a, 64 bits: detects accidental changes, not malicious ones).
/// @throws std::runtime_error naming the file that cannot be read.
[[nodiscard]] std::string Checksum(const std::filesystem::path& path);

}  // namespace dfr::recording
