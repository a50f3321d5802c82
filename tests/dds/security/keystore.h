#pragma once

#include <unistd.h>

#include <filesystem>
#include <initializer_list>
#include <string>
#include <utility>

#include "dfr/dds/certificates.h"

namespace dfr::test {

/// A lab's certificates in a separate folder, removed at the end.
class Keystore {
 public:
  Keystore(std::initializer_list<std::pair<const char*, dds::Permission>> participants) {
    static int count = 0;
    folder_ = std::filesystem::temp_directory_path() /
              ("dfr-keystore-" + std::to_string(::getpid()) + "-" + std::to_string(count++));
    std::filesystem::remove_all(folder_);
    dds::MakeAuthority(folder_);
    for (const auto& [name, permission] : participants) {
      dds::AddParticipant(folder_, name, permission);
    }
  }
  ~Keystore() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  Keystore(const Keystore&) = delete;
  Keystore& operator=(const Keystore&) = delete;

  [[nodiscard]] const std::filesystem::path& folder() const noexcept { return folder_; }
  [[nodiscard]] std::filesystem::path enclave(const std::string& name) const {
    return folder_ / "enclaves" / name;
  }

 private:
  std::filesystem::path folder_;
};

}  // namespace dfr::test
