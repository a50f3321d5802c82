#pragma once

#include <cstddef>
#include <string>

namespace dfr::bench {

/// Peak performance of one core, measured with the instruction set that dispatch chooses.
struct Machine {
  std::string processor;  ///< Name of the processor; empty if the system does not report it.
  std::string instruction_set;
  std::size_t vector_bytes = 0;
  /// Time per vector multiply-add in a loop that throughput limits.
  double fma_nanoseconds = 0.0;
  double load_l1_nanoseconds = 0.0;  ///< Time of one vector load from 16 KiB.
  double load_l2_nanoseconds = 0.0;  ///< Time of one vector load from 256 KiB.
};

/// Measures once; later calls return the same result.
[[nodiscard]] const Machine& Measure();
[[nodiscard]] std::string Describe(const Machine& machine);

/// Returns the minimum time of one decision with `terms` support vectors of `dim` entries of
/// `bytes_per_value` bytes (4 or 8). Per vector of terms it is the larger of two times: dim + 7
/// (float) or dim + 12 (double) operations on the multiply-add ports (one FMA per coordinate, the
/// polynomial, and two to split and join the exponent), or dim + 1 loads. A single query loads from
/// L1 if all terms fit 32 KiB, otherwise from L2. A batch, whose queries share tiles of terms,
/// always loads from L1.
[[nodiscard]] double DecisionBound(const Machine& machine, std::size_t terms, std::size_t dim,
                                   std::size_t bytes_per_value, bool batch);

}  // namespace dfr::bench
