#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/read_budget.h"

namespace dfr::imitation::internal {

/// Hdf5File for files from anywhere. libhdf5 trusts what it reads: files exist that crash it or
/// keep it busy forever. So it reads in a process of its own, which this class starts and asks;
/// what ends that process is an error like any other. The process may open no further file, has the
/// memory that core::ReadBudget gives a file of this size, and a few seconds of computing for each
/// answer.
///
/// Functions are those of Hdf5File. All throw std::runtime_error naming file, object and reason.
/// One object belongs to one thread.
class Hdf5Reader {
 public:
  explicit Hdf5Reader(const std::filesystem::path& path);
  Hdf5Reader(Hdf5Reader&& other) noexcept;
  Hdf5Reader& operator=(Hdf5Reader&& other) noexcept;
  ~Hdf5Reader();

  [[nodiscard]] bool Exists(const std::string& path) const;
  [[nodiscard]] bool IsGroup(const std::string& path) const;
  [[nodiscard]] std::vector<std::string> Members(const std::string& group) const;
  [[nodiscard]] std::vector<std::int64_t> Shape(const std::string& path) const;
  [[nodiscard]] bool IsNumeric(const std::string& path) const;
  [[nodiscard]] core::Matrix Read(const std::string& path) const;
  [[nodiscard]] std::vector<std::string> ReadTexts(const std::string& path) const;
  [[nodiscard]] std::optional<std::int64_t> IntegerAttribute(const std::string& path,
                                                             const char* name) const;
  [[nodiscard]] std::optional<std::string> TextAttribute(const std::string& path,
                                                         const char* name) const;

  [[noreturn]] void Fail(const std::string& path, const std::string& reason) const;
  /// Fails unless a file of this size may hold so many doubles.
  void CheckSize(const std::string& path, std::int64_t rows, std::int64_t cols) const;

 private:
  class Answer;
  [[nodiscard]] Answer Ask(char question, const std::string& path,
                           std::string_view name = {}) const;
  void Receive(void* bytes, std::size_t size, const std::string& path) const;
  [[noreturn]] void FailDead(const std::string& path) const;

  std::string name_;
  std::uint64_t file_size_ = 0;
  mutable int socket_ = -1;
  mutable pid_t process_ = -1;
};

}  // namespace dfr::imitation::internal
