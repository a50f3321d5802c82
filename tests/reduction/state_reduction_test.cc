#include "dfr/reduction/state_reduction.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::IsNan;

constexpr int kSide = 6;

// A colour picture, two entries, an embedding of eight, and one unused entry.
core::StateLayout WorldLayout() {
  core::StateLayout layout;
  layout.Add("image", core::PictureShape{kSide, kSide, 3});
  layout.Add("tip", 2);
  layout.Add("code", 8);
  layout.Add("clock", 1);
  return layout;
}

std::vector<core::Trajectory> Demonstrations(std::uint64_t seed) {
  core::Random random(seed);
  std::vector<core::Trajectory> all(5);
  for (core::Trajectory& d : all) {
    d.states.resize(9, WorldLayout().state_dim());
    for (double& value : d.states.reshaped()) value = std::floor(random.Uniform(20.0, 200.0));
    d.controls = Matrix::Ones(8, 2);
  }
  return all;
}

StateReduction Fitted(std::string_view features) {
  return StateReduction::Fit(WorldLayout(), features, Demonstrations(1), 1);
}

std::vector<double> Applied(const StateReduction& reduction, const std::vector<double>& state) {
  StateReduction::Workspace workspace(reduction);
  EXPECT_TRUE(reduction.Apply(state, workspace)) << reduction.Fault(state);
  return {workspace.state().begin(), workspace.state().end()};
}

// Saves `written` to a file and loads it for states of this layout.
StateReduction Reloaded(const StateReduction& written, const core::StateLayout& layout) {
  const std::filesystem::path path = dfr::test::ProcessFolder() / "state_reduction_test.dfr";
  core::ArchiveWriter writer("test", 1);
  written.Save(writer);
  writer.Save(path);
  core::ArchiveReader reader(path, "test", 1);
  std::filesystem::remove(path);
  StateReduction read = StateReduction::Load(reader, layout);
  reader.End();
  return read;
}

std::string RefusalOf(const StateReduction& written, const core::StateLayout& layout) {
  return test::MessageOf([&] { static_cast<void>(Reloaded(written, layout)); });
}

std::vector<double> SomeState(std::uint64_t seed) {
  const Matrix states = Demonstrations(seed)[0].states;
  return {states.row(0).begin(), states.row(0).end()};
}

TEST(StateReductionTest, KeepsListedEntriesAndDropsTheRest) {
  const StateReduction reduction = Fitted("pca:code:3,tip[1:2]");
  EXPECT_EQ(reduction.features(), "pca:code,tip[1:2]");
  ASSERT_EQ(reduction.reduced_layout().blocks.size(), 2U);
  EXPECT_EQ(reduction.reduced_layout().blocks[0].name, "pca:code");
  EXPECT_EQ(reduction.reduced_layout().blocks[0].size, 3);
  EXPECT_EQ(reduction.reduced_layout().blocks[1].name, "tip");
  const std::vector<double> state = SomeState(2);
  const std::vector<double> reduced = Applied(reduction, state);
  ASSERT_EQ(reduced.size(), 5U);
  const int tip = WorldLayout().blocks[1].offset;
  EXPECT_EQ(reduced[3], state[static_cast<std::size_t>(tip)]);
  EXPECT_EQ(reduced[4], state[static_cast<std::size_t>(tip) + 1]);
}

TEST(StateReductionTest, ComponentsAreThoseOfTheBlock) {
  const StateReduction reduction = Fitted("pca:code:8");
  // All components of the standardised block are a rotation, which preserves the lengths of
  // differences in units of the standard deviations.
  std::vector<Matrix> blocks;
  for (const core::Trajectory& d : Demonstrations(1)) {
    blocks.emplace_back(d.states.middleCols(WorldLayout().blocks[2].offset, 8));
  }
  const PrincipalComponents fit = FitPrincipalComponents(MatrixRows(blocks), {.components = 8});
  const std::vector<double> a = SomeState(2);
  const std::vector<double> b = SomeState(3);
  const std::vector<double> za = Applied(reduction, a);
  const std::vector<double> zb = Applied(reduction, b);
  const Eigen::VectorXd difference = (core::AsVector(a) - core::AsVector(b))
                                         .segment(WorldLayout().blocks[2].offset, 8)
                                         .cwiseQuotient(fit.scale);
  EXPECT_NEAR((core::AsVector(za) - core::AsVector(zb)).norm(), difference.norm(), 1e-4);
}

