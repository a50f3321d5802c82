#pragma once

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace dfr::test {

/// An empty folder, removed with this object. A fork of the process does not remove it.
class TempFolder {
 public:
  TempFolder() {
    std::filesystem::remove_all(path);
    std::filesystem::create_directories(path);
  }
  ~TempFolder() {
    if (::getpid() != owner_) return;
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;

  std::filesystem::path operator/(const std::string& name) const { return path / name; }

  const std::filesystem::path path = Unused();

 private:
  static std::filesystem::path Unused() {
    static int count = 0;
    return std::filesystem::temp_directory_path() /
           ("dfr_test_" + std::to_string(::getpid()) + "_" + std::to_string(count++));
  }
  const pid_t owner_ = ::getpid();
};

/// Returns the folder of this process for files of tests, removed at the end of the process. Other
/// processes that run the same tests at the same time have other folders.
inline const std::filesystem::path& ProcessFolder() {
  static const TempFolder folder;
  return folder.path;
}

/// Returns the content of a file, or an empty string if it does not exist.
inline std::string FileText(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace dfr::test
