"""Small studies of the program `pusher` that compare methods.

usage: pusher_system_test.py PROGRAM
"""
import json
import re
import unittest

from pusher_program import ALL, ProgramTest


class PusherSystemTest(ProgramTest):
    def test_all_methods_are_summarized(self):
        self.run_pusher("experiment", *ALL, "--out", "one")
        one = self.summary("one")
        self.assertEqual(len(one["cells"]), 16 * 2)
        self.assertEqual({cell["episodes"] for cell in one["cells"]}, {2 * 4})
        self.assertEqual({c["method"] for c in one["contrasts"]}, {c["method"] for c in one["cells"]} - {"baseline"})
        report = (self.folder / "one" / "report.html").read_text()
        self.assertIn("asks the supervisor", report)
        self.assertIn("oracle", report)

    def test_a_model_is_filmed(self):
        self.run_pusher("demonstrate", "--count", 12, "--out", "d.hdf5")
        self.run_pusher("fit", "--demonstrations", "d.hdf5", "--out", "m")
        out = self.run_pusher("render", "--model", "m", "--methods", "early-stopping,controller", "--width", 160,
                              "--height", 120, "--out", "last.png")
        self.assertIn("controls", out)
        self.assertEqual((self.folder / "last.png").read_bytes()[:4], b"\x89PNG")

    def test_a_method_runs_around_other_policies(self):
        self.run_pusher("experiment", *ALL[:2], *ALL[4:], "--out", "policies", "--demonstrations", "16", "--methods",
                        "baseline@none,lwr,baseline@lwr,controller@lwr,baseline@negated,baseline@random,"
                        "baseline@at-constraints,baseline@out-of-support,controller@at-constraints")
        by_method = {c["method"]: c for c in self.summary("policies")["averages"]}
        self.assertEqual(by_method["baseline@none"]["halted"], 1.0, "what does not move does not arrive")
        self.assertEqual(by_method["lwr"] | {"method": ""}, by_method["baseline@lwr"] | {"method": ""})
        self.assertEqual(by_method["baseline@negated"]["completed"], 0.0)
        self.assertGreater(by_method["baseline@at-constraints"]["collided"], 0.5)
        self.assertLess(by_method["controller@at-constraints"]["collided"],
                        by_method["baseline@at-constraints"]["collided"])

    def test_baselines_learn_as_described(self):
        out = self.run_pusher("experiment", "--learners", "8", "--demonstrations", "30", "--trials", "2", "--episodes",
                              "20", "--no-video", "--no-convergence", "--out", "baselines", "--methods",
                              "baseline,ensemble,dart,dagger,true-jacobian,controller@dagger")
        self.assertIn("true-jacobian: an oracle", out)
        self.assertIn("dagger, controller@dagger: asks the supervisor", out)
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

    def test_full_dynamics_are_an_option(self):
        small = ["--learners", "8", "--demonstrations", "6", "--trials", "1", "--episodes", "2", "--no-video",
                 "--no-convergence", "--methods", "baseline,controller"]
        self.run_pusher("experiment", *small, "--physics", "dynamic", "--out", "dynamic")
        self.assertEqual(self.settings("dynamic")["physics"], "dynamic")
        self.assertIn("physics", self.run_pusher("experiment", *small, "--out", "dynamic", fails=True))

    def test_recoveries_climb_in_the_report(self):
        out = self.run_pusher("experiment", *(o for o in ALL if o != "--no-convergence"), "--out",
                              "climb", "--methods", "baseline")
        blocks = out.split("50 recoveries (")[1:]
        self.assertEqual(len(blocks), 2)
        reached = {}
        for which, methods, block in (("first", {"dfr", "finite-difference", "controller"}, blocks[0]),
                                      ("all", {"dfr", "finite-difference"}, blocks[1])):
            self.assertTrue(block.startswith("the first of each" if which == "first" else "all of each"))
            rows = {line.split()[0]: [float(x) for x in line.split()[1:]] for line in block.splitlines()
                    if line.startswith("  ") and line.split()[0] in ("dfr", "finite-difference", "controller")}
            self.assertEqual(set(rows), methods)
            if which == "first":
                rows_of_first = rows
            for method, (start, *_, last, count) in rows.items():
                self.assertTrue(0 <= count <= 50)
                self.assertTrue(0 < start <= 1 and 0 < last <= 1)
                reached[which, method] = count
                if which == "first":
                    self.assertEqual(start, rows["dfr"][0], "all begin in the same states")
        # A level that no gripper position reaches cannot be reached by a recovery without pushing.
        anywhere, gripper, best = (float(x) for x in re.search(
            r"some state for (\d+) of 50.*?else unchanged, for (\d+);.*? is ([\d.]+) of", blocks[0], re.S).groups())
        self.assertTrue(0 <= gripper <= anywhere <= 50)
        self.assertLessEqual(reached["first", "finite-difference"], gripper + 5)
        self.assertLessEqual(rows_of_first["finite-difference"][-2], best + 0.05)
        self.assertIn("Speed of recoveries", (self.folder / "climb" / "report.html").read_text())


if __name__ == "__main__":
    unittest.main()
