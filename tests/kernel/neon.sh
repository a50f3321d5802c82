#!/usr/bin/env bash
# Compiles the kernel library for 64-bit ARM, where Highway uses NEON instead of AVX, and runs three
# of its test files under QEMU. Installs nothing: prints the names of missing cross tools, and
# unpacks the libraries for ARM into FOLDER.
#   usage: tests/kernel/neon.sh FOLDER
set -euo pipefail
folder=$(realpath -m "${1:?usage: tests/kernel/neon.sh FOLDER}")
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
for tool in aarch64-linux-gnu-g++ qemu-aarch64; do
  command -v "$tool" >/dev/null || { echo "neon.sh: $tool is missing: apt-get install g++-aarch64-linux-gnu qemu-user" >&2; exit 1; }
done

root=$folder/arm64/usr
lib=$root/lib/aarch64-linux-gnu
if [ ! -d "$lib" ]; then
  mkdir -p "$folder"/apt/lists/partial "$folder"/apt/archives/partial "$folder"/packages
  touch "$folder/apt/status"
  apt=(apt-get -qq -o "Dir::State=$folder/apt" -o "Dir::Cache=$folder/apt" -o "Dir::State::status=$folder/apt/status"
       -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o APT::Sandbox::User=root)
  "${apt[@]}" update
  (cd "$folder/packages" && "${apt[@]}" download libhwy-dev libhwy1 libgtest-dev libgmock-dev)
  for package in "$folder"/packages/*.deb; do dpkg-deb -x "$package" "$folder/arm64"; done
fi

tests=(gaussian/gaussian_sum support/time_varying_support support/model_selection)
mkdir -p "$folder/objects"
# HWY_DISABLED_TARGETS repeats libs/kernel/CMakeLists.txt.
{ find libs/{core,kernel}/src -name '*.cc'; printf 'tests/%s\n' support/no_alloc.cc "${tests[@]/#/kernel/}"; } |
  sed -E 's|^(tests/kernel/.*)$|\1_test.cc|' |
  xargs -P "$(nproc)" -I{} sh -c 'aarch64-linux-gnu-g++ -std=c++20 -O2 -Wall -Wextra -Wpedantic -Wshadow -Werror \
    "-DHWY_DISABLED_TARGETS=(HWY_SVE|HWY_SVE2|HWY_SVE_256|HWY_SVE2_128|HWY_RVV)" -DEIGEN_MPL2_ONLY \
    -I. -Ilibs/core/include -Ilibs/kernel/include -Ilibs/kernel/src -isystem /usr/include/eigen3 \
    -isystem "$1/include" -c "$2" -o "$3/$(echo "$2" | tr / _).o"' sh "$root" {} "$folder/objects"
for test in "${tests[@]//\//_}"; do
  aarch64-linux-gnu-g++ -o "$folder/${test}_test" "$folder/objects/tests_kernel_${test}_test.cc.o" \
    "$folder"/objects/libs_*.o "$folder/objects/tests_support_no_alloc.cc.o" -L"$lib" -lhwy -lgmock -lgtest -lgtest_main
  qemu-aarch64 -L /usr/aarch64-linux-gnu -E "LD_LIBRARY_PATH=$lib" "$folder/${test}_test" --gtest_brief=1
done
