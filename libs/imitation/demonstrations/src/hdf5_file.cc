#include "hdf5_file.h"

#include <hdf5.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <string_view>
#include <type_traits>
#include <utility>

#include "dfr/core/atomic_file.h"

namespace dfr::imitation::internal {
namespace {

static_assert(std::is_same_v<hid_t, std::int64_t>);

// Suppresses libhdf5's own error output; Fail() reports the errors.
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

// The innermost entry of the error stack is the actual cause.
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

constexpr char kOneFile[] =
    "; links to other files are not followed: copy the data into this file with h5repack or h5py";

class GroupProperties {
 public:
  explicit GroupProperties(bool track_order) : properties_(H5Pcreate(H5P_GROUP_CREATE), H5Pclose) {
    if (track_order) {
      H5Pset_link_creation_order(id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
    }
  }
  [[nodiscard]] hid_t id() const { return properties_.id(); }

 private:
  Handle properties_;
};

[[noreturn]] void FailFile(const std::string& name, const std::string& reason) {
  throw std::runtime_error(name + ": " + reason);
}

}  // namespace

Hdf5File::Hdf5File(std::string name, std::int64_t id) : name_(std::move(name)), id_(id) {}

Hdf5File::Hdf5File(Hdf5File&& other) noexcept
    : name_(std::move(other.name_)),
      id_(std::exchange(other.id_, H5I_INVALID_HID)),
      new_group_(std::exchange(other.new_group_, H5I_INVALID_HID)),
      second_list_(std::exchange(other.second_list_, H5I_INVALID_HID)),
      track_order_(other.track_order_) {}

Hdf5File& Hdf5File::operator=(Hdf5File&& other) noexcept {
  std::swap(name_, other.name_);
  std::swap(id_, other.id_);
  std::swap(new_group_, other.new_group_);
  std::swap(second_list_, other.second_list_);
  std::swap(track_order_, other.track_order_);
  return *this;
}

Hdf5File::~Hdf5File() {
  if (id_ < 0) return;
  const Quiet quiet;
  if (new_group_ >= 0) H5Gclose(new_group_);
  if (second_list_ >= 0) H5Oclose(second_list_);
  H5Fclose(id_);
}

Hdf5File Hdf5File::Create(const std::filesystem::path& path, bool track_order) {
  const Quiet quiet;
  const Handle properties(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
  if (track_order) {
    H5Pset_link_creation_order(properties.id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
  }
  // Uses the library's default version bounds: with "latest", a file whose writer was killed does
  // not open.
  constexpr std::size_t kGrowth = 1 << 16;
  const Handle memory(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_fapl_core(memory.id(), kGrowth, /*backing_store=*/false);
  const Handle empty(H5Fcreate(path.c_str(), H5F_ACC_TRUNC, properties.id(), memory.id()),
                     H5Fclose);
  if (!empty.ok() || H5Fflush(empty.id(), H5F_SCOPE_GLOBAL) < 0) {
    FailFile(path.string(), "cannot be created: " + LastError());
  }
  std::string image(static_cast<std::size_t>(H5Fget_file_image(empty.id(), nullptr, 0)), '\0');
  H5Fget_file_image(empty.id(), image.data(), image.size());
  core::ReplaceFile(path, image);

  const hid_t id = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  if (id < 0) FailFile(path.string(), "cannot be created: " + LastError());
  Hdf5File file(path.string(), id);
  file.track_order_ = track_order;
  file.HoldMetadata(true);
  return file;
}

// libhdf5 writes object metadata whenever its cache is full, in any order. After a kill, such a
// file would refer to data that were never written.
void Hdf5File::HoldMetadata(bool hold) {
  H5AC_cache_config_t config{};
  config.version = H5AC__CURR_CACHE_CONFIG_VERSION;
  if (H5Fget_mdc_config(id_, &config) < 0) FailFile(name_, "cannot be set up: " + LastError());
  config.evictions_enabled = !hold;
  config.incr_mode = hold ? H5C_incr__off : H5C_incr__threshold;
  config.decr_mode = hold ? H5C_decr__off : H5C_decr__age_out_with_threshold;
  config.flash_incr_mode = hold ? H5C_flash_incr__off : H5C_flash_incr__add_space;
  if (H5Fset_mdc_config(id_, &config) < 0) FailFile(name_, "cannot be set up: " + LastError());
}

Hdf5File Hdf5File::Open(const std::filesystem::path& path) {
  const Quiet quiet;
  if (!std::filesystem::exists(path)) FailFile(path.string(), "no such file");
  // Uses a different driver than the writer: with the same one, libhdf5 would share the descriptor
  // of an open file, which a forked process does not have.
  const Handle driver(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_fapl_stdio(driver.id());
  const hid_t id = H5Fopen(path.c_str(), H5F_ACC_RDONLY, driver.id());
  if (id < 0) {
    FailFile(path.string(),
             "cannot be opened as HDF5 (is it an HDF5 file, and did its writer finish the first "
             "episode?): " +
                 LastError());
  }
  return {path.string(), id};
}

void Hdf5File::Fail(const std::string& path, const std::string& reason) const {
  FailFile(name_, path + ": " + reason);
}

void Hdf5File::CreateGroup(const std::string& path) {
  const Quiet quiet;
  const Place at = At(path);
  const Handle group(H5Gcreate2(at.object, at.path.c_str(), H5P_DEFAULT,
                                GroupProperties(track_order_).id(), H5P_DEFAULT),
                     H5Gclose);
  if (!group.ok()) Fail(path, "cannot be created: " + LastError());
}

void Hdf5File::WriteBlock(const std::string& path, std::int64_t type,
                          std::span<const std::int64_t> shape, bool growable, const void* values) {
  std::vector<hsize_t> now(shape.begin(), shape.end());
  std::vector<hsize_t> most = now;
  const Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
  if (growable) {
    // An episode's rows are read together: one chunk, within the 1 MiB that libhdf5 caches.
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
  const Place at = At(path);
  const Handle dataset(H5Dcreate2(at.object, at.path.c_str(), type, space.id(), H5P_DEFAULT,
                                  properties.id(), H5P_DEFAULT),
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
  const Place at = At(path);
  const Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  // Overwrites an existing attribute in place: it exists at any time.
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
  const Place at = At(path);
  const Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
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
  // Metadata on the disk may leave the cache.
  HoldMetadata(false);
  HoldMetadata(true);
}

void Hdf5File::CreateNewGroup() {
  const Quiet quiet;
  if (new_group_ >= 0) H5Gclose(new_group_);
  new_group_ = H5Gcreate_anon(id_, GroupProperties(track_order_).id(), H5P_DEFAULT);
  if (new_group_ < 0) FailFile(name_, "cannot be written: " + LastError());
}

void Hdf5File::LinkNewGroup(const std::string& path) {
  const Quiet quiet;
  const Place at = At(path);
  if (H5Olink(new_group_, at.object, at.path.c_str(), H5P_DEFAULT, H5P_DEFAULT) < 0) {
    Fail(path, "cannot be written: " + LastError());
  }
}

void Hdf5File::CreateSecondList() {
  const Quiet quiet;
  CreateGroup(kSecondList);
  H5O_info_t info{};
  if (H5Oget_info_by_name2(id_, kSecondList, &info, H5O_INFO_BASIC, H5P_DEFAULT) < 0) {
    Fail(kSecondList, "cannot be found again: " + LastError());
  }
  SetAttribute("/", kSecondList, static_cast<std::int64_t>(info.addr));
}

Hdf5File::Place Hdf5File::At(const std::string& path) const {
  const auto within = [&path](std::string_view group) {
    return path.starts_with(group) && (path.size() == group.size() || path[group.size()] == '/');
  };
  const auto below = [&path](std::string_view group) {
    return path.size() == group.size() ? "." : path.substr(group.size() + 1);
  };
  if (new_group_ >= 0 && within(kNewGroup)) return {new_group_, below(kNewGroup)};
  if (within(kSecondList)) {
    const std::optional<std::int64_t> address =
        second_list_ < 0 ? IntegerAttribute("/", kSecondList) : std::nullopt;
    if (address) second_list_ = H5Oopen_by_addr(id_, static_cast<haddr_t>(*address));
    if (second_list_ >= 0) return {second_list_, below(kSecondList)};
  }
  return {id_, path};
}

core::ReadBudget Hdf5File::budget() const {
  hsize_t size = 0;
  if (H5Fget_filesize(id_, &size) < 0) FailFile(name_, "has no size: " + LastError());
  return core::ReadBudget(size);
}

bool Hdf5File::Exists(const std::string& path) const {
  const Quiet quiet;
  const auto [object, place] = At(path);
  if (place == ".") return true;
  // H5Lexists requires every parent to exist.
  for (std::size_t end = place.find('/');; end = place.find('/', end + 1)) {
    const std::string part = place.substr(0, end);
    if (H5Lexists(object, part.c_str(), H5P_DEFAULT) <= 0) return false;
    H5L_info_t link{};
    if (H5Lget_info(object, part.c_str(), &link, H5P_DEFAULT) >= 0 && link.type != H5L_TYPE_HARD &&
        link.type != H5L_TYPE_SOFT) {
      Fail(part, std::string("is a link to another file") + kOneFile);
    }
    if (end == std::string::npos) return true;
  }
}

bool Hdf5File::IsGroup(const std::string& path) const {
  const Quiet quiet;
  const Place at = At(path);
  const Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  return object.ok() && H5Iget_type(object.id()) == H5I_GROUP;
}

std::vector<std::string> Hdf5File::Members(const std::string& group) const {
  const Quiet quiet;
  const Place at = At(group.empty() ? "/" : group);
  const Handle handle(H5Gopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Gclose);
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
  const Place at = At(path);
  const Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastError());
  const Handle storage(H5Dget_create_plist(dataset.id()), H5Pclose);
  if (!storage.ok()) Fail(path, "has no layout: " + LastError());
  const H5D_layout_t layout = H5Pget_layout(storage.id());
  if (layout == H5D_VIRTUAL || H5Pget_external_count(storage.id()) != 0) {
    Fail(path, std::string("keeps its values in another file") + kOneFile);
  }
  const Handle space(H5Dget_space(dataset.id()), H5Sclose);
  const int rank = H5Sget_simple_extent_ndims(space.id());
  if (rank < 0) Fail(path, "has no shape: " + LastError());
  std::vector<hsize_t> shape(static_cast<std::size_t>(rank));
  H5Sget_simple_extent_dims(space.id(), shape.data(), nullptr);
  return {shape.begin(), shape.end()};
}

bool Hdf5File::IsNumeric(const std::string& path) const {
  const Quiet quiet;
  const Place at = At(path);
  const Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastError());
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  return HoldsNumbers(H5Tget_class(type.id()));
}

core::Matrix Hdf5File::Read(const std::string& path) const {
  const std::vector<std::int64_t> shape = Shape(path);
  if (shape.empty() || shape.size() > 4) {
    Fail(path, "has " + std::to_string(shape.size()) + " dimensions, not one to four");
  }
  const Quiet quiet;
  const Place at = At(path);
  const Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  const H5T_class_t kind = H5Tget_class(type.id());
  if (!HoldsNumbers(kind)) Fail(path, "is not numeric");
  constexpr std::int64_t kMost = std::int64_t{1} << 31;
  std::int64_t cols = 1;
  for (std::size_t k = 1; k < shape.size(); ++k) {
    // A product of claims that has become too large stays too large.
    cols = shape[k] < 0 || shape[k] > kMost || cols > kMost ? kMost + 1 : cols * shape[k];
  }
  if (shape[0] < 0 || shape[0] > kMost || cols < 0 || cols > kMost ||
      !budget().Take(static_cast<std::uint64_t>(shape[0]) * sizeof(double),
                     static_cast<std::uint64_t>(cols))) {
    Fail(path, "declares " + std::to_string(shape[0]) + " x " + std::to_string(cols) +
                   " entries, too many for a file of this size");
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
  if (shape.size() != 1 || shape[0] < 0 ||
      !budget().Take(static_cast<std::uint64_t>(shape[0]), sizeof(std::string))) {
    Fail(path, "is not a list of strings");
  }
  const Quiet quiet;
  const Place at = At(path);
  const Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  const Handle type(H5Dget_type(dataset.id()), H5Tclose);
  if (H5Tget_class(type.id()) != H5T_STRING) Fail(path, "is not a list of strings");
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
  if (!budget().Take(count, size)) {
    Fail(path, "declares texts of " + std::to_string(size) + " bytes, which is too much");
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
  const Place at = At(path);
  const Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.ok()) Fail(path, "cannot be opened: " + LastError());
  if (H5Aexists(object.id(), name) <= 0) return std::nullopt;
  const Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Handle space(H5Aget_space(attribute.id()), H5Sclose);
  const Handle type(H5Aget_type(attribute.id()), H5Tclose);
  std::int64_t value = 0;
  // h5py stores truth values as an enumeration.
  const H5T_class_t kind = H5Tget_class(type.id());
  if (H5Sget_simple_extent_npoints(space.id()) != 1 || (kind != H5T_INTEGER && kind != H5T_ENUM) ||
      H5Aread(attribute.id(), H5T_NATIVE_INT64, &value) < 0) {
    Fail(path, std::string("attribute ") + name + " is neither an integer nor a truth value");
  }
  return value;
}

std::optional<std::string> Hdf5File::TextAttribute(const std::string& path,
                                                   const char* name) const {
  const Quiet quiet;
  const Place at = At(path);
  const Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
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
  const std::size_t size = H5Tget_size(type.id());
  if (!budget().Take(size, 1)) Fail(path, std::string("attribute ") + name + " is too long");
  std::string value(size, '\0');
  if (H5Aread(attribute.id(), type.id(), value.data()) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be read: " + LastError());
  }
  value.resize(value.find_last_not_of('\0') + 1);
  return value;
}

}  // namespace dfr::imitation::internal
