#pragma once

#include <array>
#include <cstdint>
#include <iosfwd>
#include <string>

#include "dfr/dds/channel.h"
#include "dfr/hardware/word_limit.h"

namespace dfr::apps::hardware_app {

/// Says how robots' programs fare, by what each announces on dds::kRunStateTopic: a second one that
/// is refused and ends says nothing of the first. One object belongs to one thread.
class RobotWatch {
 public:
  /// @param out  where it is said, a line for each change; borrowed.
  explicit RobotWatch(std::ostream& out) : out_(&out) {}

  /// One of them has announced its state. Ten changes a second are said, and how many more there
  /// were; silence always is.
  /// @param steady_ns  a clock that never goes back, here and below.
  void Hear(const dds::Origin& who, const std::string& state, std::int64_t steady_ns);
  /// To be called some times in 150 ms, after which one that has not ended is missed.
  void Look(std::int64_t steady_ns);

 private:
  struct Robot {
    dds::Origin who = {};
    std::string state;
    std::int64_t heard_ns = 0;
    bool gone = true;  // ended, or told to be silent: another may have its place
  };
  void Say(const std::string& text, std::int64_t steady_ns);

  static constexpr std::size_t kMost = 8;  // what others say beyond that is left out

  Robot* Find(const dds::Origin& who);
  // "robot", for all but the first with its number.
  [[nodiscard]] std::string Name(const Robot& robot) const;

  std::ostream* out_;
  hardware::WordLimit limit_{10};
  std::array<Robot, kMost> robots_;
};

}  // namespace dfr::apps::hardware_app
