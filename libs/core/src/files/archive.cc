#include "dfr/core/files/archive.h"

#include <bit>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <limits>
#include <stdexcept>

#include "dfr/core/contract.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/files/read_file.h"

namespace dfr::core {
namespace {

static_assert(std::endian::native == std::endian::little, "archives are little-endian");

// Layout of a file: magic, kind (size + text), version, values (tag + content each), checksum of
// all preceding bytes.
constexpr std::string_view kMagic = "dfr\x1a\r\n\x01\n";
constexpr char kInteger = 'i';
constexpr char kNumber = 'd';
constexpr char kText = 's';
constexpr char kNumbers = 'D';
constexpr char kIntegers = 'I';
constexpr char kMatrix = 'M';

// FNV-1a, 64 bits. Detects damage and truncation, not manipulation.
std::uint64_t Checksum(std::string_view bytes) noexcept {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : bytes) {
    hash ^= static_cast<unsigned char>(c);
    hash *= 0x100000001b3u;
  }
  return hash;
}

template <typename T>
void Append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

// The pointer of an empty span may be null, which append() does not accept.
void AppendNumbers(std::string& bytes, std::span<const double> values) {
  if (values.empty()) return;
  bytes.append(reinterpret_cast<const char*>(values.data()), values.size_bytes());
}

// Returns the beginning of a file's text, with '?' for all but printable ASCII characters.
std::string Shown(std::string_view text) {
  std::string shown(text.substr(0, 40));
  for (char& c : shown) c = c >= ' ' && c <= '~' ? c : '?';
  return shown;
}

template <typename T>
T Decode(std::string_view bytes) noexcept {
  T value;
  std::memcpy(&value, bytes.data(), sizeof value);
  return value;
}

}  // namespace

ArchiveWriter::ArchiveWriter(std::string_view kind, int version) : bytes_(kMagic) {
  DFR_THROW_UNLESS(!kind.empty() && version > 0, "an archive needs a kind and a positive version");
  Append(bytes_, static_cast<std::uint64_t>(kind.size()));
  bytes_ += kind;
  Append(bytes_, static_cast<std::int64_t>(version));
}

void ArchiveWriter::Integer(std::int64_t value) {
  bytes_ += kInteger;
  Append(bytes_, value);
}

void ArchiveWriter::Number(double value) {
  bytes_ += kNumber;
  Append(bytes_, value);
}

void ArchiveWriter::Text(std::string_view value) {
  bytes_ += kText;
  Append(bytes_, static_cast<std::uint64_t>(value.size()));
  bytes_ += value;
}

void ArchiveWriter::Numbers(std::span<const double> values) {
  bytes_ += kNumbers;
  Append(bytes_, static_cast<std::uint64_t>(values.size()));
  AppendNumbers(bytes_, values);
}

void ArchiveWriter::Integers(std::span<const int> values) {
  bytes_ += kIntegers;
  Append(bytes_, static_cast<std::uint64_t>(values.size()));
  for (const int value : values) Append(bytes_, static_cast<std::int64_t>(value));
}

void ArchiveWriter::MatrixBlock(const Matrix& values) {
  bytes_ += kMatrix;
  Append(bytes_, static_cast<std::uint64_t>(values.rows()));
  Append(bytes_, static_cast<std::uint64_t>(values.cols()));
  AppendNumbers(bytes_, {values.data(), static_cast<std::size_t>(values.size())});
}

void ArchiveWriter::Save(const std::filesystem::path& path) const {
  std::string checksum;
  Append(checksum, Checksum(bytes_));
  AtomicFile file(path);
  file.Write(bytes_);
  file.Write(checksum);
  file.Commit();
}

ArchiveReader::ArchiveReader(const std::filesystem::path& path, std::string_view kind, int version)
    : file_(path.string()) {
  CheckPlainFile(path);
  errno = 0;
  std::ifstream in(path, std::ios::binary);
  if (!in) Fail(std::string("cannot be opened: ") + std::strerror(errno));
  // Reads the rest only of a file with the right magic, because another file may be large.
  bytes_.resize(kMagic.size());
  in.read(bytes_.data(), std::ssize(bytes_));
  if (in.gcount() == 0) Fail("cannot be read, or is empty");
  if (bytes_ != kMagic) Fail("is not a file written by dfr");
  AppendRest(in, path, bytes_);
  const std::size_t header = kMagic.size() + 2 * sizeof(std::uint64_t);
  if (bytes_.size() < header + sizeof(std::uint64_t)) Fail("is truncated");
  const std::string_view all(bytes_);
  const auto stored = Decode<std::uint64_t>(all.substr(all.size() - sizeof(std::uint64_t)));
  if (Checksum(all.substr(0, all.size() - sizeof(std::uint64_t))) != stored) {
    Fail("is truncated or damaged: its checksum does not match");
  }
  bytes_.resize(bytes_.size() - sizeof(std::uint64_t));
  position_ = kMagic.size();
  const std::string_view found_kind = Take(Size(1));
  if (found_kind != kind) {
    Fail("is a " + Shown(found_kind) + " file, but a " + std::string(kind) + " file is needed");
  }
  const auto found_version = Decode<std::int64_t>(Take(sizeof(std::int64_t)));
  if (found_version != version) {
    Fail("is a " + std::string(kind) + " file of version " + std::to_string(found_version) +
         "; this program reads version " + std::to_string(version) + ": fit it again");
  }
  budget_ = ReadBudget(bytes_.size());
}

