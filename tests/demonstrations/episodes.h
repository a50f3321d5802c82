#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"

namespace dfr::test {

/// Returns an episode of episodes.py. All its numbers are exact in binary except the thirds, which
/// C++ and Python compute equally.
inline core::Trajectory Episode(int index) {
  static constexpr int kLengths[] = {3, 1, 12};
  const int n = kLengths[index];
  core::Trajectory trajectory;
  trajectory.states.resize(n + 1, 6);
  trajectory.controls.resize(n, 2);
  for (int t = 0; t <= n; ++t) {
    for (int k = 0; k < 6; ++k) trajectory.states(t, k) = index + 0.25 * t + k / 3.0;
    for (int k = 0; k < 2 && t < n; ++k) trajectory.controls(t, k) = (index - t) / 16.0 + k / 2.0;
  }
  trajectory.outcome = index == 1 ? core::Outcome::kHalted : core::Outcome::kCompleted;
  trajectory.seed = 0xfedcba9876543210u + static_cast<std::uint64_t>(index);
  return trajectory;
}

/// All three episodes, with states of one block or several.
inline imitation::DemonstrationSet Episodes(bool plain = false) {
  imitation::DemonstrationSet set;
  if (plain) {
    set.layout.Add("observations", 6);
  } else {
    set.layout.Add("tip", 3);
    set.layout.Add("object", 2);
    set.layout.Add("angle", 1);
  }
  set.control_dim = 2;
  set.environment = "pusher \"P\"";
  set.trajectories = {Episode(0), Episode(1), Episode(2)};
  set.discarded = 2;
  return set;
}

/// Expects the columns of Episode()'s states in the order of their blocks' names. Files of an
/// independent writer are read in this order.
inline void ExpectStatesByName(const core::Matrix& actual, const core::Matrix& expected) {
  EXPECT_EQ(actual.col(0), expected.col(5));
  EXPECT_EQ(actual.middleCols(1, 2), expected.middleCols(3, 2));
  EXPECT_EQ(actual.rightCols(3), expected.leftCols(3));
}

/// Expects that the sets have equal layouts, environments and episodes.
inline void ExpectSame(const imitation::DemonstrationSet& loaded,
                       const imitation::DemonstrationSet& set) {
  EXPECT_EQ(loaded.layout, set.layout);
  EXPECT_EQ(loaded.control_dim, set.control_dim);
  EXPECT_EQ(loaded.environment, set.environment);
  ASSERT_EQ(loaded.trajectories.size(), set.trajectories.size());
  for (std::size_t i = 0; i < set.trajectories.size(); ++i) {
    EXPECT_EQ(loaded.trajectories[i].states, set.trajectories[i].states);
    EXPECT_EQ(loaded.trajectories[i].controls, set.trajectories[i].controls);
    EXPECT_EQ(loaded.trajectories[i].outcome, set.trajectories[i].outcome);
    EXPECT_EQ(loaded.trajectories[i].seed, set.trajectories[i].seed);
  }
}

/// Runs robomimic_peer.py or minari_peer.py.
inline void RunPeer(const std::string& script, const std::string& mode,
                    const std::filesystem::path& path) {
  const std::string command =
      DFR_PYTHON " -B " DFR_PEERS "/" + script + " " + mode + " '" + path.string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0) << command << "\n(needs Debian's python3-h5py)";
}

}  // namespace dfr::test
