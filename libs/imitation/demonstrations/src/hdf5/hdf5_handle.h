#pragma once

#include <hdf5.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

namespace dfr::imitation::internal {

static_assert(std::is_same_v<hid_t, std::int64_t>);

/// Suppresses libhdf5's own error output; Fail() reports the errors.
class Hdf5Quiet {
 public:
  Hdf5Quiet() {
    H5Eget_auto2(H5E_DEFAULT, &function_, &data_);
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  }
  ~Hdf5Quiet() { H5Eset_auto2(H5E_DEFAULT, function_, data_); }
  Hdf5Quiet(const Hdf5Quiet&) = delete;
  Hdf5Quiet& operator=(const Hdf5Quiet&) = delete;

 private:
  H5E_auto2_t function_ = nullptr;
  void* data_ = nullptr;
};

class Hdf5Handle {
 public:
  using Close = herr_t (*)(hid_t);
  Hdf5Handle(hid_t id, Close close) : id_(id), close_(close) {}
  ~Hdf5Handle() {
    if (id_ >= 0) close_(id_);
  }
  Hdf5Handle(const Hdf5Handle&) = delete;
  Hdf5Handle& operator=(const Hdf5Handle&) = delete;

  [[nodiscard]] hid_t id() const { return id_; }
  [[nodiscard]] bool ok() const { return id_ >= 0; }

 private:
  hid_t id_;
  Close close_;
};

/// Returns the innermost entry of libhdf5's error stack, which is the actual cause. After a failed
/// read or write, this entry has several lines of addresses and sizes; the result is then only the
/// system's message.
inline std::string LastHdf5Error() {
  std::string description;
  H5Ewalk2(
      H5E_DEFAULT, H5E_WALK_UPWARD,
      [](unsigned n, const H5E_error2_t* error, void* out) -> herr_t {
        if (n == 0 && error->desc != nullptr) *static_cast<std::string*>(out) = error->desc;
        return 0;
      },
      &description);
  constexpr std::string_view kSystem = "error message = '";
  if (const std::size_t at = description.find(kSystem); at != std::string::npos) {
    const std::size_t begin = at + kSystem.size();
    return description.substr(begin, description.find('\'', begin) - begin);
  }
  return description.empty() ? "libhdf5 gives no reason" : description;
}

[[noreturn]] inline void FailFile(const std::string& name, const std::string& reason) {
  throw std::runtime_error(name + ": " + reason);
}

}  // namespace dfr::imitation::internal
