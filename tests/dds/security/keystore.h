#pragma once

#include <filesystem>
#include <initializer_list>
#include <string>
#include <utility>

#include "dfr/dds/certificates.h"
#include "tests/support/temp_folder.h"

namespace dfr::test {

/// A lab's certificates in a separate folder, which the destructor removes.
class Keystore {
 public:
  Keystore(std::initializer_list<std::pair<const char*, dds::Permission>> participants) {
    dds::MakeAuthority(folder());
    for (const auto& [name, permission] : participants) {
      dds::AddParticipant(folder(), name, permission);
    }
  }

  [[nodiscard]] std::filesystem::path folder() const { return temp_ / "lab"; }
  [[nodiscard]] std::filesystem::path enclave(const std::string& name) const {
    return folder() / "enclaves" / name;
  }

 private:
  TempFolder temp_;
};

}  // namespace dfr::test
