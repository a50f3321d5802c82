"""dfr.Experiment: a plant in Python, in any number of processes and shards.

usage: experiment_system_test.py
"""

import base64
import importlib.util
import json
import os
import pathlib
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import zlib

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples/own_experiment.py"
SMALL = ("--trials", "3", "--episodes", "2", "--demonstrations", "12,20")

# Programs that differ from the example in one place each.
PLANTS = {
    # Draws from global generators.
    "careless": """
class Careless(example.Tip):
    def reset(self, seed):
        super().reset(seed)
        import random
        self.at[1] = 0.05 * np.random.normal() + 0.01 * random.random()

class Corridor(example.Corridor):
    def plant(self):
        return Careless()
""",
    # Completes or collides depending on the method. Waits while "hold" exists and the ledger has at least as many
    # lines as the number in "most".
    "held": """
class Held:
    def __init__(self):
        self.tip = example.Tip()
    def reset(self, seed):
        hold, ledger = pathlib.Path("hold"), pathlib.Path("run/ledger.jsonl")
        while hold.exists() and ledger.read_bytes().count(b"\\n") >= int(pathlib.Path("most").read_text()):
            pathlib.Path(f"{os.getpid()}.held").touch()
            time.sleep(0.001)
        self.tip.reset(seed)
    def step(self, action):
        self.tip.step(action)
    def observe(self):
        return list(self.tip.observe())
    def completed(self):
        return self.tip.completed
    def collided(self):
        return self.tip.collided

class Corridor(example.Corridor):
    def plant(self):
        return Held()
""",
    "raises": """
class Corridor(example.Corridor):
    def plant(self):
        if not pathlib.Path("mended").exists():
            raise ValueError("the arm is not plugged in")
        return super().plant()
""",
    "dies": """
class Corridor(example.Corridor):
    def learn(self, learner, states, actions, seed):
        if len(states) == 20 and not pathlib.Path("mended").exists():
            os._exit(7)
        return super().learn(learner, states, actions, seed)
""",
    "spawned": """
class Corridor(example.Corridor):
    start_method = "spawn"
""",
}


