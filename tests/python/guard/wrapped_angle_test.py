"""Targets of an angle that jumps: increments in the fit and in dfr.lerobot.GuardStep take the short way."""

import pickle
import unittest
import warnings

import numpy as np

import dfr
from dfr.lerobot import GuardStep


def wrapped_targets(count, steps=20):
    """Return states (steps + 1, 2), a position and a yaw in (-pi, pi], and their targets (steps, 2) as actions."""
    rng = np.random.default_rng(2)
    states, actions = [], []
    for _ in range(count):
        x = np.zeros((steps + 1, 2))
        x[0] = 0.05 * rng.normal(), 2.6 + 0.05 * rng.normal()
        for t in range(steps):
            x[t + 1] = x[t] + [0.1 - 0.02 * rng.normal(), 0.06 + 0.02 * rng.normal()]
        x[:, 1] = np.angle(np.exp(1j * x[:, 1]))
        states.append(x)
        actions.append(x[1:].copy())
    return states, actions


class WrappedAngleTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states, cls.actions = wrapped_targets(20)
        cls.guards = [
            dfr.Guard.fit(cls.states, cls.actions, layout={"x": 1, "yaw": 1}, differences=True, features=features)
            for features in ("", "x")  # The angle may be no feature.
        ]

    def test_increments_of_a_wrapped_angle_stay_small(self):
        for guard in self.guards:
            np.testing.assert_array_equal(guard.periods, [0.0, 2 * np.pi])
            np.testing.assert_array_equal(pickle.loads(pickle.dumps(guard)).periods, guard.periods)
            self.assertLess(guard.settings["action_limit"][1], 0.3)
            self.assertEqual(guard.summary["warnings"], [])

    def test_a_target_beyond_the_end_of_a_period_is_near(self):
        for guard in self.guards:
            with self.subTest(features=guard.features):
                self.expect_near_targets(guard)

    def test_an_infinite_target_halts_without_a_warning(self):
        step = GuardStep(self.guards[0], positions=[0, 1])
        step.reset()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            after = step({"observation": {"x": [0.0], "yaw": [2.6]}, "action": [0.1, np.inf]})
        self.assertEqual(after["info"]["guard"]["mode"], "halt")

    def expect_near_targets(self, guard):
        step = GuardStep(guard.with_settings(strategy="monitor"), positions=[0, 1])
        step.reset()
        jumps = 0
        for x, target in zip(self.states[0], self.actions[0]):
            jumps += abs(target[1] - x[1]) > 3
            after = step({"observation": {"x": x[:1], "yaw": x[1:]}, "action": target})
            self.assertEqual(after["info"]["guard"]["mode"], "policy")
            np.testing.assert_allclose(after["action"], target, atol=1e-9)
        self.assertEqual(jumps, 1)
        step.reset()
        step.guard.stop()  # the present pose, not one a revolution away
        x = np.array([0.5, 3.1])
        after = step({"observation": {"x": x[:1], "yaw": x[1:]}, "action": [0.6, -3.1]})
        np.testing.assert_array_equal(after["action"], x)


if __name__ == "__main__":
    unittest.main()
