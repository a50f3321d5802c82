"""Tests shards, merging, status, configurations and ids of episodes, as users of a program run them.

usage: shards_test.py PROGRAM DFR_CLUSTER
"""
import json
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "support"))
from eventually import eventually

CLUSTER = pathlib.Path(sys.argv.pop()).resolve()
PROGRAM = pathlib.Path(sys.argv.pop()).resolve()


class ShardsTest(unittest.TestCase):
    def setUp(self):
        self.temporary = tempfile.TemporaryDirectory()
        self.addCleanup(self.temporary.cleanup)
        self.folder = pathlib.Path(self.temporary.name)

    def run_program(self, *arguments, fails=False, differs=""):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=self.folder, text=True, capture_output=True,
                              check=False, env={**os.environ, "DFR_FAKE_DIFFERS": differs})
        self.assertEqual(done.returncode != 0, fails, done.stdout + done.stderr)
        return done.stderr if fails else done.stdout

    def bytes_of(self, name):
        return (self.folder / name).read_bytes()

    def test_merged_shards_have_the_bytes_of_the_whole(self):
        self.run_program("experiment", "--out", "whole")
        for k in (1, 2, 3):
            self.run_program("experiment", "--shard", f"{k}/3", "--out", f"in/shard-{k}")
        self.assertIn("baseline", self.run_program("merge", "in", "--out", "merged"))
        for name in ("summary.json", "report.html", "times.json", "run.toml"):
            self.assertEqual(self.bytes_of(f"merged/{name}"), self.bytes_of(f"whole/{name}"), name)

    def test_merging_leaves_the_shards_unchanged(self):
        for k in (1, 2):
            self.run_program("experiment", "--shard", f"{k}/2", "--out", f"Ä b/{k}")
        self.run_program("merge", "Ä b", "--out", "ganz \u65e5")
        kept = self.bytes_of("ganz \u65e5/ledger.jsonl"), self.bytes_of("ganz \u65e5/summary.json")
        self.run_program("experiment", "--seed", 7, "--shard", "1/2", "--out", "seed")
        error = self.run_program("merge", "seed", "--out", "ganz \u65e5", fails=True)
        self.assertIn("seed is 7 there and 2018 now", error)
        for shard, says in (("3/2", "a shard is K/N with 1 <= K <= N, as in 2/7, not '3/2'"),
                            ("1/2", 'shard is "1/1" there and "1/2" now')):
            self.assertIn(says, self.run_program("experiment", "--shard", shard, "--out", "ganz \u65e5", fails=True))
        # Merges a complete run, and resumes it without any work.
        self.run_program("merge", "Ä b/1", "--out", "ganz \u65e5")
        self.run_program("experiment", "--config", "ganz \u65e5/run.toml", "--out", "ganz \u65e5")
        self.assertEqual((self.bytes_of("ganz \u65e5/ledger.jsonl"), self.bytes_of("ganz \u65e5/summary.json")), kept)

    def test_a_configuration_starts_the_same_run_again(self):
        self.run_program("experiment", "--gamma", "7", "--seed", "11", "--methods", "baseline,dfr",
                         "--demonstrations", "12,24", "--out", "one")
        text = (self.folder / "one/run.toml").read_text()
        self.assertIn("gamma = 7\n", text)
        self.assertIn("demonstrations = [12, 24]\n", text)
        self.run_program("experiment", "--config", "one/run.toml", "--out", "two")
        self.assertEqual(self.bytes_of("one/summary.json"), self.bytes_of("two/summary.json"))
        self.assertEqual(self.bytes_of("one/run.toml"), self.bytes_of("two/run.toml"))
        self.run_program("experiment", "--config", "one/run.toml", "--seed=12", "--out", "three")
        self.assertEqual(json.loads(self.bytes_of("three/summary.json"))["seed"], 12)

    def test_a_configuration_keeps_flags_that_say_no(self):
        for flag, says in (("--warm", "cold = false\n"), ("--cold", "cold = true\n"), ("--warm=false", "cold = true\n"),
                           ("--no-video", "no-video = true\n")):
            self.run_program("experiment", flag, "--out", "one", "--restart")
            self.assertIn(says, (self.folder / "one/run.toml").read_text())
            self.run_program("experiment", "--config", "one/run.toml", "--out", "one")  # refused if it were another run
            self.assertIn(says, (self.folder / "one/run.toml").read_text())

    def test_two_names_of_one_option_are_refused_and_the_command_line_takes_precedence(self):
        says = "--warm and --cold are one option: give one of them"
        self.assertIn(says, self.run_program("experiment", "--warm", "--cold", "--out", "one", fails=True))
        self.assertFalse((self.folder / "one").exists())
        (self.folder / "c.toml").write_text("[experiment]\nseed = 3\ncold = true\n")
        self.run_program("experiment", "--config", "c.toml", "--warm", "--out", "one")
        self.assertIn("cold = false\n", (self.folder / "one/run.toml").read_text())
        (self.folder / "c.toml").write_text("[experiment]\ncold = true\nwarm = true\n")
        self.assertIn("c.toml:3: cold and warm are one option",
                      self.run_program("experiment", "--config", "c.toml", fails=True))

    def test_an_episode_runs_again_beside_others(self):
        self.run_program("experiment", "--out", "run")
        name, outcome, controls = self.run_program("episodes", "run", "--method", "dfr", "--most", 1).splitlines()[0].split("  ")
        before = self.bytes_of("run/ledger.jsonl"), self.bytes_of("run/run.toml"), self.bytes_of("run/summary.json")
        beside, again = self.run_program("rerun", "run", name, "--methods", "baseline").splitlines()
        self.assertTrue(beside.startswith("baseline "), beside)
        self.assertIn(f"{outcome} after {controls.split()[0]} controls", again)
        after = self.bytes_of("run/ledger.jsonl"), self.bytes_of("run/run.toml"), self.bytes_of("run/summary.json")
        self.assertEqual(after, before)
        for arguments, says in [
                (("run", "0/6/8/dfr"), "an episode is TRIAL/DEMONSTRATIONS/LEARNER/METHOD/START"),
                (("run", name, "--methods", "magic"), "run: the run has no method 'magic'"),
                (("run", name, "--film", "film.html"), "this program cannot draw episodes"),
                (("nowhere", name), "nowhere: contains no ledger.jsonl")]:
            self.assertIn(says, self.run_program("rerun", *arguments, fails=True))
        # The program's outcome differs from the ledger's.
        self.assertIn("the ledger's result of", self.run_program("rerun", "run", name, fails=True, differs="yes"))

    def test_whole_numbers_are_decimal_also_with_leading_zeros(self):
        self.run_program("experiment", "--seed", "06151984", "--demonstrations", "08,+010", "--trials=+02", "--out", "one",
                         "--episodes=000000000000000000000001")
        text = (self.folder / "one/run.toml").read_text()
        for says in ("seed = 6151984\n", "demonstrations = [8, 10]\n", "trials = 2\n", "episodes = 1\n"):
            self.assertIn(says, text)
        (self.folder / "c.toml").write_text('[experiment]\nseed = "0011"\ndemonstrations = ["012", 13]\ntrials = "01"\n')
        self.run_program("experiment", "--config", "c.toml", "--out", "two")
        text = (self.folder / "two/run.toml").read_text()
        for says in ("seed = 11\n", "demonstrations = [12, 13]\n", "trials = 1\n"):
            self.assertIn(says, text)
        # TOML's integers end at 9223372036854775807.
        for seed in ("9223372036854775807", "9223372036854775808", "18446744073709551615"):
            self.run_program("experiment", "--seed", seed, "--out", seed)
            self.run_program("experiment", "--config", f"{seed}/run.toml", "--out", f"{seed}b")
            self.assertEqual(json.loads(self.bytes_of(f"{seed}b/summary.json"))["seed"], int(seed))
            self.run_program("merge", seed, "--out", f"{seed}c")
        for option, value in (("--seed", "0x10"), ("--seed", "018446744073709551616"), ("--trials", "1e3"),
                              ("--trials", "2147483648"), ("--demonstrations", "6,0x10")):
            with self.subTest(option=option, value=value):
                error = self.run_program("experiment", f"{option}={value}", "--out", "three", fails=True)
                self.assertIn(option, error)
                self.assertEqual(error.count("\n"), 1, error)

    def test_a_folder_that_cannot_be_written_is_a_usage_error(self):
        (self.folder / "text").write_text("kept")
        for command in ("experiment --out", "merge none --out", "rerun none 0/6/8/dfr/0 --film"):
            for path in ("/proc/x/y", "text/x"):
                with self.subTest(command=command, path=path):
                    done = subprocess.run([PROGRAM, *command.split(), path], cwd=self.folder, text=True, capture_output=True)
                    self.assertEqual(done.returncode, 2, done.stderr)
                    self.assertIn(f": {path}: ", done.stderr)

    def test_help_ends_with_examples(self):
        for command in ("merge", "status", "episodes", "rerun"):
            self.assertRegex(self.run_program(command, "--help"), rf"\n\nExamples:\n(  \S*fake_experiment {command} .+\n)+\n?$")

    def test_mistakes_in_a_configuration_name_the_line(self):
        for text, says in [("[experiment]\nseed = 1\ngama = 5\n", "c.toml:3: experiment has no option 'gama'"),
                           ("seed = 1\n", "c.toml:1: 'seed' is not the table of a command"),
                           ("[experiment]\n\ntrials = \"many\"\n", "c.toml:3: "),
                           ("[experiment]\ntrials = [[1]]\n", "c.toml:2: 'trials' must be a string"),
                           ("[experiment]\ntrials = 1979-05-27\n", "c.toml:2: there must be a value"),
                           ("[experiment]\ntrials = \n", "c.toml:2"),
                           ("[grid]\ngamma = [1]\n", "has no table [experiment]")]:
            with self.subTest(text=text):
                (self.folder / "c.toml").write_text(text)
                self.assertIn(says, self.run_program("experiment", "--config", "c.toml", fails=True))

    def test_status_tells_how_far_it_is_and_what_failed(self):
        self.run_program("experiment", "--shard", "1/2", "--out", "run/shard-1")
        error = self.run_program("experiment", "--shard", "2/2", "--fails-once", "failed", "--threads", "1",
                                 "--out", "run/shard-2", fails=True)
        (self.folder / "run/shard-2/task.log").write_text("begun\n" + error + "\n")
        status = json.loads(self.run_program("status", "run", "--json"))
        self.assertEqual([status["done"], status["units"]], [11, 20])
        self.assertEqual(status["by_host"], {os.uname().nodename: 11})
        first, second = status["ledgers"]
        self.assertEqual([first["done"], first["units"], first["last_words"]], [10, 10, ""])
        self.assertIn("the plant fell over", second["last_words"])
        text = self.run_program("status", "run")
        self.assertIn("11 of 20 units are finished", text)
        self.assertIn("stopped", text)
        os.rename(self.folder / "run", os.fsencode(self.folder / "run") + b"\xff")
        renamed = json.loads(self.run_program("status", os.fsdecode(b"run\xff"), "--json"))
        self.assertEqual(renamed["ledgers"][0]["path"], "run\ufffd/shard-1/ledger.jsonl")

    def test_status_tells_runs_of_a_grid_apart(self):
        for gamma in (1, 5):
            for k in (1, 2):
                self.run_program("experiment", "--gamma", gamma, "--shard", f"{k}/2", "--out", f"grid/gamma={gamma}/shard-{k}")
        # The task failed before it created a ledger.
        failed = self.folder / "grid/gamma=5/shard-3"
        failed.mkdir()
        error = self.run_program("experiment", "--gama", 5, "--out", failed, fails=True)
        self.assertEqual(len(error.splitlines()), 1, error)
        (failed / "task.log").write_text("begun\n" + error)
        one, five = json.loads(self.run_program("status", "grid", "--json"))
        self.assertEqual([one["done"], one["units"], len(one["ledgers"])], [20, 20, 2])
        self.assertEqual([five["done"], five["units"], len(five["ledgers"])], [20, 20, 3])
        text = self.run_program("status", "grid")
        self.assertIn("2 runs, 40 of 40 units are finished", text)
        self.assertRegex(text, r"stopped    grid/gamma=5/shard-3/ledger.jsonl\n +task.log: .*--gama")
        for gamma in (1, 5):
            self.run_program("merge", *(f"grid/gamma={gamma}/shard-{k}" for k in (1, 2)), "--out", f"grid/gamma={gamma}")
        text = self.run_program("status", "grid")
        self.assertIn("2 runs, 40 of 40 units are finished", text)
        self.assertNotIn("shard-", text)
        # This run has no ledger.
        self.assertIn("0 of 0 units are finished", self.run_program("status", failed))
        self.assertIn("contains no ledger.jsonl", self.run_program("status", "nowhere", fails=True))

    def test_status_sees_a_run_from_outside(self):
        ledger = self.folder / "run/ledger.jsonl"
        child = subprocess.Popen([PROGRAM, "experiment", "--until", "go", "--threads", "1", "--out", "run"],
                                 cwd=self.folder, stderr=subprocess.DEVNULL)
        try:
            # The ledger has a header and two units; the third waits.
            eventually(lambda: ledger.exists() and ledger.read_bytes().count(b"\n") >= 3)
            status = json.loads(self.run_program("status", "run", "--json"))
            self.assertTrue(status["ledgers"][0]["running"])
            self.assertEqual(status["done"], 2)
            self.assertGreater(status["remaining_s"], 0)
            self.assertGreater(status["mean_wall_s"], 0)
            error = self.run_program("experiment", "--out", "run", fails=True)
            self.assertIn("another process is writing it", error)
            child.send_signal(signal.SIGTERM)
            (self.folder / "go").touch()
            self.assertNotEqual(child.wait(), 0)
            self.assertEqual(ledger.read_bytes().count(b"\n"), 4, "the run finishes its unit and begins no other")
        finally:
            child.kill()
            child.wait()
        self.run_program("experiment", "--out", "run")
        self.run_program("experiment", "--out", "whole")
        self.assertEqual(self.bytes_of("run/summary.json"), self.bytes_of("whole/summary.json"))

    def test_episodes_have_ids_and_the_worst_come_first(self):
        self.run_program("experiment", "--out", "run")
        *lines, last = self.run_program("episodes", "run", "--method", "dfr", "--most", "0").splitlines()
        self.assertEqual(len(lines), 20 * 12)
        self.assertRegex(last, r"^240 of 240 episodes, 100.00 %; on average [\d.]+ controls, [\d.]+ of recovery$")
        outcomes = [line.split()[1].rstrip(":") for line in lines]
        self.assertEqual(outcomes, sorted(outcomes, key=["collided", "halted", "completed"].index))
        self.assertRegex(lines[0], r"^\d/(6|60)/(8|64-64)/dfr/\d+  collided: policy  \d+ controls, \d+ of recovery$")
        cell = next(c for c in json.loads(self.bytes_of("run/summary.json"))["cells"]
                    if (c["method"], c["learner"], c["demonstrations"]) == ("dfr", "8", 6))
        of_cell = self.run_program("episodes", "run", "--method", "dfr", "--learner", "8", "--demonstrations", 6,
                                   "--outcome", "halted", "--most", "0").splitlines()
        self.assertEqual(len(of_cell) - 1, round(cell["halted"] * cell["episodes"]))
        self.assertIn(f"{len(of_cell) - 1} of {cell['episodes']} episodes, {100 * cell['halted']:.2f} %", of_cell[-1])
        self.assertIn('title="fake_experiment episodes FOLDER --learner 8 --method dfr --demonstrations 6 --outcome halted"',
                      (self.folder / "run/report.html").read_text())

    def test_episodes_may_be_chosen_by_how_another_method_ended(self):
        self.run_program("experiment", "--out", "run")
        def episodes(*options):
            *lines, last = self.run_program("episodes", "run", "--learner", "8", "--most", 0, *options).splitlines()
            self.assertEqual(int(last.split()[0]), len(lines))
            return {tuple(line.split("  ")[0].split("/")[k] for k in (0, 1, 4)) for line in lines}
        collided = episodes("--method", "baseline", "--outcome", "collided")
        done = episodes("--method", "dfr", "--outcome", "completed,halted")
        saved = episodes("--method", "dfr", "--outcome", "completed,halted", "--against", "baseline=collided")
        self.assertEqual(saved, collided & done)
        self.assertTrue(saved and saved < done)
        contrast = next(c for c in json.loads(self.bytes_of("run/summary.json"))["contrasts"]
                        if (c["method"], c["learner"]) == ("dfr", "8"))
        self.assertEqual(len(episodes("--method", "baseline", "--outcome", "collided", "--against", "dfr=halted,completed")),
                         contrast["only_reference_collided"])
        for options, says in [(("--against", "dfr"), "--against takes METHOD=OUTCOME"),
                              (("--against", "dfr=won"), "unknown outcome 'won'"),
                              (("--against", "magic=halted"), "unknown method 'magic'; valid: baseline, "),
                              (("--method", "magic"), "unknown method 'magic'; valid: baseline, "),
                              (("--learner", "magic"), "unknown learner 'magic'; valid: 8, 64-64"),
                              (("--demonstrations", 7), "unknown data point '7'")]:
            self.assertIn(says, self.run_program("episodes", "run", *options, fails=True))


if __name__ == "__main__":
    unittest.main()
