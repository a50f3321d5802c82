#pragma once

#include <cstddef>
#include <cstdint>

/// Begins a fuzz target: DFR_FUZZ_TARGET(archive) { ... return 0; } reads `size` bytes of `data`.
///
/// The target is libFuzzer's entry point if DFR_FUZZ is defined. Otherwise the macro registers the
/// target by its name in fuzz_replay (replay_main.cc).
#ifdef DFR_FUZZ
#define DFR_FUZZ_TARGET(name) \
  extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
#else
#define DFR_FUZZ_TARGET(name)                                                       \
  static int Fuzz_##name(const std::uint8_t* data, std::size_t size);               \
  static const bool kRegistered_##name = dfr::fuzz::AddTarget(#name, &Fuzz_##name); \
  static int Fuzz_##name(const std::uint8_t* data, std::size_t size)

namespace dfr::fuzz {

using Target = int (*)(const std::uint8_t* data, std::size_t size);

/// Registers `target` in fuzz_replay by its name. Returns true.
bool AddTarget(const char* name, Target target);

}  // namespace dfr::fuzz
#endif