TEST(StateReductionTest, AStandardisedPictureIgnoresTheLight) {
  const std::vector<double> state = SomeState(2);
  std::vector<double> lit = state;
  for (int i = 0; i < kSide * kSide * 3; ++i) {
    double& value = lit[static_cast<std::size_t>(i)];
    value = std::round(1.2 * value + 5.0);
  }
  const auto change = [&](std::string_view features) {
    const StateReduction reduction = Fitted(features);
    const std::vector<double> z = Applied(reduction, state);
    return (core::AsVector(Applied(reduction, lit)) - core::AsVector(z)).norm();
  };
  EXPECT_LT(change("pca:image:4"), 0.02 * change("pca:image:4:light=none"));
  EXPECT_LT(change("pca:image:4:light=standard"), change("pca:image:4:light=gain"));
}

TEST(StateReductionTest, PicturesBecomeGreyAndSmall) {
  const StateReduction reduction = Fitted("pca:image:4:grey:3x2");
  const StateReduction::Seen seen = reduction.Reconstruct("image", SomeState(2));
  EXPECT_EQ(seen.shape, (core::PictureShape{3, 2, 1}));
  EXPECT_EQ(seen.values.size(), 6U);
  EXPECT_THAT(
      test::MessageOf([&] { static_cast<void>(reduction.Reconstruct("tip", SomeState(2))); }),
      HasSubstr("no reduced block 'tip'; the features are pca:image"));
}

TEST(StateReductionTest, AllComponentsReconstructTheBlock) {
  for (const char* const features : {"pca:code:8", "slow:code:8"}) {
    const StateReduction reduction = Fitted(features);
    const std::vector<double> state = SomeState(2);
    const StateReduction::Seen seen = reduction.Reconstruct("code", state);
    EXPECT_EQ(seen.shape, core::PictureShape());
    const auto offset = static_cast<std::size_t>(WorldLayout().blocks[2].offset);
    for (std::size_t i = 0; i < 8; ++i) EXPECT_NEAR(seen.values[i], state[offset + i], 1e-2);
  }
  EXPECT_THAT(
      test::MessageOf(
          [] { static_cast<void>(Fitted("points:image:2").Reconstruct("image", SomeState(2))); }),
      HasSubstr("positions of patches, which cannot be shown as a picture; use pca: or slow:"));
}

TEST(StateReductionTest, TheFirstSlowComponentFollowsACounter) {
  // An embedding of noise with a counter of time steps in two entries.
  std::vector<core::Trajectory> demonstrations = Demonstrations(1);
  core::Random random(3);
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      auto code = d.states.row(t).segment(WorldLayout().blocks[2].offset, 8);
      for (double& value : code) value = 3.0 * random.Normal();
      code[3] += static_cast<double>(t);
      code[5] -= static_cast<double>(t);
      code[3] -= code[4];
    }
  }
  const StateReduction slow = StateReduction::Fit(WorldLayout(), "slow:code:1", demonstrations, 1);
  EXPECT_EQ(slow.features(), "slow:code");
  // A step of the counter moves the component more than noise of the same size.
  std::vector<double> state = SomeState(2);
  const double before = Applied(slow, state)[0];
  const auto offset = static_cast<std::size_t>(WorldLayout().blocks[2].offset);
  const auto moved = [&](std::vector<double> code) {
    std::vector<double> next = state;
    for (std::size_t i = 0; i < 8; ++i) next[offset + i] += code[i];
    return std::abs(Applied(slow, next)[0] - before);
  };
  const double counted = moved({0, 0, 0, 1, 0, -1, 0, 0});
  EXPECT_GT(counted, 3.0 * moved({0, 0, 0, -1, 1, 0, 0, 0}));
  EXPECT_GT(counted, 3.0 * moved({0, 0, 1, 0, 0, 0, 1, 0}));
}

TEST(StateReductionTest, PointsDoNotDependOnThreads) {
  const auto fitted = [](int threads) {
    return StateReduction::Fit(WorldLayout(), "points:image:5,slow:code:3", Demonstrations(1),
                               threads);
  };
  const std::vector<double> state = SomeState(2);
  EXPECT_EQ(Applied(fitted(1), state), Applied(fitted(4), state));
}

TEST(StateReductionTest, LargePicturesOfPointsAreAveraged) {
  core::StateLayout layout;
  layout.Add("eye", core::PictureShape{48, 64, 1});
  core::Random random(6);
  std::vector<core::Trajectory> demonstrations(3);
  for (core::Trajectory& d : demonstrations) {
    d.states.resize(4, layout.state_dim());
    for (double& value : d.states.reshaped()) value = std::floor(random.Uniform(20.0, 200.0));
  }
  // Two pictures with the same averages have the same positions. The default size is 24 x 32.
  std::vector<double> state = {demonstrations[0].states.row(1).begin(),
                               demonstrations[0].states.row(1).end()};
  const StateReduction points = StateReduction::Fit(layout, "points:eye:3", demonstrations, 1);
  const std::vector<double> at = Applied(points, state);
  EXPECT_EQ(at,
            Applied(StateReduction::Fit(layout, "points:eye:3:24x32", demonstrations, 1), state));
  std::swap(state[0], state[1]);
  EXPECT_EQ(Applied(points, state), at);
}

