#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "dfr/core/random.h"
#include "gaussian/gaussian_sum.h"
#include "gaussian/gaussian_terms.h"

namespace dfr::kernel::internal {

struct Problem {
  Problem(int m, int n, double gamma_, std::uint64_t seed) : gamma(gamma_), points(m, n) {
    core::Random random(seed);
    double total = 0.0;
    for (int i = 0; i < m; ++i) {
      weights.push_back(random.Uniform(0.01, 1.0));
      total += weights.back();
      for (int k = 0; k < n; ++k) points(i, k) = random.Normal();
    }
    for (double& w : weights) w /= total;
  }
  double gamma;
  core::Matrix points;
  std::vector<double> weights;
};

struct Reference {
  long double sum = 0.0L;
  std::vector<long double> shift;
};

inline Reference LongDouble(const Problem& p, std::span<const double> x) {
  Reference result;
  result.shift.resize(x.size());
  for (std::size_t i = 0; i < p.weights.size(); ++i) {
    long double squared = 0.0L;
    for (std::size_t k = 0; k < x.size(); ++k) {
      const long double diff = static_cast<long double>(x[k]) -
                               p.points(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
      squared += diff * diff;
    }
    const long double term = p.weights[i] * std::exp(-static_cast<long double>(p.gamma) * squared);
    result.sum += term;
    for (std::size_t k = 0; k < x.size(); ++k) {
      const long double s = p.points(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k));
      result.shift[k] += term * (s - x[k]);
    }
  }
  return result;
}

// Kinds of states, including those that a faulty or hostile caller may send.
enum class QueryKind { kRandom, kNear, kEqual, kFar, kVeryFar, kDenormal, kHuge, kMixed };
inline constexpr int kKinds = 8;

inline void Fill(QueryKind kind, const Problem& p, core::Random& random, std::span<double> x) {
  const auto nearest = static_cast<Eigen::Index>(random.Below(p.weights.size()));
  for (std::size_t k = 0; k < x.size(); ++k) {
    const double own = p.points(nearest, static_cast<Eigen::Index>(k));
    switch (kind) {
      case QueryKind::kRandom:
        x[k] = random.Normal();
        break;
      case QueryKind::kNear:
        x[k] = own + 1e-9 * random.Normal();
        break;
      case QueryKind::kEqual:
        x[k] = own;
        break;
      case QueryKind::kFar:  // some terms remain
        x[k] = own + 10.0 * random.Normal();
        break;
      case QueryKind::kVeryFar:  // no term remains
        x[k] = 1e4 * random.Normal();
        break;
      case QueryKind::kDenormal:
        x[k] = 1e-310 * random.Normal();
        break;
      case QueryKind::kHuge:
        x[k] = 1e17 * random.Normal();
        break;
      case QueryKind::kMixed: {
        const auto other = static_cast<QueryKind>(random.Below(7));
        Fill(other, p, random, x.subspan(k, 1));
        if (other == QueryKind::kEqual || other == QueryKind::kNear) x[k] = own;
        break;
      }
    }
  }
}

/// The terms of a problem, prepared for each instruction set.
struct OfEveryTarget {
  explicit OfEveryTarget(const Problem& p) {
    for (const std::int64_t target : SupportedTargets()) {
      ForceTarget(target);
      in_double.emplace_back(GaussianTerms<double>(p.points, p.weights, p.gamma));
      in_float.emplace_back(GaussianTerms<float>(p.points, p.weights, p.gamma));
    }
    ForceTarget(0);
  }
  std::vector<SumTerms<double>> in_double;
  std::vector<SumTerms<float>> in_float;
};

/// Checks g = sum - rho on `states` states, an eighth of each kind, with every instruction set. The
/// error is relative to max(sum, rho), with rho = 0.1, because g has no relative accuracy where sum
/// and rho cancel.
inline void CheckDecisions(int states) {
  const Problem p(24, 9, 1.0 / 9.0, 13);
  const auto& [in_double, in_float] = OfEveryTarget(p);
  core::Random random(14);
  std::vector<double> x(9), scaled(9);
  std::vector<float> scaled_float(9);
  constexpr double kRho = 0.1;
  std::array<double, kKinds> worst_double{};
  std::array<double, kKinds> worst_float{};
  for (int i = 0; i < states; ++i) {
    const auto kind = static_cast<std::size_t>(i % kKinds);
    Fill(static_cast<QueryKind>(kind), p, random, x);
    const auto expected = static_cast<double>(LongDouble(p, x).sum);
    const double scale = std::max(expected, kRho);
    ASSERT_TRUE(in_double[0]->Scale(x.data(), scaled.data()));
    ASSERT_TRUE(in_float[0]->Scale(x.data(), scaled_float.data()));
    for (std::size_t k = 0; k < in_double.size(); ++k) {
      const double a = GaussianSum(*in_double[k], scaled.data());
      const double b = GaussianSum(*in_float[k], scaled_float.data());
      worst_double[kind] = std::max(worst_double[kind], std::abs(a - expected) / scale);
      worst_float[kind] = std::max(worst_float[kind], std::abs(b - expected) / scale);
    }
  }
  for (std::size_t kind = 0; kind < kKinds; ++kind) {
    SCOPED_TRACE(testing::Message() << "kind " << kind);
    EXPECT_LT(worst_double[kind], 1e-12);
    EXPECT_LT(worst_float[kind], 1e-6);
  }
}

}  // namespace dfr::kernel::internal
