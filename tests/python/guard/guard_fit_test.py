"""dfr.Guard.fit: arrays of many kinds, wrong demonstrations, rotations, warnings and files."""

import gc
import pathlib
import tempfile
import unittest
import warnings

import numpy as np

import dfr
from corridor import LAYOUT, demonstrations
from corridor_guard import DRIFT, fit


class GuardFitTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_wrong_demonstrations_are_named(self):
        states, actions = demonstrations(1, 4)
        bad = [x.copy() for x in states]
        bad[2][3, 1] = np.nan
        huge = [x.copy() for x in states]
        huge[2][3, 1] = -1e300
        for s, a, message in [
            (bad, actions, "demonstration 2 has a non-finite entry in state 3"),
            (huge, actions, r"demonstration 2 has -1e\+300 as entry 1 of state 3, where \+-3.40282e\+38 is the limit"),
            (states, [1e300 * u for u in actions], r"demonstration 0 has .*e\+298 as entry \d of action 0, where"),
            (states, actions[:-1], "4 arrays of states and 3 of actions"),
            (states, [u[:-1] for u in actions], "21 states and 19 actions"),
            (states, [u[:, :0] for u in actions], "demonstration 0 has actions without entries"),
            ([], [], "no demonstrations"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                dfr.Guard.fit(s, a, layout=LAYOUT, features="tip")

    def test_arrays_of_many_kinds_make_the_same_guard(self):
        class Tensor:  # like torch's, on a device and with a gradient
            def __init__(self, values):
                self.values = values

            def __array__(self, dtype=None):
                raise TypeError("can't convert cuda:0 device type tensor to numpy")

            def detach(self):
                return self

            def cpu(self):
                return self.values

        states, actions = demonstrations(1, 6)
        ragged = np.empty(6, dtype=object)
        ragged[:] = states
        for name, s, a in [
            ("lists", [x.tolist() for x in states], [u.tolist() for u in actions]),
            ("generators", (x for x in states), (u for u in actions)),
            ("one array", np.stack(states), np.stack(actions)),
            ("an array of arrays", ragged, tuple(actions)),
            ("strided", [np.repeat(x, 2, axis=0)[::2] for x in states], [np.asfortranarray(u) for u in actions]),
            ("big-endian", [x.astype(">f8") for x in states], [u.astype(">f8") for u in actions]),
            ("tensors", [Tensor(x) for x in states], [Tensor(u) for u in actions]),
        ]:
            with self.subTest(name):
                guard = dfr.Guard.fit(s, a, layout=LAYOUT, features="tip")
                np.testing.assert_array_equal(
                    guard.levels(states[0]), dfr.Guard.fit(states, actions, layout=LAYOUT, features="tip").levels(states[0])
                )
        other = dfr.Guard.fit(states, actions, layout=dict(LAYOUT), features=["tip[0:1]", "tip[1:2]"])
        self.assertEqual(other.features, "tip[0:1],tip[1:2]")
        for dtype in ("f4", "f2", "i8", "bool"):
            with self.subTest(dtype):
                guard.levels(states[0].astype(dtype))

    def test_arrays_without_numbers_are_named_in_one_line(self):
        states, actions = demonstrations(1, 6)
        masked = np.ma.masked_array(states[2], mask=np.eye(21, 3, dtype=bool))
        for s, message in [
            (None, "a list of arrays is needed, one per demonstration, not None"),
            ("demos.hdf5", "not 'demos.hdf5' of type str"),
            (dict(enumerate(states)), "of type dict"),
            (states[:2] + [[[1, 2, 3], [1, 2]]], "demonstration 2: .*rows of different lengths"),
            (states[:2] + [states[2] + 1j], "demonstration 2: .*complex numbers"),
            (states[:2] + [states[2].astype(str)], "demonstration 2: .*text"),
            (states[:2] + [masked], "demonstration 2: the array has masked entries"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(TypeError, message) as raised:
                dfr.Guard.fit(s, actions, layout=LAYOUT, features="tip")
            self.assertNotIn("\n", str(raised.exception))
            self.assertLess(len(str(raised.exception)), 250)
        for options, message in [
            ({"nu": "a"}, "nu must be a number, not 'a'"),
            ({"horizon": 1.5}, "horizon must be a whole number, not 1.5"),
            ({"features": {"tip"}}, "features must be text"),
            ({"differences": "yes"}, "differences must be True or False"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(TypeError, message):
                dfr.Guard.fit(states, actions, **{"layout": LAYOUT, **options})
        for options, message in [
            ({"layout": [("tip", 1), ("tip", 2)]}, "contains 'tip' twice"),
            ({"false_alarms": 7}, "false_alarms must lie in"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                dfr.Guard.fit(states, actions, **{"layout": LAYOUT, **options})
        self.guard.reset(None)
        with self.assertRaisesRegex(TypeError, "seed must be a whole number from 0"):
            self.guard.reset(-1)
        with self.assertRaisesRegex(TypeError, "not a dict: concatenate"):
            self.guard.filter(0, {"tip": [0.0, 0.0]}, DRIFT)

    def test_target_positions_are_refused_and_converted(self):
        rng = np.random.default_rng(4)
        states = [np.cumsum(rng.normal(size=(31, 2)), axis=0) for _ in range(12)]
        actions = [x[1:] for x in states]
        with self.assertRaisesRegex(ValueError, r"actions 0, 1 take the values of state\[0\], state\[1\]"):
            dfr.Guard.fit(states, actions)
        converted = dfr.Guard.fit(states, actions, differences=True)
        by_hand = dfr.Guard.fit(states, [np.diff(x, axis=0) for x in states])
        self.assertEqual(converted.summary, by_hand.summary)
        dfr.Guard.fit(states, actions, as_recorded=True)
        with self.assertRaisesRegex(ValueError, "nothing to convert"):
            dfr.Guard.fit(*demonstrations(1, 6), differences=True)

    def test_progress_and_its_exceptions(self):
        stages = []
        fit(8, progress=lambda stage, share: stages.append((stage, share)))
        self.assertEqual(stages[-1][1], 1.0)
        self.assertEqual([share for _, share in stages], sorted(share for _, share in stages))

        def fail(stage, share):
            raise RuntimeError("enough")

        with self.assertRaisesRegex(RuntimeError, "enough"):
            fit(8, progress=fail)


class RotationsTest(unittest.TestCase):
    def test_a_quaternion_equals_its_negative_and_a_zero_one_halts(self):
        states, actions = demonstrations(1, 20)
        turns = [0.03 * np.cumsum(np.r_[i, 1 + np.arange(20) % 3]) for i in range(20)]
        states = [np.c_[x[:, 1:], np.cos(a), 0 * a, 0 * a, np.sin(a)] for x, a in zip(states, turns)]
        actions = [np.c_[u, np.diff(a)] for u, a in zip(actions, turns)]
        guard = dfr.Guard.fit(states, actions, layout=[("tip", 2), ("quat", 4)])
        flipped = states[0] * [1, 1, -1, -1, -1, -1]
        np.testing.assert_array_equal(guard.levels(states[0]), guard.levels(flipped))
        guard.reset()
        self.assertIsNone(guard.filter(0, states[0][0], actions[0][0])[1]["entry"])
        _, info = guard.filter(1, states[0][1] * [1, 1, 0, 0, 0, 0], actions[0][1])
        self.assertEqual((info["mode"], info["reason"], info["entry"]), ("halt", "quaternion-invalid", "quat[0:4]"))


class WarningsTest(unittest.TestCase):
    def test_weaknesses_of_a_guard_are_warnings_and_in_the_summary(self):
        states, actions = demonstrations(1, 4)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            guard = dfr.Guard.fit(states, actions, layout=LAYOUT, features="tip")
        self.assertEqual([str(w.message) for w in caught], guard.summary["warnings"])
        self.assertTrue(all(w.category is UserWarning and w.filename == __file__ for w in caught))
        self.assertIn("4 demonstrations cannot show", guard.summary["warnings"][0])

    def test_a_good_guard_warns_of_nothing(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            guard = dfr.Guard.fit(*demonstrations(1, 40), layout=LAYOUT, features="tip", action_limit=0.2)
        self.assertEqual(guard.summary["warnings"], [])
        self.assertLess(guard.summary["changed"], 0.1)
        self.assertLess(guard.summary["ends_outside"], 0.3)
        self.assertTrue(guard.settings["demonstrated"])
        self.assertFalse(guard.with_settings(demonstrated=False).settings["demonstrated"])


class DemonstrationsTest(unittest.TestCase):
    def test_a_file_becomes_arrays_that_a_guard_is_fitted_to(self):
        import h5py

        states, actions = demonstrations(1, 6)
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "demos.hdf5"
            with h5py.File(path, "w") as file:
                file["mask/few"] = np.array([b"demo_1", b"demo_4"])
                for i, (x, u) in enumerate(zip(states, actions)):
                    demo = file.create_group(f"data/demo_{i}")
                    demo.attrs["num_samples"] = len(u)
                    demo["actions"] = u
                    demo["dones"] = np.arange(len(u)) == (len(u) - 1 if i != 2 else -1)
                    for name, part in (("clock", x[:, :1]), ("tip", x[:, 1:])):
                        demo[f"obs/{name}"], demo[f"next_obs/{name}"] = part[:-1], part[1:]
                    demo["obs/camera"] = np.zeros((len(u), 2, 2, 3))
            kept = dfr.load_demonstrations(path)
            self.assertEqual((len(kept.states), kept.completed), (5, [True] * 5))
            np.testing.assert_array_equal(kept.actions[2], actions[3])
            self.assertIn("1 episodes did not complete the task and are left out (all=True takes them)", kept.note)
            loaded = dfr.load_demonstrations(path, all=True)
            self.assertEqual(loaded.layout, LAYOUT)
            self.assertEqual(loaded.completed, [i != 2 for i in range(6)])
            self.assertEqual(repr(loaded), f"<dfr.Demonstrations: 6 episodes, {sum(map(len, actions))} actions, states of "
                             f"{states[0].shape[1]} entries, actions of {actions[0].shape[1]}, {loaded.environment!r}>")
            nothing = loaded._replace(states=[], actions=[])
            self.assertIn("0 episodes, 0 actions, states of 0 entries", repr(nothing))
            for i in range(6):
                np.testing.assert_array_equal(loaded.states[i], states[i])
                np.testing.assert_array_equal(loaded.actions[i], actions[i])
            few = dfr.load_demonstrations(str(path), filter_key="few")
            del loaded.states[:], loaded.actions[:]
            gc.collect()
            np.testing.assert_array_equal(few.states[1], states[4])
            guard = dfr.Guard.fit(states, actions, layout=few.layout, features="tip")
            self.assertEqual(guard.features, "tip")
            with self.assertRaisesRegex(RuntimeError, "demos.hdf5: mask/none: does not exist"):
                dfr.load_demonstrations(path, filter_key="none")
        with self.assertRaisesRegex(FileNotFoundError, "absent.hdf5"):
            dfr.load_demonstrations("absent.hdf5")


if __name__ == "__main__":
    unittest.main()
