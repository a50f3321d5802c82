"""dfr.GuardedEnv: an environment in Gymnasium's shape whose actions a guard filters."""

import pathlib
import pickle
import subprocess
import sys
import textwrap
import types
import unittest

import numpy as np

import dfr
from corridor import LAYOUT, Corridor, action_for, demonstrations
from corridor_guard import DRIFT, fit


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

    def test_action_limits_are_shared_or_per_entry(self):
        for limit in (0.05, np.float32(0.05), np.array([0.05, 0.05]), (0.05, 0.05)):
            guard = self.guard.with_settings(action_limit=limit)
            np.testing.assert_allclose(guard.settings["action_limit"], [0.05, 0.05], rtol=1e-6)
        for wrong in ([0.05, -1.0], [0.05, np.nan], "wide", [0.1, 0.1, 0.1]):
            with self.assertRaisesRegex((ValueError, TypeError), "action_limit"):
                self.guard.with_settings(action_limit=wrong)

    def test_the_action_space_bounds_the_guards_actions(self):
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
        self.assertTrue(any(env.step(10 * DRIFT)[2] for _ in range(200)))
        np.testing.assert_array_less(plant.largest, np.nextafter(np.float32(env.guard.settings["action_limit"]), 1))
        self.assertIs(dfr.GuardedEnv(Corridor(), self.guard).guard, self.guard)
        for space, message in [
            (Space([-1, 0], [1, 1]), r"entry 1 .* \[0, 1\]: a guard needs a negative lower and a positive upper bound"),
            (Space([-1, -1], [1, 1], np.int64), "continuous actions"),
            (Space([0, 0], [1, 1], bool), "continuous actions"),
            (types.SimpleNamespace(spaces={"a": Space([-1], [1])}, shape=None, dtype=None), "one array of continuous"),
            (types.SimpleNamespace(shape=(), dtype=np.dtype("U1")), "continuous actions"),
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

    def test_it_is_a_gymnasium_wrapper_if_gymnasium_is_installed(self):
        """Runs with a stand-in for gymnasium.Wrapper, checked against Gymnasium 1.2."""
        script = f"""
            import pickle, sys
            sys.modules["sklearn"] = None  # blocks the slowest import
            sys.path[:0] = [{str(pathlib.Path(__file__).parent / "stand_ins")!r}, {str(pathlib.Path(__file__).parent)!r}]
            import gymnasium
            import numpy as np
            import dfr
            from corridor import LAYOUT, Corridor, action_for, demonstrations

            class Env(Corridor, gymnasium.Env):
                action_space = gymnasium.Box(-0.25, 0.25, (2,))
                observation_space = gymnasium.Box(-np.inf, np.inf, (3,))

            guard = dfr.Guard.fit(*demonstrations(1, 20), layout=LAYOUT, features="tip")
            env = gymnasium.Wrapper(dfr.GuardedEnv(Env(), guard))
            assert isinstance(env.env, gymnasium.Wrapper) and isinstance(env.env, dfr.GuardedEnv)
            assert env.action_space is Env.action_space and isinstance(env.unwrapped, Env)
            env.reset(seed=0)
            assert env.step(action_for(0.05, 0.0))[4]["guard"]["mode"] != "halt"
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

    def test_an_environment_that_raises_is_stopped_until_reset(self):
        class Failing(Corridor):
            fails = ""

            def reset(self, **options):
                return super().reset(**options) if self.fails != "reset" else 1 / 0

            def step(self, action):
                result = super().step(action)
                return result if self.fails != "step" else 1 / 0

            def _observe(self):
                return super()._observe() if self.fails != "observe" else 1 / 0

        inside = action_for(0.05, 0.0)
        for fails in ("reset", "step", "observe"):
            with self.subTest(fails):
                plant = Failing()
                env = dfr.GuardedEnv(plant, self.guard)
                env.reset(seed=1)
                self.assertEqual(env.step(inside)[4]["guard"]["mode"], "policy")
                plant.fails = fails
                with self.assertRaises(ZeroDivisionError):
                    env.reset() if fails == "reset" else env.step(inside)
                plant.fails = ""
                # The state after the call is unknown.
                *_, truncated, info = env.step(inside)
                self.assertEqual((truncated, info["guard"]["reason"]), (True, "stop-requested"))
                np.testing.assert_array_equal(info["action"], [0.0, 0.0])
                env.reset(seed=1)
                self.assertEqual(env.step(inside)[4]["guard"]["mode"], "policy")

    def test_an_observation_may_be_changed_in_place(self):
        def levels(change, **options):
            env = dfr.GuardedEnv(Corridor(), self.guard, **options)
            obs, _ = env.reset(seed=1)
            for _ in range(5):
                if change:
                    obs *= 0.0
                obs, *_, info = env.step(action_for(0.05, 0.0))
                yield info["guard"]["g"]

        class Boxed:
            """Like a tensor, which is not a NumPy array."""

            def __init__(self, values):
                self.values = values

            def __array__(self, dtype=None, copy=None):
                return self.values

        for options in ({}, {"state": lambda obs: obs[:]}, {"state": Boxed}, {"state": lambda obs: [obs]}):
            self.assertEqual(list(levels(True, **options)), list(levels(False, **options)))

    def test_an_environment_may_change_its_action_in_place(self):
        class Scaling(Corridor):
            def step(self, action):
                result = super().step(np.array(action))
                action *= 0.0
                return result

        env = dfr.GuardedEnv(Scaling(), self.guard)
        env.reset(seed=1)
        np.testing.assert_array_equal(env.step(action_for(0.05, 0.0))[4]["action"], action_for(0.05, 0.0))

    def test_after_the_end_of_an_episode_it_halts_until_reset(self):
        """An environment that resets itself would continue with the first time step of another episode."""
        class Resetting(Corridor):
            def step(self, action):
                obs, reward, terminated, truncated, info = super().step(action)
                return self.reset(seed=1)[0] if terminated else obs, reward, terminated, truncated, info

        env = dfr.GuardedEnv(Resetting(), self.guard)
        env.reset(seed=3)
        self.assertTrue(any(env.step(DRIFT)[2] for _ in range(200)))
        before = env.x.copy()
        with self.assertWarnsRegex(RuntimeWarning, r"the episode has ended: call reset\(\)"):
            *_, truncated, info = env.step(DRIFT)
        self.assertTrue(truncated)
        self.assertEqual(info["guard"]["mode"], "halt")
        self.assertIn("the episode has ended", info["guard"]["why"])
        np.testing.assert_array_equal(env.x[1:], before[1:])
        env.reset(seed=3)
        self.assertNotEqual(env.step(DRIFT)[4]["guard"]["mode"], "halt")

    def test_vectors_and_other_objects_are_refused(self):
        for count in (0, 1, 2):
            vector = Corridor()
            vector.num_envs = count
            with self.assertRaisesRegex(TypeError, f"a vector of {count} environments, .*: wrap each environment"):
                dfr.GuardedEnv(vector, self.guard)
        for other in (None, "Pusher-v0"):
            with self.assertRaisesRegex(TypeError, r"env has no reset\(\): .* not "):
                dfr.GuardedEnv(other, self.guard)
        plant = Corridor()
        plant.action_space = types.SimpleNamespace(low=np.zeros(0), high=np.zeros(0))
        with self.assertRaisesRegex(ValueError, "the environment's actions have 0 entries, but the guard's have 2"):
            dfr.GuardedEnv(plant, self.guard)

    def test_the_interface_of_the_older_gym_is_named(self):
        class Older(Corridor):
            def step(self, action):
                obs, reward, terminated, truncated, info = super().step(action)
                return obs, reward, terminated or truncated, info

        class Bare(Corridor):
            def reset(self, **options):
                return super().reset(**options)[0]

        class Listed(Corridor):
            def reset(self, **options):
                return super().reset(**options)[0], 3.0

        env = dfr.GuardedEnv(Older(), self.guard)
        env.reset()
        with self.assertRaisesRegex(TypeError, r"step\(\) returned 4 values, not \(obs, reward, terminated"):
            env.step(DRIFT)
        self.assertEqual(self.guard.filter(1, np.zeros(3), DRIFT)[1]["mode"], "halt")
        for plant, got in ((Bare(True), "one dict"), (Bare(), "one ndarray"), (Listed(), "info of type float")):
            with self.subTest(got), self.assertRaisesRegex(TypeError, rf"reset\(\) returned {got}, not \(obs, info\)"):
                dfr.GuardedEnv(plant, self.guard).reset()

    def test_a_path_instead_of_a_guard_is_refused(self):
        with self.assertRaisesRegex(TypeError, r"guard must be a dfr.Guard, not 'task.guard': dfr.Guard.load"):
            dfr.GuardedEnv(Corridor(), "task.guard")

    def test_a_masked_part_of_an_observation_is_refused(self):
        class Dropout(Corridor):
            def _observe(self):
                return {"tip": np.ma.array(self.x[1:], mask=[False, self.x[0] == 2]), "clock": self.x[:1].copy()}

        env = dfr.GuardedEnv(Dropout(), self.guard)
        env.reset(seed=1)
        for _ in range(2):
            self.assertEqual(env.step(action_for(0.05, 0.0))[4]["guard"]["mode"], "policy")
        with self.assertRaisesRegex(TypeError, "the array has masked entries: fill or drop them"):
            env.step(action_for(0.05, 0.0))

    def test_a_pipelines_step_halts_at_masked_entries(self):
        clock, tip, action = np.zeros(1), np.zeros(2), action_for(0.05, 0.0)
        for observed, wish, reason in [
            (tip, action, "inside"),
            (np.ma.array(tip, mask=[False, True]), action, "state-invalid"),
            (tip, np.ma.array(action, mask=[True, False]), "control-invalid"),
        ]:
            step = dfr.lerobot.GuardStep(self.guard)
            step.reset()
            result = step({"observation": {"clock": clock, "tip": observed}, "action": wish})
            self.assertEqual(result["info"]["guard"]["reason"], reason)

    def test_a_function_makes_states_of_observations(self):
        env = dfr.GuardedEnv(Corridor(as_dict=True), self.guard, state=lambda obs: [0.0, *obs["tip"]])
        env.reset(seed=1)
        self.assertEqual(env.step(action_for(0.05, 0.0))[4]["guard"]["mode"], "policy")

        class Other(Corridor):
            def _observe(self):
                return {"position": self.x}

        with self.assertRaisesRegex(ValueError, "no clock, tip; it has position. Give GuardedEnv"):
            dfr.GuardedEnv(Other(), self.guard).reset(seed=0)


if __name__ == "__main__":
    unittest.main()
