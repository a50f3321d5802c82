"""Helpers for the tests of the program `guard`. Removes PROGRAM from sys.argv."""

import pathlib
import subprocess
import sys
import tempfile
import unittest

from foreign_files import episodes, write_minari, write_robomimic

PROGRAM = pathlib.Path(sys.argv.pop(1)).resolve()


class GuardProgramTest(unittest.TestCase):
    """Runs the program in a folder with the same 30 demonstrations in two formats."""

    @classmethod
    def setUpClass(cls):
        temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(temporary.cleanup)
        cls.folder = pathlib.Path(temporary.name)
        write_robomimic(cls.folder / "demos.hdf5", episodes(1, 30))
        write_minari(cls.folder / "right-v0", episodes(1, 30))

    def run_program(self, *arguments, folder="."):
        return subprocess.run(
            [PROGRAM, *map(str, arguments)], cwd=self.folder / folder, text=True, capture_output=True
        )

    def run_guard(self, *arguments, fails=False):
        done = self.run_program(*arguments)
        if fails:
            self.assertNotEqual(done.returncode, 0, done.stdout)
            self.assertLessEqual(len(done.stderr.strip().splitlines()), 2, done.stderr)
            return done.stderr + done.stdout
        self.assertEqual(done.returncode, 0, done.stderr + done.stdout)
        return done.stdout

    def fit(self, name, demonstrations="demos.hdf5", *more):
        return self.run_guard("fit", demonstrations, "--features", "obs/object,obs/tip", "-o", name, *more)
