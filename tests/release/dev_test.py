"""./dev in a copy of its files, with programs that only record their calls in place of cmake and ctest.

usage: dev_test.py SOURCE_DIR
"""

import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(sys.argv[1]).resolve()
del sys.argv[1]
TOOLS = ("awk bash cat chmod cut dirname env find git grep head id ls mkdir mktemp nproc python3 rm sed sh sort tail "
         "touch tr wc xargs").split()


class DevTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name).resolve()
        self.tree, self.bin, self.calls = (self.folder / name for name in ("a tree", "bin", "calls"))
        for name in ("dev", "components.txt", "cmake/release.sh", "docs/manual.sh"):
            (self.tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(SOURCE / name, self.tree / name)
        self.bin.mkdir()
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool))
        for name in ("cmake", "ctest"):
            self.program(self.bin / name, f'echo "{name} $*" >>"{self.calls}"')

    @staticmethod
    def program(path, script):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)

    def dev(self, *arguments, status=0, folder=None):
        command = ["bash", self.tree / "dev", *arguments]
        done = subprocess.run(command, cwd=folder or self.tree, env={"PATH": str(self.bin)}, capture_output=True,
                              text=True)
        self.assertEqual(done.returncode, status, done.stdout + done.stderr)
        return done.stdout + done.stderr

    def missing(self, *arguments):
        """Return the packages that ./dev misses where dpkg knows no package."""
        self.program(self.bin / "dpkg-query", "")
        text = self.dev("--no-install", *arguments, status=1)
        return text.partition("these packages are missing: ")[2].partition("\n")[0].split()

    def test_hooks_keep_the_hooks_of_the_user(self):
        subprocess.run(["git", "init", "--quiet", "--template=", self.tree], check=True)
        hooks = self.tree / ".git/hooks"
        own = "#!/bin/sh\n./scripts/secret-scan\n"
        hooks.mkdir()
        (hooks / "pre-commit").write_text(own)
        self.assertIn("pre-commit exists. Add to it: ./dev --no-install check", self.dev("hooks", status=1))
        self.assertEqual((hooks / "pre-commit").read_text(), own)
        self.assertIn("prose_lint.py --message", (hooks / "commit-msg").read_text())
        (hooks / "pre-commit").write_text(own + "./dev --no-install check\n")
        for _ in range(2):
            self.dev("hooks")
            self.assertEqual((hooks / "pre-commit").read_text(), own + "./dev --no-install check\n")
        self.assertTrue((hooks / "commit-msg").stat().st_mode & 0o100)

    def test_a_word_that_is_no_positive_number_is_a_usage_error(self):
        for number in ("0", "x", ".5", "-1", "08"):
            for command in (["fuzz", "all", number], ["check", "--minutes", number], ["test", "--busy", number],
                            ["-j", number]):
                with self.subTest(command=command):
                    text = self.dev("--no-install", *command, status=2)
                    self.assertRegex(text, r"\Adev: .* a positive .*\n\Z")
        self.assertFalse(self.calls.exists())

    def test_a_system_without_dpkg_builds_if_nothing_is_to_be_installed(self):
        self.assertIn("not a Debian system", self.dev("build", "kernel", status=1))
        self.dev("--no-install", "build", "kernel")
        self.assertIn("cmake --build build/release", self.calls.read_text())

    def test_paths_start_in_the_callers_folder_if_arguments_are_given(self):
        mine = self.folder / "my data"
        mine.mkdir()
        self.program(self.tree / "build/release/bin/guard", 'echo "$PWD|$*"; exit 3')
        self.program(self.tree / "build/release/bin/pusher", 'echo "$PWD|$*"')
        self.assertIn(f"{mine}|check demos.hdf5\n", self.dev("--no-install", "run", "guard", "check", "demos.hdf5",
                                                            folder=mine, status=3))
        self.assertIn(f"{self.tree}|experiment --preset quick", self.dev("--no-install", "run", folder=mine))
        self.program(self.tree / "build/release/bin/line_tracking", 'echo "$PWD|$*"')  # its configuration is the tree's
        self.assertIn(f"{self.tree}|launch --config apps/line_tracking/config/simulator.toml --episodes 1\n",
                      self.dev("--no-install", "run", "line_tracking", "--dds", "--episodes", "1", folder=mine))

    def test_coverage_runs_the_tests_that_it_builds(self):
        self.program(self.tree / "tests/coverage/line_coverage.py", "")
        self.dev("--no-install", "coverage", "core")
        self.assertRegex(self.calls.read_text(), r"ctest --test-dir build/coverage .* -LE \^system\$\n")

    def test_only_the_page_needs_the_compiler_for_browsers(self):
        self.assertNotIn("emscripten", self.missing("package", "guard", "python"))
        for components in ([], ["all"], ["guard", "planar_page"]):
            self.assertIn("emscripten", self.missing("package", *components))


if __name__ == "__main__":
    unittest.main()
