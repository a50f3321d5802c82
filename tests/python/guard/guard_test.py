"""dfr.Guard: a drifting policy stays inside, every invalid input halts, and files keep all data."""

import copy
import doctest
import os
import pathlib
import pickle
import subprocess
import sys
import tempfile
import textwrap
import threading
import unittest
import unittest.mock

import numpy as np

import dfr
from corridor import LAYOUT, Corridor, action_for, demonstrations
from corridor_guard import DRIFT, fit


class GuardTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_a_drifting_policy_stays_inside_and_reaches_the_goal(self):
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

    def test_info_gives_the_reason(self):
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
        # g is computed from its logarithm, which causes rounding.
        self.assertAlmostEqual(info["g"], self.guard.decision(info["step"], state), delta=1e-15)
        self.assertIs(info["alarm"], False)
        self.assertEqual((info["step"], info["alarm_step"]), (0, 0))
        np.testing.assert_allclose(action, action_for(0.1, 0.0), atol=1e-15)
        self.assertEqual((action.dtype, action.shape), (np.float64, (2,)))

    def test_every_invalid_call_halts_and_says_why(self):
        good = np.zeros(3), action_for(0.05, 0.0)
        skipped = "halted: t was not the next one: a call was lost or doubled"
        for reason, why, t, state, action in [
            ("state-invalid", "halted: tip[0] of the state is nan", 1, [0.0, np.nan, 0.0], good[1]),
            ("state-invalid", "halted: the state has 2 entries; the guard needs 3", 1, [0.0, 0.0], good[1]),
            ("state-invalid", "halted: the state has 2 entries; the guard needs 3", 1, [[0.0, 0.0]], good[1]),
            ("control-invalid", "halted: entry 1 of the action is -inf", 1, good[0], [0.1, -np.inf]),
            ("control-invalid", "halted: the action has 3 entries; the guard needs 2", 1, good[0], [0.1, 0.1, 0.1]),
            ("step-skipped", skipped, 2, *good),
            ("step-skipped", skipped, 0, *good),
            ("step-skipped", skipped, -1, *good),
        ]:
            with self.subTest(reason=reason, t=t, state=state):
                self.guard.reset()
                first = self.guard.filter(0, *good)[1]
                self.assertEqual((first["mode"], first["why"]), ("policy", ""))
                for again in range(2):
                    safe, info = self.guard.filter(t if not again else 1, *((state, action) if not again else good))
                    self.assertEqual((info["mode"], info["reason"]), ("halt", reason))
                    np.testing.assert_array_equal(safe, [0.0, 0.0])
                    self.assertTrue(again or info["why"] == why, info["why"])
        self.guard.reset()
        self.assertRegex(self.guard.filter(0, good[0], [9.0, 0.0])[1]["why"], "entry 0 of the action is 9, beyond its limit")
        fresh = self.guard.with_settings()
        safe, info = fresh.filter(0, *good)
        self.assertEqual((info["reason"], info["why"]), ("not-reset", "halted: reset was not called"))
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
            for damaged in (content[:-1], content[:200] + b"x" + content[201:]):
                path.write_bytes(damaged)
                with self.assertRaisesRegex(RuntimeError, "task.guard"):
                    dfr.Guard.load(path)

    def test_a_source_is_decoded_as_names_of_files_are(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "task.guard"
            fit(source="demos_of_x.hdf5").save(path)
            content = path.read_bytes()[:-8].replace(b"of_x", b"of_\xff")
            checksum = 0xCBF29CE484222325  # FNV-1a
            for byte in content:
                checksum = (checksum ^ byte) * 0x100000001B3 % 2**64
            path.write_bytes(content + checksum.to_bytes(8, "little"))
            self.assertEqual(os.fsencode(dfr.Guard.load(path).summary["source"]), b"demos_of_\xff.hdf5")

    def test_errors_escape_bytes_that_are_not_utf8(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.fsencode(folder) + b"/\xff.guard"
            with open(path, "wb") as file:
                file.write(b"none of ours")
            for load in (dfr.Guard.load, dfr.TimeVaryingSupport.load, dfr.load_demonstrations):
                with self.assertRaisesRegex(RuntimeError, r"/\\xff.guard: "):
                    load(os.fsdecode(path))
        for spaces in range(3):  # the message is cut by bytes, and é has two bytes
            with self.assertRaisesRegex(TypeError, "alarm_level must be a number, not ' *é+"):
                self.guard.with_settings(alarm_level=" " * spaces + "é" * 100)

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
            np.testing.assert_array_equal(decide(np.array([2**32, 0]), x), decide(np.array([last, 0]), x))
            with self.assertRaisesRegex(ValueError, "t must hold integers"):
                decide(np.array([0.5, 1.0]), x)
            with self.assertRaisesRegex(ValueError, "t must hold integers"):
                decide(np.array([2**70, 0]), x)
            with self.assertRaisesRegex(ValueError, "t must not be negative, as -1 is: time steps begin at 0"):
                decide(-1, x[0])
            with self.assertRaisesRegex(ValueError, "t must not be negative"):
                decide(np.array([0, -(2**40)]), x)
            self.assertEqual(decide(2**40, x[0]), decide(last, x[0]))
            self.assertEqual(decide(np.uint64(2**64 - 1), x[0]), decide(last, x[0]))
        np.testing.assert_array_equal(support.gradient(2**40, x[0])[1], support.gradient(last, x[0])[1])
        self.assertEqual(support.lipschitz_bound(2**40), support.lipschitz_bound(last))
        self.assertEqual(support.at(2**40).rho, support.at(last).rho)
        for of_step in (support.at, support.lipschitz_bound):
            with self.assertRaisesRegex(ValueError, "t must not be negative, as -1 is"):
                of_step(-1)
        for decide in (self.guard.decision, support.decision):
            self.assertEqual(decide([], np.zeros((0, 3))).shape, (0,))
        for t in (2**31 - 1, 2**40, 2**70):
            self.assertEqual(self.guard.explain(x[0], t=t, demonstrations=[x])["step"], last)
            self.assertEqual(self.guard.certify(t, *good)["margin"], self.guard.certify(last, *good)["margin"])
        for advise in (lambda: self.guard.explain(x[0], t=-1), lambda: self.guard.certify(-1, *good)):
            with self.assertRaisesRegex(ValueError, "t must not be negative, as -1 is"):
                advise()

    def test_numbers_that_nothing_can_hold_are_named(self):
        guard = self.guard.with_settings()
        guard.reset()
        with self.assertRaisesRegex(ValueError, f"t is {2**40}, but the next call of filter has t = 0"):
            guard.filter_chunk(2**40, np.zeros(3), [[0.0, 0.0]])
        self.assertEqual(self.guard.with_settings(action_limit=np.array(0.2)).settings["action_limit"], [0.2, 0.2])
        for zero in (0, 0.0, np.array(0.0), [0.0, 0.0]):
            with self.assertRaisesRegex(ValueError, "action_limit is zero in all entries"):
                self.guard.with_settings(action_limit=zero)
        for huge in (10**400, 10**5000):
            with self.assertRaisesRegex(ValueError, "too large for double precision"):
                self.guard.decision(0, [huge, 0, 0])

    def test_pickles_and_copies_keep_fit_and_settings_and_need_a_reset(self):
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
        with self.assertRaisesRegex(RuntimeError, "^pickled guard: is not a file written by dfr$"):
            dfr.Guard._from_state(b"none of ours")
        with unittest.mock.patch.dict(os.environ, {"TMPDIR": "/proc/none"}):
            with self.assertRaisesRegex(RuntimeError, "set TMPDIR to a folder that you may write to"):
                pickle.dumps(guard)

    def test_no_object_is_made_without_content(self):
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

    def test_certify_reports_whether_an_action_passes_and_its_margin(self):
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

    def test_guards_in_different_threads_are_independent(self):
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


class Documentation(unittest.TestCase):
    def test_docstrings_run(self):
        self.assertEqual(doctest.testmod(sys.modules["dfr._guarded_env"]).failed, 0)
        names = ("fit", "load", "save", "filter", "applied", "filter_chunk", "explain", "reset", "decision", "levels")
        for name in names:
            self.assertTrue(getattr(dfr.Guard, name).__doc__, name)


class ExitTest(unittest.TestCase):
    def test_a_daemon_thread_within_a_call_does_not_abort_the_interpreter(self):
        """Each call releases the interpreter's lock, and needs it again after shutdown has begun."""
        calls = {
            "Guard.fit": "dfr.Guard.fit(states, actions, layout=LAYOUT, progress=lambda stage, share: running.set())",
            "OneClassSVM": "dfr.OneClassSVM().fit(states[0])",
            "TimeVaryingSupport": "dfr.TimeVaryingSupport.fit(states)",
            "levels": "guard.levels(states[0])",
            "save": "guard.save(path); dfr.Guard.load(path)",
        }
        with tempfile.TemporaryDirectory() as folder:
            path = str(pathlib.Path(folder) / "a.guard")
            fit(5).save(path)
            for name, call in calls.items():
                script = f"""
                    import sys
                    sys.modules["sklearn"] = None  # blocks the slowest import
                    sys.path[:0] = [{str(pathlib.Path(__file__).parent)!r}]
                    import threading
                    import dfr
                    from corridor import LAYOUT, demonstrations
                    states, actions = demonstrations(0, 8)
                    path = {path!r}
                    guard = dfr.Guard.load(path)
                    running = threading.Event()
                    def loop():
                        while True:
                            {call}
                            running.set()
                    class Last:
                        def __del__(self):  # runs while the interpreter ends; the other thread then takes the lock
                            for _ in range(3_000_000):
                                pass
                    last = Last()
                    threading.Thread(target=loop, daemon=True).start()
                    running.wait()
                """
                done = subprocess.run([sys.executable, "-W", "ignore", "-c", textwrap.dedent(script)],
                                      capture_output=True, text=True, timeout=300)
                with self.subTest(name):
                    self.assertEqual((done.returncode, done.stderr), (0, ""))


if __name__ == "__main__":
    unittest.main()
