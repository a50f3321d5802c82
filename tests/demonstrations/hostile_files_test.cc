// Files that are made to harm those who read them, and files that were cut off.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hdf5.h>
#include <sys/resource.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include "dfr/imitation/demonstrations.h"
#include "hdf5_file.h"
#include "hdf5_reader.h"
#include "tests/demonstrations/episodes.h"
#include "tests/imitation/temp_folder.h"

namespace dfr::imitation {
namespace {

using internal::Hdf5File;
using internal::Hdf5Reader;
using test::Episode;
using test::Episodes;
using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kRegressions =
    std::filesystem::path(DFR_REGRESSIONS) / "hdf5_demonstrations";

std::string LoadError(const std::filesystem::path& path) {
  return test::Message<std::runtime_error>([&] { (void)LoadDemonstrations(path); });
}

// An episode of robomimic's format in which `make` may put what it likes.
template <typename Make>
std::string ErrorWith(const std::filesystem::path& path, const Make& make) {
  {
    Hdf5File file = Hdf5File::Create(path);
    for (const char* group : {"data", "data/demo_0", "data/demo_0/obs"}) file.CreateGroup(group);
    file.SetAttribute("data/demo_0", "num_samples", 3);
    file.Write("data/demo_0/obs/tip", core::Matrix(core::Matrix::Zero(3, 2)));
  }
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  make(file);
  H5Fclose(file);
  return LoadError(path);
}

TEST(HostileFilesTest, WhatCrashesLibhdf5IsAnError) {
  EXPECT_THAT(LoadError(kRegressions / "hdf5_global_heap_segv.hdf5"),
              AllOf(HasSubstr("hdf5_global_heap_segv.hdf5"), HasSubstr("libhdf5 crashed on it")));
}

TEST(HostileFilesTest, WhatKeepsLibhdf5BusyForeverIsAnError) {
  const auto start = std::chrono::steady_clock::now();
  EXPECT_THAT(LoadError(kRegressions / "hdf5_global_heap_hang.hdf5"),
              HasSubstr("libhdf5 did not come to an end with it"));
  // 2 s of computing, however loaded the machine is.
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(90));
}

TEST(HostileFilesTest, AWriterKilledBeforeItsFirstEpisodeIsNamed) {
  EXPECT_THAT(LoadError(kRegressions / "hdf5_killed_while_created.hdf5"),
              HasSubstr("cannot be opened as HDF5"));
}

TEST(HostileFilesTest, ASmallFileMayNotClaimGigabytes) {
  const test::TempFolder folder;
  EXPECT_THAT(ErrorWith(folder / "claims.hdf5",
                        [](hid_t file) {
                          const hsize_t shape[] = {hsize_t{1} << 27, 7};
                          const hsize_t chunk[] = {1024, 7};
                          const hid_t space = H5Screate_simple(2, shape, nullptr);
                          const hid_t layout = H5Pcreate(H5P_DATASET_CREATE);
                          H5Pset_chunk(layout, 2, chunk);
                          H5Dclose(H5Dcreate2(file, "data/demo_0/actions", H5T_NATIVE_DOUBLE, space,
                                              H5P_DEFAULT, layout, H5P_DEFAULT));
                          H5Pclose(layout);
                          H5Sclose(space);
                        }),
              HasSubstr("claims 134217728 x 7 entries, which is too much for a file of this size"));
  // The number of rows may come from an attribute.
  {
    Hdf5File file = Hdf5File::Create(folder / "rows.hdf5");
    for (const char* group : {"data", "data/demo_0", "data/demo_0/obs"}) file.CreateGroup(group);
    file.Write("data/demo_0/obs/tip", core::Matrix(core::Matrix::Zero(3, 2)));
    file.Write("data/demo_0/actions", core::Matrix(core::Matrix::Zero(3, 2)));
    file.SetAttribute("data/demo_0", "num_samples", std::int64_t{1} << 40);
  }
  EXPECT_THAT(LoadError(folder / "rows.hdf5"), HasSubstr("claims 1099511627776 x 2 entries"));
}

TEST(HostileFilesTest, NoOtherFileIsRead) {
  const test::TempFolder folder;
  std::ofstream(folder / "secret", std::ios::binary) << std::string(3 * 2 * 8, 's');
  const std::string secret = (folder / "secret").string();
  EXPECT_THAT(ErrorWith(folder / "external.hdf5",
                        [&](hid_t file) {
                          const hsize_t shape[] = {3, 2};
                          const hid_t space = H5Screate_simple(2, shape, nullptr);
                          const hid_t layout = H5Pcreate(H5P_DATASET_CREATE);
                          H5Pset_external(layout, secret.c_str(), 0, H5F_UNLIMITED);
                          H5Dclose(H5Dcreate2(file, "data/demo_0/actions", H5T_NATIVE_DOUBLE, space,
                                              H5P_DEFAULT, layout, H5P_DEFAULT));
                          H5Pclose(layout);
                          H5Sclose(space);
                        }),
              HasSubstr("data/demo_0/actions: keeps its values in another file"));

  SaveRobomimic(Episodes(), folder / "other.hdf5");
  const std::string other = (folder / "other.hdf5").string();
  EXPECT_THAT(ErrorWith(folder / "link.hdf5",
                        [&](hid_t file) {
                          H5Lcreate_external(other.c_str(), "data/demo_0/actions", file,
                                             "data/demo_0/actions", H5P_DEFAULT, H5P_DEFAULT);
                        }),
              HasSubstr("data/demo_0/actions: is a link to another file"));

  // Whatever way leads to another file: the process that reads opens none.
  const hid_t file =
      H5Fcreate((folder / "below.hdf5").c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  H5Lcreate_external(other.c_str(), "data", file, "data", H5P_DEFAULT, H5P_DEFAULT);
  H5Fclose(file);
  const Hdf5Reader reader(folder / "below.hdf5");
  EXPECT_THAT(test::Message<std::runtime_error>([&] { (void)reader.Members("data"); }),
              HasSubstr("below.hdf5"));
}

TEST(HostileFilesTest, AnEpisodeThatWasCutOffIsLeftOutAndSaidSo) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  SaveRobomimic(Episodes(), path);
  EXPECT_EQ(OpenDemonstrations(path)->note(), "");
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  H5Gclose(H5Gcreate2(file, "data/demo_3", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  H5Fclose(file);
  const auto reader = OpenDemonstrations(path);
  EXPECT_EQ(reader->num_episodes(), 3);
  EXPECT_THAT(reader->note(), AllOf(HasSubstr("its 3 whole episodes are read"),
                                    HasSubstr("data/demo_3"), HasSubstr("--repair")));
  EXPECT_EQ(LoadDemonstrations(path).note, reader->note());
}

// The process that reads keeps nothing of the caller's open.
TEST(HostileFilesTest, ReadingLeavesNoProcessAndNoFileBehind) {
  const test::TempFolder folder;
  SaveRobomimic(Episodes(), folder / "demos.hdf5");
  const auto open_files = [] {
    return std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
  };
  const auto before = open_files();
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(LoadDemonstrations(folder / "demos.hdf5").trajectories.size(), 3U);
    EXPECT_THAT(LoadError(kRegressions / "hdf5_global_heap_segv.hdf5"), HasSubstr("crashed"));
  }
  EXPECT_EQ(open_files(), before);
  std::ifstream children("/proc/self/task/" + std::to_string(getpid()) + "/children");
  std::string first;
  EXPECT_FALSE(children >> first) << "process " << first << " is still there";
}

}  // namespace
}  // namespace dfr::imitation
