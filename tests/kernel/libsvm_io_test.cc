#include "dfr/kernel/libsvm_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <libsvm/svm.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <vector>

#include "dfr/core/random.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::kernel {
namespace {

using test::LibsvmPeer;
using test::Tube;
using testing::HasSubstr;

class LibsvmIoTest : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    path_ = dfr::test::ProcessFolder() / (std::string("dfr_io_") + test->name());
  }
  void TearDown() override { std::filesystem::remove(path_); }

  void Write(const std::string& text) { std::ofstream(path_, std::ios::binary) << text; }
  std::string Read() const {
    std::ifstream file(path_, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  core::Matrix Samples(const std::string& text, int state_dim = 0) {
    Write(text);
    return LoadSamples(path_, state_dim);
  }
  std::string LoadModelError(const std::string& text) {
    Write(text);
    return dfr::test::MessageOf<std::runtime_error>([&] { (void)LoadLibsvmModel(path_); });
  }
  std::string LoadSamplesError(const std::string& text, int state_dim = 0) {
    return dfr::test::MessageOf<std::runtime_error>([&] { (void)Samples(text, state_dim); });
  }

  std::filesystem::path path_;
};

const char kModel[] =
    "svm_type one_class\nkernel_type rbf\ngamma 0.5\nnr_class 2\ntotal_sv 2\nrho 0.75\nSV\n"
    "1 1:0.5 2:-1 \n0.5 2:2 \n";

TEST_F(LibsvmIoTest, LibsvmLoadsOurModelWithIdenticalDecisionValues) {
  core::Random random(51);
  core::Matrix samples = Tube(200, 4, random);
  samples.col(3).setZero();  // sparse files omit zeros
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.1, .gamma = 1.0});
  SaveLibsvmModel(svm, path_);
  svm_model* model = svm_load_model(path_.c_str());
  ASSERT_NE(model, nullptr);
  EXPECT_EQ(model->l, svm.num_support_vectors());
  const core::Matrix queries = Tube(50, 4, random);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    std::vector<svm_node> nodes;
    nodes.reserve(5);
    for (int k = 0; k < 4; ++k) nodes.push_back({k + 1, queries(i, k)});
    nodes.push_back({-1, 0.0});
    double theirs = 0.0;
    svm_predict_values(model, nodes.data(), &theirs);
    // The sums have 20 terms of up to 1, each rounded a few times.
    EXPECT_NEAR(theirs, svm.libsvm_scale() * svm.Decision(core::Row(queries, i)),
                1e-13 * svm.libsvm_scale());
  }
  svm_free_and_destroy_model(&model);
}

TEST_F(LibsvmIoTest, WeLoadLibsvmsModel) {
  core::Random random(52);
  const core::Matrix samples = Tube(200, 3, random);
  const LibsvmPeer peer(samples, 0.1, 1.0, 1e-4);
  ASSERT_EQ(svm_save_model(path_.c_str(), peer.model()), 0);
  const auto svm = LoadLibsvmModel(path_);
  EXPECT_NEAR(svm.libsvm_scale(), 20.0, 1e-9);
  const core::Matrix queries = Tube(50, 3, random);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    const auto x = core::Row(queries, i);
    // LIBSVM writes support vectors with 8 digits.
    EXPECT_NEAR(svm.libsvm_scale() * svm.Decision(x), peer.Decision(x), 1e-6);
  }
}

TEST_F(LibsvmIoTest, ModelsSurviveSavingAndLoading) {
  core::Random random(53);
  const auto saved = OneClassSvm::Fit(Tube(100, 5, random), {});
  SaveLibsvmModel(saved, path_);
  const auto loaded = LoadLibsvmModel(path_);
  EXPECT_EQ(loaded.support_vectors(), saved.support_vectors());
  EXPECT_TRUE(dfr::test::AllClose(loaded.alpha(), saved.alpha(), 0.0, 1e-14));  // scaled and back
  EXPECT_NEAR(loaded.rho(), saved.rho(), 1e-14);
}

