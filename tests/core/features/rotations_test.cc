#include "dfr/core/features/rotations.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/message_of.h"

namespace dfr::core {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using Kind = Rotation::Kind;

constexpr double kPi = std::numbers::pi;
constexpr int kEpisodes = 10;
constexpr int kSteps = 30;

StateLayout Layout(int size) {
  StateLayout layout;
  layout.Add("position", 2);
  layout.Add("rotation", size);
  return layout;
}

// Ten episodes of states [noise, noise, entries(episode, share of the episode)].
std::vector<Trajectory> Episodes(int size,
                                 const std::function<Eigen::VectorXd(int, double)>& entries) {
  Random random(5);
  std::vector<Trajectory> episodes;
  for (int d = 0; d < kEpisodes; ++d) {
    Trajectory episode;
    episode.states.resize(kSteps + 1, 2 + size);
    episode.controls = Matrix::Ones(kSteps, 1);
    for (int t = 0; t <= kSteps; ++t) {
      episode.states.row(t).head(2) << random.Normal(), random.Normal();
      episode.states.row(t).tail(size) = entries(d, static_cast<double>(t) / kSteps).transpose();
    }
    episodes.push_back(episode);
  }
  return episodes;
}

// Ten episodes of one entry.
std::vector<Trajectory> Angles(const std::function<double(int, double)>& angle) {
  return Episodes(1, [&](int d, double share) -> Eigen::VectorXd {
    return Eigen::VectorXd::Constant(1, angle(d, share));
  });
}

Eigen::Quaterniond Turn(int d, double share, double angle = 1.2) {
  const Eigen::Vector3d axis = Eigen::Vector3d(0.2 * d, 1.0, 0.5).normalized();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle * share + 0.05 * d, axis));
}

// Quaternions w, x, y, z. With `flips` the sign changes at random.
std::vector<Trajectory> Quaternions(double angle, bool flips) {
  auto random = std::make_shared<Random>(9);
  return Episodes(4, [=](int d, double share) -> Eigen::VectorXd {
    const Eigen::Quaterniond q = Turn(d, share, angle);
    const double sign = flips && random->Uniform() < 0.3 ? -1.0 : 1.0;
    return sign * Eigen::Vector4d(q.w(), q.x(), q.y(), q.z());
  });
}

// Returns the angle in [-period / 2, period / 2] if `centred`, otherwise in [0, period].
double Wrapped(double angle, bool centred, double period = 2.0 * kPi) {
  return angle - period * (centred ? std::round(angle / period) : std::floor(angle / period));
}

// Expects that `episodes` have one rotation, and returns it.
Rotation FindOne(const StateLayout& layout, const std::vector<Trajectory>& episodes) {
  const auto found = FindRotations(layout, episodes);
  EXPECT_EQ(found.size(), 1U);
  return found.empty() ? Rotation() : found[0];
}

StateMap MapOfOne(const Rotation& found) { return MapOf(std::vector{found}); }

TEST(RotationsTest, AQuaternionOfAnySignIsMadeContinuous) {
  for (const bool flips : {false, true}) {
    const Rotation found = FindOne(Layout(4), Quaternions(1.2, flips));
    EXPECT_EQ(found.kind, Kind::kQuaternion);
    EXPECT_EQ(found.first, 2);
    EXPECT_EQ(found.size, 4);
    EXPECT_EQ(found.jumps, flips);
    EXPECT_TRUE(found.continuous);
    EXPECT_THAT(Describe(found, Layout(4)), HasSubstr("rotation[0:4] is a unit quaternion"));
  }
  const auto plain = Quaternions(1.2, false);
  StateLayout one_block;
  one_block.Add("state", 6);
  EXPECT_THAT(Describe(FindOne(one_block, plain), one_block), HasSubstr("state[2:6]"));
  const auto flipped = Quaternions(1.2, true);
  const StateMap map = MapOf(FindRotations(Layout(4), plain));
  const StateMap same = MapOf(FindRotations(Layout(4), flipped));
  double last = 1.0;
  for (std::size_t d = 0; d < plain.size(); ++d) {
    for (Eigen::Index t = 0; t <= kSteps; ++t) {
      Eigen::VectorXd a = plain[d].states.row(t);
      Eigen::VectorXd b = flipped[d].states.row(t);
      map.Apply({a.data(), 6});
      same.Apply({b.data(), 6});
      ASSERT_EQ(a, b);
      if (t > 0) {
        ASSERT_LT(std::abs(a[2] - last), 0.1) << "it jumps";
      }
      last = a[2];
      Eigen::VectorXd again = a;
      map.Apply({again.data(), 6});
      ASSERT_EQ(again, a);
    }
  }
}

