"""dfr.lerobot.GuardStep: transitions, pairs of dictionaries, tensors, chunks, and LeRobot's own contract."""

import inspect
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile
import textwrap
import unittest

import numpy as np

import dfr
from corridor import LAYOUT, action_for, demonstrations
from corridor_guard import DRIFT, fit
from dfr.lerobot import GuardStep

sys.path.insert(0, str(pathlib.Path(__file__).parent / "stand_ins"))
from tensor import Tensor  # noqa: E402

# Interface of a step in LeRobot: huggingface/lerobot at 7427f31, src/lerobot/processor/pipeline.py.
CONTRACT = {
    "__call__": ["self", "transition"],
    "get_config": ["self"],
    "state_dict": ["self"],
    "load_state_dict": ["self", "state"],
    "save_artifacts": ["self", "save_directory"],
    "reset": ["self"],
    "transform_features": ["self", "features"],
}


class GuardStepTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def transition(self, x, action, **more):
        return {"observation": {"clock": x[:1], "tip": x[1:][None]}, "action": action, **more}

    def test_it_filters_as_the_guard_does(self):
        guard = self.guard.with_settings()
        step = GuardStep(self.guard)
        x = np.array([0.0, 0.02, 0.0])
        self.assertEqual(step(self.transition(x, DRIFT))["info"]["guard"]["mode"], "halt")  # before reset
        step.reset()
        guard.reset()
        for t in range(30):
            expected, info = guard.filter(t, x, DRIFT.astype(np.float32))
            before = self.transition(x, DRIFT[None].astype(np.float32), info={"own": 1}, reward=2.0)
            after = step(before)
            self.assertEqual((after["info"]["guard"], after["info"]["own"], after["reward"]), (info, 1, 2.0))
            self.assertEqual((after["action"].shape, after["action"].dtype), ((1, 2), np.float32))
            np.testing.assert_allclose(after["action"][0], expected, atol=1e-7)
            self.assertNotIn("guard", before["info"])
            x = x + [1, *(np.array([[0, 0]]) + expected)[0]]

    def test_rounding_stays_within_the_limits_and_blocks_have_their_sizes(self):
        for kind, limit in ((k, l) for k in (np.float16, np.float32, np.float64) for l in (0.1, 0.11, 0.13)):
            step = GuardStep(self.guard.with_settings(strategy="monitor", action_limit=limit))
            step.reset()
            after = step(self.transition(np.zeros(3), np.array([9.0, -9.0], dtype=kind)))["action"]
            self.assertEqual(after.dtype, kind)
            self.assertLessEqual(np.abs(after.astype(float)).max(), limit)
            self.assertGreater(np.abs(after.astype(float)).min(), 0.999 * limit)
        step.reset()
        with self.assertRaisesRegex(ValueError, "the observation's clock has 2 entries; the guard needs 1"):
            step({"observation": {"clock": np.zeros(2), "tip": np.zeros(1)}, "action": DRIFT})

    def test_a_chunk_is_taken_action_by_action(self):
        step = GuardStep(self.guard.with_settings(strategy="monitor"))  # passes every action
        step.reset()
        chunk = np.stack([action_for(0.05, 0.0), action_for(0.06, 0.0)])[None]
        with self.assertRaisesRegex(ValueError, "has no clock"):  # a failed call consumes no action
            step({"observation": {"tip": np.zeros(2)}, "action": chunk})
        for k in range(2):
            np.testing.assert_allclose(step(self.transition(np.zeros(3), chunk))["action"], chunk[:, k], atol=1e-12)
        with self.assertRaisesRegex(ValueError, "has no action 2"):
            step(self.transition(np.zeros(3), chunk))
        step.next_chunk()
        np.testing.assert_allclose(step(self.transition(np.zeros(3), chunk))["action"], chunk[:, 0], atol=1e-12)

    def test_targets_are_filtered_as_steps_from_the_present_pose(self):
        step = GuardStep(self.guard, positions=[1, 2])
        step.reset()
        x = np.array([0.0, 0.3, -0.02])
        wish = action_for(0.05, 0.0)
        np.testing.assert_allclose(step(self.transition(x, x[1:] + wish))["action"], x[1:] + wish, atol=1e-12)
        x[1] += 0.1
        held = x[1:].copy()
        step.guard.stop()
        for _ in range(3):  # the pose at the halt, not the pose to which the arm sags
            np.testing.assert_array_equal(step(self.transition(x, x[1:] + wish))["action"], held)
            x[2] -= 0.05
        step.reset()
        step(self.transition(x, x[1:] + wish))
        held = x[1:].copy()
        x[1] = np.nan
        after = step(self.transition(x, held + wish))
        self.assertEqual(after["info"]["guard"]["reason"], "state-invalid")
        np.testing.assert_array_equal(after["action"], held)
        step.reset()
        with self.assertRaisesRegex(RuntimeError, "no pose to hold"):
            step(self.transition(x, held))

    def test_callbacks_run_once_per_alarm_and_halt(self):
        calls = []
        guard = self.guard.with_settings(strategy="monitor")
        step = GuardStep(guard, on_alarm=lambda info: calls.append("alarm"),
                             on_halt=lambda info: calls.append("halt"))
        step.reset()
        for y in (0.0, 0.9, 0.9, 0.0, 0.9):
            step(self.transition(np.array([0.0, 0.0, y]), action_for(0.05, 0.0)))
        self.assertEqual(calls, ["alarm", "alarm"])
        guard.stop()
        for _ in range(2):
            step(self.transition(np.zeros(3), action_for(0.05, 0.0)))
        self.assertEqual(calls[2:], ["halt"])

    def test_a_callback_may_reset(self):
        step = GuardStep(self.guard, on_halt=lambda info: step.reset())
        step.reset()
        chunk = np.stack([action_for(0.05, 0.0), action_for(0.06, 0.0)])[None]
        after = step(self.transition(np.full(3, np.nan), chunk))
        self.assertEqual(after["info"]["guard"]["reason"], "state-invalid")
        np.testing.assert_array_equal(after["action"], np.zeros((1, 2)))
        self.assertIsNone(step.info)
        np.testing.assert_allclose(step(self.transition(np.zeros(3), chunk))["action"], chunk[:, 0], atol=1e-12)

    def test_positions_are_distinct_whole_numbers(self):
        for positions in (np.array([1, 2]), (1, 2), range(1, 3)):
            self.assertEqual(json.loads(json.dumps(GuardStep(self.guard, positions=positions).get_config()))["positions"],
                             [1, 2])
        self.assertEqual(GuardStep(self.guard, positions=[None, np.int64(2)]).get_config()["positions"], [None, 2])
        for wrong in ([1.0, 2.0], [True, False], [1, 1], "12", 3, [0, 3], [-1, 0], np.array([1.0, 2.0])):
            with self.subTest(wrong), self.assertRaisesRegex((TypeError, ValueError), "positions"):
                GuardStep(self.guard, positions=wrong)
        for wrong in ("ab", 3, [[], {}], ["x", "x"]):
            with self.subTest(wrong), self.assertRaisesRegex((TypeError, ValueError), "action_names"):
                GuardStep(self.guard, action_names=wrong)

    def test_callbacks_that_raise_are_called_once(self):
        calls = []
        fail = lambda info: calls.append(info["mode"]) or {}["operator"]  # noqa: E731
        step = GuardStep(self.guard.with_settings(strategy="monitor"), on_alarm=fail, on_halt=fail)
        step.reset()
        for expected in (["policy"], ["policy", "halt"]):
            for check in (lambda call: self.assertRaises(KeyError, call), lambda call: call()):
                check(lambda: step(self.transition(np.array([0.0, 0.0, 0.9]), DRIFT)))
            self.assertEqual(calls, expected)
            step.guard.stop()

    def test_results_for_integer_actions_are_not_truncated(self):
        guard, x = self.guard.with_settings(), np.array([0.0, 0.02, 0.0])
        guard.reset()
        safe = guard.filter(0, x, [1, 0])[0]
        named = {"x": np.int64(1), "y": 0}
        for form in ([1, 0], np.array([[1, 0]]), Tensor(np.array([1, 0])), np.array([True, False]), named):
            step = GuardStep(self.guard)
            step.reset()
            after = step(self.transition(x, form))["action"]
            np.testing.assert_array_equal(np.ravel(list(after.values()) if form is named else after), safe)

    def test_mistakes_are_named(self):
        for error, options, message in [
            (ValueError, {"positions": [1]}, "positions has 1 entries; actions of this guard have 2"),
            (ValueError, {"positions": [1, 3]}, "contains 3, but a state has 3 entries"),
            (ValueError, {"positions": [1, 1.5]}, "contains 1.5, which is neither a whole number"),
            (ValueError, {"action_names": ["x", "x"]}, "action_names contains 'x' twice"),
            (TypeError, {"on_halt": "stop"}, "on_halt must be a function of info, not 'stop'"),
        ]:
            with self.assertRaisesRegex(error, message):
                GuardStep(self.guard, **options)
        step = GuardStep(self.guard)
        step.reset()
        with self.assertRaisesRegex(ValueError, "no clock, tip; it has pixels"):
            step({"observation": {"pixels": 0}, "action": DRIFT})
        with self.assertRaisesRegex(ValueError, "a guard is for one robot"):
            step(self.transition(np.zeros(3), np.zeros((2, 2))))
        self.assertEqual((step.get_config(), step.state_dict()), ({"positions": None, "action_names": None}, {}))
        self.assertEqual(step.transform_features({"a": 1}), {"a": 1})

    def test_a_path_is_loaded_and_stored_and_anything_else_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "task.guard"
            self.guard.save(path)
            for form in (path, str(path)):
                step = GuardStep(form, positions=[1, 2])
                self.assertEqual(step.guard.settings, self.guard.settings)
                again = GuardStep(**step.get_config())  # as a stored pipeline is rebuilt
                self.assertEqual((again.positions, again.guard.layout), ([1, 2], LAYOUT))
            with self.assertRaises(FileNotFoundError):
                GuardStep(path.with_name("other.guard"))
        with self.assertRaisesRegex(TypeError, "guard must be a dfr.Guard or the path of one, not 7"):
            GuardStep(7)


