// Time of decisions without Python: prints the minimum processor time of one batch in milliseconds.
// usage: decision_in_cpp FILE SAMPLES FEATURES GAMMA NU REPETITIONS. FILE contains the samples,
// then as many queries, as doubles.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace {

double ThreadSeconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 7) throw std::runtime_error("six arguments are needed");
  dfr::core::Matrix samples(std::atoi(argv[2]), std::atoi(argv[3]));
  dfr::core::Matrix queries(samples.rows(), samples.cols());
  std::ifstream in(argv[1], std::ios::binary);
  for (dfr::core::Matrix* part : {&samples, &queries}) {
    in.read(reinterpret_cast<char*>(part->data()),
            static_cast<std::streamsize>(sizeof(double)) * part->size());
  }
  if (!in) throw std::runtime_error("the file is too short");
  const auto svm = dfr::kernel::OneClassSvm::Fit(
      samples, {.nu = std::atof(argv[5]), .gamma = std::atof(argv[4]), .tolerance = 1e-3});
  std::vector<double> g(static_cast<std::size_t>(queries.rows()));
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i < std::atoi(argv[6]); ++i) {
    const double start = ThreadSeconds();
    svm.DecisionBatch(queries, g);
    least = std::min(least, ThreadSeconds() - start);
  }
  std::printf("%.6f\n", 1e3 * least);
} catch (const std::exception& e) {
  std::fprintf(stderr, "decision_in_cpp: %s\n", e.what());
  return EXIT_FAILURE;
}