TEST(StateReductionTest, WithComponentsCutsOnlyOpenNumbers) {
  const StateReduction all = Fitted("pca:code,tip,pca:image:4");
  EXPECT_EQ(all.num_open(), 1);
  EXPECT_EQ(all.most_components(), 8);
  EXPECT_THAT(all.InOrderOfComponents(), ElementsAre(8, 9, 10, 11, 12, 13, 0, 1, 2, 3, 4, 5, 6, 7));
  const StateReduction few = all.WithComponents(3);
  EXPECT_EQ(few.reduced_dim(), 3 + 2 + 4);
  const std::vector<double> state = SomeState(2);
  const std::vector<double> more = Applied(all, state);
  const std::vector<double> less = Applied(few, state);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(less[i], more[i], 1e-12);
  EXPECT_EQ(std::vector(less.begin() + 3, less.end()), std::vector(more.begin() + 8, more.end()));
}

TEST(StateReductionTest, RefusesInvalidStates) {
  const StateReduction reduction = Fitted("pca:image:4,tip");
  StateReduction::Workspace workspace(reduction);
  const auto refused = [&](const std::vector<double>& state, const std::string& fault) {
    EXPECT_FALSE(reduction.Apply(state, workspace));
    EXPECT_THAT(std::vector(workspace.state().begin(), workspace.state().end()), Each(IsNan()));
    EXPECT_THAT(reduction.Fault(state), HasSubstr(fault));
  };
  std::vector<double> state = SomeState(2);
  EXPECT_THAT(reduction.Fault(state), IsEmpty());
  state.pop_back();
  refused(state, "the state has 118 entries, not 119");
  state = SomeState(2);
  state[7] = std::numeric_limits<double>::quiet_NaN();
  refused(state, "image[7] of the state is nan");
  state[7] = 256.0;
  refused(state, "image[7] of the state is 256; a picture has values from 0 to 255");
  state = SomeState(2);
  std::fill_n(state.begin(), kSide * kSide * 3, 1.0);
  refused(state, "the picture 'image' is black");
  state = SomeState(2);
  state[kSide * kSide * 3] = std::numeric_limits<double>::infinity();
  refused(state, "tip[0] of the state is inf");
}

TEST(StateReductionTest, ApplyAllocatesNothing) {
  core::StateLayout layout = WorldLayout();
  layout.Add("wrist", core::PictureShape{kSide, kSide, 1});
  std::vector<core::Trajectory> demonstrations = Demonstrations(1);
  for (core::Trajectory& d : demonstrations) {
    const Matrix first = d.states;
    d.states.resize(first.rows(), layout.state_dim());
    d.states << first, first.leftCols(kSide * kSide);
  }
  const StateReduction reduction = StateReduction::Fit(
      layout, "pca:image:4:grey:3x3,tip,slow:code:2,points:wrist:3", demonstrations, 1);
  StateReduction::Workspace workspace(reduction);
  const std::vector<double> state = {demonstrations[1].states.row(2).begin(),
                                     demonstrations[1].states.row(2).end()};
  const test::NoAlloc guard;
  EXPECT_TRUE(reduction.Apply(state, workspace));
}

TEST(StateReductionTest, SharesOfComponentsAddUpOverPixels) {
  for (const char* const features :
       {"pca:image:4,tip", "pca:image:4:grey:3x2,tip", "slow:image:4,tip", "points:image:4,tip",
        "points:image:4:grey:light=gain,tip"}) {
    const StateReduction reduction = Fitted(features);
    core::Random random(5);
    Eigen::MatrixXd products(6, 6);
    for (double& value : products.reshaped()) value = random.Normal();
    std::vector<double> shares(static_cast<std::size_t>(reduction.state_dim()), 7.0);
    reduction.Spread(products, SomeState(2), shares);
    const auto all = core::AsVector(std::span<const double>(shares));
    EXPECT_NEAR(all.head(kSide * kSide * 3).sum(), products.topLeftCorner(4, 4).trace(), 1e-4);
    EXPECT_EQ(all[kSide * kSide * 3 + 1], products(5, 5));
    EXPECT_EQ(all.tail(9), Eigen::VectorXd::Zero(9));
  }
}