class TensorTest(unittest.TestCase):
    """GuardStep takes stand-in tensors and, if torch is installed, torch's tensors in the same way."""

    @classmethod
    def setUpClass(cls):
        cls.guard = fit()

    def check(self, make, dtype_of):
        observation = {"clock": make([0.0]), "tip": make([[0.02, 0.0]])}
        expected = self.guard.with_settings()
        expected.reset()
        safe = expected.filter(0, [0.0, 0.02, 0.0], DRIFT.astype(np.float32))[0]
        for shape in ((2,), (1, 2), (1, 1, 2)):
            with self.subTest(shape=shape):
                step = GuardStep(self.guard)
                step.reset()
                action = make(DRIFT.reshape(shape))
                after = step({"observation": observation, "action": action})["action"]
                self.assertIs(type(after), type(action))
                self.assertEqual((tuple(after.shape), dtype_of(after)), (shape, dtype_of(action)))
                np.testing.assert_allclose(np.ravel(after.cpu().numpy()), safe, atol=1e-6)
        chunk = make(np.stack([DRIFT, DRIFT])[None])
        step = GuardStep(self.guard)
        step.reset()
        for _ in range(2):
            after = step({"observation": observation, "action": chunk})["action"]
            self.assertEqual(tuple(after.shape), (1, 2))
        with self.assertRaisesRegex(ValueError, r"chunk of shape \(1, 2, 2\) has no action 2"):
            step({"observation": observation, "action": chunk})

    def test_shape_type_and_device_are_kept(self):
        self.check(lambda values: Tensor(np.asarray(values, dtype=np.float32), device="cuda:0"),
                   lambda tensor: (tensor.dtype, tensor.device))

    def test_torch_tensors_keep_shape_and_type(self):
        try:
            import torch
        except ImportError:
            self.skipTest("torch is not installed")
        self.check(lambda values: torch.tensor(np.asarray(values), dtype=torch.float32), lambda tensor: tensor.dtype)
        step = GuardStep(self.guard)
        step.reset()
        half = torch.tensor(DRIFT[None], dtype=torch.bfloat16, requires_grad=True)
        after = step({"observation": {"clock": [0.0], "tip": [0.02, 0.0]}, "action": half})["action"]
        self.assertEqual((after.dtype, tuple(after.shape)), (torch.bfloat16, (1, 2)))