def frames_of(animation):
    """Return the pictures of an animated PNG with unfiltered lines."""
    assert animation.startswith(b"\x89PNG\r\n\x1a\n")
    at, frames, width = 8, [], 0
    while at < len(animation):
        length, kind = struct.unpack_from(">I4s", animation, at)
        data = animation[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", animation, at + 8 + length)[0] == zlib.crc32(kind + data)
        if kind == b"IHDR":
            width, height = struct.unpack_from(">II", data)
        if kind in (b"IDAT", b"fdAT"):
            rows = np.frombuffer(zlib.decompress(data[4 if kind == b"fdAT" else 0 :]), np.uint8).reshape(height, -1)
            frames.append(rows[:, 1:].reshape(height, width, 3))
        at += 12 + length
    return frames


class ExperimentTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        self.program = shutil.copy(EXAMPLE, self.folder)

    def write(self, name):
        path = self.folder / f"{name}.py"
        path.write_text(
            f"import os, pathlib, sys, time\nsys.path.insert(0, {str(EXAMPLE.parent)!r})\nimport numpy as np\n"
            f"import own_experiment as example\n{PLANTS[name]}\nif __name__ == '__main__':\n    Corridor().main()\n"
        )
        return path

    def start(self, program, *arguments):
        return subprocess.Popen(
            [sys.executable, program, *map(str, arguments)],
            cwd=self.folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )

    def run_program(self, program, *arguments, fails=False):
        process = self.start(program, *arguments)
        out, error = process.communicate()
        self.assertEqual(process.returncode != 0, fails, out + error)
        return error if fails else out

    def import_program(self):
        specification = importlib.util.spec_from_file_location("own_experiment", self.program)
        module = importlib.util.module_from_spec(specification)
        sys.modules["own_experiment"] = module  # lets inspect find the file of its classes
        self.addCleanup(sys.modules.pop, "own_experiment", None)
        specification.loader.exec_module(module)
        return module

    def bytes_of(self, name):
        return (self.folder / name).read_bytes()

    def test_an_episode_can_be_run_again(self):
        self.run_program(self.program, "experiment", *SMALL, "--out", "run", "--ahead", 0.9)
        self.assertIn("6 of 6 units are finished", self.run_program(self.program, "status", "run"))
        self.assertIn("own_experiment.py episodes FOLDER --learner policy --method guard", self.bytes_of("run/report.html").decode())
        averages = {a["method"]: a for a in json.loads(self.bytes_of("run/summary.json"))["averages"]}
        self.assertGreater(averages["guard"]["completed"], averages["baseline"]["completed"])
        lines = self.run_program(self.program, "episodes", "run", "--most", 0).splitlines()
        own_experiment = self.import_program()
        corridor = own_experiment.Corridor()
        for line in (lines[0], next(line for line in lines if "/guard/" in line)):
            name, outcome, controls = line.split("  ")[0], line.split("  ")[1], line.split("  ")[2]
            method = name.split("/")[3]
            found = corridor.replay(self.folder / "run", name, methods=["early-stopping", method])
            self.assertEqual(list(found), ["early-stopping", method])
            episode = found[method]
            self.assertEqual(": ".join(filter(None, (episode.outcome, episode.cause))), outcome)
            self.assertTrue(controls.startswith(f"{len(episode.actions)} controls"), controls)
            self.assertEqual(episode.states.shape, (len(episode.actions) + 1, 2))
            np.testing.assert_array_equal(episode.states[0], found["early-stopping"].states[0])
        self.assertEqual(corridor.parameters["ahead"], 0.9)
        name = lines[0].split("  ")[0]
        out = self.run_program(self.program, "rerun", "run", name, "--methods", "guard")
        self.assertIn(lines[0].split("  ")[1] + " after " + lines[0].split("  ")[2].split(",")[0], out)
        self.assertTrue(out.startswith("guard "))
        with self.assertRaisesRegex((RuntimeError, ValueError), "no pair of learner and method|unknown method"):
            corridor.replay(self.folder / "run", "0/12/policy/magic/0")
        with open(self.program, "a", encoding="utf-8") as file:
            file.write("# another one\n")
        with self.assertRaisesRegex(RuntimeError, "this program cannot run its episodes again: hash of own_experiment.py"):
            self.import_program().Corridor().replay(self.folder / "run", lines[0].split("  ")[0])

    def test_an_episode_can_be_filmed(self):
        self.run_program(self.program, "experiment", *SMALL, "--out", "run")
        line = self.run_program(self.program, "episodes", "run", "--method", "baseline", "--most", 1).splitlines()[0]
        name, actions = line.split("  ")[0], int(line.split("  ")[2].split()[0])
        self.run_program(self.program, "rerun", "run", name, "--methods", "guard", "--film", "new/film.html")
        page = self.bytes_of("new/film.html").decode()
        self.assertIn("Left to right: guard, baseline", page)
        self.assertIn(f"baseline: {line.split('  ')[1]} after {actions} controls", page)
        # An animation has one picture per state. That of the page shows both plants.
        both = frames_of(base64.b64decode(re.search('src="data:image/png;base64,([^"]+)"', page)[1]))
        self.assertEqual([path.name for path in (self.folder / "new").iterdir()], ["film.html"])
        self.run_program(self.program, "rerun", "run", name, "--film", "film.png")
        own_experiment = self.import_program()
        corridor = own_experiment.Corridor()
        states = corridor.replay(self.folder / "run", name)["baseline"].states
        pictures = frames_of(self.bytes_of("film.png"))
        self.assertEqual(len(pictures), actions + 1)
        tip = own_experiment.Tip()
        for k in (0, actions):
            tip.at = states[k]
            np.testing.assert_array_equal(pictures[k], tip.render())
        self.assertEqual(both[0].shape, (pictures[0].shape[0], 2 * pictures[0].shape[1] + 4, 3))
        np.testing.assert_array_equal(both[0][:, : pictures[0].shape[1]], pictures[0])
        np.testing.assert_array_equal(both[-1][:, -pictures[0].shape[1] :], pictures[-1])
        for film, says in (("film.mp4", "film.mp4: the name must end in one of .html, .png"), ("/proc/x/film.html", "/proc/x")):
            self.assertIn(says, self.run_program(self.program, "rerun", "run", name, "--film", film, fails=True))

    def test_a_plant_without_pictures_has_a_page_of_its_states(self):
        program = self.write("held")
        self.run_program(program, "experiment", *SMALL, "--out", "run")
        name = self.run_program(program, "episodes", "run", "--most", 1).split("  ")[0]
        self.run_program(program, "rerun", "run", name, "--methods", "guard", "--film", "film.html")
        self.assertIn("state[1] over state[0]", self.bytes_of("film.html").decode())
        error = self.run_program(program, "rerun", "run", name, "--film", "film.png", fails=True)
        self.assertIn("give its class a method render() that returns an RGB array", error)

    def test_parameters_are_options_and_settings(self):
        self.run_program(self.program, "experiment", *SMALL, "--ahead", 0.25, "--out", "run")
        self.assertIn("ahead = 0.25\n", (self.folder / "run/run.toml").read_text())
        error = self.run_program(self.program, "experiment", *SMALL, "--ahead", 0.5, "--out", "run", fails=True)
        self.assertIn('settings.ahead is "0.25" there and "0.5" now', error)
        with open(self.program, "a", encoding="utf-8") as file:
            file.write("# another program\n")
        error = self.run_program(self.program, "experiment", "--config", "run/run.toml", "--out", "run", fails=True)
        self.assertIn("settings.hash of own_experiment.py", error)
        for arguments, says in [
            (["experiment", "--methods", "baseline,magic"], "unknown method 'magic'; valid: baseline, monitor"),
            (["experiment", "--aheda", "1"], "--aheda"),
            (["experiment", "--demonstrations", "20,10"], "ascending"),
            (["merge", "nowhere", "--out", "x"], "contains no ledger.jsonl"),
        ]:
            self.assertIn(says, self.run_program(self.program, *arguments, fails=True))

    def test_global_random_generators_are_seeded(self):
        program = self.write("careless")
        for threads in (1, 3):
            self.run_program(program, "experiment", *SMALL, "--threads", threads, "--out", f"t{threads}")
        self.assertEqual(self.bytes_of("t1/ledger.jsonl").count(b"\n"), 7)
        self.assertEqual(self.bytes_of("t1/summary.json"), self.bytes_of("t3/summary.json"))

    def test_processes_may_be_spawned(self):
        self.run_program(self.program, "experiment", *SMALL, "--out", "forked")
        self.run_program(self.write("spawned"), "experiment", *SMALL, "--threads", 2, "--out", "spawned")
        forked, spawned = (json.loads(self.bytes_of(f"{name}/summary.json")) for name in ("forked", "spawned"))
        self.assertEqual(forked["averages"], spawned["averages"])

    def test_exceptions_of_a_plant_name_the_unit(self):
        error = self.run_program(self.write("raises"), "experiment", *SMALL, "--out", "run", fails=True)
        # Every unit raises the error: any of them may be the first.
        self.assertRegex(error, r"trial [0-2], (12|20) demonstrations, policy: Traceback")
        self.assertIn("ValueError: the arm is not plugged in", error)
        (self.folder / "mended").touch()
        self.run_program(self.folder / "raises.py", "experiment", *SMALL, "--out", "run")

    def test_a_process_that_dies_loses_only_its_unit(self):
        program = self.write("dies")
        error = self.run_program(program, "experiment", *SMALL, "--threads", 1, "--out", "run", fails=True)
        self.assertIn("trial 0, 20 demonstrations, policy: its process ended with exit code 7", error)
        self.assertEqual(self.bytes_of("run/ledger.jsonl").count(b"\n"), 2)
        (self.folder / "mended").touch()
        self.run_program(program, "experiment", *SMALL, "--out", "run")
        self.run_program(program, "experiment", *SMALL, "--out", "whole")
        self.assertEqual(self.bytes_of("run/summary.json"), self.bytes_of("whole/summary.json"))

    def workers_of(self, pid):
        found = []
        for entry in pathlib.Path("/proc").glob("[0-9]*/stat"):
            try:
                words = entry.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(words[1]) == pid and words[0] != "Z":
                found.append(int(entry.parent.name))
        return found

    def has_pending_signals(self, pid):
        text = pathlib.Path(f"/proc/{pid}/status").read_text()
        if re.search(r"^State:\s+Z", text, re.MULTILINE):  # the signal that killed it stays pending
            return False
        return any(int(mask, 16) for mask in re.findall(r"^(?:SigPnd|ShdPnd):\t(\w+)$", text, re.MULTILINE))

    def test_a_signal_ends_the_run_between_units_and_leaves_no_process(self):
        program, hold = self.write("held"), self.folder / "hold"
        units = ["--trials", 8, "--episodes", 2, "--demonstrations", "12,20"]
        arguments = ["experiment", *units, "--methods", "baseline", "--threads", 2, "--out", "run"]
        for number in (signal.SIGTERM, signal.SIGKILL, signal.SIGINT):
            wanted = self.lines() + 2
            (self.folder / "most").write_text(str(wanted))
            hold.touch()
            process = self.start(program, *arguments)
            while self.lines() < wanted:
                time.sleep(0.001)
                self.assertIsNone(process.poll())
            while len(workers := self.workers_of(process.pid)) < 2 or any(
                not (self.folder / f"{pid}.held").exists() for pid in workers
            ):
                time.sleep(0.001)
            os.kill(process.pid, number)
            while self.has_pending_signals(process.pid):
                time.sleep(0.001)
            if number != signal.SIGINT:  # also ends while all units run
                hold.unlink()
            process.communicate(timeout=60)
            self.assertNotEqual(process.returncode, 0, f"{number}, {self.lines()} lines")
            while any(pathlib.Path(f"/proc/{pid}").exists() for pid in workers):
                time.sleep(0.001)
        hold.unlink()
        self.run_program(program, *arguments)
        self.run_program(program, *arguments[:-1], "whole")
        self.assertEqual(self.bytes_of("run/summary.json"), self.bytes_of("whole/summary.json"))

    def lines(self):
        path = self.folder / "run/ledger.jsonl"
        return path.read_bytes().count(b"\n") if path.exists() else 0


if __name__ == "__main__":
    unittest.main()
