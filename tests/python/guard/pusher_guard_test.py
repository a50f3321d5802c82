"""A guard around a scripted policy on the Pusher, from Python: the same bits as in C++.

usage: pusher_guard_test.py PUSHER GUARD

Demonstrations are those of the program `pusher`, read by h5py, and the guard is that of the program
`guard`.
"""

import pathlib
import subprocess
import sys
import tempfile
import unittest

import h5py
import numpy as np

import dfr
from pusher_plant import PusherPlant, rollout

PUSHER, GUARD = (pathlib.Path(p).resolve() for p in sys.argv[1:3])
del sys.argv[1:3]
SEEDS = 30


def control(weights, x):
    """Add the terms one by one: matrix products use another order."""
    u = []
    for row in weights:
        total = row[0]
        for weight, entry in zip(row[1:], x):
            total += weight * entry
        u.append(total)
    return u


class PusherGuardTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)
        cls.run_program(PUSHER, "demonstrate", "--count", 40, "--out", "demos.hdf5")
        cls.run_program(GUARD, "fit", "demos.hdf5", "--features", "obs/object[0:2],obs/tip,obs/tip_tilt", "-o", "pusher.guard")
        cls.weights = cls.regress(cls.folder / "demos.hdf5", dfr.Guard.load(cls.folder / "pusher.guard").layout)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    @classmethod
    def run_program(cls, *arguments):
        return subprocess.run(
            [str(a) for a in arguments], cwd=cls.folder, text=True, capture_output=True, check=True, timeout=200
        ).stdout

    @staticmethod
    def regress(path, layout):
        """The scripted policy: actions are a linear function of the cylinder's position, and the arm is ignored."""
        with h5py.File(path) as file:
            demos = list(file["data"].values())
            objects = np.vstack([d["obs/object"][:] for d in demos])
            u = np.vstack([d["actions"][:] for d in demos])
        x = np.hstack([np.ones((len(objects), 1)), objects])
        fitted = np.linalg.lstsq(x, u, rcond=None)[0].T
        sizes = dict(layout)
        first = 1 + sum(sizes[name] for name in list(sizes)[: list(sizes).index("object")])
        weights = np.zeros((u.shape[1], 1 + sum(sizes.values())))
        weights[:, 0] = fitted[:, 0]
        weights[:, first : first + sizes["object"]] = fitted[:, 1:]
        return weights

    def rollout(self, plant, guard, seed):
        plant.reset(seed)
        if guard is not None:
            guard.reset(seed)
        for t in range(100_000):
            if plant.collided:
                return "collided", t
            if plant.completed:
                return "completed", t
            x = plant.observe()
            action = control(self.weights, x)
            if guard is not None:
                action, info = guard.filter(t, x, action)
                if info["mode"] == "halt":
                    return "halted", t
            elif t >= 60:
                return "halted", t
            self.assertTrue(plant.apply(action))

    def test_the_same_outcomes_as_in_cpp(self):
        guard = dfr.Guard.load(self.folder / "pusher.guard")
        plant = PusherPlant()
        outcomes = []
        for seed in range(SEEDS):
            outcome, controls, state = rollout(str(self.folder / "pusher.guard"), self.weights, seed)
            with self.subTest(seed=seed):
                self.assertEqual(self.rollout(plant, guard, seed), (outcome, controls))
                np.testing.assert_array_equal(plant.observe(), state)
            outcomes.append(outcome)
        alone = [self.rollout(plant, None, seed)[0] for seed in range(SEEDS)]
        print("guarded:", {o: outcomes.count(o) for o in sorted(set(outcomes))})
        print("alone:  ", {o: alone.count(o) for o in sorted(set(alone))})
        # Such a crude policy collides in most episodes. With the guard it completes or halts.
        self.assertGreater(alone.count("collided"), SEEDS // 2)
        self.assertEqual(outcomes.count("collided"), 0)
        self.assertGreater(outcomes.count("completed"), alone.count("completed"))


if __name__ == "__main__":
    unittest.main()
