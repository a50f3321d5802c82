"""A wheel built from the source installs into a clean virtual environment and passes the tests there.

usage: wheel_system_test.py SOURCE_DIR     (with python3-skbuild, python3-pip and python3-venv)
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest
import zipfile

import numpy

SOURCE = pathlib.Path(sys.argv[1]).resolve()
del sys.argv[1]
# Excludes the build tree and the network.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
ENVIRONMENT |= {"PIP_NO_INDEX": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def run(*command, **options):
    environment = ENVIRONMENT | options.pop("env", {})
    done = subprocess.run([str(c) for c in command], text=True, capture_output=True, env=environment, **options)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(map(str, command))}\n{done.stdout[-6000:]}{done.stderr[-3000:]}")
    return done.stdout


class WheelTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(temporary.cleanup)
        cls.folder = pathlib.Path(temporary.name)
        source = cls.folder / "source"  # a build leaves files beside setup.py
        # Ignored files are not sources. An unpacked archive has no git.
        shutil.copytree(SOURCE, source, ignore=shutil.ignore_patterns("build", ".git", "out", "_skbuild", "*.egg-info"))
        # The test concerns the package and not its speed: -O1 and a compiler cache suffice.
        ENVIRONMENT["SKBUILD_CONFIGURE_OPTIONS"] = (
            "-DDFR_BUNDLE=ON -DDFR_PRECOMPILE=ON -DCMAKE_UNITY_BUILD=ON -DCMAKE_CXX_FLAGS_RELEASE=-O1")
        if shutil.which("ccache"):
            ENVIRONMENT["SKBUILD_CONFIGURE_OPTIONS"] += " -DCMAKE_CXX_COMPILER_LAUNCHER=ccache"
            ENVIRONMENT.update(CCACHE_BASEDIR=str(cls.folder), CCACHE_NOHASHDIR="1")
        run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", cls.folder, source)
        [cls.wheel] = cls.folder.glob("*.whl")
        # Only NumPy comes from the system, because there is no network.
        run(sys.executable, "-m", "venv", cls.folder / "venv")
        [site] = (cls.folder / "venv").glob("lib/python*/site-packages")
        (site / "numpy").symlink_to(pathlib.Path(numpy.__file__).parent)
        cls.python = cls.folder / "venv/bin/python"
        run(cls.python, "-m", "pip", "install", "--no-deps", cls.wheel)

    def test_it_holds_the_module_its_types_and_its_licence(self):
        names = zipfile.ZipFile(self.wheel).namelist()
        for end in ("dfr/__init__.py", "dfr/py.typed", "dfr/_core.pyi", "/LICENSE", "examples/first_guard.py"):
            self.assertTrue([name for name in names if name.endswith(end)], end)
        self.assertEqual(len([name for name in names if "dfr/_core." in name and name.endswith(".so")]), 1)
        self.assertFalse([name for name in names if name.endswith((".a", ".h", ".cmake", ".cc"))])

    def test_it_needs_only_the_c_library_and_gccs_run_time(self):
        objects = sorted((self.folder / "venv").glob("lib/**/dfr/*.so*"))
        self.assertEqual([file.name.split(".")[0] for file in objects], ["_core", "libhwy"])
        for file in objects:
            needed = set(re.findall(r"\(NEEDED\).*\[(.+)\]", run("readelf", "-d", file)))
            self.assertLessEqual(needed, {"libhwy.so.1", "libc.so.6", "libm.so.6", "libstdc++.so.6", "libgcc_s.so.1",
                                          "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"})
        found = dict(re.findall(r"(\S+) => (\S+)", run("ldd", objects[0])))
        self.assertEqual(pathlib.Path(found["libhwy.so.1"]).resolve(), objects[1].resolve())
        exported = run("nm", "--dynamic", "--defined-only", objects[0]).split()[2::3]
        self.assertEqual([name for name in exported if "H5" in name or "ZSTD" in name or "3dfr" in name], [])

    def test_it_contains_the_licences_of_bundled_packages(self):
        [folder] = (self.folder / "venv").glob("lib/**/dfr/third_party_licenses")
        packages = {path.parent.name for path in folder.glob("*/copyright")}
        self.assertGreaterEqual(packages, {"libhwy-dev", "libhdf5-dev", "libaec-dev", "zlib1g-dev", "libsnappy-dev",
                                           "libzstd-dev", "libeigen3-dev", "pybind11-dev"})
        for text in folder.glob("*/copyright"):
            for name in re.findall(r"/usr/share/common-licenses/([\w.-]*\w)", text.read_text()):
                self.assertTrue((folder / "common-licenses" / name).is_file(), f"{text}: {name}")

    def test_metadata_match_the_project(self):
        shown = run(self.python, "-m", "pip", "show", "dfr")
        self.assertIn("Version: 0.1.0", shown)
        self.assertIn("License: BSD-3-Clause", shown)
        self.assertIn("Requires: numpy", shown)
        self.assertEqual(run(self.python, "-c", "import dfr; print(dfr.__version__)"), "0.1.0\n")

    def test_the_first_guard_of_the_installation_page_runs_in_an_empty_folder(self):
        [script] = re.findall(r"^```python\n(import dfr\n.*?)^```$", (SOURCE / "docs/install.md").read_text(), re.M | re.S)
        with tempfile.TemporaryDirectory() as empty:
            begin = time.monotonic()
            x, y, mode = re.fullmatch(r"\[(\S+) +(\S+)\] (\w+)\n", run(self.python, "-c", script, cwd=empty)).groups()
            self.assertLess(time.monotonic() - begin, 60)
        self.assertLess(abs(float(y)), 0.6)
        self.assertNotEqual(mode, "halt")

    def test_it_reads_demonstrations(self):
        script = "import dfr, sys; print(len(dfr.load_demonstrations(sys.argv[1]).states))"
        run("/usr/bin/python3", SOURCE / "examples/record_demonstrations.py", "demos.hdf5", cwd=self.folder)  # with h5py
        self.assertEqual(run(self.python, "-c", script, "demos.hdf5", cwd=self.folder), "60\n")

    def test_the_python_tests_pass_with_the_wheel(self):
        # One test writes a file with the system's h5py, whose HDF5 differs from the wheel's.
        package = run("/usr/bin/python3", "-c", "import h5py; print(h5py.__path__[0])").strip()
        (self.folder / "with_h5py").mkdir()
        (self.folder / "with_h5py/h5py").symlink_to(package)
        for name in ("guard/guard_test.py", "guard/guard_fit_test.py", "guard/guarded_env_test.py", "time_varying_support_test.py"):
            run(self.python, SOURCE / "tests/python" / name, cwd=self.folder, env={"PYTHONPATH": self.folder / "with_h5py"})
        run(self.python, SOURCE / "examples/guard_a_policy.py", cwd=self.folder)
        small = ["--trials", 1, "--episodes", 2, "--demonstrations", 12, "--out", "small"]
        self.assertIn("guard", run(self.python, SOURCE / "examples/own_experiment.py", "experiment", *small, cwd=self.folder))


if __name__ == "__main__":
    unittest.main()
