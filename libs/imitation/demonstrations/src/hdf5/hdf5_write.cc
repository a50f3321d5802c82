#include <hdf5.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "dfr/core/files/atomic_file.h"
#include "hdf5/hdf5_file.h"
#include "hdf5/hdf5_handle.h"

namespace dfr::imitation::internal {
namespace {

class GroupProperties {
 public:
  explicit GroupProperties(bool track_order) : properties_(H5Pcreate(H5P_GROUP_CREATE), H5Pclose) {
    if (track_order) {
      H5Pset_link_creation_order(id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
    }
  }
  [[nodiscard]] hid_t id() const { return properties_.id(); }

 private:
  Hdf5Handle properties_;
};

}  // namespace

Hdf5File Hdf5File::Create(const std::filesystem::path& path, bool track_order) {
  const Hdf5Quiet quiet;
  const Hdf5Handle properties(H5Pcreate(H5P_FILE_CREATE), H5Pclose);
  if (track_order) {
    H5Pset_link_creation_order(properties.id(), H5P_CRT_ORDER_TRACKED | H5P_CRT_ORDER_INDEXED);
  }
  // Uses the library's default version bounds: with "latest", a file whose writer was killed does
  // not open.
  constexpr std::size_t kGrowth = 1 << 16;
  const Hdf5Handle memory(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_fapl_core(memory.id(), kGrowth, /*backing_store=*/false);
  const Hdf5Handle empty(H5Fcreate(path.c_str(), H5F_ACC_TRUNC, properties.id(), memory.id()),
                         H5Fclose);
  if (!empty.ok() || H5Fflush(empty.id(), H5F_SCOPE_GLOBAL) < 0) {
    FailFile(path.string(), "cannot be created: " + LastHdf5Error());
  }
  std::string image(static_cast<std::size_t>(H5Fget_file_image(empty.id(), nullptr, 0)), '\0');
  H5Fget_file_image(empty.id(), image.data(), image.size());
  core::ReplaceFile(path, image);

  const hid_t id = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  if (id < 0) FailFile(path.string(), "was created, but cannot be opened: " + LastHdf5Error());
  Hdf5File file(path.string(), id);
  file.track_order_ = track_order;
  file.HoldMetadata(true);
  return file;
}

// If `hold` is true, keeps object metadata in the cache. Otherwise libhdf5 writes them in any order
// when the cache is full, and after a kill the file would refer to data that were never written.
void Hdf5File::HoldMetadata(bool hold) {
  H5AC_cache_config_t config{};
  config.version = H5AC__CURR_CACHE_CONFIG_VERSION;
  if (H5Fget_mdc_config(id_, &config) < 0) {
    FailFile(name_, "the settings of its cache cannot be read: " + LastHdf5Error());
  }
  config.evictions_enabled = !hold;
  config.incr_mode = hold ? H5C_incr__off : H5C_incr__threshold;
  config.decr_mode = hold ? H5C_decr__off : H5C_decr__age_out_with_threshold;
  config.flash_incr_mode = hold ? H5C_flash_incr__off : H5C_flash_incr__add_space;
  if (H5Fset_mdc_config(id_, &config) < 0) {
    FailFile(name_, "the settings of its cache cannot be changed: " + LastHdf5Error());
  }
}

void Hdf5File::CreateGroup(const std::string& path) {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle group(H5Gcreate2(at.object, at.path.c_str(), H5P_DEFAULT,
                                    GroupProperties(track_order_).id(), H5P_DEFAULT),
                         H5Gclose);
  if (!group.ok()) Fail(path, "cannot be created: " + LastHdf5Error());
}

void Hdf5File::WriteBlock(const std::string& path, std::int64_t type,
                          const std::vector<std::int64_t>& shape, bool growable,
                          const void* values) {
  const Hdf5Quiet quiet;
  std::vector<hsize_t> now(shape.begin(), shape.end());
  std::vector<hsize_t> most = now;
  const Hdf5Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
  if (growable) {
    // An episode's rows are read together and form one chunk of at most 1 MiB, the size of
    // libhdf5's cache.
    constexpr hsize_t kChunkBytes = 1 << 20;
    std::vector<hsize_t> chunk = now;
    hsize_t row_bytes = H5Tget_size(type);
    for (std::size_t k = 1; k < chunk.size(); ++k) row_bytes *= chunk[k];
    chunk[0] = std::clamp<hsize_t>(kChunkBytes / row_bytes, 1, std::max<hsize_t>(1, chunk[0]));
    H5Pset_chunk(properties.id(), static_cast<int>(chunk.size()), chunk.data());
    most[0] = H5S_UNLIMITED;
  }
  const Hdf5Handle space(H5Screate_simple(static_cast<int>(now.size()), now.data(), most.data()),
                         H5Sclose);
  const Hdf5Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose);
  H5Pset_create_intermediate_group(links.id(), 1);
  const Place at = At(path);
  const Hdf5Handle dataset(H5Dcreate2(at.object, at.path.c_str(), type, space.id(), links.id(),
                                      properties.id(), H5P_DEFAULT),
                           H5Dclose);
  if (!dataset.ok() || H5Dwrite(dataset.id(), type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) < 0) {
    Fail(path, "cannot be written: " + LastHdf5Error());
  }
}

void Hdf5File::Write(const std::string& path, const core::Matrix& values) {
  WriteBlock(path, H5T_NATIVE_DOUBLE, {values.rows(), values.cols()}, false, values.data());
}

void Hdf5File::Write(const std::string& path, std::span<const double> values) {
  WriteBlock(path, H5T_NATIVE_DOUBLE, {std::ssize(values)}, false, values.data());
}

void Hdf5File::Write(const std::string& path, std::span<const std::int64_t> values) {
  WriteBlock(path, H5T_NATIVE_INT64, {std::ssize(values)}, false, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, const core::Matrix& values) {
  WriteBlock(path, H5T_NATIVE_DOUBLE, {values.rows(), values.cols()}, true, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, std::span<const double> values) {
  WriteBlock(path, H5T_NATIVE_DOUBLE, {std::ssize(values)}, true, values.data());
}

void Hdf5File::WriteGrowable(const std::string& path, const std::vector<bool>& values) {
  const Hdf5Handle type(H5Tenum_create(H5T_NATIVE_INT8), H5Tclose);
  const std::int8_t no = 0;
  const std::int8_t yes = 1;
  H5Tenum_insert(type.id(), "FALSE", &no);
  H5Tenum_insert(type.id(), "TRUE", &yes);
  const std::vector<std::int8_t> bytes(values.begin(), values.end());
  WriteBlock(path, type.id(), {std::ssize(bytes)}, true, bytes.data());
}

void Hdf5File::SetAttribute(const std::string& path, const char* name, std::int64_t value) {
  WriteAttribute(path, name, H5T_NATIVE_INT64, &value);
}

void Hdf5File::SetAttribute(const std::string& path, const char* name, const std::string& value) {
  const Hdf5Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
  H5Tset_size(type.id(), H5T_VARIABLE);
  H5Tset_cset(type.id(), H5T_CSET_UTF8);
  const char* const text = value.c_str();
  WriteAttribute(path, name, type.id(), &text);
}

void Hdf5File::WriteAttribute(const std::string& path, const char* name, std::int64_t type,
                              const void* value) {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  const Hdf5Handle object(H5Oopen(at.object, at.path.c_str(), H5P_DEFAULT), H5Oclose);
  const Hdf5Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  // Overwrites an existing attribute in place, so the attribute always exists.
  const Hdf5Handle attribute(
      H5Aexists(object.id(), name) > 0
          ? H5Aopen(object.id(), name, H5P_DEFAULT)
          : H5Acreate2(object.id(), name, type, space.id(), H5P_DEFAULT, H5P_DEFAULT),
      H5Aclose);
  if (!attribute.ok() || H5Awrite(attribute.id(), type, value) < 0) {
    Fail(path, std::string("attribute ") + name + " cannot be written: " + LastHdf5Error());
  }
}

void Hdf5File::Flush() {
  const Hdf5Quiet quiet;
  if (H5Fflush(id_, H5F_SCOPE_GLOBAL) < 0) FailFile(name_, "cannot be flushed: " + LastHdf5Error());
  // Metadata on the disk may leave the cache.
  HoldMetadata(false);
  HoldMetadata(true);
}

void Hdf5File::CreateNewGroup() {
  const Hdf5Quiet quiet;
  if (new_group_ >= 0) H5Gclose(new_group_);
  new_group_ = H5Gcreate_anon(id_, GroupProperties(track_order_).id(), H5P_DEFAULT);
  if (new_group_ < 0) FailFile(name_, "cannot be written: " + LastHdf5Error());
}

void Hdf5File::LinkNewGroup(const std::string& path) {
  const Hdf5Quiet quiet;
  const Place at = At(path);
  if (H5Olink(new_group_, at.object, at.path.c_str(), H5P_DEFAULT, H5P_DEFAULT) < 0) {
    Fail(path, "cannot be written: " + LastHdf5Error());
  }
}

void Hdf5File::CreateSecondList() {
  const Hdf5Quiet quiet;
  CreateGroup(kSecondList);
  H5O_info_t info{};
  if (H5Oget_info_by_name2(id_, kSecondList, &info, H5O_INFO_BASIC, H5P_DEFAULT) < 0) {
    Fail(kSecondList, "cannot be found again: " + LastHdf5Error());
  }
  SetAttribute("/", kSecondList, static_cast<std::int64_t>(info.addr));
  SetAttribute(kSecondList, kListed, 0);
}

}  // namespace dfr::imitation::internal