class DictionariesTest(unittest.TestCase):
    """Actions and observations of a robot as dictionaries, {"x.pos": ...}."""

    @classmethod
    def setUpClass(cls):
        states, actions = demonstrations(1, 30)
        # Name of the dataset's feature; the robot defines the names of its entries.
        cls.guard = dfr.Guard.fit([x[:, 1:] for x in states], actions, layout=[("observation.state", 2)])

    def observation(self, x, y):
        return {"x.pos": x, "y.pos": y, "front": np.zeros((4, 4, 3))}

    def filtered(self, state, action):
        guard = self.guard.with_settings()
        guard.reset()
        return guard.filter(0, state, action)

    def test_a_pair_gives_the_action_to_apply(self):
        step = GuardStep(self.guard)
        step.reset()
        safe, info = self.filtered([0.02, 0.0], DRIFT)
        action = dict(zip(("x.pos", "y.pos"), DRIFT.tolist()))
        wide = step(({name: np.array([value]) for name, value in action.items()}, self.observation(0.02, 0.0)))
        self.assertEqual({name: value.tolist() for name, value in wide.items()}, {"x.pos": [safe[0]], "y.pos": [safe[1]]})
        step.reset()
        after = step((action, self.observation(0.02, 0.0)))
        self.assertEqual(after, dict(zip(("x.pos", "y.pos"), safe)))
        self.assertTrue(all(type(value) is float for value in after.values()))
        self.assertEqual(step.info, info)
        self.assertEqual(list(action.values()), DRIFT.tolist())  # left as it was

    def test_entries_are_matched_by_name_not_by_order(self):
        step = GuardStep(self.guard, action_names=["x.pos", "y.pos"])
        step.reset()
        safe, _ = self.filtered([0.02, 0.0], DRIFT)
        after = step(({"y.pos": DRIFT[1], "x.pos": DRIFT[0]}, self.observation(0.02, 0.0)))
        self.assertEqual(list(after), ["y.pos", "x.pos"])
        self.assertEqual((after["x.pos"], after["y.pos"]), tuple(safe))
        with self.assertRaisesRegex(ValueError, "has the entries x.pos, z.pos; the guard needs x.pos, y.pos"):
            step(({"x.pos": 0.0, "z.pos": 0.0}, self.observation(0.0, 0.0)))
        unnamed = GuardStep(self.guard)
        unnamed.reset()
        with self.assertRaisesRegex(ValueError, "has the entries x.pos; the guard needs 2: give action_names"):
            unnamed(({"x.pos": 0.0}, self.observation(0.0, 0.0)))
        with self.assertRaisesRegex(ValueError, "action_names has 1 entries; actions of this guard have 2"):
            GuardStep(self.guard, action_names=["x.pos"])

    def test_an_observation_without_the_needed_entries_is_named(self):
        step = GuardStep(self.guard)
        step.reset()
        with self.assertRaisesRegex(ValueError, "no observation.state; it has x.pos, front, of which 1 are numbers; the guard needs 2"):
            step(({"x.pos": 0.0, "y.pos": 0.0}, {"x.pos": 0.0, "front": np.zeros(3)}))

    def test_an_observation_given_by_observe_counts_once(self):
        step = GuardStep(self.guard)
        step.reset()
        transition = {"observation": None, "action": Tensor(DRIFT[None])}
        with self.assertRaisesRegex(ValueError, r"no observation, .*: call observe\(observation\)"):
            step(transition)
        safe, info = self.filtered([0.02, 0.0], DRIFT)
        observation = {name: np.array(value) for name, value in self.observation(0.02, 0.0).items()}
        step.observe(observation)
        for value in observation.values():
            value += 1.0  # as a robot that reuses its memory does
        after = step(transition)
        np.testing.assert_array_equal(after["action"].cpu().numpy()[0], safe)
        self.assertEqual(after["info"]["guard"], info)
        step.observe(observation)
        step({**transition, "observation": observation})
        with self.assertRaisesRegex(ValueError, "no observation"):
            step(transition)


