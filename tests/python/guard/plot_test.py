"""dfr.plot draws the guard's values."""

import unittest

import matplotlib
import numpy as np

import dfr
from corridor import LAYOUT, Corridor, demonstrations
from corridor_guard import DRIFT
from dfr import plot

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402


class PlotTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states, actions = demonstrations(1, 30)
        cls.guard = dfr.Guard.fit(cls.states, actions, layout=LAYOUT, features="obs/tip")

    def episode(self, guard):
        plant = Corridor()
        x, _ = plant.reset(seed=3)
        guard.reset(3)
        infos = []
        for t in range(200):
            action, info = guard.filter(t, x, DRIFT)
            infos.append(info)
            x, _, done, cut, _ = plant.step(action)
            if done or cut or info["mode"] == "halt":
                return infos
        return infos

    def tearDown(self):
        pyplot.close("all")

    def test_an_episode_has_one_point_per_action_in_the_colour_of_its_reason(self):
        infos = self.episode(self.guard)
        ax = plot.episode(infos)
        np.testing.assert_array_equal(ax.lines[1].get_ydata(), [info["g"] for info in infos])
        drawn = {c.get_label(): len(c.get_offsets()) for c in ax.collections if c.get_label() != "alarm"}
        self.assertEqual(sum(drawn.values()), len(infos))
        for reason, count in drawn.items():
            told = [i for i in infos if (i["mode"] if i["mode"] == "halt" else i["reason"]) == reason]
            self.assertEqual(len(told), count, reason)
        self.assertIn("demonstrations", drawn)
        with self.assertRaisesRegex(ValueError, "infos is empty"):
            plot.episode([])

    def test_alarms_are_marked(self):
        monitor = self.guard.with_settings(strategy="monitor")
        infos = self.episode(monitor)
        alarms = [t for t, info in enumerate(infos) if info["alarm"]]
        self.assertTrue(alarms)
        [marks] = [c for c in plot.episode(infos).collections if c.get_label() == "alarm"]
        np.testing.assert_array_equal(marks.get_offsets()[:, 0], alarms)

    def test_levels_are_those_of_the_guard_on_the_axes_given(self):
        _, (left, right) = pyplot.subplots(1, 2)
        self.assertIs(plot.levels(self.guard, self.states, ax=left), left)
        self.assertEqual(len(right.lines), 0)
        for line, states in zip(left.lines, self.states):
            np.testing.assert_array_equal(line.get_ydata(), self.guard.levels(states))
        strayed = self.states[0] + 5.0
        [line] = plot.levels(self.guard, [strayed], ax=right).lines[:1]
        self.assertEqual(line.get_color(), "#cc3344")

    def test_features_name_the_entry_that_put_states_outside(self):
        strayed = [states + [0.0, 0.0, 0.3] for states in self.states[:5]]
        ax = plot.features(self.guard, strayed)
        bars = {label.get_text(): bar.get_width() for label, bar in zip(ax.get_yticklabels(), ax.patches)}
        self.assertEqual([label.get_text() for label in ax.get_yticklabels()][-1], "tip[1]")
        levels = np.concatenate([self.guard.levels(states) for states in strayed])
        self.assertAlmostEqual(sum(bars.values()), -levels[levels < 0].mean(), places=9)
        with self.assertRaisesRegex(ValueError, "all states are inside"):
            plot.features(self.guard, [self.states[0][:1]])
        with self.assertRaisesRegex(ValueError, "or immeasurably far outside"):
            plot.features(self.guard, [[[0.0, 0.0, 1e200]]])


if __name__ == "__main__":
    unittest.main()
