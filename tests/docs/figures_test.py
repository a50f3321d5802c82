"""Checks that README.md and docs/results.md print the figures of the recorded runs in docs/recorded.

usage: figures_test.py SOURCE_DIR
"""
import csv
import json
import pathlib
import re
import sys
import unittest

SOURCE = pathlib.Path(sys.argv.pop(1)).resolve()
RECORDED = SOURCE / "docs/recorded"
METHODS = {"Baseline": "baseline", "Early Stopping": "early-stopping", "DFR": "dfr", "`controller`": "controller",
           "LWR alone": "lwr"}


def rows(page):
    """Yield the cells of each row of each table, without emphasis."""
    return [[cell.strip().replace("**", "") for cell in line.strip("|\n").split("|")]
            for line in (SOURCE / page).read_text().splitlines() if line.startswith("|")]


def number(text):
    return float(re.match(r"-?[\d.]+", text).group())


class Figures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.pusher = json.loads((RECORDED / "pusher.json").read_text())
        cls.average = {(row["learner"], row["method"]): row for row in cls.pusher["averages"]}
        cls.contrast = {(row["learner"], row["method"]): row for row in cls.pusher["contrasts"]}
        with (RECORDED / "gallery.csv").open(newline="") as file:
            gallery = list(csv.DictReader(file))
        cls.gallery = {}
        cls.passed = {}
        for policy, method in {(row["policy"], row["method"]) for row in gallery}:
            mine = [row for row in gallery if (row["policy"], row["method"]) == (policy, method)]
            episodes = sum(int(row["episodes"]) for row in mine)
            ok, failed = (sum(int(row[key]) for row in mine) / episodes for key in ("ok", "failed"))
            cls.gallery[policy, method] = (ok, 1 - ok - failed, failed)
            # The mean over tasks, as the program prints it.
            cls.passed[policy, method] = sum(1 - float(row["changed"]) / float(row["controls"]) for row in mine) / len(mine)
        cls.tasks = {row["task"] for row in gallery}

    def prose(self, page):
        return re.sub(r"\s+", " ", (SOURCE / page).read_text())

    def assert_printed(self, cell, share, digits=1):
        """Check that `cell` is `share` as printed in per cent."""
        self.assertAlmostEqual(number(cell), 100 * share, delta=0.5 * 10**-digits + 1e-9)

    def assert_outcomes(self, cells, row):
        for cell, outcome in zip(cells, ("completed", "halted", "collided")):
            self.assert_printed(cell, row[outcome])

    def test_readme(self):
        table = {cells[0]: cells[1:] for cells in rows("README.md")}
        self.assertEqual(len(self.tasks), 27)
        rows_of_gallery = {"a good policy in 27 small tasks, alone": ("good", "alone"),
                           "with a guard, which passes 98.3 % of its actions": ("good", "guard"),
                           "a weak policy in these tasks, alone": ("weak", "alone"),
                           "with a guard": ("weak", "guard"),
                           "with the guard's corrections at random times instead": ("weak", "placebo-corrections"),
                           "nearest-neighbour regression on the same demonstrations, no guard": ("knn", "alone")}
        for name, key in rows_of_gallery.items():
            for cell, share in zip(table[name], self.gallery[key]):
                self.assert_printed(cell, share)
        self.assert_printed("98.3", self.passed["good", "guard"])
        for name, method in (("a weak policy on the paper's Pusher, alone (the time limit counts as halted)",
                              "baseline"),
                             ("with Derivative-Free Recovery, as published", "dfr"),
                             ("with strategy `controller`", "controller"),
                             ("locally weighted regression, no guard", "lwr")):
            with self.subTest(name=name):
                row = self.average["8", method]
                self.assert_outcomes(table[name], row)
                for cell, outcome in zip(table[name], ("completed", "halted", "collided")):
                    self.assertEqual([int(n) for n in re.findall(r"\d+", cell.split("[")[1])],
                                     [round(100 * x) for x in row[outcome + "_interval"]])
        around = re.search(r"strategy `controller` the regression completes ([\d.]+) %", self.prose("README.md"))
        self.assert_printed(around.group(1), self.average["8", "controller@lwr"]["completed"])

    def test_results(self):
        text = (SOURCE / "docs/results.md").read_text()
        self.assertIn(f"--seed {self.pusher['seed']} ", text)
        self.assertIn(f"commit {self.pusher['commit'][:7]}", text)
        redrawn = re.search(r"redraws ([\d.]+) % of the start states", self.prose("docs/results.md"))
        alone = self.average["8", "baseline"]
        self.assert_printed(redrawn.group(1),
                            alone["redrawn_starts"] / (alone["episodes"] + alone["redrawn_starts"]))
        learner = None
        seen = set()
        # The first table of the page is about the Pusher.
        for cells in rows("docs/results.md")[2:]:
            if len(cells) != 8:
                break
            name, method = cells[0], METHODS[cells[1]]
            if name == "LWR":  # in place of a network
                learner, method = "8", "controller@lwr"
            elif name:
                learner = {"none": "8"}.get(name) or ("64-64" if name.startswith("64-64") else
                                                      "8x100" if "100 epochs" in name else "8")
            with self.subTest(learner=learner, method=method):
                row = self.average[learner, method]
                self.assert_outcomes(cells[2:5], row)
                self.assertAlmostEqual(number(cells[7]), row["controls_per_trajectory"], delta=0.5)
                if cells[5]:
                    contrast = self.contrast[learner, method]
                    low, high = contrast["collision_reduction_interval"]
                    self.assertEqual([int(n) for n in re.findall(r"-?\d+", cells[5].split("(")[0])],
                                     [round(-100 * x) for x in (contrast["collision_reduction"], high, low)])
                    low, high = contrast["completion_ratio_interval"]
                    self.assertEqual([int(n) for n in re.findall(r"\d+", cells[6].split("(")[0])],
                                     [round(100 * x) for x in (contrast["completion_ratio"], low, high)])
            seen.add((learner, method))
        self.assertGreaterEqual(len(seen), 10)


    def test_small_tasks(self):
        table = {cells[0]: cells[1:] for cells in rows("docs/recovery.md")}
        policies = ("good", "weak", "biased", "lwr", "knn", "none")
        for name, method in (("alone, or with `monitor`", "alone"), ("`guard`", "guard"), ("`controller`", "controller"),
                             ("placebo-corrections", "placebo-corrections")):
            for cell, policy in zip(table[name], policies):
                completed, _, failed = self.gallery[policy, method]
                for text, share in zip(cell.split(" / "), (completed, failed)):
                    self.assert_printed(text, share)


if __name__ == "__main__":
    unittest.main()