TEST_F(LibsvmIoTest, NewerModelsWithDensityMarksLoad) {
  Write(std::string(kModel).replace(std::string(kModel).find("SV\n"), 3,
                                    "prob_density_marks 0.1 0.2 0.3\nSV\n"));
  const auto svm = LoadLibsvmModel(path_);
  EXPECT_EQ(svm.num_support_vectors(), 2);
  EXPECT_EQ(svm.support_vectors()(1, 0), 0.0);
  EXPECT_EQ(svm.support_vectors()(1, 1), 2.0);
  EXPECT_NEAR(svm.rho(), 0.5, 1e-15);  // 0.75 / (1 + 0.5)
}

// LIBSVM omits all zeros, even if no entry remains.
TEST_F(LibsvmIoTest, ASupportVectorAtTheOriginHasOneEntry) {
  Write(
      "svm_type one_class\nkernel_type rbf\ngamma 2\nnr_class 2\ntotal_sv 1\nrho 1\nSV\n"
      "4 \n");
  const auto svm = LoadLibsvmModel(path_);
  EXPECT_EQ(svm.state_dim(), 1);
  EXPECT_NEAR(svm.Decision(std::vector<double>{0.5}), std::exp(-0.5) - 0.25, 1e-15);
}

TEST_F(LibsvmIoTest, AStateMayHaveAsManyEntriesAsAnEstimateAllows) {
  std::string line = "1";
  for (int k = 1; k < OneClassSvm::kMaxStateDim; ++k) line += ",1";
  EXPECT_EQ(Samples(line + "\n").cols(), OneClassSvm::kMaxStateDim);
  EXPECT_THAT(LoadSamplesError(line + ",1\n"), HasSubstr(":1: more than 2048 entries"));
  const core::Matrix sparse = Samples("1 2048:1\n");
  EXPECT_EQ(sparse.cols(), OneClassSvm::kMaxStateDim);
  EXPECT_EQ(sparse(0, 2047), 1.0);
  EXPECT_THAT(LoadSamplesError("1 2049:1\n"), HasSubstr(":1: an index must be an integer from 1"));
}

TEST_F(LibsvmIoTest, QuotesAreShortAndPrintable) {
  EXPECT_THAT(LoadSamplesError("1,2\n3,a\x01~\x7f b\n"), HasSubstr("not 'a?~?'"));
  EXPECT_THAT(LoadSamplesError("1,2\n3,x" + std::string(50, 'y') + "\n"),
              HasSubstr("not 'x" + std::string(39, 'y') + "'"));
}

TEST_F(LibsvmIoTest, WrongModelsAreRefusedWithLineAndReason) {
  const std::string good = kModel;
  const auto with = [&](const char* from, const char* to) {
    std::string text = good;
    return text.replace(text.find(from), std::strlen(from), to);
  };
  const auto error = [&](const std::string& text) { return LoadModelError(text); };
  EXPECT_THAT(error(with("one_class", "c_svc")), HasSubstr(":1: svm_type must be one_class"));
  EXPECT_THAT(error(with("rbf", "linear")), HasSubstr(":2: kernel_type must be rbf"));
  EXPECT_THAT(error(with("gamma 0.5", "gamma -1")), HasSubstr(":3: gamma must be positive"));
  EXPECT_THAT(error(with("gamma 0.5", "gamma nan")), HasSubstr(":3: gamma must be a finite"));
  EXPECT_THAT(error(with("gamma 0.5", "gamma 1 2")), HasSubstr(":3: gamma has two values"));
  EXPECT_THAT(error(with("gamma 0.5", "gamma 0")), HasSubstr(":3: gamma must be positive"));
  EXPECT_THAT(error(with("gamma 0.5", "gamma")), HasSubstr(":3: gamma must be a finite"));
  EXPECT_THAT(error(with("nr_class 2", "nr_class 9")), HasSubstr(":4: nr_class"));
  EXPECT_THAT(error(with("nr_class 2", "nr_class 1")), HasSubstr(":4: nr_class"));
  EXPECT_THAT(error(with("total_sv 2", "total_sv 0")), HasSubstr(":5: total_sv"));
  EXPECT_THAT(error(with("total_sv 2", "total_sv -2")), HasSubstr(":5: total_sv"));
  EXPECT_THAT(error(with("total_sv 2", "total_sv 99999999999")), HasSubstr(":5: total_sv"));
  EXPECT_THAT(error(with("total_sv 2", "total_sv 2147483647")), HasSubstr("ends after 2 of"));
  EXPECT_THAT(error(with("total_sv 2", "total_sv 1")), HasSubstr(":9: more than the 1"));
  EXPECT_THAT(error(with("rho 0.75\n", "")), HasSubstr("no rho"));
  EXPECT_THAT(error(with("gamma 0.5\n", "")), HasSubstr("no gamma"));
  EXPECT_THAT(error(with("total_sv 2\n", "")), HasSubstr("no total_sv"));
  EXPECT_THAT(error(with("svm_type one_class\n", "")), HasSubstr("no svm_type"));
  EXPECT_THAT(error(with("kernel_type rbf\n", "")), HasSubstr("no kernel_type"));
  EXPECT_THAT(error(with("rho 0.75", "rho 1e999")), HasSubstr(":6: rho must be a finite"));
  EXPECT_THAT(error(with("rho", "what")), HasSubstr(":6: unknown key 'what'"));
  EXPECT_THAT(error(with("0.5 2:2", "0 2:2")), HasSubstr(":9: a coefficient must be positive"));
  EXPECT_THAT(error(with("2:2", "0:2")), HasSubstr(":9: an index must be an integer from 1"));
  EXPECT_THAT(error(with("2:2", "2000000000:2")), HasSubstr(":9: an index"));
  EXPECT_THAT(error(with("1:0.5 2:-1", "2:0.5 1:-1")), HasSubstr(":8: indices must ascend"));
  EXPECT_THAT(error(with("2:2", "2")), HasSubstr(":9: expected index:value"));
  EXPECT_THAT(error(with("2:2", "2:")), HasSubstr(":9: a value must be a finite number"));
  EXPECT_THAT(error(with("2:2", "2:2x")), HasSubstr(":9: a value must be a finite number"));
  EXPECT_THAT(error(""), HasSubstr("no SV"));
  std::filesystem::remove(path_);
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { (void)LoadLibsvmModel(path_); }),
              HasSubstr("cannot be opened"));
}

