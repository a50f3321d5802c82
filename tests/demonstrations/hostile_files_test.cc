// Files crafted to harm their readers, and truncated files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hdf5.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/imitation/demonstrations.h"
#include "hdf5/hdf5_file.h"
#include "hdf5/hdf5_reader.h"
#include "parquet/parquet_file.h"
#include "tests/demonstrations/episodes.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using internal::Hdf5File;
using internal::Hdf5Reader;
using test::Episodes;
using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kRegressions =
    std::filesystem::path(DFR_REGRESSIONS) / "hdf5_demonstrations";

std::string LoadError(const std::filesystem::path& path) {
  return test::MessageOf<std::runtime_error>([&] { (void)LoadDemonstrations(path); });
}

// Returns the error of reading an episode in robomimic's format that `make` has changed.
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

// Creates the dataset of actions with these rows and a layout that `change` sets.
template <typename Change>
void CreateActions(hid_t file, hsize_t rows, hsize_t columns, const Change& change) {
  const hsize_t shape[] = {rows, columns};
  const hid_t space = H5Screate_simple(2, shape, nullptr);
  const hid_t layout = H5Pcreate(H5P_DATASET_CREATE);
  change(layout);
  H5Dclose(H5Dcreate2(file, "data/demo_0/actions", H5T_NATIVE_DOUBLE, space, H5P_DEFAULT, layout,
                      H5P_DEFAULT));
  H5Pclose(layout);
  H5Sclose(space);
}

TEST(HostileFilesTest, AFileThatCrashesLibhdf5IsAnError) {
  EXPECT_THAT(LoadError(kRegressions / "hdf5_global_heap_segv.hdf5"),
              AllOf(HasSubstr("hdf5_global_heap_segv.hdf5"), HasSubstr("libhdf5 crashed on it")));
}

TEST(HostileFilesTest, AWriterKilledBeforeItsFirstEpisodeIsNamed) {
  EXPECT_THAT(LoadError(kRegressions / "hdf5_killed_while_created.hdf5"),
              HasSubstr("cannot be opened as HDF5"));
}

TEST(HostileFilesTest, ASmallFileMayNotClaimGigabytes) {
  const test::TempFolder folder;
  EXPECT_THAT(ErrorWith(folder / "claims.hdf5",
                        [](hid_t file) {
                          CreateActions(file, hsize_t{1} << 27, 7, [](hid_t layout) {
                            const hsize_t chunk[] = {1024, 7};
                            H5Pset_chunk(layout, 2, chunk);
                          });
                        }),
              HasSubstr("declares 134217728 x 7 entries, too many for a file of this size"));
  // An attribute can also declare the number of rows.
  {
    Hdf5File file = Hdf5File::Create(folder / "rows.hdf5");
    for (const char* group : {"data", "data/demo_0", "data/demo_0/obs"}) file.CreateGroup(group);
    file.Write("data/demo_0/obs/tip", core::Matrix(core::Matrix::Zero(3, 2)));
    file.Write("data/demo_0/actions", core::Matrix(core::Matrix::Zero(3, 2)));
    file.SetAttribute("data/demo_0", "num_samples", std::int64_t{1} << 40);
  }
  EXPECT_THAT(LoadError(folder / "rows.hdf5"), HasSubstr("declares 1099511627776 x 2 entries"));
}