class ContractTest(unittest.TestCase):
    def test_the_step_has_the_recorded_methods(self):
        for name, parameters in CONTRACT.items():
            with self.subTest(name):
                self.assertEqual(list(inspect.signature(getattr(GuardStep, name)).parameters), parameters)

    def test_it_derives_from_lerobots_step_if_lerobot_is_installed(self):
        """Runs with a stand-in for lerobot.processor that has the recorded methods and checks."""
        folder = pathlib.Path(__file__).parent
        script = f"""
            import sys
            sys.modules["sklearn"] = None  # blocks the slowest import
            sys.path[:0] = [{str(folder / "stand_ins")!r}, {str(folder)!r}]
            import dfr
            assert not any(name.startswith("lerobot") for name in sys.modules)  # import dfr stays light
            GuardStep = dfr.lerobot.GuardStep
            from lerobot.processor import Pipeline, ProcessorStep
            from corridor import LAYOUT, action_for, demonstrations

            states, actions = demonstrations(1, 20)
            guard = dfr.Guard.fit([x[:, 1:] for x in states], actions, layout={{"observation.state": 2}})
            step = GuardStep(guard)
            assert isinstance(step, ProcessorStep)
            pipeline = Pipeline([step])
            pipeline.reset()
            action = dict(zip(("x.pos", "y.pos"), action_for(0.0997, 0.0)))
            after = pipeline((action, {{"x.pos": 0.0, "y.pos": 0.0}}))
            assert after["action"] == action, after
            assert after["info"]["guard"]["source"] == "policy"
            assert step.transition["action"] is action
        """
        done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_artifacts_are_a_guard_named_by_its_content(self):
        guard = fit(10)
        step = GuardStep(guard)
        with tempfile.TemporaryDirectory() as folder:
            own = pathlib.Path(folder) / "new.guard"
            own.write_text("the user's")
            saved = step.save_artifacts(pathlib.Path(folder))
            self.assertEqual(own.read_text(), "the user's")
            own.unlink()
            self.assertEqual(saved, step.save_artifacts(folder))
            self.assertEqual([path.name for path in pathlib.Path(folder).iterdir()], [saved["guard"]])
            again = GuardStep(**{**step.get_config(), "guard": pathlib.Path(folder) / saved["guard"]})
            self.assertEqual((again.guard.settings, again.guard.layout), (guard.settings, guard.layout))
            self.assertNotEqual(GuardStep(fit(11)).save_artifacts(folder), saved)