// Every truncation and thousands of random corruptions: the reader rejects or reads the model, and
// never crashes or hangs.
TEST(LibsvmModelTest, DamagedModelsNeverCrash) {
  const std::string good = kModel;
  const std::size_t header = good.find("SV\n");
  for (std::size_t size = 0; size < good.size(); ++size) {
    std::istringstream in(good.substr(0, size));
    try {
      (void)LoadLibsvmModel(in, "a model");
      EXPECT_GT(size, header);  // a truncation within a number leaves another valid number
    } catch (const std::runtime_error&) {
    }
  }
  core::Random random(54);
  for (int trial = 0; trial < 5000; ++trial) {
    std::string bad = good;
    for (int k = 0; k < 3; ++k)
      bad[random.Below(bad.size())] = static_cast<char>(random.Below(256));
    std::istringstream in(bad);
    try {
      EXPECT_NEAR(LoadLibsvmModel(in, "a model").alpha().sum(), 1.0, 1e-12);
    } catch (const std::runtime_error& e) {
      EXPECT_THAT(e.what(), testing::StartsWith("a model:"));
    }
  }
}

TEST_F(LibsvmIoTest, SamplesAreReadFromSparseLinesAndFromCommas) {
  core::Matrix expected(2, 3);
  expected << 1, 0, -2.5, 0, 4e3, 0;
  const char* sparse = "+1 1:1 3:-2.5\n\n-1 2:4e3\r\n";
  EXPECT_EQ(Samples(sparse), expected);
  EXPECT_EQ(Samples(sparse, 4).cols(), 4);
  EXPECT_EQ(Samples("1,0, -2.5\n0,4e3,0\n"), expected);
  EXPECT_EQ(Samples("x,y,z\n1,0,-2.5\n0,4e3,0\n", 3), expected);
  EXPECT_EQ(Samples("3\n4\n"), Eigen::Vector2d(3, 4));
}

// LIBSVM omits all zeros: a first sample of zeros is a label alone.
TEST_F(LibsvmIoTest, TheFirstLineWithAColonOrACommaDecidesTheForm) {
  core::Matrix expected(3, 3);
  expected << 0, 0, 0, 0, 0, 0, 0, 0, 0.5;
  EXPECT_EQ(Samples("1\n\n-1\n1 3:0.5\n"), expected);
  EXPECT_EQ(Samples("pos:x,pos:y\n3,4\n"), Eigen::RowVector2d(3, 4));
}

