"""Each test has one tier, no tier is empty, and only tests of the tier system read the machine's clocks. Every
program ignores SIGXFSZ. No folder and no source file is large.

usage: tiers_test.py SOURCE_DIR BINARY_DIR
"""
import collections
import json
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

SOURCE, BINARY = (pathlib.Path(p).resolve() for p in sys.argv[1:3])
del sys.argv[1:3]
TIERS = {"unit", "integration", "system", "repository"}
CLOCKS = re.compile(r"sleep_for|sleep_until|\busleep\b|nanosleep|wait_for\(|system_clock|steady_clock|time\.sleep|time\.monotonic")


class Tiers(unittest.TestCase):
    def test_each_test_has_one_tier_and_no_tier_is_empty(self):
        listed = subprocess.run(["ctest", "--test-dir", BINARY, "--show-only=json-v1"], capture_output=True, text=True,
                                check=True)
        count = collections.Counter()
        for test in json.loads(listed.stdout)["tests"]:
            labels = [value for of in test.get("properties", []) if of["name"] == "LABELS" for value in of["value"]]
            with self.subTest(test["name"]):
                self.assertEqual(len(labels), 1, labels)
                self.assertIn(labels[0], TIERS)
            count.update(labels)
        self.assertEqual(set(count), TIERS)

    def test_every_program_ignores_sigxfsz(self):
        for path in sorted((SOURCE / "apps").glob("*/main.cc")):
            with self.subTest(path.parent.name):
                self.assertRegex(path.read_text(), r"\nint main\(.*\{\s+return dfr::apps::RunProgram\(")

    def test_only_system_tests_read_the_clock(self):
        # No test of another tier runs these programs.
        theirs = {"tests/support/tiers_test.py", "tests/mutation/mutate.py", "tests/support/busy.py"}
        for path in sorted((SOURCE / "tests").rglob("*")):
            name = path.relative_to(SOURCE).as_posix()
            if path.suffix not in (".cc", ".h", ".py") or "_system_" in path.name or name in theirs:
                continue
            with self.subTest(name):
                self.assertEqual(CLOCKS.findall(path.read_text()), [])

    def test_no_two_processes_share_a_file_by_its_name(self):
        for path in sorted((SOURCE / "tests").rglob("*")):
            if path.suffix in (".cc", ".h"):
                with self.subTest(path.relative_to(SOURCE).as_posix()):
                    self.assertNotIn("testing::TempDir()", path.read_text(), "use ProcessFolder() of temp_folder.h")

    def test_no_folder_has_more_than_15_files_and_no_source_more_than_450_lines(self):
        git = ["git", "ls-files", "apps", "bench", "hardware", "libs", "python", "sim", "tests"]
        listed = subprocess.run(git, cwd=SOURCE, capture_output=True, text=True) if shutil.which("git") else None
        if listed is None or listed.returncode != 0 or not listed.stdout:
            self.skipTest("not a git checkout")
        tracked = [path for path in map(pathlib.Path, listed.stdout.splitlines()) if (SOURCE / path).exists()]
        files = collections.Counter(path.parent.as_posix() for path in tracked)
        self.assertEqual({folder: count for folder, count in files.items() if count > 15}, {})
        lines = {path.as_posix(): (SOURCE / path).read_text().count("\n")
                 for path in tracked if path.suffix in (".c", ".cc", ".h", ".py")}
        self.assertEqual({path: count for path, count in lines.items() if count > 450}, {})


if __name__ == "__main__":
    unittest.main()
