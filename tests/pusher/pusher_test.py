"""The program `pusher` as its users run it: each command on small numbers, and each kind of mistake.

usage: pusher_test.py PROGRAM
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

PROGRAM = pathlib.Path(sys.argv.pop(1)).resolve()
SMALL = ["--learners", "8", "--demonstrations", "8,16", "--trials", "2", "--episodes", "4", "--no-video", "--no-convergence"]
CELL_KEYS = {
    "method", "learner", "demonstrations", "trials", "episodes", "completed", "completed_interval",
    "halted", "halted_interval", "collided", "collided_interval", "controls_per_trajectory", "recovery_controls",
}


class PusherTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temporary.name)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def run_pusher(self, *arguments, fails=False):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=self.folder, text=True,
                              capture_output=True, check=False, timeout=240)
        if fails:
            self.assertNotEqual(done.returncode, 0, done.stdout)
            lines = done.stderr.strip().splitlines()
            self.assertLessEqual(len(lines), 2, done.stderr)
            return lines[0]
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def summary_text(self, out):
        return (self.folder / out / "summary.json").read_text()

    def summary(self, out):
        return json.loads(self.summary_text(out))

    def test_commands_follow_one_another(self):
        out = self.run_pusher("demonstrate", "--count", 12, "--out", "d.hdf5")
        self.assertIn("12 demonstrations", out)
        out = self.run_pusher("fit", "--demonstrations", "d.hdf5", "--out", "m")
        self.assertIn("policy 8", out)
        out = self.run_pusher("evaluate", "--model", "m", "--episodes", 3)
        for method in ("baseline", "early-stopping", "dfr", "guided"):
            self.assertIn(method, out)
        out = self.run_pusher("render", "--model", "m", "--methods", "early-stopping,guided", "--width", 160,
                              "--height", 120, "--out", "last.png")
        self.assertIn("controls", out)
        self.assertEqual((self.folder / "last.png").read_bytes()[:4], b"\x89PNG")

    def test_summary_has_its_shape_and_does_not_depend_on_threads(self):
        self.run_pusher("experiment", *SMALL, "--out", "one", "--threads", 1)
        self.run_pusher("experiment", *SMALL, "--out", "two", "--threads", 2)
        one = self.summary("one")
        self.assertEqual(self.summary_text("one"), self.summary_text("two"))
        self.assertEqual(one["experiment"], "pusher")
        self.assertEqual(len(one["cells"]), 10 * 2)
        for cell in one["cells"]:
            self.assertLessEqual(CELL_KEYS, cell.keys())
            self.assertEqual(cell["episodes"], 2 * 4)
            self.assertAlmostEqual(cell["completed"] + cell["halted"] + cell["collided"], 1.0)
            low, high = cell["collided_interval"]
            self.assertTrue(0.0 <= low <= cell["collided"] <= high <= 1.0)
        self.assertEqual({c["method"] for c in one["contrasts"]}, {"early-stopping", "dfr", "guided", "true-jacobian", "lwr", "knn", "ensemble", "dart", "dagger"})
        report = (self.folder / "one" / "report.html").read_text()
        self.assertIn("asks the supervisor", report)
        self.assertIn("oracle", report)
        self.assertIn(one["commit"], report)

    def test_drift_compares_methods_under_every_condition(self):
        out = self.run_pusher("drift", "--trials", 1, "--episodes", 2, "--demonstrations", 12,
                              "--methods", "baseline,guided")
        self.assertEqual(out, self.run_pusher("drift", "--trials", 1, "--episodes", 2, "--threads", 1,
                                              "--demonstrations", 12, "--methods", "baseline,guided"))
        for condition in ("as demonstrated", "noise doubled", "wide bar", "turned", "scaled"):
            self.assertIn(condition, out)
        self.assertEqual(out.count("  baseline "), out.count("  guided "))

    def test_a_method_runs_around_other_policies(self):
        self.run_pusher("experiment", *SMALL[:2], *SMALL[4:], "--out", "policies", "--demonstrations", "16", "--methods",
                        "baseline@zero,lwr,baseline@lwr,guided@lwr,baseline@negated,baseline@random,"
                        "baseline@at-constraints,baseline@out-of-support,guided@at-constraints")
        by_method = {c["method"]: c for c in self.summary("policies")["averages"]}
        self.assertEqual(by_method["baseline@zero"]["halted"], 1.0, "what does not move does not arrive")
        self.assertEqual(by_method["lwr"] | {"method": ""}, by_method["baseline@lwr"] | {"method": ""})
        self.assertEqual(by_method["baseline@negated"]["completed"], 0.0)
        self.assertGreater(by_method["baseline@at-constraints"]["collided"], 0.5)
        self.assertLess(by_method["guided@at-constraints"]["collided"],
                        by_method["baseline@at-constraints"]["collided"])

    def test_baselines_learn_what_they_say(self):
        out = self.run_pusher("experiment", "--learners", "8", "--demonstrations", "30", "--trials", "2", "--episodes",
                              "20", "--no-video", "--no-convergence", "--out", "baselines", "--methods",
                              "baseline,ensemble,dart,dagger,true-jacobian,guided@dagger")
        self.assertIn("true-jacobian: an oracle", out)
        self.assertIn("dagger, guided@dagger: asks the supervisor", out)
        by_method = {c["method"]: c for c in self.summary("baselines")["averages"]}
        alone = by_method["baseline"]
        self.assertGreater(by_method["dagger"]["completed"], alone["completed"])
        self.assertIn("early-stopping", by_method["ensemble"]["halt_causes"])
        self.assertLess(by_method["true-jacobian"]["collided"], alone["collided"])

    def test_supervisors_take_turns(self):
        small = ["--learners", "8", "--demonstrations", "8", "--trials", "5", "--episodes", "4", "--no-video",
                 "--no-convergence", "--methods", "baseline"]
        self.run_pusher("experiment", *small, "--supervisors", 5, "--out", "five")
        self.run_pusher("experiment", *small, "--out", "single")
        units = {name: [json.loads(line) for line in (self.folder / name / "ledger.jsonl").read_text().splitlines()]
                 for name in ("five", "single")}
        self.assertEqual(units["five"][0]["settings"]["supervisors"], "5")
        outcomes = {name: [[method["outcomes"] for method in unit["episodes"]] for unit in lines[1:]]
                    for name, lines in units.items()}
        self.assertNotEqual(outcomes["five"], outcomes["single"])
        error = self.run_pusher("experiment", *small, "--supervisors", 9, fails=True)
        self.assertIn("--supervisors", error)

    def test_full_dynamics_are_a_choice(self):
        small = ["--learners", "8", "--demonstrations", "6", "--trials", "1", "--episodes", "2", "--no-video",
                 "--no-convergence", "--methods", "baseline,guided"]
        self.run_pusher("experiment", *small, "--physics", "dynamic", "--out", "dynamic")
        settings = json.loads((self.folder / "dynamic" / "ledger.jsonl").read_text().splitlines()[0])["settings"]
        self.assertEqual(settings["physics"], "dynamic")
        self.assertIn("physics", self.run_pusher("experiment", *small, "--out", "dynamic", fails=True))
        self.assertIn("--physics", self.run_pusher("experiment", "--physics", "magic", fails=True))

    def test_recoveries_climb_in_the_report(self):
        out = self.run_pusher("experiment", *(o for o in SMALL if o != "--no-convergence"), "--out",
                              "climb", "--methods", "baseline")
        blocks = out.split("50 recoveries (")[1:]
        self.assertEqual(len(blocks), 2)
        reached = {}
        for which, methods, block in (("first", {"dfr", "finite-difference", "guided"}, blocks[0]),
                                      ("all", {"dfr", "finite-difference"}, blocks[1])):
            self.assertTrue(block.startswith("the first of each" if which == "first" else "all of each"))
            rows = {line.split()[0]: [float(x) for x in line.split()[1:]] for line in block.splitlines()
                    if line.startswith("  ") and line.split()[0] in ("dfr", "finite-difference", "guided")}
            self.assertEqual(set(rows), methods)
            if which == "first":
                rows_of_first = rows
            for method, (start, *_, last, count) in rows.items():
                self.assertTrue(0 <= count <= 50)
                self.assertTrue(0 < start <= 1 and 0 < last <= 1)
                reached[which, method] = count
                if which == "first":
                    self.assertEqual(start, rows["dfr"][0], "all begin in the same states")
        # What no place of the gripper is high enough for, no recovery reaches without pushing.
        anywhere, gripper, best = (float(x) for x in re.search(
            r"any state in (\d+) of 50.*?as it is, in (\d+);.*?: ([\d.]+) of", blocks[0], re.S).groups())
        self.assertTrue(0 <= gripper <= anywhere <= 50)
        self.assertLessEqual(reached["first", "finite-difference"], gripper + 5)
        self.assertLessEqual(rows_of_first["finite-difference"][-2], best + 0.05)
        self.assertIn("How fast recoveries climb", (self.folder / "climb" / "report.html").read_text())

    def test_an_interrupted_experiment_goes_on_where_it_ended(self):
        self.run_pusher("experiment", *SMALL, "--out", "whole")
        ledger = (self.folder / "whole" / "ledger.jsonl").read_text().splitlines(keepends=True)
        (self.folder / "half").mkdir()
        # Killed while it wrote its third unit.
        (self.folder / "half" / "ledger.jsonl").write_text("".join(ledger[:3]) + ledger[3][:20])
        self.run_pusher("experiment", *SMALL, "--out", "half")
        self.assertEqual(self.summary_text("whole"), self.summary_text("half"))

    def test_shards_merge_to_the_same_summary_and_any_episode_can_be_filmed(self):
        small = [*SMALL, "--methods", "baseline,guided"]
        self.run_pusher("experiment", *small, "--out", "unsharded")
        for k in (1, 2, 3):
            self.run_pusher("experiment", *small, "--shard", f"{k}/3", "--out", f"shards/{k}")
        self.run_pusher("merge", "shards", "--out", "merged")
        self.assertEqual(self.summary_text("merged"), self.summary_text("unsharded"))
        line = self.run_pusher("episodes", "merged", "--method", "guided", "--most", 1).splitlines()[0]
        name, outcome = line.split()[:2]
        controls = line.split("  ")[2].split()[0]
        out = self.run_pusher("render", "--run", "merged", "--episode", name, "--methods", "baseline", "--width", 160,
                              "--height", 120, "--out", "episode.png")
        self.assertIn("baseline", out)
        guided = next(row for row in out.splitlines() if row.startswith("guided"))
        self.assertIn(outcome.rstrip(":"), guided)
        self.assertIn(f"after {controls} controls", guided)
        error = self.run_pusher("render", "--run", "merged", "--episode", "7/8/8/guided/0", fails=True)
        self.assertIn("there are trials 0 to 1", error)

    def test_drift_runs_in_shards(self):
        small = ["--trials", 1, "--episodes", 2, "--demonstrations", 12, "--methods", "baseline,guided"]
        whole = self.run_pusher("drift", *small)
        for k in (1, 2):
            self.run_pusher("drift", *small, "--shard", f"{k}/2", "--out", f"drift/{k}")
        self.assertEqual(self.run_pusher("merge", "drift", "--out", "drift/whole"), whole)
        self.assertIn("needs --out", self.run_pusher("drift", *small, "--shard", "1/2", fails=True))

    def test_a_ledger_of_other_settings_is_refused_until_restart(self):
        self.run_pusher("experiment", *SMALL, "--out", "other")
        error = self.run_pusher("experiment", *SMALL, "--out", "other", "--gamma", 7, fails=True)
        self.assertIn("gamma", error)
        self.run_pusher("experiment", *SMALL, "--out", "other", "--gamma", 7, "--restart")

    def test_mistakes_get_one_clear_line(self):
        (self.folder / "text").write_text("not a file of ours, and long enough to be looked into\n")
        (self.folder / "empty").mkdir(exist_ok=True)
        for arguments, says in [
            (["fit", "--demonstrations", "absent.hdf5"], "absent.hdf5"),
            (["fit", "--demonstrations", "text"], "text"),
            (["evaluate", "--model", "empty"], "policy.dfr"),
            (["demonstrate", "--supervisor", "text"], "text: is not a file written by dfr"),
            (["experiment", "--methods", "baseline,magic"], "no method 'magic'"),
            (["experiment", "--methods", "baseline,guided@magic"], "no policy 'magic'"),
            (["experiment", "--learners", "8-x"], "learner '8-x'"),
            (["experiment", "--learners", "8x0"], "learner '8x0'"),
            (["experiment", "--preset", "huge"], "huge"),
            (["experiment", "--out", "text/below"], "text/below"),
            (["experiment", *SMALL, "--red-y", "0.05", "--out", "r"], "red"),
            (["experiment", *SMALL, "--features", "gripper", "--out", "f"], "gripper"),
            (["demonstrate", "--count", "-3"], "count"),
            (["view", "--model", "empty"], "policy.dfr"),
            (["nonsense"], "nonsense"),
        ]:
            with self.subTest(arguments=arguments):
                self.assertIn(says, self.run_pusher(*arguments, fails=True))

    def test_the_authors_preset_takes_their_constants_but_not_from_the_user(self):
        self.run_pusher("experiment", *SMALL, "--out", "authors", "--preset", "authors", "--methods", "baseline",
                        "--gamma", "3")
        settings = json.loads((self.folder / "authors" / "ledger.jsonl").read_text().splitlines()[0])["settings"]
        self.assertEqual([settings[k] for k in ("learning_rate", "horizon", "nu", "gamma")],
                         ["0.01", "100", "0.1", "3"])

    def test_help_tells_units_and_defaults(self):
        out = self.run_pusher("experiment", "--help")
        for word in ("[m]", "[1/m^2]", "quick", "paper", "0.05"):
            self.assertIn(word, out)


if __name__ == "__main__":
    unittest.main()
