"""./dev release in a clone: the same tarball twice, notes, checksums, and rejected tags.

usage: release_test.py SOURCE_DIR
"""

import hashlib
import pathlib
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import unittest

SOURCE = pathlib.Path(sys.argv[1]).resolve()
del sys.argv[1]


def git(folder, *arguments):
    command = ["git", "-C", folder, "-c", "user.name=dfr", "-c", "user.email=dfr@example.invalid", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@unittest.skipUnless((SOURCE / ".git").exists(), "a release is made in a clone")
class ReleaseTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(temporary.cleanup)
        cls.clone = pathlib.Path(temporary.name) / "clone"
        git(SOURCE, "clone", "--quiet", "--shared", "--no-tags", str(SOURCE), str(cls.clone))
        cls.start = git(cls.clone, "rev-parse", "HEAD")
        cls.artefacts = cls.clone / "build/release-artefacts"
        cls.version = re.search(r"project\(dfr VERSION (\S+)", (cls.clone / "CMakeLists.txt").read_text()).group(1)

    def setUp(self):
        git(self.clone, "reset", "--quiet", "--hard", self.start)
        for tag in git(self.clone, "tag").split():
            git(self.clone, "tag", "--delete", tag)
        shutil.rmtree(self.clone / "build", ignore_errors=True)

    def release(self, *arguments, status=0, options=()):
        command = [self.clone / "dev", "--no-install", *options, "release", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, umask=0o077)
        self.assertEqual(done.returncode, status, done.stderr)
        return done.stderr

    def test_two_runs_give_the_same_files_of_the_commit(self):
        self.release("--dry-run", "source")
        sums = (self.artefacts / "SHA256SUMS").read_text()
        (self.clone / "uncommitted").write_text("")
        self.release("--dry-run", "source")
        self.assertEqual((self.artefacts / "SHA256SUMS").read_text(), sums)
        for line in sums.splitlines():
            checksum, name = line.split()
            self.assertEqual(hashlib.sha256((self.artefacts / name).read_bytes()).hexdigest(), checksum)
        self.assertEqual([line.split()[1] for line in sums.splitlines()],
                         [f"dfr-{self.version}.tar.gz", "release_notes.md"])
        with tarfile.open(self.artefacts / f"dfr-{self.version}.tar.gz") as tarball:
            files = {member.name for member in tarball if not member.isdir()}
            self.assertEqual(files, {f"dfr-{self.version}/{name}" for name in git(self.clone, "ls-files").splitlines()})
            self.assertEqual({member.mtime for member in tarball}, {int(git(self.clone, "log", "-1", "--format=%ct"))})
            commit = tarball.extractfile(f"dfr-{self.version}/cmake/commit.txt").read().decode().strip()
        self.assertEqual(commit, self.start)

    def test_packages_are_built_from_the_tarball_with_the_jobs_of_the_command(self):
        with (self.clone / "cmake/release.sh").open("a") as script:  # in place of a build that takes minutes
            script.write('need() { :; }\n'
                         'cmd_package() { mkdir -p build/packages && echo "$PWD $jobs" >build/packages/a.deb; }\n')
        git(self.clone, "commit", "--quiet", "--all", "--message", "Replace the packages")
        self.release("--dry-run", "packages", options=["-j7"])
        self.assertEqual((self.artefacts / "a.deb").read_text(),
                         f"{self.clone}/build/release-work/dfr-{self.version} 7\n")
        self.assertIn("a.deb\n", (self.artefacts / "SHA256SUMS").read_text())
        # Files have the modes of the tarball, regardless of the user's umask. As root, the test has no effect.
        module = self.clone / f"build/release-work/dfr-{self.version}/python/dfr/__init__.py"
        self.assertEqual(module.stat().st_mode & 0o777, 0o644)

    def test_a_path_that_compilers_would_split_is_refused(self):
        moved = self.clone.rename(self.clone.parent / "my clone")
        self.addCleanup(lambda: moved.rename(self.clone))
        command = [moved / "dev", "--no-install", "release", "--dry-run", "wheels"]
        done = subprocess.run(command, capture_output=True, text=True)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn(f"a path without blanks, not '{moved}'", done.stderr)

    def test_notes_are_the_versions_part_of_the_changelog(self):
        changes = self.clone / "CHANGELOG.md"
        changes.write_text(f"# Changes\n\n## {self.version}.1 (2026-02-02)\n\nLater.\n\n"
                           f"## {self.version} (2026-01-01)\n\n### New\n\n- A.\n\n## 0.0.1 (2025-01-01)\n\n- B.\n")
        git(self.clone, "commit", "--quiet", "--all", "--message", "Date the release")
        git(self.clone, "tag", f"v{self.version}")
        self.release(f"v{self.version}", "source")
        self.assertEqual((self.artefacts / "release_notes.md").read_text().rstrip(),
                         f"## {self.version} (2026-01-01)\n\n### New\n\n- A.")

    def test_a_tag_that_does_not_fit_is_refused(self):
        (self.clone / "CHANGELOG.md").write_text(f"## {self.version} (unreleased)\n")
        git(self.clone, "commit", "--quiet", "--all", "--allow-empty", "--message", "Begin a release")
        self.assertIn("HEAD has no tag", self.release(status=2))
        self.assertIn("no tag 'v9'", self.release("v9", status=2))
        git(self.clone, "tag", "v9")
        self.assertIn(f"whose tag is v{self.version}", self.release("v9", status=2))
        git(self.clone, "tag", f"v{self.version}")
        self.assertIn(f"## {self.version} (YYYY-MM-DD)", self.release(f"v{self.version}", status=1))
        self.assertIn("unknown part 'all'", self.release("--dry-run", "all", status=2))
        self.assertFalse(self.artefacts.exists())


if __name__ == "__main__":
    unittest.main()