// Entries that jump to their negatives are a quaternion even if their length is not exactly 1.
TEST(RotationsTest, AQuaternionThatIsNotNormalisedIsFoundByItsSigns) {
  const auto scaled = [](std::vector<Trajectory> episodes, double length) {
    for (Trajectory& episode : episodes) episode.states.rightCols(4) *= length;
    return episodes;
  };
  const auto exact = Quaternions(1.2, true);
  const StateMap map = MapOf(FindRotations(Layout(4), exact));
  for (const double length : {0.93, 1.07}) {
    const auto off = scaled(exact, length);
    const Rotation found = FindOne(Layout(4), off);
    EXPECT_EQ(found.kind, Kind::kQuaternion);
    EXPECT_TRUE(found.continuous);
    std::vector<double> a(6);
    std::vector<double> b(6);
    std::ranges::copy(Row(exact[1].states, 7), a.begin());
    std::ranges::copy(Row(off[1].states, 7), b.begin());
    map.Apply(a);
    MapOfOne(found).Apply(b);
    for (std::size_t i = 0; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 1e-12);
    // Without a change of sign the entries may also be lengths.
    EXPECT_THAT(FindRotations(Layout(4), scaled(Quaternions(1.2, false), length)), IsEmpty());
  }
  EXPECT_THAT(FindRotations(Layout(4), scaled(exact, 1.12)), IsEmpty());
}

TEST(RotationsTest, OrientationsTooFarApartAreNamedWithTheRemedy) {
  const Rotation found = FindOne(Layout(4), Quaternions(6.0, true));
  EXPECT_FALSE(found.continuous);
  EXPECT_TRUE(MapOfOne(found).empty());
  EXPECT_THAT(Describe(found, Layout(4)), HasSubstr("first two columns"));
}

// Four entries of norm 1 that are not a quaternion: opposite signs mean different states.
TEST(RotationsTest, CosineAndSineBesideDeadEntriesAndOneHotCodesAreNoQuaternions) {
  const auto circle = Episodes(5, [](int d, double share) -> Eigen::VectorXd {
    const double angle = 0.1 * d + share;
    return Eigen::Vector<double, 5>(std::cos(angle), std::sin(angle), 0.0, 0.0, 0.3 * d);
  });
  EXPECT_THAT(FindRotations(Layout(5), circle), IsEmpty());
  const auto code = Episodes(4, [](int, double share) -> Eigen::VectorXd {
    return Eigen::Vector4d::Unit(std::min(3, static_cast<int>(4.0 * share)));
  });
  EXPECT_THAT(FindRotations(Layout(4), code), IsEmpty());
}

