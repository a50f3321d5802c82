#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/read_budget.h"

namespace dfr::imitation::internal {

/// The part of libhdf5 that demonstration files need. Objects are named by paths within the file,
/// "data/demo_0/obs/tip". Everything throws std::runtime_error naming file and object, with what
/// libhdf5 says.
class Hdf5File {
 public:
  /// Replaces what is there by a whole file, as a core::AtomicFile does; from then on the file
  /// grows. Nothing of what is known about the file's objects reaches the disk but by Flush().
  /// @param track_order  groups list their members in the order of creation, as Minari's readers
  ///   expect.
  static Hdf5File Create(const std::filesystem::path& path, bool track_order = false);
  /// To read, what is trusted: see Hdf5Reader. What is in other files is refused.
  static Hdf5File Open(const std::filesystem::path& path);

  Hdf5File(Hdf5File&& other) noexcept;
  Hdf5File& operator=(Hdf5File&& other) noexcept;
  ~Hdf5File();

  void CreateGroup(const std::string& path);
  /// Begins a group without a name: until LinkNewGroup() nothing in the file refers to it. Paths
  /// that begin with kNewGroup are in it. There is one at a time.
  void CreateNewGroup();
  /// Gives it a path, and more than one if asked again, in groups that exist.
  void LinkNewGroup(const std::string& path);
  static constexpr char kNewGroup[] = "*";
  /// Makes the group kSecondList in the file's top. It is found by its address, which an attribute
  /// of the top tells, even where the list of the top cannot be read.
  void CreateSecondList();
  static constexpr char kSecondList[] = ".episodes";
  /// A two-dimensional dataset of doubles, one row after another.
  void Write(const std::string& path, const core::Matrix& values);
  /// A one-dimensional one.
  void Write(const std::string& path, std::span<const double> values);
  void Write(const std::string& path, std::span<const std::int64_t> values);
  /// The same as datasets that can grow in their first dimension, in chunks.
  void WriteGrowable(const std::string& path, const core::Matrix& values);
  void WriteGrowable(const std::string& path, std::span<const double> values);
  /// Truth values as h5py stores them: an enumeration {FALSE = 0, TRUE = 1} over one byte.
  void WriteGrowable(const std::string& path, const std::vector<bool>& values);
  /// Sets or replaces an attribute of a group or dataset; text has variable length, UTF-8.
  void SetAttribute(const std::string& path, const char* name, std::int64_t value);
  void SetAttribute(const std::string& path, const char* name, const std::string& value);
  /// Hands all that was written to the operating system.
  void Flush();

  [[nodiscard]] bool Exists(const std::string& path) const;
  [[nodiscard]] bool IsGroup(const std::string& path) const;
  /// Names of the members of a group, in alphabetical order; "" is the file's top.
  [[nodiscard]] std::vector<std::string> Members(const std::string& group) const;
  /// Dimensions of a dataset.
  [[nodiscard]] std::vector<std::int64_t> Shape(const std::string& path) const;
  /// Whether a dataset holds numbers or truth values.
  [[nodiscard]] bool IsNumeric(const std::string& path) const;
  /// A numeric dataset of one dimension (as one column) or two, converted to doubles.
  [[nodiscard]] core::Matrix Read(const std::string& path) const;
  /// A one-dimensional dataset of texts, of fixed or variable length.
  [[nodiscard]] std::vector<std::string> ReadTexts(const std::string& path) const;
  /// Nothing where the attribute does not exist.
  [[nodiscard]] std::optional<std::int64_t> IntegerAttribute(const std::string& path,
                                                             const char* name) const;
  [[nodiscard]] std::optional<std::string> TextAttribute(const std::string& path,
                                                         const char* name) const;

  /// For what a caller finds wrong with an object.
  [[noreturn]] void Fail(const std::string& path, const std::string& reason) const;

  /// What reading an object of the file may cost: core::ReadBudget of its size.
  [[nodiscard]] core::ReadBudget budget() const;

 private:
  void HoldMetadata(bool hold);
  /// Where a path leads: an object, and the path from there.
  struct Place {
    std::int64_t object;
    std::string path;
  };
  [[nodiscard]] Place At(const std::string& path) const;
  Hdf5File(std::string name, std::int64_t id);
  void WriteBlock(const std::string& path, std::int64_t type, std::span<const std::int64_t> shape,
                  bool growable, const void* values);

  std::string name_;
  std::int64_t id_;  // hid_t
  std::int64_t new_group_ = -1;
  mutable std::int64_t second_list_ = -1;
  bool track_order_ = false;
};

}  // namespace dfr::imitation::internal