TEST(StateReductionTest, AFileRestoresTheReduction) {
  for (const char* const features : {"pca:image:grey:light=gain,tip[0:1],pca:code:2",
                                     "points:image:grey:light=gain,tip[0:1],slow:code:2"}) {
    const StateReduction written = Fitted(features);
    const StateReduction read = Reloaded(written, WorldLayout());
    EXPECT_EQ(read.features(), written.features());
    EXPECT_EQ(read.reduced_layout(), written.reduced_layout());
    EXPECT_EQ(read.num_open(), 1);
    const std::vector<double> state = SomeState(2);
    EXPECT_EQ(Applied(read, state), Applied(written, state));
    StateReduction::Workspace of_read(read);
    StateReduction::Workspace of_written(written);
    static_cast<void>(read.Apply(state, of_read));
    static_cast<void>(written.Apply(state, of_written));
    EXPECT_GT(of_read.novelty(), 0.0);
    EXPECT_EQ(of_read.novelty(), of_written.novelty());
    core::StateLayout other = WorldLayout();
    other.blocks[2].name = "another";
    EXPECT_THAT(RefusalOf(written, other), HasSubstr("reduces a block that is not in the state"));
  }
}

TEST(StateReductionTest, AFileWithPointsOfAnotherPictureIsRefused) {
  const StateReduction written = Fitted("points:image:3");
  core::StateLayout other;
  other.Add("image", core::PictureShape{kSide - 1, kSide, 3});
  EXPECT_THAT(RefusalOf(written, other), HasSubstr("out_width and out_height must lie in"));
  other = {};
  other.Add("image", core::PictureShape{kSide, kSide, 1});
  EXPECT_THAT(RefusalOf(written, other), HasSubstr("patches have 75 entries, not 5 x 5 x 1"));
  other = {};
  other.Add("image", kSide * kSide * 3);
  EXPECT_THAT(RefusalOf(written, other), HasSubstr("points of a block that is not a picture"));
}

TEST(StateReductionTest, InvalidFeaturesAreNamed) {
  for (const auto& [features, message] : std::vector<std::pair<const char*, const char*>>{
           {"pca:camera", "no block 'camera' in the state; it has image, tip, code, clock"},
           {"pca:code:grey", "'grey' is for pictures; give the block"},
           {"pca:image:blue", "'blue' is not an option; options are a number"},
           {"pca:image:7x5",
            "feature 'pca:image:7x5': 7x5 is larger than the pictures, which have 6x6 pixels "
            "(height x width)"},
           {"pca:image:0x0", "'0x0' is not an option"},
           {"points:image:0x24", "'0x24' is not an option"},
           {"pca:image:0", "must lie in [1, 256]"},
           {"pca:code:9", "there are 8 components, not 9"},
           {"pca:code:2,pca:code:3", "names a block that is listed already"},
           {"pca:code:2,code[0:1]", "is part of a block that is reduced"},
           {"pca:code:2,image", "is a picture: put points: or pca: before it"},
           {"points:code",
            "points are for pictures; give the block the shape (height, width, channels) in the "
            "layout, or put pca: before it"},
           {"points:image:4x6", "need pictures of 5 to 128 pixels a side"},
           {"points:image:33", "there are 32 components, not 33"},
           {"pca:code:2,tip,tip[0:1]", "feature 'tip[0:1]' repeats an entry"},
           {"pca:code:2,hand", "feature 'hand' is not part of the state"}}) {
    EXPECT_THAT(test::MessageOf([&] { static_cast<void>(Fitted(features)); }), HasSubstr(message))
        << features;
    // The number of components is known after a fit.
    if (std::string_view(message).starts_with("there are")) continue;
    EXPECT_THAT(test::MessageOf([&] { StateReduction::CheckFeatures(WorldLayout(), features); }),
                HasSubstr(message))
        << features;
  }
  EXPECT_NO_THROW(StateReduction::CheckFeatures(WorldLayout(), "tip,points:image,pca:code:8"));
  EXPECT_NO_THROW(StateReduction::CheckFeatures(WorldLayout(), "tip,code[0:1],code[2:3]"));
  EXPECT_NO_THROW(StateReduction::CheckFeatures(WorldLayout(), ""));
  using Request = core::BlockRequest;
  EXPECT_THAT(StateReduction::Requests("tip,points:image:3:16x24:grey,pca:code:4,slow:hand"),
              ElementsAre(Request{"image", 16, 24}, Request{"code"}, Request{"hand"}));
  EXPECT_THAT(StateReduction::Requests("tip,image"), IsEmpty());
}

TEST(StateReductionTest, PicturesOfAnotherScaleAreNamed) {
  std::vector<core::Trajectory> demonstrations = Demonstrations(1);
  const auto message = [&] {
    return test::MessageOf([&] {
      static_cast<void>(StateReduction::Fit(WorldLayout(), "pca:image:2", demonstrations, 1));
    });
  };
  demonstrations[2].states(3, 5) = -1.0;
  EXPECT_THAT(message(), HasSubstr("demonstration 2, state 3: the picture 'image' has a value"));
  for (core::Trajectory& d : demonstrations) d.states = d.states.cwiseMax(0.0) / 255.0;
  EXPECT_THAT(message(), HasSubstr("is black (values are 0 to 255, not 0 to 1)"));
}

}  // namespace
}  // namespace dfr::reduction