// A turn about one axis leaves two entries at zero. In a state without blocks only the signs reveal
// that the four entries form a quaternion.
TEST(RotationsTest, SignsThatDifferBetweenEpisodesIndicateAQuaternion) {
  StateLayout layout;
  layout.Add("state", 6);
  for (const bool scalar_first : {true, false}) {
    const auto yaw = [&](bool flips) {
      return Episodes(4, [=](int d, double share) -> Eigen::VectorXd {
        const double half = 0.05 * d + 0.4 * share;
        const double sign = flips && d % 2 == 1 ? -1.0 : 1.0;
        const double w = sign * std::cos(half);
        const double z = sign * std::sin(half);
        return scalar_first ? Eigen::Vector4d(w, 0.0, 0.0, z) : Eigen::Vector4d(0.0, 0.0, z, w);
      });
    };
    const Rotation found = FindOne(layout, yaw(true));
    EXPECT_EQ(found.first, 2);
    EXPECT_TRUE(found.continuous);
    EXPECT_TRUE(found.guessed);
    EXPECT_THAT(Describe(found, layout), HasSubstr("sign differs between demonstrations"));
    EXPECT_THAT(FindRotations(layout, yaw(false)), IsEmpty());
    EXPECT_FALSE(FindRotations(Layout(4), yaw(true))[0].guessed) << "a block of four";
  }
}

// A gripper that opens and closes beside dead entries has a quaternion's pattern of signs.
TEST(RotationsTest, AFlagBesideZerosIsNamedAndNotMapped) {
  StateLayout layout;
  layout.Add("state", 6);
  for (const bool within : {true, false}) {
    const Rotation found = FindOne(layout, Episodes(4, [=](int d, double share) -> Eigen::VectorXd {
                                     const bool closed = within ? share > 0.5 : d % 2 == 1;
                                     return Eigen::Vector4d(closed ? -1.0 : 1.0, 0.0, 0.0, 0.0);
                                   }));
    EXPECT_TRUE(MapOfOne(found).empty());
    EXPECT_THAT(Describe(found, layout), HasSubstr("a flag of +-1"));
  }
}

TEST(RotationsTest, QuaternionsMayBeRoundedToTwoDigits) {
  auto rounded = Quaternions(1.2, true);
  for (Trajectory& episode : rounded) {
    episode.states.rightCols(4) = (100.0 * episode.states.rightCols(4)).array().round() / 100.0;
  }
  const Rotation found = FindOne(Layout(4), rounded);
  EXPECT_TRUE(found.continuous);
}

TEST(RotationsTest, AnAngleThatWrapsIsMadeContinuousIfItLeavesAGap) {
  for (const double period : {2.0 * kPi, 360.0}) {
    for (const bool centred : {true, false}) {
      // The angle goes from 110 to 250 degrees, or from -70 to 70. Each range crosses one of the
      // two cuts.
      const double begin = (centred ? 110.0 : -70.0) / 360.0 * period;
      const auto episodes = Angles([&](int d, double share) {
        const double angle = begin + period * (0.01 * d + 0.3 * share);
        return Wrapped(angle, centred, period);
      });
      const Rotation found = FindOne(Layout(1), episodes);
      EXPECT_EQ(found.kind, Kind::kAngle);
      EXPECT_EQ(found.first, 2);
      EXPECT_EQ(found.period, period);
      EXPECT_TRUE(found.continuous);
      const StateMap map = MapOfOne(found);
      for (const Trajectory& episode : episodes) {
        std::vector<double> angles;
        for (Eigen::Index t = 0; t <= kSteps; ++t) {
          angles.push_back(map.Value(Row(episode.states, t), 2));
          if (t > 0) {
            ASSERT_LT(std::abs(angles[angles.size() - 2] - angles.back()), 0.1 * period);
          }
        }
      }
      // The same angle on any revolution gives the same value.
      const std::vector<double> state = {0.0, 0.0, 0.75};
      for (const double revolutions : {-2.0, 1.0, 3.0}) {
        const std::vector<double> other = {0.0, 0.0, 0.75 + revolutions * period};
        EXPECT_NEAR(map.Value(state, 2), map.Value(other, 2), 1e-12 * period);
      }
    }
  }
}

