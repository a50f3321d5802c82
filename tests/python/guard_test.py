"""dfr.Guard and dfr.GuardedEnv: a drifting policy stays inside, every doubt halts, files keep all."""

import copy
import doctest
import gc
import os
import pathlib
import pickle
import subprocess
import sys
import tempfile
import textwrap
import threading
import unittest
import warnings

import numpy as np

import dfr
from corridor import LAYOUT, Corridor, action_for, demonstrations

DRIFT = action_for(0.09, 0.06)


def fit(count=30, seed=1, **options):
    states, actions = demonstrations(seed, count)
    return dfr.Guard.fit(states, actions, layout=LAYOUT, features="obs/tip", **options)


class GuardTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_a_drifting_policy_stays_inside_and_gets_there(self):
        alone = Corridor()
        alone.reset(seed=3)
        while not alone.step(DRIFT)[2]:
            pass
        self.assertGreater(abs(alone.x[2]), 0.6)
        plant = Corridor()
        plant.reset(seed=3)
        self.guard.reset(3)
        changed = 0
        for t in range(80):
            action, info = self.guard.filter(t, plant.x, DRIFT)
            self.assertIn(info["mode"], ("policy", "recovery", "probe"), info)
            changed += info["changed"]
            if plant.step(action)[2]:
                break
        self.assertGreaterEqual(plant.x[1], 1.8)
        self.assertLess(abs(plant.x[2]), 0.6)
        self.assertGreater(changed, 0)

    def test_info_says_why(self):
        self.guard.reset()
        grid = np.linspace(-0.1, 0.1, 21)
        state = max(
            ([0.0, x, y] for x in grid for y in grid),
            key=lambda s: min(self.guard.decision(0, s), self.guard.decision(1, s)),
        )
        action, info = self.guard.filter(0, state, action_for(0.1, 0.0))
        self.assertEqual(info["mode"], "policy")
        self.assertEqual(info["reason"], "inside")
        self.assertGreaterEqual(info["g"], info["threshold"])
        # Computed by its logarithm, which rounds.
        self.assertAlmostEqual(info["g"], self.guard.decision(info["step"], state), delta=1e-15)
        self.assertIs(info["alarm"], False)
        self.assertEqual((info["step"], info["alarm_step"]), (0, 0))
        np.testing.assert_allclose(action, action_for(0.1, 0.0), atol=1e-15)
        self.assertEqual((action.dtype, action.shape), (np.float64, (2,)))

    def test_every_doubt_halts(self):
        good = np.zeros(3), action_for(0.05, 0.0)
        for reason, t, state, action in [
            ("state-invalid", 1, [0.0, np.nan, 0.0], good[1]),
            ("state-invalid", 1, [0.0, 0.0], good[1]),
            ("control-invalid", 1, good[0], [np.inf, 0.0]),
            ("control-invalid", 1, good[0], [0.0]),
            ("step-skipped", 2, *good),
            ("step-skipped", 0, *good),
            ("step-skipped", -1, *good),
        ]:
            with self.subTest(reason=reason, t=t, state=state):
                self.guard.reset()
                self.assertEqual(self.guard.filter(0, *good)[1]["mode"], "policy")
                for again in range(2):
                    safe, info = self.guard.filter(t if not again else 1, *((state, action) if not again else good))
                    self.assertEqual((info["mode"], info["reason"]), ("halt", reason))
                    np.testing.assert_array_equal(safe, [0.0, 0.0])
        fresh = self.guard.with_settings()
        safe, info = fresh.filter(0, *good)
        self.assertEqual(info["reason"], "not-reset")
        fresh.reset()
        fresh.stop()
        self.assertEqual(fresh.filter(0, *good)[1]["reason"], "stop-requested")

    def test_files_keep_all_bits_and_refuse_damage(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "task.guard"
            self.guard.save(path)
            loaded = dfr.Guard.load(str(path))
            self.assertEqual(loaded.layout, LAYOUT)
            self.assertEqual(loaded.features, "tip")
            self.assertEqual(loaded.settings, self.guard.settings)
            self.assertEqual(loaded.summary, self.guard.summary)
            x = np.random.default_rng(0).normal(size=(50, 3))
            np.testing.assert_array_equal(
                loaded.decision(np.arange(50) % 25, x), self.guard.decision(np.arange(50) % 25, x)
            )
            content = path.read_bytes()
            for damaged in (content[:-1], content[: len(content) // 2], b"", content[:200] + b"x" + content[201:]):
                path.write_bytes(damaged)
                with self.assertRaisesRegex(RuntimeError, "task.guard"):
                    dfr.Guard.load(path)

    def test_decision_takes_one_or_many(self):
        x = np.random.default_rng(1).normal(size=(40, 3))
        t = np.arange(40) % 30
        each = [self.guard.decision(int(s), row) for s, row in zip(t, x)]
        np.testing.assert_array_equal(self.guard.decision(t, x), each)
        np.testing.assert_array_equal(self.guard.decision(4, x), [self.guard.decision(4, row) for row in x])
        self.assertEqual(self.guard.decision(0, [0.0, np.nan, 0.0]), -np.inf)
        with self.assertRaisesRegex(ValueError, "states of 2 entries; the guard has 3"):
            self.guard.decision(0, np.zeros((3, 2)))
        with self.assertRaisesRegex(ValueError, "one time step, or one for each row"):
            self.guard.decision([0, 1], np.zeros((3, 3)))

    def test_time_steps_of_any_size_are_not_wrapped(self):
        good = np.zeros(3), action_for(0.05, 0.0)
        for t in (2**31, 2**32, 2**40, 2**70, -(2**40), np.int64(2**32)):
            with self.subTest(t=t):
                self.guard.reset()
                self.assertEqual(self.guard.filter(t, *good)[1]["reason"], "step-skipped")
        last = self.guard.num_steps - 1
        x = np.zeros((2, 3))
        support = dfr.TimeVaryingSupport.fit(demonstrations(1, 5)[0])
        for decide in (self.guard.decision, support.decision):
            np.testing.assert_array_equal(decide(np.array([2**32, -(2**40)]), x), decide(np.array([last, 0]), x))
            with self.assertRaisesRegex(ValueError, "t must hold integers"):
                decide(np.array([0.5, 1.0]), x)
            with self.assertRaisesRegex(ValueError, "t must hold integers"):
                decide(np.array([2**70, 0]), x)

    def test_pickles_and_copies_keep_knowledge_and_settings_and_need_a_reset(self):
        guard = self.guard.with_settings(strategy="monitor", action_limit=0.5)
        guard.reset()
        x = np.random.default_rng(0).normal(size=(50, 3))
        before = set(os.listdir(tempfile.gettempdir()))
        for twin in (pickle.loads(pickle.dumps(guard)), copy.copy(guard), copy.deepcopy(guard)):
            self.assertEqual((twin.settings, twin.summary, twin.layout), (guard.settings, guard.summary, guard.layout))
            np.testing.assert_array_equal(twin.decision(3, x), guard.decision(3, x))
            self.assertEqual(twin.filter(0, np.zeros(3), DRIFT)[1]["reason"], "not-reset")
        left = {name for name in set(os.listdir(tempfile.gettempdir())) - before if name.startswith("dfr-")}
        self.assertEqual(left, set())
        content = pickle.dumps(guard)
        with self.assertRaises((RuntimeError, pickle.UnpicklingError, ValueError)):
            pickle.loads(content.replace(b"guard", b"guarf").replace(b"monitor", b"monitos"))

    def test_worker_processes_get_guards(self):
        """A child process with only the pickle runs the same episode."""
        script = """
            import pickle, sys
            sys.path.insert(0, sys.argv[1])
            from corridor import Corridor, action_for
            guard = pickle.load(sys.stdin.buffer)
            plant = Corridor()
            plant.reset(seed=5)
            guard.reset(5)
            for t in range(30):
                plant.step(guard.filter(t, plant.x, action_for(0.09, 0.06))[0])
            print(plant.x.tolist())
        """
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(script), str(pathlib.Path(__file__).parent)],
            input=pickle.dumps(self.guard), capture_output=True, check=True,
        )
        plant = Corridor()
        plant.reset(seed=5)
        self.guard.reset(5)
        for t in range(30):
            plant.step(self.guard.filter(t, plant.x, DRIFT)[0])
        self.assertEqual(eval(done.stdout), plant.x.tolist())

    def test_no_object_comes_without_its_content(self):
        for cls in (dfr.Guard, dfr.FitSummary, dfr.SupportEstimate, dfr.TimeVaryingSupport):
            for make in (lambda: cls.__new__(cls), lambda: object.__new__(cls), cls):
                with self.subTest(cls.__name__), self.assertRaises(TypeError):
                    make()

    def test_settings_and_strategies(self):
        monitor = self.guard.with_settings(strategy="monitor", action_limit=0.5)
        self.assertEqual(monitor.settings["strategy"], "monitor")
        self.assertEqual(self.guard.settings["strategy"], "guard")
        plant = Corridor()
        plant.reset(seed=0)
        monitor.reset()
        alarms = []
        for t in range(20):
            action, info = monitor.filter(t, plant.x, [0.2, 0.3])
            np.testing.assert_array_equal(action, [0.2, 0.3])
            alarms.append(info["alarm"])
            plant.step(action)
        self.assertFalse(alarms[0])
        self.assertTrue(alarms[-1])
        stopping = self.guard.with_settings(strategy="early-stopping")
        stopping.reset()
        self.assertEqual(stopping.filter(0, [0.0, 0.0, 0.9], [0.1, 0.1])[1]["reason"], "outside-support")
        with self.assertRaisesRegex(ValueError, "unknown strategy 'brave'"):
            self.guard.with_settings(strategy="brave")

    def test_a_certified_guard_applies_what_it_certifies(self):
        guard = fit(40, strategy="certified")
        self.assertEqual(guard.settings["strategy"], "certified")
        self.assertEqual(guard.settings["direction_error"], 2.0 * guard.summary["direction_error"])
        plant = Corridor()
        plant.reset(seed=3)
        guard.reset(3)
        certified = 0
        for t in range(40):
            action, info = guard.filter(t, plant.x, DRIFT)
            self.assertNotEqual(info["reason"], "assumption-violated")
            if info["mode"] == "halt":
                break
            self.assertTrue(info["certified"])
            self.assertFalse(info["alarm"])
            certified += 1
            plant.step(action)
        self.assertGreater(certified, 10)

    def test_certify_tells_what_passes_and_by_how_much(self):
        state = [0.0, 0.0, 0.0]
        small = self.guard.certify(0, state, action_for(0.1, 0.0))
        self.assertTrue(small["passes"])
        self.assertGreaterEqual(small["margin"], 0.0)
        self.assertGreater(small["radius"], 0.0)
        self.assertGreaterEqual(small["ball_radius"], small["radius"])
        self.assertEqual(small["effect"].shape, (2,))
        large = self.guard.certify(0, state, action_for(5.0, 5.0))
        self.assertFalse(large["passes"])
        self.assertLess(large["margin"], 0.0)
        outside = self.guard.certify(0, [0.0, 0.0, 3.0], action_for(0.1, 0.0))
        self.assertLess(outside["radius"], 0.0)
        with self.assertRaisesRegex(ValueError, "action has 1 entries"):
            self.guard.certify(0, state, [0.0])

    def test_the_order_of_demonstrations_changes_nothing(self):
        states, actions = demonstrations(1, 20)
        ours = dfr.Guard.fit(states, actions, layout=LAYOUT, features="tip", hold_out=0.3, confidence=0.5)
        theirs = dfr.Guard.fit(
            states[::-1], actions[::-1], layout=LAYOUT, features="tip", hold_out=0.3, confidence=0.5
        )
        self.assertEqual(ours.settings, theirs.settings)
        self.assertEqual(ours.summary["held_out"], 6)
        self.assertEqual(ours.summary["support_fits"], 11)
        np.testing.assert_array_equal(ours.levels(states[0]), theirs.levels(states[0]))

    def test_alarms_on_demonstrations_are_few(self):
        states, _ = demonstrations(2, 200)
        level = -self.guard.settings["alarm_level"]
        alarms = sum(self.guard.levels(x).min() < level for x in states)
        # .1 promised on the average over sets of 30 demonstrations; sqrt(.1 .9 / 32) = .053 is the
        # scatter between sets. Three of these.
        self.assertLess(alarms / 200, 0.1 + 3 * 0.053)

    def test_wrong_demonstrations_are_named(self):
        states, actions = demonstrations(1, 4)
        bad = [x.copy() for x in states]
        bad[2][3, 1] = np.nan
        for s, a, message in [
            (bad, actions, "demonstration 2 has a non-finite entry in state 3"),
            (states, actions[:-1], "4 arrays of states and 3 of actions"),
            (states, [u[:-1] for u in actions], "21 states and 19 actions"),
            ([], [], "no demonstrations"),
            (states[:2], actions[:2], "at least 3 demonstrations"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                dfr.Guard.fit(s, a, layout=LAYOUT, features="tip")
        with self.assertRaisesRegex(ValueError, "feature 'gripper' is not part of the state"):
            dfr.Guard.fit(states, actions, layout=LAYOUT, features="gripper")

    def test_arrays_of_many_kinds_make_the_same_guard(self):
        class Tensor:  # as torch's, on a device and with a tape
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
            (None, "a list of arrays is needed, one a demonstration, not None"),
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
            ({"layout": [("tip", 1), ("tip", 2)]}, "names 'tip' twice"),
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
        states, actions = [], []
        for _ in range(12):
            x, u = np.zeros((31, 2)), np.zeros((30, 2))
            x[0], goal = rng.normal(size=2), rng.normal(size=2)
            for t in range(30):
                u[t] = x[t] + 0.2 * (goal - x[t])
                x[t + 1] = u[t]
            states.append(x)
            actions.append(u)
        with self.assertRaisesRegex(ValueError, r"actions 0, 1 take the values of state\[0\], state\[1\]"):
            dfr.Guard.fit(states, actions)
        converted = dfr.Guard.fit(states, actions, differences=True)
        by_hand = dfr.Guard.fit(states, [u - x[:-1] for x, u in zip(states, actions)])
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

    def test_threads_have_guards_of_their_own(self):
        def run(guard, out):
            plant = Corridor()
            plant.reset(seed=5)
            guard.reset(5)
            for t in range(30):
                action, _ = guard.filter(t, plant.x, DRIFT)
                plant.step(action)
            out.append(plant.x.copy())

        results = []
        threads = [threading.Thread(target=run, args=(self.guard.with_settings(), results)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for result in results[1:]:
            np.testing.assert_array_equal(result, results[0])

    def test_actions_outlive_the_guard(self):
        guard = fit(8)
        guard.reset()
        action, _ = guard.filter(0, np.zeros(3), DRIFT)
        before = action.copy()
        del guard
        gc.collect()
        np.testing.assert_array_equal(action, before)


def turning(seed, count, turn):
    """The corridor with `turn(angle)` in place of the clock; a third action turns."""
    rng = np.random.default_rng(seed)
    states, actions = demonstrations(seed, count)
    turned = []
    for x, u in zip(states, actions):
        rates = 0.06 + 0.02 * rng.normal(size=len(u))
        angles = 0.1 * rng.normal() + np.concatenate([[0.0], np.cumsum(rates)])
        turned.append((np.c_[x[:, 1:], [turn(a) for a in angles]], np.c_[u, rates]))
    return [x for x, _ in turned], [u for _, u in turned]


class RotationsTest(unittest.TestCase):
    LAYOUT = [("tip", 2), ("quat", 4)]

    @staticmethod
    def quaternion(angle):
        return [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]

    def test_a_quaternion_and_its_negative_are_one_and_zeros_halt_by_name(self):
        states, actions = turning(1, 20, self.quaternion)
        guard = dfr.Guard.fit(states, actions, layout=self.LAYOUT)
        flipped = states[0] * [1, 1, -1, -1, -1, -1]
        np.testing.assert_array_equal(guard.levels(states[0]), guard.levels(flipped))
        same = pickle.loads(pickle.dumps(guard))
        np.testing.assert_array_equal(guard.levels(states[0]), same.levels(flipped))
        guard.reset()
        self.assertIsNone(guard.filter(0, states[0][0], actions[0][0])[1]["entry"])
        _, info = guard.filter(1, states[0][1] * [1, 1, 0, 0, 0, 0], actions[0][1])
        self.assertEqual((info["mode"], info["reason"]), ("halt", "quaternion-invalid"))
        self.assertEqual(info["entry"], "quat[0:4]")

    def test_an_angle_that_goes_all_the_way_round_is_warned_of(self):
        states, actions = turning(1, 20, lambda a: [np.angle(np.exp(12j * a))])
        with self.assertWarnsRegex(UserWarning, r"angle\[0\] is an angle that jumps by 6.28"):
            guard = dfr.Guard.fit(states, actions, layout=[("tip", 2), ("angle", 1)], accept_any=True)
        self.assertTrue(any("angle[0]" in w for w in guard.summary["warnings"]))


class WarningsTest(unittest.TestCase):
    def test_weaknesses_of_a_guard_are_warnings_and_in_the_summary(self):
        states, actions = demonstrations(1, 4)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            guard = dfr.Guard.fit(states, actions, layout=LAYOUT, features="tip")
        self.assertEqual([str(w.message) for w in caught], guard.summary["warnings"])
        self.assertTrue(all(w.category is UserWarning and w.filename == __file__ for w in caught))
        self.assertIn("4 demonstrations cannot tell", guard.summary["warnings"][0])

    def test_a_good_guard_warns_of_nothing(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            guard = dfr.Guard.fit(*demonstrations(1, 40), layout=LAYOUT, features="tip", action_limit=0.2)
        self.assertEqual(guard.summary["warnings"], [])
        self.assertLess(guard.summary["changed"], 0.3)
        self.assertLessEqual(guard.summary["ends_outside"], guard.summary["changed"])
        self.assertTrue(guard.settings["demonstrated"])
        self.assertFalse(guard.with_settings(demonstrated=False).settings["demonstrated"])

    def test_features_with_which_nothing_is_inside_are_refused(self):
        rng = np.random.default_rng(1)
        states, actions = demonstrations(1, 12)
        noisy = [np.c_[x, rng.normal(size=(len(x), 30))] for x in states]
        layout = LAYOUT + [("noise", 30)]
        with self.assertRaisesRegex(ValueError, r"inside would be with .*tip \("):
            dfr.Guard.fit(noisy, actions, layout=layout)
        with self.assertWarns(UserWarning):
            dfr.Guard.fit(noisy, actions, layout=layout, accept_any=True)


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
            loaded = dfr.load_demonstrations(path)
            self.assertEqual(loaded.layout, LAYOUT)
            self.assertEqual(loaded.completed, [i != 2 for i in range(6)])
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


class GuardedEnvTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_an_episode_in_gymnasiums_shape(self):
        for as_dict in (False, True):
            env = dfr.GuardedEnv(Corridor(as_dict), self.guard)
            obs, info = env.reset(seed=3, options="given")
            self.assertEqual(info, {"options": "given"})
            for _ in range(80):
                obs, reward, terminated, truncated, info = env.step(DRIFT)
                self.assertFalse(info["hit"])
                self.assertEqual(info["action"].shape, (2,))
                if terminated or truncated:
                    break
            self.assertTrue(terminated)
            self.assertFalse(truncated)

    def test_a_halt_truncates_with_action_zero(self):
        env = dfr.GuardedEnv(Corridor(), self.guard)
        env.reset(seed=0)
        x = env.x.copy()
        _, _, _, truncated, info = env.step([np.nan, 0.0])
        self.assertTrue(truncated)
        self.assertEqual(info["guard"]["reason"], "control-invalid")
        np.testing.assert_array_equal(env.x[1:], x[1:])
        env.reset(seed=0)
        self.assertEqual(env.step(action_for(0.05, 0.0))[4]["guard"]["mode"], "policy")

    def test_limits_are_one_for_all_or_one_each(self):
        for limit in (0.05, np.float32(0.05), np.array([0.05, 0.05]), (0.05, 0.05)):
            guard = self.guard.with_settings(action_limit=limit)
            np.testing.assert_allclose(guard.settings["action_limit"], [0.05, 0.05], rtol=1e-6)
        for wrong in ([0.05, -1.0], [0.05, np.nan], "wide", [0.1, 0.1, 0.1]):
            with self.assertRaisesRegex((ValueError, TypeError), "action_limit"):
                self.guard.with_settings(action_limit=wrong)

    def test_action_space_bounds_what_the_guard_gives(self):
        class Space:
            def __init__(self, low, high, dtype=np.float32):
                self.low, self.high = np.array(low, dtype), np.array(high, dtype)
                self.dtype, self.shape = np.dtype(dtype), self.low.shape

        class Bounded(Corridor):
            action_space = Space([-0.08, -1.0], [0.08, 1.0])
            largest = np.zeros(2)

            def step(self, action):
                assert action.dtype == np.float32 and action.shape == (2,)
                self.largest = np.maximum(self.largest, np.abs(action))
                return super().step(action)

        self.assertGreater(self.guard.settings["action_limit"][0], 0.08)
        plant = Bounded()
        env = dfr.GuardedEnv(plant, self.guard)
        np.testing.assert_array_equal(
            env.guard.settings["action_limit"],
            np.minimum(self.guard.settings["action_limit"], [float(np.float32(0.08)), 1.0]),
        )
        env.reset(seed=3)
        for _ in range(40):
            env.step(10 * DRIFT)
        np.testing.assert_array_less(plant.largest, np.nextafter(np.float32(env.guard.settings["action_limit"]), 1))
        self.assertIs(dfr.GuardedEnv(Corridor(), self.guard).guard, self.guard)
        for space, message in [
            (Space([-1, 0], [1, 1]), r"entry 1 .* \[0, 1\]: a guard needs room on both sides of zero"),
            (Space([-1, -1], [1, 1], np.int64), "continuous actions"),
        ]:
            plant.action_space = space
            with self.assertRaisesRegex(ValueError, message):
                dfr.GuardedEnv(plant, self.guard)

    def test_environments_with_their_guards_are_pickled(self):
        env = dfr.GuardedEnv(Corridor(), self.guard)
        env.reset(seed=2)
        twin = pickle.loads(pickle.dumps(env))
        for one in (env, twin):
            one.reset(seed=2)
        np.testing.assert_array_equal(env.step(DRIFT)[0], twin.step(DRIFT)[0])

    def test_with_gymnasium_it_is_one_of_its_wrappers(self):
        """Runs with a stand-in for gymnasium.Wrapper, checked against Gymnasium 1.2."""
        script = f"""
            import pickle, sys
            sys.path[:0] = [{str(pathlib.Path(__file__).parent / "stand_ins")!r}, {str(pathlib.Path(__file__).parent)!r}]
            import gymnasium
            import numpy as np
            import dfr
            from corridor import LAYOUT, Corridor, action_for, demonstrations

            class Env(Corridor, gymnasium.Env):
                action_space = gymnasium.Box(-0.25, 0.25, (2,))
                observation_space = gymnasium.Box(-np.inf, np.inf, (3,))

            guard = dfr.Guard.fit(*demonstrations(1, 20), layout=LAYOUT, features="tip")
            env = gymnasium.TimeLimit(dfr.GuardedEnv(Env(), guard), 7)
            assert isinstance(env.env, gymnasium.Wrapper) and isinstance(env.env, dfr.GuardedEnv)
            assert env.action_space is Env.action_space and isinstance(env.unwrapped, Env)
            gymnasium.check_determinism(env, action_for(0.09, 0.06).astype(np.float32))
            env.reset(seed=0)
            for _ in range(7):
                truncated = env.step(action_for(0.05, 0.0))[3]
            assert truncated
            assert env.get_wrapper_attr("guard").settings["action_limit"] == [min(0.25, c) for c in guard.settings["action_limit"]]
            assert not hasattr(env.env, "as_dict")  # as in all of Gymnasium's wrappers
            assert env.get_wrapper_attr("as_dict") is False
            shaped = dfr.GuardedEnv(Corridor(), guard)  # no gymnasium.Env
            assert isinstance(shaped, gymnasium.Env)
            shaped.reset(seed=0)
            assert shaped.step(action_for(0.05, 0.0))[4]["guard"]["mode"] != "halt"
            assert shaped.get_wrapper_attr("x")[0] == 1
            for one in (env, shaped):
                pickle.loads(pickle.dumps(one)).reset(seed=0)
        """
        done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_path_is_no_guard(self):
        with self.assertRaisesRegex(TypeError, r"guard must be a dfr.Guard, not 'task.guard': dfr.Guard.load"):
            dfr.GuardedEnv(Corridor(), "task.guard")

    def test_own_states(self):
        env = dfr.GuardedEnv(Corridor(as_dict=True), self.guard, state=lambda obs: [0.0, *obs["tip"]])
        env.reset(seed=1)
        self.assertEqual(env.step(action_for(0.05, 0.0))[4]["guard"]["mode"], "policy")

        class Other(Corridor):
            def _observe(self):
                return {"position": self.x}

        with self.assertRaisesRegex(ValueError, "no clock, tip; it has position. Give GuardedEnv"):
            dfr.GuardedEnv(Other(), self.guard).reset(seed=0)


class Documentation(unittest.TestCase):
    def test_docstrings_run(self):
        self.assertEqual(doctest.testmod(sys.modules["dfr._guarded_env"]).failed, 0)
        names = ("fit", "load", "save", "filter", "applied", "filter_chunk", "explain", "reset", "decision", "levels")
        for name in names:
            self.assertTrue(getattr(dfr.Guard, name).__doc__, name)


if __name__ == "__main__":
    unittest.main()
