"""Texts of dfr.Guard: reasons for changed actions, errors of calls, progress of fits; and chunks of actions."""

import io
import pathlib
import sys
import tempfile
import typing
import unittest
from unittest import mock

import numpy as np

import dfr
from corridor import Corridor, action_for, demonstrations
from corridor_guard import DRIFT, fit
from dfr import _progress

CHUNK = 8


class ChunkTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_in_shadow_mode_it_judges_actions_that_are_applied_unchanged(self):
        plant = Corridor()
        x, _ = plant.reset(seed=1)
        self.guard.reset()
        changed = []
        for t in range(15):
            action = action_for(0.0997, 0.0) if t < 5 else DRIFT
            _, info = self.guard.filter(t, x, action)
            self.guard.applied(action)
            changed.append(info["changed"])
            x = plant.step(action)[0]
        self.assertEqual(changed[:5], 5 * [False])
        self.assertTrue(changed[-1])
        with self.assertRaisesRegex(ValueError, "the action has 1 entries; the guard needs 2"):
            self.guard.applied([0.1])

    def test_bad_input_is_named(self):
        state, chunk = np.zeros(3), np.tile(action_for(0.0997, 0.0), (CHUNK, 1))
        fresh = self.guard.with_settings()
        self.assertEqual(fresh.filter_chunk(0, state, chunk), 0)  # waits for reset
        fresh.reset()
        broken = chunk.copy()
        broken[2, 1] = np.nan
        for t, x, actions, message in [
            (0, state[:2], chunk, "the state has 2 entries; the guard needs 3"),
            (0, [0.0, np.inf, 0.0], chunk, r"tip\[0\] of the state is inf"),
            (0, state, chunk[:0], "the chunk has no actions"),
            (0, state, chunk[:, :1], "actions of the chunk have 1 entries; the guard needs 2"),
            (0, state, chunk[0], r"a chunk has 2 dimensions, \(k, 2\), not 1"),
            (0, state, broken, "entry 1 of action 2 is nan"),
            (3, state, chunk, "t is 3, but the next call of filter has t = 0"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                fresh.filter_chunk(t, x, actions)
        self.assertEqual(fresh.filter_chunk(0, state, chunk), CHUNK)
        fresh.stop()
        self.assertEqual(fresh.filter_chunk(0, state, chunk), 0)
        # `filter` would halt at a constant entry unlike demonstrations, so no action counts.
        paths, actions = demonstrations(1, 30)
        guard = dfr.Guard.fit([np.hstack([x, np.full((len(x), 1), 5.0)]) for x in paths], actions)
        guard.reset()
        self.assertEqual(guard.filter_chunk(0, [*paths[0][0], 6.0], chunk), 0)
        published = self.guard.with_settings(strategy="dfr")
        published.reset()
        with self.assertRaisesRegex(ValueError, "strategy 'dfr' predicts nothing: filter each action"):
            published.filter_chunk(0, state, chunk)


class WhyTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def test_explains_actions_that_do_not_pass(self):
        plant = Corridor()
        x, _ = plant.reset(seed=3)
        self.guard.reset(3)
        named = 0
        for t in range(20):
            action, info = self.guard.filter(t, x, DRIFT)
            self.assertEqual(info["why"] == "", info["source"] == "policy", info)
            named += "tip[1] is" in info["why"] and "above what was demonstrated at step" in info["why"]
            x = plant.step(action)[0]
        self.assertGreater(named, 3)

    def test_a_state_is_explained(self):
        states, _ = demonstrations(1, 30)
        found = self.guard.explain([3.0, 0.3, 0.6], t=3, demonstrations=states)
        entry = found["entries"][0]
        self.assertEqual((found["step"], entry["name"], entry["entry"]), (3, "tip[1]", 2))
        self.assertGreater(entry["excess"], 0.1)
        self.assertLess(entry["excess"], 0.6)
        self.assertAlmostEqual(sum(e["share"] for e in found["entries"]), -found["l"], places=9)
        nearest = found["nearest"]
        distances = [abs(x[max(0, 3 - 3) : 7, 2] - 0.6).min() for x in states]
        self.assertLess(distances[nearest["demonstration"]], np.quantile(distances, 0.2))
        self.assertIn("what was demonstrated at step 3; demonstration", found["text"])
        inside = self.guard.explain(states[4][6], demonstrations=states)
        self.assertEqual(inside["entries"], [])
        self.assertEqual((inside["nearest"]["demonstration"], inside["nearest"]["step"]), (4, 6))
        self.assertIsNone(self.guard.explain(states[4][6])["nearest"])
        self.guard.reset()
        info = self.guard.filter(0, [0.0, 1e200, 0.0], [0.0, 0.0])[1]
        self.assertEqual(info["why"], "halted: the state is immeasurably far outside")
        self.assertIn("immeasurably far outside what was demonstrated", self.guard.explain([0.0, 1e200, 0.0])["text"])
        for state, options, message in [
            ([0.0, np.nan, 0.0], {}, "entry 1 of the state is nan"),
            ([0.0, 0.0], {}, "the state has 2 entries; the guard needs 3"),
            (np.zeros(3), {"demonstrations": [states[0], states[1][:, :2]]}, "demonstration 1 has states of 2 entries"),
        ]:
            with self.assertRaisesRegex(ValueError, message):
                self.guard.explain(state, **options)

    def test_a_halt_names_the_broken_entry_also_after_a_standstill(self):
        guard = self.guard.with_settings(strategy="monitor")
        guard.reset()
        action = action_for(0.0997, 0.0)
        for t in range(15):
            guard.filter(t, np.zeros(3), action)
        _, info = guard.filter(15, [0.0, np.nan, 0.0], action)
        self.assertEqual(info["why"], "halted: tip[0] of the state is nan")


class MistakesTest(unittest.TestCase):
    def test_a_missing_file(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "no.guard"
            for load in (dfr.Guard.load, dfr.TimeVaryingSupport.load, dfr.load_demonstrations):
                with self.subTest(load.__qualname__), self.assertRaises(FileNotFoundError) as raised:
                    load(path)
                self.assertEqual(raised.exception.filename, str(path))

    def test_an_unknown_keyword(self):
        states, actions = demonstrations(1, 4)
        for call, message in [
            (lambda: dfr.Guard.fit(states, actions, strateggy="guard"),
             r"fit\(\) has no parameter 'strateggy': did you mean 'strategy'\?"),
            (lambda: dfr.Guard.fit(states, actions, alarms=0.1), "did you mean 'false_alarms'"),
            (lambda: dfr.Guard.fit(states, actions, zzzz=0.1), "no parameter 'zzzz'; it has states, actions, layout"),
            (lambda: dfr.Guard.load("x", pth=1), "did you mean 'path'"),
            (lambda: fit(8).with_settings(actionlimit=1.0), "did you mean 'action_limit'"),
            (lambda: dfr.TimeVaryingSupport.fit(states, gama=1.0), "did you mean 'gamma'"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(TypeError, message) as raised:
                call()
            self.assertNotIn("\n", str(raised.exception))

    def test_a_time_step_that_is_no_whole_number(self):
        guard = fit(8)
        state, action = np.zeros(guard.state_dim), np.zeros(guard.action_dim)
        support = dfr.TimeVaryingSupport.fit(demonstrations(1, 4)[0])
        for call in (
            lambda t: guard.filter(t, state, action),
            lambda t: guard.certify(t, state, action),
            lambda t: guard.filter_chunk(t, state, [action]),
            lambda t: guard.explain(state, t=t),
            lambda t: support.gradient(t, state),
            support.at,
            support.lipschitz_bound,
        ):
            for t in (0.0, "a", np.float64(1.0), [1]):
                with self.subTest(t=t), self.assertRaisesRegex(TypeError, "^t must be a whole number") as raised:
                    call(t)
                self.assertNotIn("\n", str(raised.exception))
            call(np.int32(1))

    def test_a_progress_that_cannot_be_called(self):
        for progress in (3, 0, "bar", []):
            with self.subTest(progress), self.assertRaisesRegex(TypeError, "^progress must be True, False, None"):
                fit(8, progress=progress)

    def test_info_has_the_keys_of_its_type(self):
        stub = (pathlib.Path(dfr.__file__).parent / "_core.pyi").read_text()
        guard = fit(8)
        guard.reset()
        info = guard.filter(0, np.zeros(3), DRIFT)[1]
        block = stub[stub.index("class GuardInfo") :].split("\nclass ")[0]
        named = [line.split(":")[0].strip() for line in block.splitlines() if ":" in line and '"""' not in line]
        self.assertEqual(set(named[1:]), set(info))
        strategies = stub[stub.index("Strategy = ") :].splitlines()[0].split("=", 1)[1].strip()
        for strategy in typing.get_args(eval(strategies, {"Literal": typing.Literal})):
            guard.with_settings(strategy=strategy)
        with self.assertRaises(ValueError) as raised:
            guard.with_settings(strategy="gided")
        for strategy in typing.get_args(eval(strategies, {"Literal": typing.Literal})):
            self.assertIn(strategy, str(raised.exception))


class ProgressTest(unittest.TestCase):
    def shown(self, terminal, **options):
        stream = io.StringIO()
        stream.isatty = lambda: terminal
        with mock.patch.object(sys, "stderr", stream), mock.patch.object(_progress.Display, "AFTER", 0.0), \
                mock.patch.object(_progress.Display, "EVERY", 0.0):
            fit(8, **options)
        return stream.getvalue()

    def test_progress_appears_on_a_terminal_and_not_in_a_log(self):
        shown = self.shown(True)
        self.assertRegex(shown, r"dfr: .*, \d+ %, \d+ s")
        self.assertTrue(shown.endswith("\r"))  # cleared
        self.assertEqual(self.shown(False), "")
        self.assertEqual(self.shown(True, progress=False), "")
        self.assertIn("dfr:", self.shown(False, progress=True))
        calls = []
        self.assertEqual(self.shown(True, progress=lambda *call: calls.append(call)), "")
        self.assertTrue(calls)

    def test_short_fits_show_no_progress(self):
        now = [0.0]
        stream = io.StringIO()
        with mock.patch.object(sys, "stderr", stream):
            display = _progress.Display(lambda: now[0])
            display("fitting", 0.1)
            now[0] = 1.9
            display("fitting", 0.4)
            self.assertEqual(stream.getvalue(), "")
            now[0] = 2.0
            display("fitting", 0.5)
            now[0] = 2.1  # too soon
            display("fitting", 0.51)
            display.close()
        self.assertEqual(stream.getvalue().count("dfr:"), 1)
        self.assertIn("dfr: fitting, 50 %, 2 s", stream.getvalue())


if __name__ == "__main__":
    unittest.main()
