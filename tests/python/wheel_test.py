"""A wheel built from the source installs into a clean virtual environment and passes the tests there.

usage: wheel_test.py SOURCE_DIR     (with python3-skbuild, python3-pip and python3-venv)
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest
import zipfile

SOURCE = pathlib.Path(sys.argv[1]).resolve()
del sys.argv[1]
# Nothing of the build tree, and no network.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
ENVIRONMENT |= {"PIP_NO_INDEX": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def run(*command, **options):
    done = subprocess.run([str(c) for c in command], text=True, capture_output=True, env=ENVIRONMENT, **options)
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
        # Ignored files are not sources; an unpacked archive has no git.
        shutil.copytree(SOURCE, source, ignore=shutil.ignore_patterns("build", ".git", "out", "_skbuild", "*.egg-info"))
        # What is tested is the package, not its speed; what was compiled before is taken from a cache.
        ENVIRONMENT["SKBUILD_CONFIGURE_OPTIONS"] = "-DCMAKE_CXX_FLAGS_RELEASE=-O1"
        if shutil.which("ccache"):
            ENVIRONMENT["SKBUILD_CONFIGURE_OPTIONS"] += " -DCMAKE_CXX_COMPILER_LAUNCHER=ccache"
            ENVIRONMENT.update(CCACHE_BASEDIR=str(cls.folder), CCACHE_NOHASHDIR="1")
        run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", cls.folder, source)
        [cls.wheel] = cls.folder.glob("*.whl")
        # NumPy comes from the system: there is no network to get it from.
        run(sys.executable, "-m", "venv", "--system-site-packages", cls.folder / "venv")
        cls.python = cls.folder / "venv/bin/python"
        run(cls.python, "-m", "pip", "install", "--no-deps", cls.wheel)

    def test_it_holds_the_module_its_types_and_its_licence(self):
        names = zipfile.ZipFile(self.wheel).namelist()
        for end in ("dfr/__init__.py", "dfr/py.typed", "dfr/_core.pyi", "/LICENSE", "examples/first_guard.py"):
            self.assertTrue([name for name in names if name.endswith(end)], end)
        self.assertEqual(len([name for name in names if "dfr/_core." in name and name.endswith(".so")]), 1)
        self.assertFalse([name for name in names if name.endswith((".a", ".h", ".cmake", ".cc"))])

    def test_it_links_neither_mujoco_nor_dds_nor_ceres(self):
        [module] = (self.folder / "venv").glob("lib/**/dfr/_core*.so")
        self.assertNotRegex(run("ldd", module), "mujoco|fastrtps|ceres|cholmod|opencv")

    def test_metadata_are_those_of_the_project(self):
        shown = run(self.python, "-m", "pip", "show", "dfr")
        self.assertIn("Version: 0.1.0", shown)
        self.assertIn("License: BSD-3-Clause", shown)
        self.assertIn("Requires: numpy", shown)
        self.assertEqual(run(self.python, "-c", "import dfr; print(dfr.__version__)"), "0.1.0\n")

    def test_the_tests_pass_there(self):
        for name in ("guard_test.py", "time_varying_support_test.py"):
            run(self.python, SOURCE / "tests/python" / name, cwd=self.folder)
        run(self.python, SOURCE / "examples/guard_a_policy.py", cwd=self.folder)
        small = ["--trials", 1, "--episodes", 2, "--demonstrations", 12, "--out", "small"]
        self.assertIn("guard", run(self.python, SOURCE / "examples/own_experiment.py", "experiment", *small, cwd=self.folder))


if __name__ == "__main__":
    unittest.main()
