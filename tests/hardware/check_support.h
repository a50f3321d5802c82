#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <sstream>
#include <string>
#include <thread>

#include "check.h"
#include "tests/dds/domain.h"

namespace dfr::test {

inline apps::hardware_app::CheckOptions Options() {
  apps::hardware_app::CheckOptions options;
  options.network.domain = OwnDomain();
  options.find_s = 20.0;  // of a machine that is busy with other things
  options.listen_s = 0.4;
  return options;
}

// `find_s` is waited for in vain where something is missing.
inline apps::hardware_app::CheckOptions ForArm(const std::string& arm = "PSM1",
                                               double find_s = 20.0) {
  apps::hardware_app::CheckOptions options = Options();
  options.find_s = find_s;
  options.arm = arm;
  return options;
}

inline std::string Shown(const apps::hardware_app::DeviceReport& report) {
  std::ostringstream out;
  Print(report, out);
  return out.str();
}

// Something that goes on in a thread of its own while the test checks.
class Background {
 public:
  explicit Background(const std::function<void()>& step)
      : thread_([this, step] {
          while (!stop_) {
            step();
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
          }
        }) {}
  ~Background() {
    stop_ = true;
    thread_.join();
  }
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace dfr::test
