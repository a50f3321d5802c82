#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/files/read_budget.h"
#include "dfr/core/matrix.h"

namespace dfr::imitation::internal {

/// Wrapper of the parts of libhdf5 that demonstration files need. Paths within the file name
/// objects, for example "data/demo_0/obs/tip". All functions throw std::runtime_error naming the
/// file, the object and libhdf5's message.
class Hdf5File {
 public:
  /// Creates a file and replaces any existing one as a whole, like core::AtomicFile. The file then
  /// grows in place. Only Flush() writes metadata of the file's objects to the disk.
  /// @param track_order  if true, groups list their members in the order of creation, as Minari's
  ///   readers expect.
  static Hdf5File Create(const std::filesystem::path& path, bool track_order = false);
  /// Opens a trusted file for reading; use Hdf5Reader for untrusted files. Rejects data stored in
  /// other files.
  static Hdf5File Open(const std::filesystem::path& path);

  Hdf5File(Hdf5File&& other) noexcept;
  Hdf5File& operator=(Hdf5File&& other) noexcept;
  ~Hdf5File();

  void CreateGroup(const std::string& path);
  /// Creates a group without a name: nothing in the file refers to it until LinkNewGroup(). Paths
  /// that start with kNewGroup are in it. Only one such group exists at a time.
  void CreateNewGroup();
  /// Links the new group to a path in an existing group. May be called again to add paths.
  void LinkNewGroup(const std::string& path);
  static constexpr char kNewGroup[] = "*";
  /// Creates the group kSecondList in the root. An attribute of the root holds the group's address,
  /// which makes the group accessible even if the root's list is unreadable. The group's attribute
  /// kListed is the number of its members that the first list has received, initially 0.
  void CreateSecondList();
  static constexpr char kSecondList[] = ".episodes";
  static constexpr char kListed[] = "listed";
  /// Writes a two-dimensional dataset of doubles, row by row. This and the next functions create
  /// missing groups above the dataset.
  void Write(const std::string& path, const core::Matrix& values);
  /// Writes a one-dimensional dataset.
  void Write(const std::string& path, std::span<const double> values);
  void Write(const std::string& path, std::span<const std::int64_t> values);
  /// Writes a chunked dataset that can grow in its first dimension.
  void WriteGrowable(const std::string& path, const core::Matrix& values);
  void WriteGrowable(const std::string& path, std::span<const double> values);
  /// Writes Boolean values in h5py's form: an enumeration {FALSE = 0, TRUE = 1} over one byte.
  void WriteGrowable(const std::string& path, const std::vector<bool>& values);
  /// Sets or replaces an attribute of a group or dataset. Stores text as UTF-8 of variable length.
  void SetAttribute(const std::string& path, const char* name, std::int64_t value);
  void SetAttribute(const std::string& path, const char* name, const std::string& value);
  /// Passes all written data to the operating system.
  void Flush();

  [[nodiscard]] bool Exists(const std::string& path) const;
  [[nodiscard]] bool IsGroup(const std::string& path) const;
  /// Returns the names of a group's members in alphabetical order; "" is the root.
  [[nodiscard]] std::vector<std::string> Members(const std::string& group) const;
  /// Returns the dimensions of a dataset.
  [[nodiscard]] std::vector<std::int64_t> Shape(const std::string& path) const;
  /// Returns true if a dataset holds numbers or Boolean values.
  [[nodiscard]] bool IsNumeric(const std::string& path) const;
  /// Reads a numeric dataset, converted to doubles. The first dimension becomes the rows, and the
  /// others are flattened into columns (one column for a one-dimensional dataset).
  [[nodiscard]] core::Matrix Read(const std::string& path) const;
  /// Reads a one-dimensional dataset of strings, of fixed or variable length.
  [[nodiscard]] std::vector<std::string> ReadTexts(const std::string& path) const;
  /// Returns std::nullopt if the attribute does not exist. IntegerAttribute() also returns it for
  /// the text "None".
  [[nodiscard]] std::optional<std::int64_t> IntegerAttribute(const std::string& path,
                                                             const char* name) const;
  [[nodiscard]] std::optional<std::string> TextAttribute(const std::string& path,
                                                         const char* name) const;

  /// Throws std::runtime_error naming the file, `path` and `reason`.
  [[noreturn]] void Fail(const std::string& path, const std::string& reason) const;

  /// Budget for reading an object: core::ReadBudget of the file's size.
  [[nodiscard]] core::ReadBudget budget() const;

 private:
  void HoldMetadata(bool hold);
  /// Target of a path: an object, and the rest of the path from there.
  struct Place {
    std::int64_t object;
    std::string path;
  };
  [[nodiscard]] Place At(const std::string& path) const;
  Hdf5File(std::string name, std::int64_t id);
  void WriteBlock(const std::string& path, std::int64_t type,
                  const std::vector<std::int64_t>& shape, bool growable, const void* values);
  void WriteAttribute(const std::string& path, const char* name, std::int64_t type,
                      const void* value);

  std::string name_;
  std::int64_t id_;  // hid_t
  std::int64_t new_group_ = -1;
  mutable std::int64_t second_list_ = -1;
  bool track_order_ = false;
};

}  // namespace dfr::imitation::internal