try:
    import torch
    from lerobot import processor
except ImportError:
    torch = processor = None


@unittest.skipIf(processor is None or not hasattr(processor, "DataProcessorPipeline"),
                 "needs LeRobot's src/lerobot/processor/pipeline.py and torch: docs/lerobot.md says how")
class OwnPipelineTest(unittest.TestCase):
    """LeRobot's own pipeline and converters, with torch's tensors."""

    @classmethod
    def setUpClass(cls):
        states, actions = demonstrations(1, 30)
        cls.guard = dfr.Guard.fit([x[:, 1:] for x in states], actions, layout=[("observation.state", 2)])

    def expected(self, steps):
        """Return the guard's results for DRIFT, from (0.02, 0) on."""
        guard = self.guard.with_settings()
        guard.reset()
        x = np.array([0.02, 0.0])
        for t in range(steps):
            action, info = guard.filter(t, x, DRIFT.astype(np.float32))
            yield x.copy(), action, info
            x += action

    def test_lerobots_step_has_the_recorded_signatures(self):
        own = {name for name, member in vars(processor.ProcessorStep).items()
               if inspect.isfunction(member)}
        self.assertEqual(own, set(CONTRACT))
        for name, parameters in CONTRACT.items():
            self.assertEqual(list(inspect.signature(getattr(processor.ProcessorStep, name)).parameters), parameters)

    def test_a_robots_action_processor(self):
        pipeline = processor.RobotProcessorPipeline(
            [GuardStep(self.guard)], to_transition=processor.robot_action_observation_to_transition,
            to_output=processor.transition_to_robot_action)
        for number in (float, np.float32, torch.tensor):
            pipeline.reset()
            for x, safe, info in self.expected(30):
                action = {"x.pos": number(np.float32(DRIFT[0])), "y.pos": number(np.float32(DRIFT[1]))}
                after = pipeline((action, {"x.pos": number(x[0]), "y.pos": number(x[1]), "front": torch.zeros(3, 4, 4)}))
                self.assertEqual(list(after), ["x.pos", "y.pos"])
                np.testing.assert_allclose([float(value) for value in after.values()], safe, atol=1e-6)
                self.assertEqual(type(after["x.pos"]), type(action["x.pos"]))
                self.assertEqual(pipeline[0].info["mode"], info["mode"])

    def test_it_is_saved_and_loaded_with_its_pipeline(self):
        step = GuardStep(self.guard.with_settings(strategy="monitor"), positions=[0, 1], action_names=["x.pos", "y.pos"])
        pipeline = processor.RobotProcessorPipeline([step], name="action", to_transition=dict, to_output=dict)
        self.assertEqual((pipeline.state_dict(), step.state_dict()), ({}, {}))
        pipeline.load_state_dict({})
        with tempfile.TemporaryDirectory() as folder:
            pipeline.save_pretrained(folder)
            moved = shutil.move(folder, folder + ".moved")
            alarms = []
            again = processor.RobotProcessorPipeline.from_pretrained(
                moved, config_filename="action.json", overrides={"GuardStep": {"on_alarm": alarms.append}},
                to_transition=processor.robot_action_observation_to_transition,
                to_output=processor.transition_to_robot_action)
            loaded = again[0]
            self.assertEqual((loaded.positions, loaded.action_names), (step.positions, step.action_names))
            self.assertEqual((loaded.guard.settings, loaded.guard.layout), (step.guard.settings, self.guard.layout))
            again.save_pretrained(folder)  # once more, from a step that was loaded
            self.assertEqual({path.name for path in pathlib.Path(folder).iterdir()},
                             {path.name for path in pathlib.Path(moved).iterdir()})
            shutil.rmtree(moved)
        again.reset()
        far = {"x.pos": 0.0, "y.pos": 0.9}
        self.assertEqual(again((far, far)), far)
        self.assertEqual(len(alarms), 1)

    def test_features_pass(self):
        from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
        features = {PipelineFeatureType.ACTION: {"action": PolicyFeature(FeatureType.ACTION, (2,))}}
        self.assertEqual(processor.DataProcessorPipeline([GuardStep(self.guard)]).transform_features(features), features)


if __name__ == "__main__":
    unittest.main()
