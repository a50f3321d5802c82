"""A program's experiments, small ones: shards merge to the same bytes, and run.toml starts the same run again.

usage: apps_test.py PROGRAM
"""
import pathlib
import shlex
import subprocess
import sys
import tempfile
import unittest

PROGRAM = pathlib.Path(sys.argv.pop()).resolve()
# Of each program: command, options that are not the defaults, one option with another value, and what a ledger says
# of that one.
RUNS = {
    "planar": [
        ("experiment", "--trials 4 --episodes 3 --demonstrations 20 --methods baseline,guided,certified-radius "
         "--certified-level 0.1 --factor 1.2 --seed 3", "--certified-level=0.2", "settings.certified level"),
        ("drift", "--trials 1 --episodes 2 --demonstrations 12 --methods baseline,guided --gamma 0.3 --task push",
         "--gamma=0.4", "settings.gamma"),
    ],
    "gallery": [
        ("run", "--tasks reach,push,goal --policies lwr,weak --methods guided,monitor --trials 1 --episodes 2 --demonstrations 12",
         "--demonstrations=13", "demonstrations"),
    ],
    "stress": [
        ("run", "--tasks planar-corridor --policies lwr --controllers guided --trials 1 --episodes 2 "
         "--demonstrations 12", "--controllers=dfr", "methods"),
        ("grid", "--tasks planar-corridor --conditions 'as demonstrated,turned 40 deg' --policies lwr "
         "--controllers guided/raw,dfr/whitened --trials 2 --episodes 2 --demonstrations 12", "--episodes=3", "episodes"),
    ],
    "pusher": [
        ("experiment", "--trials 2 --episodes 2 --demonstrations 6,12 --learners 8,8x20 --methods baseline,guided "
         "--gripper fork --no-video --no-convergence --epochs 5 --learning-rate 0.005", "--gripper=bar", "settings.gripper"),
        ("experiment", "--preset authors --trials 2 --episodes 2 --demonstrations 6 --learners 8 --methods baseline,guided "
         "--no-convergence --no-video --nu 0.2", "--nu=0.1", "settings.nu"),
        ("drift", "--trials 1 --episodes 1 --demonstrations 6 --methods baseline,guided", "--learner=16", "settings.learner"),
    ],
    "line_tracking": [
        ("experiment", "--trials 2 --episodes 2 --worlds frozen,30ms --methods baseline,guided --observation truth --no-video "
         "--amplitude 0.001,0.001,0,0,0,0 --not-during --between --pause 0.2", "--pause=0.3", "settings.disturbance"),
    ],
}
# A run of line_tracking calibrates first, which takes seconds.
COUNTS = (2,) if PROGRAM.name == "line_tracking" else (2, 7)
FILMS = {"planar": "film.mp4", "gallery": "film.html", "pusher": "film.mp4", "line_tracking": "film.mp4"}
COMPARED = ("summary.json", "report.html", "run.toml")


class AppsTest(unittest.TestCase):
    maxDiff = 400

    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def run_program(self, *arguments, fails=False):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=self.folder, text=True, capture_output=True, check=False,
                              timeout=600)
        self.assertEqual(done.returncode != 0, fails, done.stdout + done.stderr)
        return done.stderr

    def rerun_the_worst(self, folder):
        """The first of the episodes, and what the other methods make of it; the ledger must agree."""
        done = subprocess.run([PROGRAM, "episodes", folder, "--most", "1"], cwd=self.folder, text=True, capture_output=True,
                              check=True)
        name = done.stdout.split("  ")[0]
        film = FILMS.get(PROGRAM.name)
        self.run_program("rerun", folder, name, *(["--film", film] if film else []))
        if film:
            self.assertGreater((self.folder / film).stat().st_size, 1000)

    def compare(self, here, there, names=COMPARED):
        for name in names:
            self.assertEqual((self.folder / here / name).read_text(), (self.folder / there / name).read_text(),
                             f"{here}/{name}")

    def test_shards_and_configurations_give_the_same_bytes(self):
        for command, options, other, field in RUNS[PROGRAM.name]:
            with self.subTest(command=command, options=options):
                options = shlex.split(options)
                self.run_program(command, *options, "--out", "whole", "--restart")
                for count in COUNTS:
                    for k in range(1, count + 1):
                        self.run_program(command, *options, "--shard", f"{k}/{count}", "--out", f"in{count}/{k}", "--restart")
                    (self.folder / f"merged{count}/ledger.jsonl").unlink(missing_ok=True)
                    self.run_program("merge", f"in{count}", "--out", f"merged{count}")
                    self.compare(f"merged{count}", "whole")
                self.rerun_the_worst("whole")
                # From its own configuration alone, and with one value of it overruled.
                self.run_program(command, "--config", "whole/run.toml", "--out", "again", "--restart")
                self.compare("again", "whole")
                error = self.run_program(command, "--config", "whole/run.toml", other, "--out", "again", fails=True)
                self.assertIn(f"was begun with other settings: {field}", error)


if __name__ == "__main__":
    unittest.main()