TEST(RotationsTest, AnAngleThatGoesAllTheWayRoundBecomesCosineAndSine) {
  const auto episodes =
      Angles([](int d, double share) { return Wrapped(0.05 * d + 5.0 * kPi * share, true); });
  const Rotation found = FindOne(Layout(1), episodes);
  EXPECT_EQ(found.kind, Kind::kAngle);
  EXPECT_FALSE(found.continuous);
  EXPECT_THAT(Describe(found, Layout(1)), HasSubstr("rotation[0] is an angle that jumps by 6.28"));
  EXPECT_THAT(Describe(found, Layout(1)), HasSubstr("a guard uses its cosine and sine"));
  const auto selection =
      FeatureSelection(Layout(1), "rotation,position[1:2]").Mapped(MapOfOne(found));
  EXPECT_EQ(selection.indices(), (std::vector{2, 2, 1}));
  EXPECT_EQ(selection.Mapped(MapOfOne(found)).indices(), selection.indices());
  for (const Trajectory& episode : episodes) {
    for (Eigen::Index t = 0; t <= kSteps; ++t) {
      const double angle = episode.states(t, 2);
      std::vector<double> features(3);
      selection.Apply(Row(episode.states, t), features);
      EXPECT_NEAR(features[0], std::cos(angle), 1e-15);
      EXPECT_NEAR(features[1], std::sin(angle), 1e-15);
      EXPECT_EQ(features[2], episode.states(t, 1));
    }
  }
}

TEST(RotationsTest, AnAngleOnSeveralRevolutionsIsNamed) {
  const auto episodes = [](int revolutions) {
    return Angles([=](int d, double share) {
      return 0.02 * d + 2.0 * kPi * (d % revolutions) + 5.0 * kPi * share;
    });
  };
  for (const int revolutions : {2, 3}) {
    const Rotation found = FindOne(Layout(1), episodes(revolutions));
    EXPECT_EQ(found.kind, Kind::kRunning);
    EXPECT_THAT(Describe(found, Layout(1)), HasSubstr("cosine and sine"));
    EXPECT_TRUE(MapOfOne(found).empty());
  }
  // An angle that stays on one revolution can be used like a length.
  EXPECT_THAT(FindRotations(Layout(1), episodes(1)), IsEmpty());
}

TEST(RotationsTest, LengthsThatJumpOrSpreadAreNoAngles) {
  const auto apart = Angles([](int, double share) { return share < 0.5 ? -2.0 : 2.0; });
  EXPECT_THAT(FindRotations(Layout(1), apart), IsEmpty());
  const auto wide = Angles([](int d, double share) { return 7.3 * d + 20.0 * share; });
  EXPECT_THAT(FindRotations(Layout(1), wide), IsEmpty());
}

TEST(RotationsTest, ARotationMatrixIsRedundantAndARotationVectorJumps) {
  const auto matrices = Episodes(9, [](int d, double share) -> Eigen::VectorXd {
    const Eigen::Matrix3d r = Turn(d, share, 3.0).toRotationMatrix();
    return Eigen::Map<const Eigen::VectorXd>(r.data(), 9);
  });
  Rotation found = FindOne(Layout(9), matrices);
  EXPECT_EQ(found.kind, Kind::kMatrix);
  EXPECT_FALSE(found.jumps);
  EXPECT_THAT(Describe(found, Layout(9)), HasSubstr("rotation[0:9] is a rotation matrix"));

  const auto vectors = Episodes(3, [](int d, double share) -> Eigen::VectorXd {
    const Eigen::AngleAxisd turn(Turn(d, share, 4.0));
    return turn.angle() > kPi ? Eigen::Vector3d(-(2.0 * kPi - turn.angle()) * turn.axis())
                              : Eigen::Vector3d(turn.angle() * turn.axis());
  });
  found = FindOne(Layout(3), vectors);
  EXPECT_EQ(found.kind, Kind::kAxisAngle);
  EXPECT_TRUE(found.jumps);
  EXPECT_THAT(Describe(found, Layout(3)), HasSubstr("rotation vector"));
}

