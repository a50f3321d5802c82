#include "hdf5/hdf5_file.h"

#include <hdf5.h>

#include <algorithm>
#include <cstdint>
#include <string_view>
#include <utility>

#include "hdf5/hdf5_handle.h"

namespace dfr::imitation::internal {
namespace {

bool HoldsNumbers(H5T_class_t kind) {
  // h5py stores booleans as an enumeration over int8.
  return kind == H5T_FLOAT || kind == H5T_INTEGER || kind == H5T_ENUM;
}

constexpr char kOneFile[] =
    "; links to other files are not followed: copy the data into this file with h5repack or h5py";

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
  const Hdf5Quiet quiet;
  if (new_group_ >= 0) H5Gclose(new_group_);
  if (second_list_ >= 0) H5Oclose(second_list_);
  H5Fclose(id_);
}

Hdf5File Hdf5File::Open(const std::filesystem::path& path) {
  const Hdf5Quiet quiet;
  if (!std::filesystem::exists(path)) FailFile(path.string(), "no such file");
  // Uses another driver, not the writer's. With the writer's driver, libhdf5 would share the
  // descriptor of an open file, which a forked process does not have.
  const Hdf5Handle driver(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_fapl_stdio(driver.id());
  const hid_t id = H5Fopen(path.c_str(), H5F_ACC_RDONLY, driver.id());
  if (id < 0) {
    FailFile(path.string(),
             "cannot be opened as HDF5 (is it an HDF5 file, and did its writer finish the first "
             "episode?): " +
                 LastHdf5Error());
  }
  return {path.string(), id};
}

void Hdf5File::Fail(const std::string& path, const std::string& reason) const {
  FailFile(name_, path + ": " + reason);
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
  if (H5Fget_filesize(id_, &size) < 0) FailFile(name_, "has no size: " + LastHdf5Error());
  return core::ReadBudget(size);
}

bool Hdf5File::Exists(const std::string& path) const {
  const Hdf5Quiet quiet;
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
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  return object.ok() && H5Iget_type(object.id()) == H5I_GROUP;
}

std::vector<std::string> Hdf5File::Members(const std::string& group) const {
  const Hdf5Quiet quiet;
  const Place at = At(group.empty() ? "/" : group);
  const Hdf5Handle handle(H5Gopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Gclose);
  if (!handle.ok()) Fail(group, "is not a group: " + LastHdf5Error());
  std::vector<std::string> names;
  const auto collect = [](hid_t, const char* name, const H5L_info_t*, void* out) -> herr_t {
    static_cast<std::vector<std::string>*>(out)->emplace_back(name);
    return 0;
  };
  if (H5Literate(handle.id(), H5_INDEX_NAME, H5_ITER_INC, nullptr, collect, &names) < 0) {
    Fail(group, "cannot be listed: " + LastHdf5Error());
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::vector<std::int64_t> Hdf5File::Shape(const std::string& path) const {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastHdf5Error());
  const Hdf5Handle storage(H5Dget_create_plist(dataset.id()), H5Pclose);
  if (!storage.ok()) Fail(path, "has no layout: " + LastHdf5Error());
  const H5D_layout_t layout = H5Pget_layout(storage.id());
  if (layout == H5D_VIRTUAL || H5Pget_external_count(storage.id()) != 0) {
    Fail(path, std::string("keeps its values in another file") + kOneFile);
  }
  const Hdf5Handle space(H5Dget_space(dataset.id()), H5Sclose);
  const int rank = H5Sget_simple_extent_ndims(space.id());
  if (rank < 0) Fail(path, "has no shape: " + LastHdf5Error());
  std::vector<hsize_t> shape(static_cast<std::size_t>(rank));
  H5Sget_simple_extent_dims(space.id(), shape.data(), nullptr);
  return {shape.begin(), shape.end()};
}

bool Hdf5File::IsNumeric(const std::string& path) const {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) Fail(path, "is not a dataset: " + LastHdf5Error());
  const Hdf5Handle type(H5Dget_type(dataset.id()), H5Tclose);
  return HoldsNumbers(H5Tget_class(type.id()));
}

core::Matrix Hdf5File::Read(const std::string& path) const {
  const std::vector<std::int64_t> shape = Shape(path);
  if (shape.empty() || shape.size() > 4) {
    Fail(path, "has " + std::to_string(shape.size()) + " dimensions, not one to four");
  }
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  const Hdf5Handle type(H5Dget_type(dataset.id()), H5Tclose);
  const H5T_class_t kind = H5Tget_class(type.id());
  if (!HoldsNumbers(kind)) Fail(path, "is not numeric");
  constexpr std::int64_t kMost = std::int64_t{1} << 31;
  std::int64_t cols = 1;
  for (std::size_t k = 1; k < shape.size(); ++k) {
    // A product that exceeds the limit stays above it.
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
      Fail(path, "cannot be read as Boolean values");
    }
    std::copy(bytes.begin(), bytes.end(), values.data());
  } else if (H5Dread(dataset.id(), H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT,
                     values.data()) < 0) {
    Fail(path, "cannot be read: " + LastHdf5Error());
  }
  return values;
}

std::vector<std::string> Hdf5File::ReadTexts(const std::string& path) const {
  const std::vector<std::int64_t> shape = Shape(path);
  if (shape.size() != 1 || shape[0] < 0 ||
      !budget().Take(static_cast<std::uint64_t>(shape[0]), sizeof(std::string))) {
    Fail(path, "is not a list of strings");
  }
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle dataset(H5Dopen2(at.object, at.path.c_str(), H5P_DEFAULT), H5Dclose);
  const Hdf5Handle type(H5Dget_type(dataset.id()), H5Tclose);
  if (H5Tget_class(type.id()) != H5T_STRING) Fail(path, "is not a list of strings");
  const auto count = static_cast<std::size_t>(shape[0]);
  std::vector<std::string> texts;
  texts.reserve(count);
  if (H5Tis_variable_str(type.id()) > 0) {
    std::vector<char*> values(count, nullptr);
    const Hdf5Handle space(H5Dget_space(dataset.id()), H5Sclose);
    if (H5Dread(dataset.id(), type.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0) {
      Fail(path, "cannot be read: " + LastHdf5Error());
    }
    for (const char* value : values) texts.emplace_back(value == nullptr ? "" : value);
    H5Dvlen_reclaim(type.id(), space.id(), H5P_DEFAULT, values.data());
    return texts;
  }
  const std::size_t size = H5Tget_size(type.id());
  if (!budget().Take(count, size)) {
    Fail(path, "declares texts of " + std::to_string(size) + " bytes, which is too long");
  }
  std::string bytes(count * size, '\0');
  if (H5Dread(dataset.id(), type.id(), H5S_ALL, H5S_ALL, H5P_DEFAULT, bytes.data()) < 0) {
    Fail(path, "cannot be read: " + LastHdf5Error());
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
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.ok()) Fail(path, "cannot be opened: " + LastHdf5Error());
  if (H5Aexists(object.id(), name) <= 0) return std::nullopt;
  const Hdf5Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Hdf5Handle space(H5Aget_space(attribute.id()), H5Sclose);
  const Hdf5Handle type(H5Aget_type(attribute.id()), H5Tclose);
  std::int64_t value = 0;
  // h5py stores Boolean values as an enumeration.
  const H5T_class_t kind = H5Tget_class(type.id());
  // Minari 0.4 writes the text "None" for an unknown seed.
  if (kind == H5T_STRING && TextAttribute(path, name) == "None") return std::nullopt;
  if (H5Sget_simple_extent_npoints(space.id()) != 1 || (kind != H5T_INTEGER && kind != H5T_ENUM) ||
      H5Aread(attribute.id(), H5T_NATIVE_INT64, &value) < 0) {
    Fail(path, std::string("attribute ") + name + " is neither an integer nor a Boolean");
  }
  return value;
}

std::optional<std::string> Hdf5File::TextAttribute(const std::string& path,
                                                   const char* name) const {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.ok()) Fail(path, "cannot be opened: " + LastHdf5Error());
  if (H5Aexists(object.id(), name) <= 0) return std::nullopt;
  const Hdf5Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Hdf5Handle type(H5Aget_type(attribute.id()), H5Tclose);
  const Hdf5Handle space(H5Aget_space(attribute.id()), H5Sclose);
  if (H5Tget_class(type.id()) != H5T_STRING || H5Sget_simple_extent_npoints(space.id()) != 1) {
    Fail(path, std::string("attribute ") + name + " is not text");
  }
  if (H5Tis_variable_str(type.id()) > 0) {
    char* text = nullptr;
    if (H5Aread(attribute.id(), type.id(), &text) < 0) {
      Fail(path, std::string("attribute ") + name + " cannot be read: " + LastHdf5Error());
    }
    std::string value = text == nullptr ? "" : text;
    H5Dvlen_reclaim(type.id(), space.id(), H5P_DEFAULT, &text);
    return value;
  }
  const std::size_t size = H5Tget_size(type.id());
  if (!budget().Take(size, 1)) Fail(path, std::string("attribute ") + name + " is too long");
  std::string value(size, '\0');
  if (H5Aread(attribute.id(), type.id(), value.data()) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be read: " + LastHdf5Error());
  }
  value.resize(value.find_last_not_of('\0') + 1);
  return value;
}

}  // namespace dfr::imitation::internal