void ArchiveReader::Spend(std::uint64_t count, std::uint64_t bytes_each, const char* what) {
  if (!budget_.Take(count, bytes_each)) {
    Fail("declares " + std::to_string(count) + " " + what + " of " + std::to_string(bytes_each) +
         " bytes, too many for a file of " + std::to_string(bytes_.size()) + " bytes");
  }
}

void ArchiveReader::Fail(const std::string& reason) const {
  throw std::runtime_error(file_ + ": " + reason);
}

std::string_view ArchiveReader::Take(std::size_t size) {
  if (size > bytes_.size() - position_) {
    Fail("ends at byte " + std::to_string(bytes_.size()) + " within a value");
  }
  const std::string_view taken = std::string_view(bytes_).substr(position_, size);
  position_ += size;
  return taken;
}

void ArchiveReader::Expect(char tag) {
  const std::size_t at = position_;
  const char found = Take(1)[0];
  if (found != tag) {
    Fail("has a value of type '" + Shown({&found, 1}) + "' at byte " + std::to_string(at) +
         ", where '" + std::string(1, tag) + "' is needed");
  }
}

// Reads a size and checks it against the rest of the file before any allocation.
std::uint64_t ArchiveReader::Size(std::size_t bytes_per_entry) {
  const auto size = Decode<std::uint64_t>(Take(sizeof(std::uint64_t)));
  if (size > (bytes_.size() - position_) / bytes_per_entry) {
    Fail("declares " + std::to_string(size) + " entries at byte " + std::to_string(position_) +
         " but does not contain them");
  }
  return size;
}

std::int64_t ArchiveReader::Integer() {
  Expect(kInteger);
  return Decode<std::int64_t>(Take(sizeof(std::int64_t)));
}

int ArchiveReader::IntegerIn(int low, int high) {
  const std::int64_t value = Integer();
  if (value < low || value > high) {
    Fail("has the value " + std::to_string(value) + " where one in [" + std::to_string(low) + ", " +
         std::to_string(high) + "] is needed");
  }
  return static_cast<int>(value);
}

double ArchiveReader::Number() {
  Expect(kNumber);
  return Decode<double>(Take(sizeof(double)));
}

std::string ArchiveReader::Text() {
  Expect(kText);
  return std::string(Take(Size(1)));
}

std::vector<double> ArchiveReader::Numbers() {
  Expect(kNumbers);
  std::vector<double> values(Size(sizeof(double)));
  const std::string_view content = Take(values.size() * sizeof(double));
  if (!values.empty()) std::memcpy(values.data(), content.data(), content.size());
  return values;
}

std::vector<int> ArchiveReader::Integers() {
  Expect(kIntegers);
  std::vector<int> values(Size(sizeof(std::int64_t)));
  for (int& value : values) {
    const auto wide = Decode<std::int64_t>(Take(sizeof(std::int64_t)));
    if (wide < std::numeric_limits<int>::min() || wide > std::numeric_limits<int>::max()) {
      Fail("has the integer " + std::to_string(wide) + ", which is out of range");
    }
    value = static_cast<int>(wide);
  }
  return values;
}

Matrix ArchiveReader::MatrixBlock() {
  Expect(kMatrix);
  const auto rows = Decode<std::uint64_t>(Take(sizeof(std::uint64_t)));
  const auto cols = Decode<std::uint64_t>(Take(sizeof(std::uint64_t)));
  const std::uint64_t left = (bytes_.size() - position_) / sizeof(double);
  constexpr auto kMost = static_cast<std::uint64_t>(std::numeric_limits<int>::max());
  if (rows > kMost || cols > kMost || (cols > 0 && rows > left / cols)) {
    Fail("declares a " + std::to_string(rows) + " x " + std::to_string(cols) +
         " matrix but does not contain it");
  }
  Matrix values(static_cast<Eigen::Index>(rows), static_cast<Eigen::Index>(cols));
  const std::string_view content = Take(rows * cols * sizeof(double));
  if (values.size() > 0) std::memcpy(values.data(), content.data(), content.size());
  return values;
}

void ArchiveReader::End() {
  if (position_ != bytes_.size()) {
    Fail("has " + std::to_string(bytes_.size() - position_) + " bytes after its last value");
  }
}

}  // namespace dfr::core
