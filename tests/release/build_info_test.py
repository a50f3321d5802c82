"""The commit that cmake/BuildInfo.cmake writes for copies of the source tree.

usage: build_info_test.py CMAKE SOURCE_DIR
"""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

CMAKE, SOURCE = sys.argv[1], pathlib.Path(sys.argv[2]).resolve()
del sys.argv[1:]


class BuildInfoTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.tree = pathlib.Path(temporary.name).resolve() / "a tree"
        (self.tree / "cmake").mkdir(parents=True)
        shutil.copy(SOURCE / "cmake/commit.txt", self.tree / "cmake")
        (self.tree / "rule.cc").write_text("first\n")
        (self.tree / ".gitignore").write_text("build_info.cc\n")

    def git(self, *arguments):
        identity = ["-c", "user.name=a", "-c", "user.email=a@b.invalid"]
        return subprocess.run(["git", "-C", self.tree, *identity, *arguments], check=True, capture_output=True,
                              text=True).stdout.strip()

    def commit_tree(self):
        self.git("init", "--quiet", "--template=")
        self.git("add", ".")
        self.git("commit", "--quiet", "--message=first")
        return self.git("rev-parse", "--short=12", "HEAD")

    def build_commit(self):
        output = self.tree / "build_info.cc"
        subprocess.run([CMAKE, f"-DSOURCE={self.tree}", f"-DOUTPUT={output}", "-DVERSION=1.2.3", "-P",
                        SOURCE / "cmake/BuildInfo.cmake"], check=True)
        return re.search(r'BuildCommit\(\).*"(.*)"', output.read_text()).group(1)

    def test_different_edits_of_a_commit_have_different_names(self):
        head = self.commit_tree()
        self.assertEqual(self.build_commit(), head)
        names = []
        for text in ("second;\n", "third [x]\n", "first\n"):
            (self.tree / "rule.cc").write_text(text)
            names.append(self.build_commit())
            self.assertEqual(self.build_commit(), names[-1])
        self.assertEqual(names.pop(), head)
        for name in names:
            self.assertRegex(name, rf"\A{head}\+changes\.[0-9a-f]{{8}}\Z")
        self.assertNotEqual(*names)

    def test_an_untracked_source_file_takes_part_beside_a_changed_one(self):
        head = self.commit_tree()
        (self.tree / "new rule.h").write_text("first\n")
        self.assertEqual(self.build_commit(), head)
        (self.tree / "rule.cc").write_text("includes it\n")
        before = self.build_commit()
        (self.tree / "new rule.h").write_text("second\n")
        self.assertNotEqual(self.build_commit(), before)

    def test_an_archive_names_its_commit_and_a_bare_copy_none(self):
        self.assertEqual(self.build_commit(), "unknown")
        (self.tree / "cmake/commit.txt").write_text("0123456789abcdef0123\n")
        self.assertEqual(self.build_commit(), "0123456789ab")


if __name__ == "__main__":
    unittest.main()
