"""Helpers for the tests of the program `pusher`. Removes PROGRAM from sys.argv."""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAM = pathlib.Path(sys.argv.pop(1)).resolve()
# A study of all methods, and a study of one method.
ALL = ["--learners", "8", "--demonstrations", "8,16", "--trials", "2", "--episodes", "4", "--no-video", "--no-convergence"]
SMALL = ["--learners", "8", "--demonstrations", "8", "--trials", "2", "--episodes", "2", "--no-video", "--no-convergence",
         "--methods", "baseline,controller"]


class ProgramTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        temporary = tempfile.TemporaryDirectory()
        cls.addClassCleanup(temporary.cleanup)
        cls.folder = pathlib.Path(temporary.name)

    @classmethod
    def run_pusher(cls, *arguments, fails=False):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=cls.folder, text=True, capture_output=True, check=False)
        assert (done.returncode != 0) == fails, done.stdout + done.stderr
        if not fails:
            return done.stdout
        lines = done.stderr.strip().splitlines()
        assert len(lines) <= 2, done.stderr
        return lines[0]

    def summary_text(self, out):
        return (self.folder / out / "summary.json").read_text()

    def summary(self, out):
        return json.loads(self.summary_text(out))

    def settings(self, out):
        return json.loads((self.folder / out / "ledger.jsonl").read_text().splitlines()[0])["settings"]
