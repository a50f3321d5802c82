#include "simulator/simulator_link.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <sstream>
#include <stdexcept>
#include <string_view>
#include <utility>

namespace dfr::apps::line_tracking {
namespace {

SimulatorTruth ReadTruth(const std::string& text) {
  std::istringstream in(text);
  SimulatorTruth truth;
  if (!(in >> truth.completed >> truth.collided >> truth.progress_m >> truth.distance_m >>
        truth.tip_m.x() >> truth.tip_m.y() >> truth.tip_m.z())) {
    throw std::runtime_error("cannot parse the simulator's truth:" + text);
  }
  return truth;
}

}  // namespace

SimulatorLink::SimulatorLink(dds::Participant& participant, double answer_s,
                             std::function<std::int64_t()> steady_ns)
    : participant_(&participant),
      answer_s_(answer_s),
      steady_ns_(std::move(steady_ns)),
      request_(participant, "/simulator/request", dds::Role::kRequest),
      reply_(participant, "/simulator/reply", dds::Role::kRequest) {}

std::int64_t SimulatorLink::In(double seconds) const {
  return steady_ns_() + std::llround(1e9 * seconds);
}

void SimulatorLink::Await(double timeout_s, const std::string& arm) {
  // Each end discovers the other at a different time. Only an answer proves both discoveries.
  constexpr double kTry = 0.1;
  const std::int64_t end_ns = In(timeout_s);
  while (!TryAsk("truth", kTry)) {
    if (steady_ns_() > end_ns) {
      throw std::runtime_error(
          "there is no simulator on the network: start dvrk_simulator with the same --domain and "
          "--discovery, or set simulator.present = false for a robot" +
          dds::ExplainRefused(*participant_));
    }
  }
  // The simulator of another arm does not prove that this arm is simulated.
  if (arm.empty()) return;
  const std::string simulated = Ask("arm");
  if (simulated != " " + arm) {
    throw std::runtime_error("the simulator on the network has the arm" + simulated + ", not " +
                             arm +
                             ": correct arm.name, or set simulator.present = false for a robot");
  }
}

void SimulatorLink::Begin(const std::string& request) {
  // The stamp identifies the request and is unique.
  last_id_ = std::max(last_id_ + 1, dds::Stamp::Now().nanoseconds());
  dds::StringStamped message;
  message.stamp = dds::Stamp::FromNanoseconds(last_id_);
  message.text = request;
  if (!request_.Write(message)) {
    throw std::runtime_error("cannot send a request to the simulator: DDS rejects the message");
  }
}

std::optional<std::string> SimulatorLink::Poll() {
  dds::StringStamped reply;
  while (reply_.Take(reply)) {
    if (reply.stamp.nanoseconds() != last_id_) continue;
    if (reply.text.rfind("ok", 0) == 0) return reply.text.substr(2);
    throw std::runtime_error("the simulator answers: " + reply.text);
  }
  return std::nullopt;
}

std::optional<std::string> SimulatorLink::TryAsk(const std::string& request, double timeout_s) {
  Begin(request);
  const std::int64_t end_ns = In(timeout_s);
  while (true) {
    if (std::optional<std::string> answer = Poll()) return answer;
    const double left_s = 1e-9 * static_cast<double>(end_ns - steady_ns_());
    if (left_s <= 0.0) return std::nullopt;
    reply_.Wait(std::min(left_s, 0.02));
  }
}

void SimulatorLink::FailUnanswered(const std::string& request) {
  throw std::runtime_error("the simulator does not answer '" + request + "'");
}

std::string SimulatorLink::Ask(const std::string& request) {
  std::optional<std::string> answer = TryAsk(request, answer_s_);
  if (!answer) FailUnanswered(request);
  return *std::move(answer);
}

void SimulatorLink::AskForTime(const std::string& request) {
  const std::string text = Ask(request);
  std::istringstream in(text);
  if (!(in >> now_ns_)) {
    throw std::runtime_error("cannot parse the simulator's time '" + text + "'");
  }
}

void SimulatorLink::Reset(std::uint64_t seed) { AskForTime("reset " + std::to_string(seed)); }

SimulatorTruth SimulatorLink::Truth() { return ReadTruth(Ask("truth")); }

bool SimulatorLink::Truth(SimulatorTruth& truth, const std::function<bool()>& go_on) {
  Begin("truth");
  const std::int64_t end_ns = In(answer_s_);
  std::optional<std::string> answer;
  while (!(answer = Poll())) {
    if (!go_on()) return false;
    if (steady_ns_() > end_ns) FailUnanswered("truth");
  }
  truth = ReadTruth(*answer);
  return true;
}

void SimulatorLink::Fault(const std::string& name, const std::string& value) {
  Ask("fault " + name + " " + value);
}

bool SimulatorLink::Run(double dt_s, int commands) {
  std::array<char, 32> digits;
  const auto end = std::to_chars(digits.begin(), digits.end(), dt_s);
  try {
    AskForTime("run " + std::string(digits.begin(), end.ptr) + " " + std::to_string(commands));
  } catch (const std::runtime_error& e) {
    if (std::string_view(e.what()).find("commands have arrived") == std::string_view::npos) throw;
    return false;
  }
  return true;
}

void SimulatorLink::Rest() { AskForTime("rest"); }

void SimulatorLink::Look() { AskForTime("look"); }

}  // namespace dfr::apps::line_tracking
