#include "channels.h"

#include <span>

#include "cdr.h"

namespace dfr::recording::internal {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

// Appends a builtin_interfaces/Time.
void EncodeStamp(std::int64_t time_ns, CdrWriter& cdr) {
  std::int64_t nanoseconds = time_ns % kSecond;
  if (nanoseconds < 0) nanoseconds += kSecond;
  cdr.Number(static_cast<std::int32_t>((time_ns - nanoseconds) / kSecond));
  cdr.Number(static_cast<std::uint32_t>(nanoseconds));
}

void SkipStamp(CdrReader& cdr) {
  cdr.Number<std::int32_t>();
  cdr.Number<std::uint32_t>();
}

template <std::size_t N>
bool Take(CdrReader& cdr, Numbers<N>& numbers) {
  std::array<double, N> values;
  std::size_t count = 0;
  return cdr.Numbers(values, count) && numbers.Assign(std::span(values).first(count));
}

constexpr std::uint8_t kWarn = 30;  // level of rcl_interfaces/Log

#define DFR_SEPARATOR \
  "================================================================================\n"
#define DFR_TIME DFR_SEPARATOR "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"

constexpr std::string_view kStepSchema =
    "# One decision of a control loop: its inputs, the chosen command and the reasons.\n"
    "builtin_interfaces/Time stamp\n"
    "uint64 episode\n"
    "uint64 seed         # of the controller in this episode\n"
    "int32 t             # time step whose support and policy were used\n"
    "int32 iteration     # of the recovery under way\n"
    "string mode         # who chose the command\n"
    "string cause        # why the controller halts\n"
    "string machine      # state of the machine around the controller\n"
    "bool applied        # the command was handed to the robot\n"
    "bool filtered       # the learned command was changed\n"
    "bool certified      # the next state is inside, by the controller's certificate\n"
    "float64 g           # decision function\n"
    "float64 log_g       # its log form\n"
    "float64 threshold   # of g\n"
    "float64 decision_s  # time that the decision took\n"
    "float64[] state\n"
    "float64[] command\n"
    "uint64 image_sequence\n"
    "int64 image_time_ns\n" DFR_TIME;
constexpr std::string_view kTransitionSchema =
    "# A change of the machine around the controller.\n"
    "builtin_interfaces/Time stamp\n"
    "string from_state\n"
    "string to_state\n"
    "string cause\n" DFR_TIME;
constexpr std::string_view kArmSchema =
    "# How the arm stood at one moment, and what the operator's stop said.\n"
    "builtin_interfaces/Time stamp\n"
    "int64 measured_ns           # stamp of what was measured, ns since the Unix epoch\n"
    "float64[] position          # measured joints, rad (insertion: m)\n"
    "float64[] velocity\n"
    "float64[] setpoint          # last sent to the console; empty while not armed\n"
    "float64[] console_setpoint  # what the console says\n"
    "string operating_state\n"
    "bool homed\n"
    "bool busy\n"
    "string machine              # state of the machine around the controller\n"
    "string fault                # what speaks against moving\n"
    "string stop                 # the emergency stop\n" DFR_TIME;
constexpr std::string_view kPictureSchema =
    "std_msgs/Header header\n"
    "string format\n"
    "uint8[] data\n" DFR_SEPARATOR
    "MSG: std_msgs/Header\n"
    "builtin_interfaces/Time stamp\n"
    "string frame_id\n" DFR_TIME;
constexpr std::string_view kNoteSchema =
    "builtin_interfaces/Time stamp\n"
    "uint8 level\n"
    "string name\n"
    "string msg\n"
    "string file\n"
    "string function\n"
    "uint32 line\n" DFR_TIME;

#undef DFR_TIME
#undef DFR_SEPARATOR

}  // namespace

const std::array<ChannelInfo, 5> kChannels = {{
    {Channel::kStep, "/dfr/step", "dfr_msgs/msg/Step", kStepSchema},
    {Channel::kTransition, "/dfr/transition", "dfr_msgs/msg/Transition", kTransitionSchema},
    {Channel::kPicture, "/dfr/image/compressed", "sensor_msgs/msg/CompressedImage", kPictureSchema},
    {Channel::kNote, "/dfr/log", "rcl_interfaces/msg/Log", kNoteSchema},
    {Channel::kArm, "/dfr/arm", "dfr_msgs/msg/Arm", kArmSchema},
}};