// Each group has four links to the next one: 4^8 paths lead to one dataset.
TEST(HostileFilesTest, LinksMayNotMultiplyTheDatasets) {
  const test::TempFolder folder;
  EXPECT_THAT(
      ErrorWith(folder / "links.hdf5",
                [](hid_t file) {
                  std::string from = "data/demo_0/obs";
                  for (int level = 0; level < 8; ++level) {
                    const std::string to =
                        level == 7 ? "data/demo_0/obs/tip" : "g" + std::to_string(level);
                    if (level < 7) {
                      H5Gclose(H5Gcreate2(file, to.c_str(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
                    }
                    for (const char* link : {"/0", "/1", "/2", "/3"}) {
                      H5Lcreate_hard(file, to.c_str(), file, (from + link).c_str(), H5P_DEFAULT,
                                     H5P_DEFAULT);
                    }
                    from = to;
                  }
                }),
      HasSubstr("is one of more than 1024 groups and datasets"));
}

// The part of Thrift's compact protocol that Parquet's metadata use.
std::string Varint(std::uint64_t value) {
  std::string out;
  for (; value >= 0x80; value >>= 7U) out += static_cast<char>((value & 0x7fU) | 0x80U);
  return out + static_cast<char>(value);
}
std::string Number(int delta, std::uint64_t value) {
  return static_cast<char>((delta << 4) | 6) + Varint(2 * value);
}
std::string Text(int delta, const std::string& value) {
  return static_cast<char>((delta << 4) | 8) + Varint(value.size()) + value;
}
std::string Structs(int delta, const std::vector<std::string>& elements) {
  std::string out = static_cast<char>((delta << 4) | 9) + std::string("\xfc");
  out += Varint(elements.size());
  for (const std::string& element : elements) out.append(element) += '\0';
  return out;
}
void SaveParquet(const std::filesystem::path& path, const std::string& pages,
                 const std::string& footer) {
  const auto size = static_cast<std::uint32_t>(footer.size());
  std::ofstream(path, std::ios::binary)
      << "PAR1" << pages << footer
      << std::string_view(reinterpret_cast<const char*>(&size), sizeof size) << "PAR1";
}

// Saves a file whose row groups share the pages of one column: a run of equal truth values, which
// takes a few bytes for any length.
void SaveRuns(const std::filesystem::path& path, const std::string& name, char truth,
              std::uint64_t values, std::size_t row_groups) {
  const std::string run = Varint(2 * values) + truth;
  const auto size = static_cast<std::uint32_t>(run.size());
  const std::string page = std::string(reinterpret_cast<const char*>(&size), sizeof size) + run;
  const std::string chunk = Number(1, 0) + Number(1, page.size()) + Number(1, page.size()) +
                            "\x2c" + Number(1, values) + Number(1, 3) + '\0' + '\0' + page;
  const std::string column =
      "\x3c" + Number(4, 0) + Number(1, values) + Number(2, chunk.size()) + Number(2, 4) + '\0';
  const std::vector groups(row_groups, Structs(1, {column}) + Number(2, values));
  SaveParquet(
      path, chunk,
      Structs(2, {Text(4, "root") + Number(1, 1), Number(1, 0) + Number(2, 0) + Text(1, name)}) +
          Structs(2, groups) + '\0');
}

// 2^26 values would take 512 MiB of memory.
TEST(HostileFilesTest, ASmallParquetFileMayNotClaimGigabytes) {
  const test::TempFolder folder;
  SaveRuns(folder / "few.parquet", "done", '\1', 1000, 2);
  const internal::ParquetFile few(folder / "few.parquet");
  EXPECT_EQ(few.Read(1, "done").values, std::vector<double>(1000, 1.0));
  for (const std::size_t row_groups : {1U, 64U}) {
    SaveRuns(folder / "many.parquet", "done", '\1', (std::uint64_t{1} << 26) / row_groups,
             row_groups);
    EXPECT_THAT([&] { const internal::ParquetFile many(folder / "many.parquet"); },
                testing::ThrowsMessage<std::runtime_error>(
                    AllOf(HasSubstr("many.parquet: declares "),
                          HasSubstr(" more values, too many for a file of this size"))));
  }
}

// The states would take 16 TiB.
TEST(HostileFilesTest, ASmallLeRobotDatasetMayNotClaimTerabytes) {
  const test::TempFolder folder;
  std::filesystem::create_directories(folder / "meta");
  std::filesystem::create_directories(folder / "data");
  std::ofstream(folder / "meta/info.json")
      << R"({"codebase_version": "v3.0", "features": {"action": {"dtype": "float32", "shape": [1]},)"
      << R"("observation.state": {"dtype": "float32", "shape": [1048576]}}})";
  SaveRuns(folder / "data/few.parquet", "episode_index", '\0', std::uint64_t{1} << 21, 1);
  EXPECT_THAT(
      LoadError(folder / "."),
      AllOf(HasSubstr("few.parquet: episode 0"),
            HasSubstr("declares 2097152 x 1048577 entries, too many for files of this size")));
}

// 20 000 columns have a parent with a name of 20 000 letters. Each column's path repeats this name.
TEST(HostileFilesTest, ASmallSchemaMayNotAskForGigabytes) {
  const test::TempFolder folder;
  std::vector<std::string> elements(20'002, Number(1, 1));
  elements[0] = Text(4, "root") + Number(1, 1);
  elements[1] = Text(4, std::string(20'000, 'a')) + Number(1, 20'000);
  SaveParquet(folder / "names.parquet", "",
              Structs(2, elements) + Structs(2, {Structs(1, {}) + Number(2, 0)}) + '\0');
  EXPECT_THAT([&] { internal::ParquetFile(folder / "names.parquet"); },
              testing::ThrowsMessage<std::runtime_error>(HasSubstr("too many names")));
}

TEST(HostileFilesTest, NoOtherFileIsRead) {
  const test::TempFolder folder;
  std::ofstream(folder / "secret", std::ios::binary) << std::string(3 * 2 * 8, 's');
  const std::string secret = (folder / "secret").string();
  EXPECT_THAT(ErrorWith(folder / "external.hdf5",
                        [&](hid_t file) {
                          CreateActions(file, 3, 2, [&](hid_t layout) {
                            H5Pset_external(layout, secret.c_str(), 0, H5F_UNLIMITED);
                          });
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

  // The reading process opens no other file, for any kind of link.
  const hid_t file =
      H5Fcreate((folder / "below.hdf5").c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  H5Lcreate_external(other.c_str(), "data", file, "data", H5P_DEFAULT, H5P_DEFAULT);
  H5Fclose(file);
  const Hdf5Reader reader(folder / "below.hdf5");
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { (void)reader.Members("data"); }),
              HasSubstr("below.hdf5"));
}

TEST(HostileFilesTest, AnIncompleteEpisodeIsLeftOutAndReported) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  SaveRobomimic(Episodes(), path);
  EXPECT_EQ(OpenDemonstrations(path)->note(), "");
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  H5Gclose(H5Gcreate2(file, "data/demo_3", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  H5Fclose(file);
  const auto reader = OpenDemonstrations(path);
  EXPECT_EQ(reader->num_episodes(), 3);
  EXPECT_THAT(reader->note(), AllOf(HasSubstr("its 3 complete episodes are read"),
                                    HasSubstr("data/demo_3"), HasSubstr("--repair")));
  EXPECT_EQ(LoadDemonstrations(path).note, reader->note());
}

TEST(HostileFilesTest, TheUsersListOfEpisodesIsRead) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  SaveRobomimic(Episodes(), path);
  hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  H5Ldelete(file, "data/demo_1", H5P_DEFAULT);
  H5Fclose(file);
  auto reader = OpenDemonstrations(path);
  ASSERT_EQ(reader->num_episodes(), 2);
  EXPECT_EQ(reader->name(1), "data/demo_2");
  EXPECT_EQ(reader->note(), "");
  reader.reset();
  file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  for (const char* name : {"data/demo_1", "data/demo_3"}) {
    H5Lcreate_hard(file, "data/demo_0", file, name, H5P_DEFAULT, H5P_DEFAULT);
  }
  H5Fclose(file);
  reader = OpenDemonstrations(path);
  EXPECT_EQ(reader->num_episodes(), 4);
  EXPECT_EQ(reader->note(), "");
}

// A writer killed between the two links leaves an episode that only the second list contains.
TEST(HostileFilesTest, AMaskNamesTheEpisodesOfTheSecondList) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  SaveRobomimic(Episodes(), path);
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  H5Ldelete(file, "data/demo_2", H5P_DEFAULT);
  const std::int64_t listed = 2;
  const hid_t list = H5Gopen2(file, ".episodes", H5P_DEFAULT);
  const hid_t attribute = H5Aopen(list, "listed", H5P_DEFAULT);
  H5Awrite(attribute, H5T_NATIVE_INT64, &listed);
  H5Aclose(attribute);
  H5Gclose(list);
  H5Gclose(H5Gcreate2(file, "mask", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  const hid_t text = H5Tcopy(H5T_C_S1);
  H5Tset_size(text, 6);
  const hsize_t one = 1;
  const hid_t space = H5Screate_simple(1, &one, nullptr);
  const hid_t mask =
      H5Dcreate2(file, "mask/train", text, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
  H5Dwrite(mask, text, H5S_ALL, H5S_ALL, H5P_DEFAULT, "demo_2");
  H5Dclose(mask);
  H5Sclose(space);
  H5Tclose(text);
  H5Fclose(file);
  EXPECT_THAT(OpenDemonstrations(path)->note(), HasSubstr("its 3 complete episodes are read"));
  const auto masked = OpenDemonstrations(path, "train");
  ASSERT_EQ(masked->num_episodes(), 1);
  EXPECT_EQ(masked->Read(0).states, test::Episode(2).states);
}

TEST(HostileFilesTest, TheReportOfOneCompleteEpisodeIsInTheSingular) {
  const test::TempFolder folder;
  const std::filesystem::path path = folder / "demos.hdf5";
  DemonstrationSet one = Episodes();
  one.trajectories.resize(1);
  SaveRobomimic(one, path);
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  H5Gclose(H5Gcreate2(file, "data/demo_1", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  H5Fclose(file);
  EXPECT_THAT(OpenDemonstrations(path)->note(), HasSubstr("its 1 complete episode is read; "));
}

// The reading process keeps none of the caller's files open.
TEST(HostileFilesTest, ReadingLeavesNoProcessAndNoFileBehind) {
  const test::TempFolder folder;
  SaveRobomimic(Episodes(), folder / "demos.hdf5");
  const auto open_files = [] {
    return std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
  };
  const auto before = open_files();
  for (int i = 0; i < 5; ++i) {
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
