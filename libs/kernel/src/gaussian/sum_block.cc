#include "gaussian/sum_block.h"

#include <algorithm>
#include <new>

#include "gaussian/gaussian_sum.h"

namespace dfr::kernel::internal {

// Relative errors 2.3e-16 and 8.3e-8 (Remez; the constant term is 1 to make k(x, x) = 1).
constinit const Exp2Constants<double> kExp2Double{
    {9.935326288527113e-09, 9.469651597530141e-08, 1.3310800888130517e-06, 1.5244895767042944e-05,
     0.00015403939740726082, 0.0013333544569884535, 0.009618129384464252, 0.05550410863258579,
     0.2402265069609467, 0.693147180559909, 1.0},
    -1022.0,
    6755399441055744.0};
constinit const Exp2Constants<float> kExp2Float{
    {0.0018671300702315652f, 0.009017030321454624f, 0.05579991310471325f, 0.24016445015469612f,
     0.6931513118046542f, 1.0f},
    -126.0f,
    12582912.0f};

template <typename T>
std::size_t SumBlock<T>::Lines(const GaussianTerms<T>& terms) noexcept {
  return sizeof(SumBlock) / sizeof(CacheLine) + (terms.dim + 7) / 8 + terms.data.size() / kLanes;
}

template <typename T>
const SumBlock<T>& SumBlock<T>::Write(const GaussianTerms<T>& terms, void* memory) {
  auto* block = ::new (memory) SumBlock{.functions = BestSumFunctions<T>(),
                                        .dim = terms.dim,
                                        .num_blocks = terms.num_blocks,
                                        .scale = terms.scale};
  std::copy(terms.center.begin(), terms.center.end(), const_cast<double*>(block->center()));
  T* to = const_cast<T*>(block->data());
  for (std::size_t b = 0; b < terms.num_blocks;) {
    const std::size_t group = GroupBlocks(block->functions.together, terms.num_blocks - b);
    for (std::size_t row = 0; row <= terms.dim; ++row) {
      for (std::size_t k = 0; k < group; ++k) {
        to =
            std::copy_n(terms.data.data() + ((b + k) * (terms.dim + 1) + row) * kLanes, kLanes, to);
      }
    }
    b += group;
  }
  return *block;
}

template struct SumBlock<double>;
template struct SumBlock<float>;

}  // namespace dfr::kernel::internal
