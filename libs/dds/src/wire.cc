#include "wire.h"

#include <chrono>

namespace dfr::dds {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

}  // namespace

Stamp Stamp::FromNanoseconds(std::int64_t since_epoch_ns) noexcept {
  std::int64_t sec = since_epoch_ns / kSecond;
  std::int64_t nanosec = since_epoch_ns % kSecond;
  if (nanosec < 0) {
    nanosec += kSecond;
    --sec;
  }
  return {static_cast<std::int32_t>(sec), static_cast<std::uint32_t>(nanosec)};
}

Stamp Stamp::Now() noexcept {
  return FromNanoseconds(std::chrono::duration_cast<std::chrono::nanoseconds>(
                             std::chrono::system_clock::now().time_since_epoch())
                             .count());
}

std::int64_t Stamp::nanoseconds() const noexcept {
  return kSecond * static_cast<std::int64_t>(sec) + static_cast<std::int64_t>(nanosec);
}

namespace internal {

void ToWire(const Matrix& message, WireOf<Matrix>::Type& wire) {
  auto& dims = wire.layout_().dim_();
  dims.resize(2);
  dims[0].label_("rows");
  dims[0].size_(message.rows);
  dims[0].stride_(message.rows * message.cols);
  dims[1].label_("cols");
  dims[1].size_(message.cols);
  dims[1].stride_(message.cols);
  wire.data_(message.data);
}

void FromWire(const WireOf<Matrix>::Type& wire, Matrix& message) {
  const auto& dims = wire.layout_().dim_();
  message.rows = dims.size() == 2 ? dims[0].size_() : 0;
  message.cols = dims.size() == 2 ? dims[1].size_() : 0;
  message.data = wire.data_();
}

}  // namespace internal

}  // namespace dfr::dds
