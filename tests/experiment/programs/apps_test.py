"""Runs small experiments of a program: shards merge to the same bytes, run.toml reproduces the run, and the commands
in the report print its numbers.

usage: apps_test.py PROGRAM
"""
import html.parser
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import unittest

PROGRAM = pathlib.Path(sys.argv.pop()).resolve()
# For each program: command, options other than the defaults, one option with another value, and the ledger's name
# of that option.
RUNS = {
    "study": [
        ("run", "--tasks reach,push,goal --policies lwr,weak --methods controller,monitor --trials 1 --episodes 2 --demonstrations 12",
         "--demonstrations=13", "demonstrations"),
        ("experiment", "--trials 4 --episodes 3 --demonstrations 20 --methods controller,certified-direction "
         "--certified-level 0.1 --factor 1.2 --seed 3", "--certified-level=0.2", "settings.certified level"),
        ("drift", "--trials 1 --episodes 2 --demonstrations 12 --methods controller --gamma 0.3 --tasks planar-push",
         "--gamma=0.4", "settings.gamma"),
        ("stress", "--tasks planar-corridor --policies lwr --controllers controller --trials 1 --episodes 2 "
         "--demonstrations 12", "--controllers=dfr", "methods"),
        ("grid", "--tasks planar-corridor --conditions 'as demonstrated,turned 40 deg' --policies lwr "
         "--controllers controller/raw,dfr/whitened --trials 2 --episodes 2 --demonstrations 12", "--episodes=3", "episodes"),
    ],
    "pusher": [
        ("experiment", "--trials 2 --episodes 2 --demonstrations 6,12 --learners 8,8x20 --methods baseline,controller "
         "--gripper fork --no-video --no-convergence --epochs 5 --learning-rate 0.005", "--gripper=bar", "settings.gripper"),
        ("experiment", "--preset authors --trials 2 --episodes 2 --demonstrations 6 --learners 8 --methods baseline,controller "
         "--no-convergence --no-video --nu 0.2", "--nu=0.1", "settings.nu"),
    ],
    "line_tracking": [
        ("experiment", "--trials 2 --episodes 2 --worlds frozen,30ms --methods baseline,controller,ensemble --observation truth --no-video "
         "--amplitude 0.001,0.001,0,0,0,0 --not-during --between --pause 0.2", "--pause=0.3", "settings.disturbance"),
    ],
}
SHARDS = 3
FILM = "film.html" if PROGRAM.name == "study" else "film.mp4"