// One entry of a rotation vector that jumps at pi looks like an angle.
TEST(RotationsTest, ARotationVectorIsDistinguishedFromAnAngleBesideLengths) {
  const auto vectors = [](const Eigen::Vector3d& axis) {
    return Episodes(3, [=](int d, double share) -> Eigen::VectorXd {
      const double angle = kPi - 0.6 + 0.02 * d + 1.2 * share;
      return (angle > kPi ? angle - 2.0 * kPi : angle) * axis;
    });
  };
  const Rotation tilted = FindOne(Layout(3), vectors(Eigen::Vector3d(0.2, 0.1, 1).normalized()));
  EXPECT_EQ(tilted.kind, Kind::kAxisAngle);
  const Rotation upright = FindOne(Layout(3), vectors(Eigen::Vector3d::UnitZ()));
  EXPECT_EQ(upright.kind, Kind::kAngle);
  EXPECT_TRUE(upright.continuous);
}

// 2 acos(w) gives rotation vectors that jump between episodes if the quaternion's sign differs.
TEST(RotationsTest, RotationVectorsThatDifferBetweenEpisodesAreNamed) {
  const Rotation found =
      FindOne(Layout(3), Episodes(3, [](int d, double share) {
                const Eigen::Vector3d axis = Eigen::Vector3d(0.02 * d, 0.6, 0.8).normalized();
                const double angle = 0.6 + share;
                return Eigen::VectorXd((d % 2 == 1 ? angle - 2.0 * kPi : angle) * axis);
              }));
  EXPECT_EQ(found.kind, Kind::kAxisAngle);
}

TEST(RotationsTest, TheOrderOfTheDemonstrationsChangesNoBit) {
  auto episodes = Quaternions(1.2, true);
  const auto reference = FindOne(Layout(4), episodes).reference;
  std::rotate(episodes.begin(), episodes.begin() + 3, episodes.end());
  EXPECT_EQ(FindOne(Layout(4), episodes).reference, reference);
}

TEST(StateMapTest, FindsInvalidQuaternions) {
  const StateMap map({{1, {1.0, 0.0, 0.0, 0.0}}}, {});
  EXPECT_EQ(map.FindInvalid(std::vector{9.0, 1.05, 0.0, 0.0, 0.0}), -1);
  EXPECT_EQ(map.FindInvalid(std::vector{9.0, 0.0, 0.0, 0.0, 0.0}), 1);
  EXPECT_EQ(map.FindInvalid(std::vector{9.0, 0.0, 1.12, 0.0, 0.0}), 1);
  EXPECT_EQ(map.least_state_dim(), 5);
}

// Every quaternion that FindInvalid() accepts is used with length 1.
TEST(StateMapTest, NormalisesQuaternions) {
  const StateMap map({{1, {1.0, 0.0, 0.0, 0.0}}}, {});
  for (const double factor : {-1.09, -0.91, 0.91, 0.999, 1.001, 1.09}) {
    std::vector<double> state = {9.0, 0.8 * factor, 0.6 * factor, 0.0, 0.0};
    EXPECT_EQ(map.FindInvalid(state), -1);
    EXPECT_NEAR(map.Value(state, 1), 0.8, 1e-15);
    EXPECT_NEAR(map.Value(state, 2), 0.6, 1e-15);
    EXPECT_NEAR(map.Slope(state, 2), 1.0 / factor, 1e-15);
    map.Apply(state);
    EXPECT_EQ(state[0], 9.0);
    EXPECT_NEAR(state[1], 0.8, 1e-15);
    EXPECT_NEAR(state[2], 0.6, 1e-15);
    std::vector<double> again = state;
    map.Apply(again);
    EXPECT_EQ(again, state);
  }
  // Quaternions of other lengths stay unchanged, far from all orientations.
  EXPECT_EQ(map.Value(std::vector{9.0, 0.0, 2.0, 0.0, 0.0}, 2), 2.0);
  EXPECT_EQ(map.Value(std::vector{9.0, 0.0, 0.0, 0.0, 0.0}, 2), 0.0);
}