TEST_F(LibsvmIoTest, WrongSamplesAreRefusedWithLineAndReason) {
  EXPECT_THAT(LoadSamplesError(""), HasSubstr("empty"));
  EXPECT_THAT(LoadSamplesError("x,y\n"), HasSubstr("no samples"));
  EXPECT_THAT(LoadSamplesError("1,2\n3\n"), HasSubstr(":2: the sample has 1 entries, not 2"));
  EXPECT_THAT(LoadSamplesError("1,2\n3,x\n"), HasSubstr(":2: an entry must be a finite number"));
  EXPECT_THAT(LoadSamplesError("1,2\n3,nan\n"), HasSubstr(":2: an entry must be a finite"));
  EXPECT_THAT(LoadSamplesError("1,2 3\n"), HasSubstr(":1: an entry holds more than one number"));
  EXPECT_THAT(LoadSamplesError("1 1:2\nx 1:2\n"), HasSubstr(":2: a label"));
  EXPECT_THAT(LoadSamplesError("1 5:2\n", 3),
              HasSubstr(":1: index 5 exceeds the number of entries, 3"));
  EXPECT_THAT(LoadSamplesError("1,2,3\n", 2), HasSubstr(":1: the sample has 3 entries, not 2"));
}

// The reader once mistook each of these lines for a header, and lost the sample.
TEST_F(LibsvmIoTest, NoFirstSampleIsTakenForAHeader) {
  const std::string mark = "\xEF\xBB\xBF";  // the byte order mark
  const Eigen::Matrix2d two{{1.0, 2.0}, {3.0, 4.0}};
  EXPECT_EQ(Samples(mark + "1,2\n3,4\n"), two);
  EXPECT_EQ(Samples(mark + "1 1:2\n")(0, 0), 2.0);
  EXPECT_EQ(Samples(mark + "x,y\r\n3,4\r\n"), two.bottomRows(1));
  EXPECT_EQ(Samples("1e-400,2\n3,4\n")(0, 0), 0.0);
  for (const char* text : {"0x10,2\n3,4\n", "nan,2\n3,4\n", "1e999\n3\n", "x,2\n3,4\n"}) {
    EXPECT_THAT(LoadSamplesError(text), HasSubstr(":1: an entry must be a finite number")) << text;
  }
}

// A line of 9 bytes may request a dense row of 16 KiB once, but not a hundred thousand times.
TEST_F(LibsvmIoTest, ASmallSparseFileCannotRequestGigabytes) {
  std::string text;
  for (int i = 0; i < 100'000; ++i) text += "1 2048:1\n";
  EXPECT_THAT(LoadSamplesError(text), HasSubstr("100000 rows of 2048 entries are too many"));
  EXPECT_EQ(Samples(text.substr(0, 9 * 1000)).cols(), 2048);
}

TEST_F(LibsvmIoTest, AFileLargerThanTheMemoryIsRefusedUnread) {
  Write("1,2\n3,4\n");
  std::error_code refused;
  std::filesystem::resize_file(path_, std::uintmax_t{8} << 40, refused);  // a sparse file
  if (refused || !std::filesystem::exists("/proc/meminfo")) GTEST_SKIP() << refused.message();
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { (void)LoadSamples(path_); }),
              testing::AllOf(HasSubstr("8192.0 GiB of samples are more than the "),
                             HasSubstr("use fewer samples")));
}

TEST_F(LibsvmIoTest, SavingRespectsLinksAndModes) {
  const auto svm = OneClassSvm::Fit(core::Matrix::Random(20, 2), {.nu = 0.5, .gamma = 1.0});
  const std::filesystem::path link = path_.string() + "_link";
  std::filesystem::remove(link);
  Write("");
  std::filesystem::permissions(
      path_, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  std::filesystem::create_symlink(path_, link);
  SaveLibsvmModel(svm, link);
  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_EQ(std::filesystem::status(path_).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  EXPECT_EQ(LoadLibsvmModel(path_).num_support_vectors(), svm.num_support_vectors());
  std::filesystem::remove(link);
}

}  // namespace
}  // namespace dfr::kernel
