#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/files/read_budget.h"
#include "dfr/core/matrix.h"

namespace dfr::imitation::internal {

/// Hdf5File for untrusted files. libhdf5 does not validate its input: some files crash it or make
/// it loop forever. This class therefore runs it in a separate process. An early end of that
/// process becomes an ordinary error. The process cannot open further files. The core::ReadBudget
/// of the file's size limits the memory of the process. Its CPU time per answer is at most 2 s plus
/// 1 s per 20 MB of the file.
///
/// The functions are those of Hdf5File. All throw std::runtime_error naming the file, object and
/// reason. Each object belongs to one thread.
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

  /// Name of the file.
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[noreturn]] void Fail(const std::string& path, const std::string& reason) const;
  /// Fails if the file is too small for this many doubles.
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
