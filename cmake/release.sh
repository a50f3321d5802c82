# shellcheck shell=bash
# Implements ./dev release. The script dev reads this file.

# interpreters: prints the path of one CPython with headers for each minor version, 3.9 or newer. Prefers Debian's.
interpreters() {
  local python
  for python in /usr/bin/python3 $(compgen -c python3. | sort -u | grep -E '^python3\.[0-9]+$' || true) \
                "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/python3; do
    "$python" - "$(command -v "$python")" 2>/dev/null <<'PY' || true
import os, sys, sysconfig
if sys.implementation.name == "cpython" and sys.version_info >= (3, 9):
    if os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
        print(sys.version_info[1], sys.argv[1])
PY
  done | awk '!seen[$1]++ { print $2 }'
}

# make_wheel PYTHON SOURCE FOLDER: builds a wheel. Debian's build tools are pure Python: any interpreter runs them.
make_wheel() {
  local python=$1 source=$2 folder=$3 platform tools tool
  platform=manylinux_$(getconf GNU_LIBC_VERSION | sed 's/glibc //; s/\./_/')_$(uname -m)
  tools=$(mktemp -d)
  for tool in /usr/lib/python3/dist-packages/{_distutils_hack,distro,packaging,pkg_resources,setuptools,skbuild,wheel} \
              /usr/lib/python3/dist-packages/{distro,packaging,setuptools,scikit_build,wheel}-*.*-info; do
    [ ! -e "$tool" ] || ln -s "$tool" "$tools"
  done
  # Debian's setuptools reads two options that only Debian's distutils defines.
  local build='import setuptools, runpy; from distutils.command.install import install
install.install_layout = install.prefix_option = None
runpy.run_path("setup.py", run_name="__main__")'
  (cd "$source" && rm -rf _skbuild && PYTHONPATH=$tools CMAKE_BUILD_PARALLEL_LEVEL=$jobs \
     SKBUILD_CONFIGURE_OPTIONS="-DDFR_BUNDLE=ON -DDFR_PRECOMPILE=ON -DCMAKE_UNITY_BUILD=ON" \
     "$python" -c "$build" --quiet bdist_wheel --plat-name "$platform" -d "$folder") >"$source/wheel.log" 2>&1 ||
    { tail -n 30 "$source/wheel.log" >&2; die "no wheel for $python; the end of $source/wheel.log is above."; }
  rm -rf "$tools"
}

# Builds all files in the unpacked tarball, with the commit's time. Two runs on one commit give the same files.
cmd_release() {
  local tag commit version name out=$PWD/build/release-artefacts work=$PWD/build/release-work python part
  tag=${1:-$(git describe --exact-match HEAD 2>/dev/null || true)}
  [ -n "$tag" ] || misused "HEAD has no tag; name one, or --dry-run"
  if [ "$tag" = --dry-run ]; then commit=HEAD; else commit=refs/tags/$tag; fi
  commit=$(git rev-parse --verify --quiet "$commit^{commit}") || misused "there is no tag '$tag'"
  if [ $# -gt 1 ]; then shift; else set -- source packages wheels; fi
  for part in "$@"; do
    [[ $part =~ ^(source|packages|wheels)$ ]] || misused "unknown part '$part'; parts: source, packages or wheels"
  done
  version=$(git show "$commit:CMakeLists.txt" | sed -n 's/^project(dfr VERSION \([^ ]*\) .*/\1/p')
  name=dfr-$version
  if [ "$tag" != --dry-run ]; then
    [ "$tag" = "v$version" ] || misused "CMakeLists.txt of $tag names version $version, whose tag is v$version"
    git show "$commit:CHANGELOG.md" | grep -qE "^## $version \([0-9]{4}-[0-9]{2}-[0-9]{2}\)$" ||
      die "CHANGELOG.md of $tag needs the heading of its date: ## $version (YYYY-MM-DD)"
  fi
  [ "$*" = source ] || [[ $work != *[[:space:]]* ]] ||
    die "packages and wheels need a path without blanks, not '$PWD': the build splits CXXFLAGS there. Clone into another folder"
  [[ " $* " != *" packages "* ]] || need build package page all
  [[ " $* " != *" wheels "* ]] || need build release python
  rm -rf "$out" "$work"
  mkdir -p "$out" "$work"
  SOURCE_DATE_EPOCH=$(git log -1 --format=%ct "$commit")
  git -c tar.umask=0022 archive --format=tar --prefix="$name/" "$commit" | gzip -9n >"$out/$name.tar.gz"
  git show "$commit:CHANGELOG.md" |
    awk -v version="$version" '/^## / { found = $2 == version; if (found) print; next } found' >"$out/release_notes.md"
  umask 022
  [ "$*" = source ] || tar -xzf "$out/$name.tar.gz" -C "$work"
  export SOURCE_DATE_EPOCH LC_ALL=C.UTF-8 TZ=UTC
  export CFLAGS="-ffile-prefix-map=$work/= ${CFLAGS:-}" CXXFLAGS="-ffile-prefix-map=$work/= ${CXXFLAGS:-}"
  if [[ " $* " = *" packages "* ]]; then
    (cd "$work/$name" && ./dev --no-install -j"$jobs" package)
    cp "$work/$name"/build/packages/*.deb "$out"
  fi
  if [[ " $* " = *" wheels "* ]]; then
    for python in $(interpreters); do
      say "A wheel for $python"
      make_wheel "$python" "$work/$name" "$out"
    done
  fi
  (cd "$out" && sha256sum -- * >SHA256SUMS)
  say "In $out:"
  cat "$out/SHA256SUMS"
}