void Encode(const StepRecord& step, std::string& out) {
  CdrWriter cdr(out);
  EncodeStamp(step.time_ns, cdr);
  cdr.Number(step.episode);
  cdr.Number(step.seed);
  cdr.Number(step.t);
  cdr.Number(step.iteration);
  cdr.Text(step.mode.view());
  cdr.Text(step.cause.view());
  cdr.Text(step.machine.view());
  cdr.Bool(step.applied);
  cdr.Bool(step.filtered);
  cdr.Bool(step.certified);
  cdr.Number(step.g);
  cdr.Number(step.log_g);
  cdr.Number(step.threshold);
  cdr.Number(step.decision_s);
  cdr.Numbers(step.state.view());
  cdr.Numbers(step.command.view());
  cdr.Number(step.image_sequence);
  cdr.Number(step.image_time_ns);
}

bool Decode(std::string_view message, StepRecord& step) {
  CdrReader cdr(message);
  SkipStamp(cdr);
  step.episode = cdr.Number<std::uint64_t>();
  step.seed = cdr.Number<std::uint64_t>();
  step.t = cdr.Number<std::int32_t>();
  step.iteration = cdr.Number<std::int32_t>();
  step.mode = cdr.Text();
  step.cause = cdr.Text();
  step.machine = cdr.Text();
  step.applied = cdr.Bool();
  step.filtered = cdr.Bool();
  step.certified = cdr.Bool();
  step.g = cdr.Number<double>();
  step.log_g = cdr.Number<double>();
  step.threshold = cdr.Number<double>();
  step.decision_s = cdr.Number<double>();
  if (!Take(cdr, step.state) || !Take(cdr, step.command)) return false;
  step.image_sequence = cdr.Number<std::uint64_t>();
  step.image_time_ns = cdr.Number<std::int64_t>();
  return cdr.complete();
}

void Encode(const TransitionRecord& transition, std::string& out) {
  CdrWriter cdr(out);
  EncodeStamp(transition.time_ns, cdr);
  cdr.Text(transition.from.view());
  cdr.Text(transition.to.view());
  cdr.Text(transition.cause.view());
}

bool Decode(std::string_view message, TransitionRecord& transition) {
  CdrReader cdr(message);
  SkipStamp(cdr);
  transition.from = cdr.Text();
  transition.to = cdr.Text();
  transition.cause = cdr.Text();
  return cdr.complete();
}

void Encode(const ArmRecord& arm, std::string& out) {
  CdrWriter cdr(out);
  EncodeStamp(arm.time_ns, cdr);
  cdr.Number(arm.measured_ns);
  cdr.Numbers(arm.position.view());
  cdr.Numbers(arm.velocity.view());
  cdr.Numbers(arm.setpoint.view());
  cdr.Numbers(arm.console_setpoint.view());
  cdr.Text(arm.operating_state.view());
  cdr.Bool(arm.homed);
  cdr.Bool(arm.busy);
  cdr.Text(arm.machine.view());
  cdr.Text(arm.fault.view());
  cdr.Text(arm.stop.view());
}

bool Decode(std::string_view message, ArmRecord& arm) {
  CdrReader cdr(message);
  SkipStamp(cdr);
  arm.measured_ns = cdr.Number<std::int64_t>();
  if (!Take(cdr, arm.position) || !Take(cdr, arm.velocity) || !Take(cdr, arm.setpoint) ||
      !Take(cdr, arm.console_setpoint)) {
    return false;
  }
  arm.operating_state = cdr.Text();
  arm.homed = cdr.Bool();
  arm.busy = cdr.Bool();
  arm.machine = cdr.Text();
  arm.fault = cdr.Text();
  arm.stop = cdr.Text();
  return cdr.complete();
}

void EncodePicture(std::int64_t time_ns, std::string_view jpeg, std::string& out) {
  CdrWriter cdr(out);
  EncodeStamp(time_ns, cdr);
  cdr.Text("");  // frame_id
  cdr.Text("jpeg");
  cdr.Bytes(jpeg);
}

bool DecodePicture(std::string_view message, std::uint64_t& offset, std::uint64_t& size) {
  CdrReader cdr(message);
  SkipStamp(cdr);
  cdr.Text();
  const bool jpeg = cdr.Text() == "jpeg";
  size = cdr.Bytes().size();
  offset = cdr.position() - size;
  return jpeg && cdr.complete();
}

void EncodeNote(std::int64_t time_ns, std::string_view text, std::string& out) {
  CdrWriter cdr(out);
  EncodeStamp(time_ns, cdr);
  cdr.Number(kWarn);
  cdr.Text("recorder");
  cdr.Text(text);
  cdr.Text("");  // file
  cdr.Text("");  // function
  cdr.Number(std::uint32_t{0});
}

bool DecodeNote(std::string_view message, std::string& text) {
  CdrReader cdr(message);
  SkipStamp(cdr);
  cdr.Number<std::uint8_t>();
  cdr.Text();
  text = cdr.Text();
  cdr.Text();
  cdr.Text();
  cdr.Number<std::uint32_t>();
  return cdr.complete();
}

}  // namespace dfr::recording::internal
