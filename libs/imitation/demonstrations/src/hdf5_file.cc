#include "hdf5_file.h"

#include <hdf5.h>

#include <algorithm>
#include <stdexcept>
#include <type_traits>
#include <utility>

namespace dfr::imitation::internal {
namespace {

static_assert(std::is_same_v<hid_t, std::int64_t>);

// Keeps libhdf5 from printing its errors, which Fail() reports.
class Quiet {
 public:
  Quiet() {
    H5Eget_auto2(H5E_DEFAULT, &function_, &data_);
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  }
  ~Quiet() { H5Eset_auto2(H5E_DEFAULT, function_, data_); }
  Quiet(const Quiet&) = delete;
  Quiet& operator=(const Quiet&) = delete;

 private:
  H5E_auto2_t function_ = nullptr;
  void* data_ = nullptr;
};

class Handle {
 public:
  using Close = herr_t (*)(hid_t);
  Handle(hid_t id, Close close) : id_(id), close_(close) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;

  [[nodiscard]] hid_t id() const { return id_; }
  [[nodiscard]] bool ok() const { return id_ >= 0; }

 private:
  hid_t id_;
  Close close_;
};

// The innermost entry of the error stack says what really happened.
std::string LastError() {
  std::string description;
  H5Ewalk2(
      H5E_DEFAULT, H5E_WALK_UPWARD,
      [](unsigned n, const H5E_error2_t* error, void* out) -> herr_t {
        if (n == 0 && error->desc != nullptr) *static_cast<std::string*>(out) = error->desc;
        return 0;
      },
      &description);
  return description.empty() ? "libhdf5 refused" : description;
}

bool HoldsNumbers(H5T_class_t kind) {
  // h5py stores booleans as an enumeration over int8.
  return kind == H5T_FLOAT || kind == H5T_INTEGER || kind == H5T_ENUM;
}

[[noreturn]] void FailFile(const std::string& name, const std::string& reason) {
  throw std::runtime_error(name + ": " + reason);
}

}  // namespace

Hdf5File::Hdf5File(std::string name, std::int64_t id) : name_(std::move(name)), id_(id) {}

Hdf5File::Hdf5File(Hdf5File&& other) noexcept
    : name_(std::move(other.name_)),
      id_(std::exchange(other.id_, H5I_INVALID_HID)),
      track_order_(other.track_order_) {}

Hdf5File& Hdf5File::operator=(Hdf5File&& other) noexcept {
  std::swap(name_, other.name_);
  std::swap(id_, other.id_);
  std::swap(track_order_, other.track_order_);
  return *this;
}

Hdf5File::~Hdf5File() {
  if (id_ < 0) return;
  const Quiet quiet;
  H5Fclose(id_);
}

Hdf5File Hdf5File::Create(const std::filesystem::path& path, bool track_order) {
  const Quiet quiet;
  const Handle properties(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
  if (track_order) {
    H5Pset_link_creation_order(properties.id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
  }
  // The library's default version bounds: with "latest" a file whose writer was killed does not
  // open.
  const hid_t id = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, properties.id(), H5P_DEFAULT);
  if (id < 0) FailFile(path.string(), "cannot be created: " + LastError());
  Hdf5File file(path.string(), id);
  file.track_order_ = track_order;
  return file;
}

Hdf5File Hdf5File::Open(const std::filesystem::path& path) {
  const Quiet quiet;
  if (!std::filesystem::exists(path)) FailFile(path.string(), "no such file");
  const hid_t id = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (id < 0) FailFile(path.string(), "cannot be opened as HDF5: " + LastError());
  return {path.string(), id};
}

void Hdf5File::Fail(const std::string& path, const std::string& reason) const {
  FailFile(name_, path + ": " + reason);
}

void Hdf5File::CreateGroup(const std::string& path) {
  const Quiet quiet;
  const Handle properties(H5Pcreate(H5P_GROUP_CREATE), H5Pclose);
  if (track_order_) {
    H5Pset_link_creation_order(properties.id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
  }
  const Handle group(H5Gcreate2(id_, path.c_str(), H5P_DEFAULT, properties.id(), H5P_DEFAULT),
                     H5Gclose);
  if (!group.ok()) Fail(path, "cannot be created: " + LastError());
}

void Hdf5File::WriteBlock(const std::string& path, std::int64_t type,
                          std::span<const std::int64_t> shape, bool growable, const void* values) {
  std::vector<hsize_t> now(shape.begin(), shape.end());
  std::vector<hsize_t> most = now;
  const Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
  if (growable) {
    // An episode's rows are read together: one chunk, within the mebibyte that libhdf5 caches.
    constexpr hsize_t kChunkBytes = 1 << 20;
    std::vector<hsize_t> chunk = now;
    hsize_t row_bytes = H5Tget_size(type);
    for (std::size_t k = 1; k < chunk.size(); ++k) row_bytes *= chunk[k];
    chunk[0] = std::clamp<hsize_t>(kChunkBytes / row_bytes, 1, std::max<hsize_t>(1, chunk[0]));
    H5Pset_chunk(properties.id(), static_cast<int>(chunk.size()), chunk.data());
    most[0] = H5S_UNLIMITED;
  }
  const Handle space(H5Screate_simple(static_cast<int>(now.size()), now.data(), most.data()),
                     H5Sclose);
  const Handle dataset(
      H5Dcreate2(id_, path.c_str(), type, space.id(), H5P_DEFAULT, properties.id(), H5P_DEFAULT),
      H5Dclose);
  if (!dataset.ok() || H5Dwrite(dataset.id(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) < 0) {
    Fail(path, "cannot be written: " + LastError());
  }
}

void Hdf5File::Write(const std::string& path, const core::Matrix& values) {
  const Quiet quiet;
  const std::int64_t shape[] = {values.rows(), values.cols()};
  WriteBlock(path, H5T_NATIVE_DOUBLE, shape, false, values.data());
}

void Hdf5File::Write(const std::string& path, std::span<const double> values) {
  const Quiet quiet;
  const std::int64_t shape[] = {static_cast<std::int64_t>(values.size())};
  WriteBlock(path, H5T_NATIVE_DOUBLE, shape, false, values.data());
}

void Hdf5File::Write(const std::string& path, std::span<const std::int64_t> values) {
  const Quiet quiet;
  const std::int64_t shape[] = {static_cast<std::int64_t>(values.size())};
  WriteBlock(path, H5T_NATIVE_INT64, shape, false, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, const core::Matrix& values) {
  const Quiet quiet;
  const std::int64_t shape[] = {values.rows(), values.cols()};
  WriteBlock(path, H5T_NATIVE_DOUBLE, shape, true, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, std::span<const double> values) {
  const Quiet quiet;
  const std::int64_t shape[] = {static_cast<std::int64_t>(values.size())};
  WriteBlock(path, H5T_NATIVE_DOUBLE, shape, true, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, const std::vector<bool>& values) {
  const Quiet quiet;
  const Handle type(H5Tenum_create(H5T_NATIVE_INT8), H5Tclose);
  const std::int8_t no = 0;
  const std::int8_t yes = 1;
  H5Tenum_insert(type.id(), "FALSE", &no);
  H5Tenum_insert(type.id(), "TRUE", &yes);
  const std::vector<std::int8_t> bytes(values.begin(), values.end());
  const std::int64_t shape[] = {static_cast<std::int64_t>(bytes.size())};
  WriteBlock(path, type.id(), shape, true, bytes.data());
}

void Hdf5File::SetAttribute(const std::string& path, const char* name, std::int64_t value) {
  const Quiet quiet;
  const Handle object(H5Oopen(id_, path.c_str(), H5P_DEFAULT), H5Oclose);
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  // An existing attribute is overwritten in place, so that no moment is without it.
  const Handle attribute(
      H5Aexists(object.id(), name) > 0
          ? H5Aopen(object.id(), name, H5P_DEFAULT)
          : H5Acreate2(object.id(), name, H5T_NATIVE_INT64, space.id(), H5P_DEFAULT, H5P_DEFAULT),
      H5Aclose);
  if (!attribute.ok() || H5Awrite(attribute.id(), H5T_NATIVE_INT64, &value) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be written: " + LastError());
  }
}

void Hdf5File::SetAttribute(const std::string& path, const char* name, const std::string& value) {
  const Quiet quiet;
  const Handle object(H5Oopen(id_, path.c_str(), H5P_DEFAULT), H5Oclose);
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
  H5Tset_size(type.id(), H5T_VARIABLE);
  H5Tset_cset(type.id(), H5T_CSET_UTF8);
  const Handle attribute(
      H5Acreate2(object.id(), name, type.id(), space.id(), H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
  const char* const text = value.c_str();
  if (!attribute.ok() || H5Awrite(attribute.id(), type.id(), &text) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be written: " + LastError());
  }
}

void Hdf5File::Flush() {
  const Quiet quiet;
  if (H5Fflush(id_, H5F_SCOPE_GLOBAL) < 0) FailFile(name_, "cannot be flushed: " + LastError());
}

bool Hdf5File::Exists(const std::string& path) const {
  const Quiet quiet;
  // H5Lexists wants every parent to exist.
  for (std::size_t end = path.find('/');; end = path.find('/', end + 1)) {
    if (H5Lexists(id_, path.substr(0, end).c_str(), H5P_DEFAULT) <= 0) return false;
    if (end == std::string::npos) return true;
  }
}

bool Hdf5File::IsGroup(const std::string& path) const {
  const Quiet quiet;
  const Handle object(H5Oopen(id_, path.c_str(), H5P_DEFAULT), H5Oclose);
  return object.ok() && H5Iget_type(object.id()) == H5I_GROUP;
}

std::vector<std::string> Hdf5File::Members(const std::string& group) const {
  const Quiet quiet;
  const Handle handle(H5Gopen2(id_, group.empty() ? "/" : group.c_str(), H5P_DEFAULT), H5Gclose);
  if (!handle.ok()) Fail(group, "is not a group: " + LastError());
  std::vector<std::string> names;
  const auto collect = [](hid_t, const char* name, const H5L_info_t*, void* out) -> herr_t {
    static_cast<std::vector<std::string>*>(out)->emplace_back(name);
    return 0;
  };
  if (H5Literate(handle.id(), H5_INDEX_NAME, H5_ITER_INC, nullptr, collect, &names) < 0) {
    Fail(group, "cannot be listed: " + LastError());
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::vector<std::int64_t> Hdf5File::Shape(const std::string& path) const {
  const Quiet quiet;
  const Handle dataset(H5Dopen2(id_, path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastError());
  const Handle space(H5Dget_space(dataset.id()), H5Sclose);
  const int rank = H5Sget_simple_extent_ndims(space.id());
  if (rank < 0) Fail(path, "has no shape: " + LastError());
  std::vector<hsize_t> shape(static_cast<std::size_t>(rank));
  H5Sget_simple_extent_dims(space.id(), shape.data(), nullptr);
  return {shape.begin(), shape.end()};
}

bool Hdf5File::IsNumeric(const std::string& path) const {
  const Quiet quiet;
  const Handle dataset(H5Dopen2(id_, path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastError());
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  return HoldsNumbers(H5Tget_class(type.id()));
}

core::Matrix Hdf5File::Read(const std::string& path) const {
  const std::vector<std::int64_t> shape = Shape(path);
  if (shape.empty() || shape.size() > 2) {
    Fail(path, "has " + std::to_string(shape.size()) + " dimensions, not one or two");
  }
  const Quiet quiet;
  const Handle dataset(H5Dopen2(id_, path.c_str(), H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  const H5T_class_t kind = H5Tget_class(type.id());
  if (!HoldsNumbers(kind)) Fail(path, "is not numeric");
  const std::int64_t cols = shape.size() == 2 ? shape[1] : 1;
  constexpr std::int64_t kMost = std::int64_t{1} << 31;
  if (shape[0] > kMost || cols > kMost || (cols > 0 && shape[0] > kMost / cols)) {
    Fail(path, "claims " + std::to_string(shape[0]) + " x " + std::to_string(cols) +
                   " entries, which is too much");
  }
  core::Matrix values(shape[0], cols);
  if (kind == H5T_ENUM) {
    std::vector<signed char> bytes(static_cast<std::size_t>(values.size()));
    if (H5Tget_size(type.id()) != 1 ||
        H5Dread(dataset.id(), type.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, bytes.data()) < 0) {
      Fail(path, "cannot be read as truth values");
    }
    std::copy(bytes.begin(), bytes.end(), values.data());
  } else if (H5Dread(dataset.id(), H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT,
                     values.data()) < 0) {
    Fail(path, "cannot be read: " + LastError());
  }
  return values;
}

std::vector<std::string> Hdf5File::ReadTexts(const std::string& path) const {
  const std::vector<std::int64_t> shape = Shape(path);
  constexpr std::int64_t kMost = std::int64_t{1} << 24;
  if (shape.size() != 1 || shape[0] > kMost) Fail(path, "is not a list of texts");
  const Quiet quiet;
  const Handle dataset(H5Dopen2(id_, path.c_str(), H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  if (H5Tget_class(type.id()) != H5T_STRING) Fail(path, "is not a list of texts");
  const auto count = static_cast<std::size_t>(shape[0]);
  std::vector<std::string> texts;
  texts.reserve(count);
  if (H5Tis_variable_str(type.id()) > 0) {
    std::vector<char*> values(count, nullptr);
    const Handle space(H5Dget_space(dataset.id()), H5Sclose);
    if (H5Dread(dataset.id(), type.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0) {
      Fail(path, "cannot be read: " + LastError());
    }
    for (const char* value : values) texts.emplace_back(value == nullptr ? "" : value);
    H5Dvlen_reclaim(type.id(), space.id(), H5P_DEFAULT, values.data());
    return texts;
  }
  const std::size_t size = H5Tget_size(type.id());
  if (size > (std::size_t{1} << 30) / std::max<std::size_t>(1, count)) {
    Fail(path, "claims texts of " + std::to_string(size) + " bytes, which is too much");
  }
  std::string bytes(count * size, '\0');
  if (H5Dread(dataset.id(), type.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, bytes.data()) < 0) {
    Fail(path, "cannot be read: " + LastError());
  }
  for (std::size_t i = 0; i < count; ++i) {
    std::string text = bytes.substr(i * size, size);
    text.resize(text.find_last_not_of('\0') + 1);
    texts.push_back(std::move(text));
  }
  return texts;
}

std::optional<std::int64_t> Hdf5File::IntegerAttribute(const std::string& path,
                                                       const char* name) const {
  const Quiet quiet;
  const Handle object(H5Oopen(id_, path.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.ok()) Fail(path, "cannot be opened: " + LastError());
  if (H5Aexists(object.id(), name) <= 0) return std::nullopt;
  const Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Handle space(H5Aget_space(attribute.id()), H5Sclose);
  const Handle type(H5Aget_type(attribute.id()), H5Tclose);
  std::int64_t value = 0;
  if (H5Sget_simple_extent_npoints(space.id()) != 1 || H5Tget_class(type.id()) != H5T_INTEGER ||
      H5Aread(attribute.id(), H5T_NATIVE_INT64, &value) < 0) {
    Fail(path, std::string("attribute ") + name + " is not an integer");
  }
  return value;
}

std::optional<std::string> Hdf5File::TextAttribute(const std::string& path,
                                                   const char* name) const {
  const Quiet quiet;
  const Handle object(H5Oopen(id_, path.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.ok()) Fail(path, "cannot be opened: " + LastError());
  if (H5Aexists(object.id(), name) <= 0) return std::nullopt;
  const Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Handle type(H5Aget_type(attribute.id()), H5Tclose);
  const Handle space(H5Aget_space(attribute.id()), H5Sclose);
  if (H5Tget_class(type.id()) != H5T_STRING || H5Sget_simple_extent_npoints(space.id()) != 1) {
    Fail(path, std::string("attribute ") + name + " is not text");
  }
  if (H5Tis_variable_str(type.id()) > 0) {
    char* text = nullptr;
    if (H5Aread(attribute.id(), type.id(), &text) < 0) {
      Fail(path, std::string("attribute ") + name + " cannot be read: " + LastError());
    }
    std::string value = text == nullptr ? "" : text;
    H5Dvlen_reclaim(type.id(), space.id(), H5P_DEFAULT, &text);
    return value;
  }
  std::string value(H5Tget_size(type.id()), '\0');
  if (H5Aread(attribute.id(), type.id(), value.data()) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be read: " + LastError());
  }
  value.resize(value.find_last_not_of('\0') + 1);
  return value;
}

}  // namespace dfr::imitation::internal
