"""Results of each method on the Pusher, against a recorded run: a DFR that never moves fails here, and so does a
guided recovery that never filters.

usage: performance_test.py PROGRAM
"""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAM = pathlib.Path(sys.argv.pop(1)).resolve()
# Bounds per learner and method: completed and collided, %, and the minimum number of recovery controls per episode.
# `pusher experiment --seed 9201 --trials 2 --episodes 60 --demonstrations 20,60,120` printed the figures in the
# comments. The bounds allow for rounding and four standard errors of 360 episodes, with the recorded trials' variance.
RECORDED = {
    # learner, method: ((completed), (collided), recovery controls)
    ("8", "baseline"): ((12, 36), (27, 53), 0),  # 24.2, 40.0
    ("8", "early-stopping"): ((4, 23), (0, 8), 0),  # 13.3, 3.1
    ("8", "dfr"): ((8, 29), (1, 16), 100),  # 18.1, 8.1
    ("8", "controller"): ((96, 100), (0, 1), 1),  # 99.4, 0.0
    ("64-64", "baseline"): ((90, 100), (0, 7), 0),  # 95.8, 2.5
    ("64-64", "early-stopping"): ((17, 43), (0, 3), 0),  # 30.0, 0
    ("64-64", "dfr"): ((37, 64), (0, 3), 100),  # 50.6, 0
    ("64-64", "controller"): ((97, 100), (0, 1), 0),  # 99.7, 0
}


class PerformanceTest(unittest.TestCase):
    def test_methods_stay_within_bounds_of_the_recorded_run(self):
        methods = list(dict.fromkeys(method for _, method in RECORDED))
        learners = list(dict.fromkeys(learner for learner, _ in RECORDED))
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([PROGRAM, "experiment", "--seed", "9201", "--trials", "2", "--episodes", "60",
                            "--demonstrations", "20,60,120", "--methods", ",".join(methods), "--learners",
                            ",".join(learners), "--no-video", "--no-convergence", "--out", folder],
                           check=True, capture_output=True, timeout=280)
            summary = json.loads((pathlib.Path(folder) / "summary.json").read_text())
        for cell in summary["averages"]:
            completed, collided, recovery = RECORDED[cell["learner"], cell["method"]]
            with self.subTest(learner=cell["learner"], method=cell["method"]):
                for name, (least, most) in (("completed", completed), ("collided", collided)):
                    self.assertGreaterEqual(100 * cell[name], least, name)
                    self.assertLessEqual(100 * cell[name], most, name)
                self.assertGreaterEqual(cell["recovery_controls"], recovery)


if __name__ == "__main__":
    unittest.main()