TEST(StateMapTest, InvalidPartsAreNamed) {
  // Uses the map for states of three entries.
  const auto refusal = [](std::vector<StateMap::Quaternion> quaternions,
                          std::vector<StateMap::Angle> angles,
                          std::vector<StateMap::Circle> circles = {}) {
    return test::MessageOf<std::invalid_argument>([&] {
      static_cast<void>(FeatureSelection::All(3).Mapped(StateMap(quaternions, angles, circles)));
    });
  };
  EXPECT_THAT(refusal({}, {}, {{0, std::nan("")}}), HasSubstr("the period of an angle"));
  EXPECT_THAT(refusal({}, {}, {{-1, 1.0}}), HasSubstr("entry -1"));
  EXPECT_THAT(refusal({}, {}, {{3, 1.0}}), HasSubstr("of at least 4 entries, not 3"));
  EXPECT_THAT(refusal({{0, {1.0, 1.0, 0.0, 0.0}}}, {}), HasSubstr("must be a unit quaternion"));
  EXPECT_THAT(refusal({{-1, {1.0, 0.0, 0.0, 0.0}}}, {}), HasSubstr("cannot begin at entry -1"));
  EXPECT_THAT(refusal({{0, {1.0, 0.0, 0.0, 0.0}}}, {}), HasSubstr("of at least 4 entries, not 3"));
  EXPECT_THAT(refusal({}, {{0, 0.0, 0.0}}), HasSubstr("its period positive"));
  EXPECT_THAT(refusal({}, {{-1, 0.0, 1.0}}), HasSubstr("entry -1"));
  // Features of a repeated circle would exceed the size of the selection.
  EXPECT_THAT(refusal({}, {}, {{1, 1.0}, {1, 1.0}}), HasSubstr("entry 1 belongs to two rotations"));
  EXPECT_THAT(refusal({}, {{2, 0.0, 1.0}}, {{2, 1.0}}), HasSubstr("entry 2 belongs to two"));
}

TEST(StateMapTest, SlopesAreThoseOfTheMappedEntries) {
  const StateMap map({{1, {1.0, 0.0, 0.0, 0.0}}}, {{0, 0.0, 2.0 * kPi}});
  const std::vector<double> state = {4.0, -0.8, 0.6, 0.0, 0.0, 7.0};
  EXPECT_EQ(map.Slope(state, 0), 1.0);
  EXPECT_EQ(map.Slope(state, 1), -1.0);
  EXPECT_EQ(map.Slope(state, 4), -1.0);
  EXPECT_EQ(map.Slope(state, 5), 1.0);
  EXPECT_EQ(map.Value(state, 1), 0.8);
  EXPECT_EQ(map.Value(state, 0), 4.0 - 2.0 * kPi);
  EXPECT_EQ(map.Value(state, 5), 7.0);
}

// Features have the unit of the entry, here degrees. The slopes equal finite differences.
TEST(StateMapTest, FeaturesOfACircleMoveAsFarAsTheAngle) {
  const auto selection =
      FeatureSelection::All(3).Mapped(StateMap({}, {{0, 0.0, 360.0}}, {{1, 360.0}}));
  ASSERT_EQ(selection.num_features(), 4);
  const std::vector<double> state = {200.0, 130.0, 5.0};
  const std::vector<double> next = {200.0, 130.001, 5.0};
  std::vector<double> here(4);
  std::vector<double> there(4);
  std::vector<double> slopes(4);
  selection.Apply(state, here);
  selection.Apply(next, there);
  selection.Slopes(state, slopes);
  EXPECT_EQ(here[0], -160.0);
  EXPECT_EQ(here[3], 5.0);
  EXPECT_NEAR(std::hypot(there[1] - here[1], there[2] - here[2]), 0.001, 1e-9);
  for (const std::size_t k : {1U, 2U}) {
    EXPECT_NEAR(slopes[k], (there[k] - here[k]) / 0.001, 1e-4);
  }
  EXPECT_EQ(slopes[0], 1.0);
  EXPECT_EQ(slopes[3], 1.0);
}

}  // namespace
}  // namespace dfr::core