class Numbers(html.parser.HTMLParser):
    """The numbers of a report with the commands that print them: (text, [command, ...])."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.open = []  # tag, commands and texts of each open element
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag in ("meta", "br", "img"):
            return
        commands = (dict(attributes).get("title") or "").splitlines()
        if commands and not commands[0].startswith(PROGRAM.name):  # a bar's title: name and number, then commands
            first, *commands = commands
            if commands:
                self.found.append((first.rpartition(": ")[2], commands))
            commands = None
        self.open.append((tag, commands, []))

    def handle_data(self, data):
        for _, _, texts in self.open:
            texts.append(data)

    def handle_endtag(self, tag):
        open_tag, commands, texts = self.open.pop()
        assert open_tag == tag, (open_tag, tag)
        text = "".join(texts).replace("\u2212", "-").strip()
        if tag == "title" and "\n" in text:  # a mark's title: its description, then the commands
            first, *commands = text.splitlines()
            self.found.append((first.rpartition(": ")[2], commands))
        elif commands and any(c.isdigit() for c in text):
            self.found.append((text, commands))


class AppsTest(unittest.TestCase):
    maxDiff = 400

    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)

    def run_program(self, *arguments, fails=False):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=self.folder, text=True, capture_output=True, check=False,
                              timeout=600)
        self.assertEqual(done.returncode != 0, fails, done.stdout + done.stderr)
        return done.stderr

    def rerun_the_worst(self, folder):
        """Run the worst episode again, which the program compares with its ledger, and check its film."""
        done = subprocess.run([PROGRAM, "episodes", folder, "--most", "1"], cwd=self.folder, text=True, capture_output=True,
                              check=True)
        name = done.stdout.split("  ")[0]
        self.run_program("rerun", folder, name, "--film", FILM)
        for arguments in (["rerun", folder, name + "9999"], ["rerun", folder, "first"], ["rerun", folder, "99" + name],
                          ["rerun", folder, name, "--methods", "magic"], ["episodes", folder, "--method", "magic"]):
            done = subprocess.run([PROGRAM, *arguments], cwd=self.folder, text=True, capture_output=True, check=False)
            self.assertEqual((done.returncode, done.stdout), (2, ""), done.stderr)
        self.assertGreater((self.folder / FILM).stat().st_size, 1000)
        if FILM.endswith(".html"):
            text = (self.folder / FILM).read_text()
            self.assertIn(name.split("/")[-2], text)
            self.assertNotRegex(text, r"\b(nan|inf)\b")

    def episodes(self, command):
        """Run a command of a report. Return the numbers of its last line: count, per cent, controls, recovery."""
        words = shlex.split(command)
        self.assertEqual(words[:3], [PROGRAM.name, "episodes", "FOLDER"])
        done = subprocess.run([PROGRAM, "episodes", "whole", *words[3:], "--most", "0"], cwd=self.folder, text=True,
                              capture_output=True, check=False)
        self.assertEqual(done.returncode, 0, command + done.stderr)
        *ids, last = done.stdout.splitlines()
        said = re.fullmatch(r"(\d+) of \d+ episodes, ([\d.]+) %(?:; on average ([\d.]+) controls, ([\d.]+) of recovery)?", last)
        self.assertTrue(said, last)
        self.assertEqual(len(ids), int(said[1]))
        return [float(value or 0.0) for value in said.groups()]

    def check_report(self):
        """Check that the commands in the report print its numbers, for the first twenty and for some of the others."""
        known = {}
        numbers = Numbers((self.folder / "whole/report.html").read_text()).found
        self.assertGreater(len(numbers), 3)
        for text, commands in numbers[:20] + numbers[20 :: len(numbers) // 20 + 1]:
            if "FOLDER/run.toml" in commands[0]:
                continue
            for command in commands:
                if command not in known:
                    known[command] = self.episodes(command)
            told = [known[command] for command in commands]
            values = re.findall(r"-?\d+(?:\.\d+)?", text)
            if len(told) == 1:
                wanted = [told[0]]
            elif " / " in text:
                wanted = [[share] for _, share, _, _ in told]
            else:  # one method compared with another
                (count, _, controls, _), (other, _, controls_there, _) = told
                ratio = count / other if other else 0.0
                there = max(controls_there, 1e-9)
                wanted = [[ratio, controls / there] if "\u00d7" in text else [100 * ratio - 100, 100 * ratio, controls / there]]
            for value, candidates in zip(values, wanted):
                digits = len(value.partition(".")[2])
                # Half of the report's last digit, and half of the command's last digit.
                slack = 0.5 * 10**-digits + 0.06 * max(1.0, max(map(abs, candidates)) / 100)
                self.assertTrue(any(abs(float(value) - c) <= slack for c in candidates), f"{text}: {commands} {told}")

    def compare(self, here, there):
        for name in ("summary.json", "report.html", "run.toml"):
            self.assertEqual((self.folder / here / name).read_text(), (self.folder / there / name).read_text(),
                             f"{here}/{name}")

    def test_shards_and_configurations_give_the_same_bytes(self):
        for command, options, other, field in RUNS[PROGRAM.name]:
            with self.subTest(command=command, options=options):
                options = shlex.split(options)
                self.run_program(command, *options, "--out", "whole", "--restart")
                for k in range(1, SHARDS + 1):
                    self.run_program(command, *options, "--shard", f"{k}/{SHARDS}", "--out", f"in/{k}", "--restart")
                (self.folder / "merged/ledger.jsonl").unlink(missing_ok=True)
                self.run_program("merge", "in", "--out", "merged")
                self.compare("merged", "whole")
                self.check_report()
                self.rerun_the_worst("whole")
                # Runs once from the configuration alone, and once with one value overridden.
                self.run_program(command, "--config", "whole/run.toml", "--out", "again", "--restart")
                self.compare("again", "whole")
                error = self.run_program(command, "--config", "whole/run.toml", other, "--out", "again", fails=True)
                self.assertIn(f"was begun with other settings: {field}", error)


if __name__ == "__main__":
    unittest.main()
