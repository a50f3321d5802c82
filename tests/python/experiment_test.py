"""dfr.Experiment in the test's own process and the workers that it starts.

usage: experiment_test.py
"""

import importlib.util
import linecache
import pathlib
import sys
import tempfile
import unittest

import numpy as np

import dfr

EXAMPLE = pathlib.Path(__file__).resolve().parents[2] / "examples/own_experiment.py"
SMALL = ("--trials", "2", "--episodes", "1", "--demonstrations", "12")


class Corner(dfr.Experiment):
    """A plant that starts at its goal."""

    parameters = {"goal_x": 1.0, "fast": True, "count": 3, "word": "a b", "gamma": np.float32(0.5)}
    episodes, trials, demonstrations = 1, 1, (5,)
    methods = ("baseline",)

    def plant(corner):
        assert type(corner.parameters["gamma"]) is float

        class There:
            completed, collided = True, False
            reset = step = lambda self, _: None

            def observe(self):
                return [corner.parameters["goal_x"], 0.0]

        return There()

    def demonstrate(self, seed):
        actions = 0.1 * np.random.default_rng(seed).normal(size=(9, 2))
        return np.vstack([[1.0, 0.0], [1.0, 0.0] + np.cumsum(actions, axis=0)]), actions

    def learn(self, learner, states, actions, seed):
        return lambda t, state: [0.0, 0.0]


class ExperimentTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def import_example(self):
        specification = importlib.util.spec_from_file_location("own_experiment", EXAMPLE)
        module = importlib.util.module_from_spec(specification)
        sys.modules["own_experiment"] = module  # lets inspect find the file of its classes
        self.addCleanup(sys.modules.pop, "own_experiment")
        specification.loader.exec_module(module)
        return module

    def bytes_of(self, name):
        return (self.folder / name).read_bytes()

    def test_processes_and_shards_give_the_same_bytes_and_an_episode_runs_again(self):
        corridor = self.import_example().Corridor()
        states, actions = map(np.array, zip(*map(corridor.demonstrate, range(9))))
        np.testing.assert_allclose(np.diff(states, axis=1), 0.1 * actions, atol=1e-12)  # as the plant applies them

        def run(*arguments, out):
            return corridor.run(["experiment", *SMALL, *arguments, "--out", str(self.folder / out)])

        summary = run("--threads", "1", out="one")
        self.assertEqual({a["method"]: a["episodes"] for a in summary["averages"]}["baseline"], 2)
        for k in (1, 2):
            self.assertIsNone(run("--threads", "2", "--shard", f"{k}/2", out=f"in/{k}"))
        corridor.run(["merge", str(self.folder / "in"), "--out", str(self.folder / "merged")])
        for name in ("summary.json", "report.html", "run.toml"):
            self.assertEqual(self.bytes_of(f"merged/{name}"), self.bytes_of(f"one/{name}"), name)
        found = corridor.replay(self.folder / "one", "1/12/policy/guard/0", methods=["baseline", "guard"])
        self.assertEqual(list(found), ["baseline", "guard"])
        np.testing.assert_array_equal(found["baseline"].states[0], found["guard"].states[0])
        for episode in found.values():
            self.assertEqual(episode.states.shape, (len(episode.actions) + 1, 2))

    def test_functions_may_change_their_arguments_in_place(self):
        module = self.import_example()

        class Spoiling(module.Corridor):
            methods = ("baseline", "guard")

            def plant(self):
                class Plant(module.Tip):
                    def step(self, action):
                        super().step(np.array(action))
                        action *= 0.0

                return Plant()

            def learn(self, learner, states, actions, seed):
                for array in (*states, *actions):
                    array *= 0.8
                policy = super().learn(learner, states, actions, seed)

                def spoiling(t, state):
                    action = policy(t, np.array(state))
                    state *= 0.0
                    return action

                return spoiling

        def episodes(experiment, out):
            out = str(self.folder / out)
            experiment.run(["experiment", *SMALL, "--methods", "baseline", "guard", "--out", out, "--threads", "1"])
            return experiment.replay(out, "1/12/policy/guard/0", methods=["baseline", "guard"])

        spoilt, kept = episodes(Spoiling(), "spoilt"), episodes(module.Corridor(), "kept")
        for method, episode in kept.items():
            np.testing.assert_array_equal(spoilt[method].states, episode.states)
            np.testing.assert_array_equal(spoilt[method].actions, episode.actions)

    def test_a_subclass_runs_inside_the_callers_program(self):
        out = str(self.folder / "corner")
        summary = Corner().run(["experiment", "--out", out, "--fast", "false", "--count", "4", "--threads", "1"])
        self.assertEqual(summary["averages"][0]["completed"], 1.0)
        text = (self.folder / "corner/run.toml").read_text()
        for line in ("goal-x = 1", 'fast = "false"', "count = 4", 'word = "a b"', "gamma = 0.5"):
            self.assertIn(line + "\n", text)
        self.assertIsNone(Corner().run(["experiment", "--out", out + "2", "--shard", "1/2", "--threads", "1"]))
        again = Corner().replay(out, "0/5/policy/baseline/0")
        self.assertEqual(again["baseline"].outcome, "completed")
        self.assertEqual(again["baseline"].actions.shape, (0, 2))
        with self.assertRaises(SystemExit):
            Corner().run(["status", out])
        with self.assertRaisesRegex(NotImplementedError, "Experiment must define plant"):
            dfr.Experiment().plant()

    def test_parameters_of_an_instance_are_its_defaults(self):
        corner = Corner()
        corner.parameters = {**Corner.parameters, "word": "c"}
        for k, (arguments, word) in enumerate([([], "c"), (["--word", "d"], "d"), ([], "c"), ([], "e")]):
            if word == "e":
                corner.parameters["word"] = word
            corner.run(["experiment", "--out", str(self.folder / f"{k}"), "--threads", "1", *arguments])
            self.assertEqual(corner.parameters["word"], word)

    def test_a_class_without_a_file_continues_only_its_own_runs(self):
        def cell(text, name, shown=True):
            if shown:  # as a notebook does
                linecache.cache[name] = (len(text), None, text.splitlines(True), name)
                self.addCleanup(linecache.cache.pop, name)
            space = {"__name__": "notebook", "Corner": Corner}
            exec(compile(text, name, "exec"), space)
            return space["Cell"]()

        text = "class Cell(Corner):\n    k = 1\n    def learn(self, *_):\n        return lambda *_: [0.0, 0.0]\n"
        arguments = ["experiment", "--out", str(self.folder / "cell"), "--threads", "1"]
        cell(text, "<cell 1>").run(arguments)
        cell(text, "<cell 2>").run(arguments)
        for other in (cell(text.replace("k = 1", "k = 2"), "<cell 3>"), cell(text, "<stdin>", shown=False)):
            with self.assertRaisesRegex(RuntimeError, "settings.hash of Cell"):
                other.run(arguments)
            with self.assertRaisesRegex(RuntimeError, "hash of Cell"):
                other.replay(self.folder / "cell", "0/5/policy/baseline/0")
            other.run([*arguments, "--restart"])
            other.run(arguments)

    def test_wrong_attributes_are_named(self):
        for attribute, value, message in [
            ("trials", -1, "trials must be a whole number from 1 to 2147483647, not -1"),
            ("trials", "2", "trials must be a whole number from 1 to 2147483647, not '2'"),
            ("episodes", 1.5, "episodes must be a whole number from 1 to 2147483647, not 1.5"),
            ("demonstrations", 6, r"demonstrations must be a list of whole numbers, as in \(20, 60\), not 6"),
            ("demonstrations", (6, 2**31), "each of demonstrations must be a whole number from 1 to 2147483647, not"),
            ("methods", "guard", "methods must be a list of names, not 'guard'"),
            ("learners", (1,), r"learners must be a list of names, not \(1,\)"),
            ("parameters", {"a b": 1}, "parameters has 'a b', which is not a valid option name"),
            ("parameters", {"a": None}, "parameter a must be a number, text, True or False, not None"),
            ("parameters", {"a": 2**63}, "parameter a must fit into 64 bits, not 9223372036854775808"),
        ]:
            with self.subTest(attribute, value=value), self.assertRaisesRegex(ValueError, message):
                type("Wrong", (dfr.Experiment,), {attribute: value})().run(["experiment", "--out", str(self.folder / "no")])


if __name__ == "__main__":
    unittest.main()
