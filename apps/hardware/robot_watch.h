#pragma once

#include <array>
#include <chrono>
#include <iosfwd>
#include <string>

#include "dfr/dds/channel.h"

namespace dfr::apps::hardware_app {

/// Says how robots' programs fare, by what each announces on dds::kRunStateTopic: a second one that
/// is refused and ends says nothing of the first. One object belongs to one thread.
class RobotWatch {
 public:
  /// @param out  where it is said, a line for each change; borrowed.
  RobotWatch(dds::Participant& participant, std::ostream& out);

  /// To be called some times in 150 ms, after which one that has not ended is missed.
  void Show();

 private:
  using Clock = std::chrono::steady_clock;
  struct Robot {
    dds::Origin who = {};
    std::string state;
    Clock::time_point heard;
    bool gone = true;  // ended, or told to be silent: another may have its place
  };
  static constexpr std::size_t kMost = 8;  // what others say beyond that is left out

  Robot* Find(const dds::Origin& who);
  // "robot", for all but the first with its number.
  [[nodiscard]] std::string Name(const Robot& robot) const;

  // All that they say: with the newest alone one could hide another.
  dds::Subscriber<dds::OperatingState> subscriber_;
  std::ostream* out_;
  std::array<Robot, kMost> robots_;
};

}  // namespace dfr::apps::hardware_app
