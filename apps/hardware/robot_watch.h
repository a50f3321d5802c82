#pragma once

#include <array>
#include <cstdint>
#include <iosfwd>
#include <string>

#include "dfr/dds/channel.h"
#include "dfr/hardware/word_limit.h"

namespace dfr::apps::hardware_app {

/// Reports the state of robots' programs, as each announces it on dds::kRunStateTopic. A second
/// program that is refused and ends does not affect the report on the first. One object belongs to
/// one thread.
class RobotWatch {
 public:
  /// @param out  stream for the reports, one line per change; borrowed.
  explicit RobotWatch(std::ostream& out) : out_(&out) {}

  /// Handles a program's announcement. Reports at most ten changes per second and the number of
  /// further changes; silence is always reported.
  /// @param steady_ns  time of a monotonic clock, here and below.
  void Hear(const dds::Origin& who, const std::string& state, std::int64_t steady_ns);
  /// Call this several times per 150 ms. After 150 ms of silence a program that has not ended is
  /// reported as missing.
  void Look(std::int64_t steady_ns);

 private:
  struct Robot {
    dds::Origin who = {};
    std::string state;
    std::int64_t heard_ns = 0;
    bool gone = true;  // ended, or reported as silent: another program may take its number
  };
  void Say(const std::string& text, std::int64_t steady_ns);

  static constexpr std::size_t kMost = 8;  // further programs are ignored

  Robot* Find(const dds::Origin& who);
  // Returns "robot", with a number for all but the first.
  [[nodiscard]] std::string Name(const Robot& robot) const;

  std::ostream* out_;
  hardware::WordLimit limit_{10};
  std::array<Robot, kMost> robots_;
};

}  // namespace dfr::apps::hardware_app
