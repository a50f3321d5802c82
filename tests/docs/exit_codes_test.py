#!/usr/bin/env python3
"""Tests that programs exit with 0 after --help, and with 2 and one line after a usage error.

usage: exit_codes_test.py SERVER PROGRAM ...       SERVER: the library of main_server.cc
"""

import functools
import os
import pathlib
import re
import shlex
import subprocess
import sys
import tempfile
import unittest

import h5py
import numpy as np

SERVER = pathlib.Path(sys.argv[1])
PROGRAMS = [pathlib.Path(name) for name in sys.argv[2:]]


class Server:
    """A process that has loaded a program and runs its main() in a new process for each call."""

    def __init__(self, program):
        self.process = subprocess.Popen([program], env={**os.environ, "LD_PRELOAD": str(SERVER)}, stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE)
        self.files = [tempfile.NamedTemporaryFile(mode="r") for _ in range(2)]

    def run(self, *arguments):
        words = [*(file.name for file in self.files), *arguments]
        request = b"".join(os.fsencode(word) + b"\0" for word in words)
        self.process.stdin.write(b"%d\n" % len(request) + request)
        self.process.stdin.flush()
        code = int(self.process.stdout.readline())
        for file in self.files:
            file.seek(0)
        return subprocess.CompletedProcess(arguments, code, *(file.read() for file in self.files))

    def close(self):
        self.process.communicate()
        for file in self.files:
            file.close()


class ExitCodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.servers = {program: Server(program) for program in PROGRAMS}
        for server in cls.servers.values():
            cls.addClassCleanup(server.close)

    @staticmethod
    @functools.cache
    def run_program(program, *arguments):
        return ExitCodesTest.servers[program].run(*arguments)

    def test_a_served_program_differs_from_no_other(self):
        for program in PROGRAMS:
            for argument in ("--help", "--nonsense"):
                with self.subTest(program=program.name, argument=argument):
                    done = subprocess.run([program, argument], text=True, capture_output=True, check=False, timeout=60)
                    served = self.run_program(program, argument)
                    self.assertEqual((served.returncode, served.stdout, served.stderr),
                                     (done.returncode, done.stdout, done.stderr))

    def test_help_succeeds(self):
        for program in PROGRAMS:
            with self.subTest(program=program.name):
                done = self.run_program(program, "--help")
                self.assertEqual((done.returncode, done.stderr), (0, ""))

    def test_version_names_the_release_and_the_commit(self):
        for program in PROGRAMS:
            with self.subTest(program=program.name):
                done = self.run_program(program, "--version")
                self.assertEqual((done.returncode, done.stderr), (0, ""))
                self.assertRegex(done.stdout, r"\A\d+\.\d+\.\d+ \((unknown|[0-9a-f]+(\+changes\.[0-9a-f]{8})?)\)\n\Z")

    def test_usage_errors_give_two_and_one_line_with_the_closest_name(self):
        for program in PROGRAMS:
            commands = re.findall(r"^  ([a-z]+) ", self.run_program(program, "--help").stdout.partition("Subcommands:")[2], re.M)
            wrong = {"--versoin": "unknown option '--versoin' (did you mean '--version'?)", "nonsense": "nonsense"}
            for command in commands[-1:]:  # One parser serves all commands.
                wrong[command + "x"] = f"unknown command '{command}x' (did you mean '{command}'?)"
                del wrong["nonsense"]
            for argument, message in wrong.items():
                with self.subTest(program=program.name, argument=argument):
                    done = self.run_program(program, argument)
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertRegex(done.stderr, rf"\A{program.name}: .*--help lists .*\n\Z")
                    self.assertIn(message, done.stderr)

    def test_every_option_has_a_description(self):
        for program in PROGRAMS:
            overview = self.run_program(program, "--help").stdout
            commands = re.findall(r"^  ([a-z-]+) ", overview.partition("Subcommands:")[2], re.M)
            for command in [[], *([name] for name in commands)]:
                lists = self.run_program(program, *command, "--help").stdout.partition("Usage:")[2].partition("\nExamples:")[0]
                found = re.findall(r"^  (\S.*(?:\n {30}.*)*)", lists, re.M)
                self.assertTrue(found)
                for text in found:
                    first, _, below = text.partition("\n")
                    name, beside = first[:27], first[27:]
                    # A long type reaches beyond the column. Its description is in the next lines.
                    whole = sum(map(name.count, "([{")) == sum(map(name.count, ")]}"))
                    with self.subTest(program=program.name, command=command, option=name):
                        self.assertTrue(below.strip() or (whole and re.match(r" \S", beside)), text)

    def test_a_wrong_number_of_values_is_named(self):
        for program, call, message in [
            ("line_tracking", "run --amplitude 1,1", "--amplitude: needs 6 values, not 2"),
            ("line_tracking", "run --amplitude 1 1 --seed 3", "--amplitude: needs 6 values, not 2"),
            ("line_tracking", "run --frequency", "--frequency: needs 6 values, not none"),
            ("line_tracking", "vision --frequency=1,1,1,1,1,1,1", "--frequency: takes 6 values, not 7"),
            ("dvrk_simulator", "--amplitude=1", "--amplitude: needs 6 values, not 1"),
            ("guard", "fit none --nu", "--nu: needs one value, not none"),
            ("guard", "fit none -o x -o y", "--out: takes one value, not 2"),
            ("study", "run --tasks", "--tasks: needs one value, not none"),
            ("study", "picture reach --policy weak good", "--policy: takes one value, not 2"),
            ("study", "compare --first dfr --second knn --first lwr", "--first: takes one value, not 2"),
            ("pusher", "fit --use 3 --use=4", "--use: takes one value, not 2"),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                with self.subTest(program=program, call=call):
                    done = self.run_program(path, *shlex.split(call))
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertEqual(done.stderr, f"{program}: {message}; --help lists commands and options\n")

    def test_help_explains_valid_methods_only(self):
        supervised = {"dart", "dagger"}
        learned = {"ensemble", "five policies"}
        simulated = {"true-jacobian", "oracle", "random", "at-constraints", "out-of-support"}
        for program, command, words, others in [
            ("line_tracking", "experiment", learned | simulated, supervised),
            ("line_tracking", "run", {"lwr-online", "proportional"}, supervised | learned | simulated),
            ("line_tracking", "render", simulated, supervised | learned),
            ("pusher", "experiment", supervised | learned | simulated, set()),
            ("pusher", "evaluate", simulated, supervised | learned),
            ("study", "compare", supervised | learned | simulated, set()),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                with self.subTest(program=program, command=command):
                    text = self.run_program(path, command, "--help").stdout
                    options = re.search(r"^  --(?:methods?|first) (?:.*\n)(?: {5,}.*\n)*", text, re.M).group()
                    self.assertEqual({word for word in words | others if word in options}, words)

    def test_a_missing_file_names_the_command_that_writes_it(self):
        for program, calls, message in [
            ("line_tracking", ["run", "render"],
             "model/policy.dfr: no such file. Run `line_tracking fit` first, or give the folder of a model with --model"),
            ("line_tracking", ["fit"],
             "demonstrations.hdf5: no such file. Run `line_tracking demonstrate` first, or give another file with --demonstrations"),
            ("line_tracking", ["demonstrate", "vision"], "calibration.dfr: no such file. Run `line_tracking calibrate` first, or continue "
             "with --calibration none: the true camera and an uncorrected arm"),
            ("line_tracking", ["replay x.mcap"],
             "x.mcap: no such file. Run `line_tracking run` first, which writes logs, or name another log"),
            ("dvrk_simulator", ["--calibration calibration.dfr"],
             "calibration.dfr: no such file. Run `line_tracking calibrate` first, or give another file"),
            ("pusher", ["evaluate", "render"],
             "model/policy.dfr: no such file. Run `pusher fit` first, or give the folder of a model with --model"),
            ("pusher", ["fit"],
             "demonstrations.hdf5: no such file. Run `pusher demonstrate` first, or give another file with --demonstrations"),
            ("pusher", ["demonstrate --supervisor x.dfr", "experiment --supervisor x.dfr --out x"],
             "x.dfr: no such file. Run `pusher train-supervisor` first, or leave --supervisor out"),
            ("guard", ["show x.guard", "report x.guard x.hdf5", "evaluate x.guard x.hdf5", "export x.guard --onnx x.onnx"],
             "x.guard: no such file. Run `guard fit` first, or name another file"),
            *((program, ["status runs", "episodes runs", "rerun runs 0/1/2/dfr/3", "merge runs --out x"],
               "runs: contains no ledger.jsonl, nor do the folders in it; name the --out of a run")
              for program in ("line_tracking", "pusher", "study")),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                for call in calls:
                    with self.subTest(program=program, call=call):
                        done = self.run_program(path, *shlex.split(call))
                        self.assertEqual((done.returncode, done.stdout, done.stderr), (1, "", f"{program}: {message}\n"))

    def test_demonstrations_of_another_task_are_named(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "demos.hdf5"
            with h5py.File(path, "w") as file:
                for i in range(8):
                    demo = file.create_group(f"data/demo_{i}")
                    demo.attrs["num_samples"] = 5
                    demo["actions"] = np.zeros((5, 2))
                    demo["obs/tip"] = demo["next_obs/tip"] = np.zeros((5, 2))
            for program_path in (path for path in PROGRAMS if path.name == "guard"):
                for values, fault in [("0,0", "is zero in all entries"), ("1,1,1", "has 3 entries")]:
                    done = self.run_program(program_path, "fit", str(path), "--action-limit", values)
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertIn(f"guard: --action-limit: {fault}", done.stderr)
                for features in ("foo", "obs/foo,tip", "tip[0:9]", "tip,tip", "pca:foo", "points:tip", "points:foo:3"):
                    done = self.run_program(program_path, "fit", str(path), "--features", features)
                    self.assertEqual((done.returncode, done.stdout), (2, ""), features)
                    self.assertIn("guard: --features: ", done.stderr)
            for program, needed in [
                ("pusher", "states of qpos[0:7],tip[0:3],object[0:3],goal[0:3],red[0:6],tip_tilt[0:3] and controls of 7 entries"),
                ("line_tracking", "states of tip[0:2],distance[0:1],heading[0:1] and controls of 2 entries"),
            ]:
                for program_path in (path for path in PROGRAMS if path.name == program):
                    with self.subTest(program=program):
                        done = self.run_program(program_path, "fit", "--demonstrations", str(path))
                        self.assertEqual((done.returncode, done.stdout), (1, ""))
                        self.assertEqual(done.stderr, f"{program}: {path}: demonstrates another task: it has states of tip[0:2] and "
                                         f"controls of 2 entries, not {needed}. `{program} demonstrate` writes such demonstrations\n")

    def test_a_wrong_name_is_reported_before_a_missing_file(self):
        for program, *calls in [
            ("line_tracking", "run --method foo", "run --method dart", "run --method true-jacobian", "render --method ensemble",
             "fit --features foo"),
            ("pusher", "evaluate --methods foo", "evaluate --methods dagger", "render --methods foo", "fit --learner foo",
             "fit --features foo", "experiment --supervisor x.dfr --methods foo", "experiment --supervisor x.dfr --learners foo",
             "experiment --supervisor x.dfr --learners 8x0", "experiment --supervisor x.dfr --features foo"),
            ("guard", "fit x.hdf5 --strategy foo"),
            ("study", "run --conditions foo", "compare --condition foo"),
            ("hardware", "certificates keys --participants foo"),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                for call in calls:
                    with self.subTest(program=program, call=call):
                        done = self.run_program(path, *shlex.split(call))
                        self.assertEqual((done.returncode, done.stdout), (2, ""))
                        *_, option, value = call.split()
                        self.assertRegex(done.stderr, rf"\A{program}: .*{option.strip('-').rstrip('s')}.*'{value}'.*\n\Z")
                        self.assertNotIn("no such file", done.stderr)

    def test_a_wrong_name_in_a_configuration_is_reported_with_its_line(self):
        with tempfile.TemporaryDirectory() as folder:
            for i, (program, command, key, values, fault) in enumerate([
                ("pusher", "experiment", "methods", '["baseline", "foo"]', "--methods: unknown method 'foo'"),
                ("pusher", "experiment", "learners", '["8x0"]', "--learners: "),
                ("pusher", "experiment", "features", '"foo"', "--features: "),
                ("line_tracking", "experiment", "methods", '["foo"]', "--methods: unknown method 'foo'"),
                ("line_tracking", "experiment", "worlds", '["foo"]', "--worlds: unknown world 'foo'"),
                ("study", "run", "tasks", '["foo"]', "--tasks: unknown task 'foo'"),
                ("study", "run", "conditions", '["foo"]', "--conditions: unknown condition 'foo'"),
                ("study", "stress", "controllers", '["dfr/foo"]', "--methods: method 'dfr/foo': unknown support 'foo'"),
                ("study", "stress", "policies", '["foo"]', "--policies: unknown policy 'foo'"),
                ("study", "run", "pictures", '"points:foo"', "--pictures: "),
                ("study", "run", "tasks", '["pusher"]', "--tasks: guards run on tasks of the gallery only"),
                ("study", "experiment", "methods", '["dfr", "placebo-halts"]', "--methods: unknown method 'placebo-halts'"),
                ("line_tracking", "experiment", "features", '"foo"', "--features: "),
            ]):
                path = pathlib.Path(folder) / f"{i}.toml"
                path.write_text(f"[{command}]\nseed = 3\n{key} = {values}\n")
                for program_path in (path for path in PROGRAMS if path.name == program):
                    with self.subTest(program=program, key=key):
                        done = self.run_program(program_path, command, "--config", str(path), "--out", f"{folder}/{i}")
                        self.assertEqual((done.returncode, done.stdout), (2, ""))
                        self.assertIn(f"{program}: {path}:3: {fault}", done.stderr)

    def test_a_method_on_pictures_names_the_option_that_it_needs(self):
        for program in (path for path in PROGRAMS if path.name == "study"):
            for call in ("run --methods guard/pictures", "picture reach --methods guard/pictures"):
                done = self.run_program(program, *call.split())
                self.assertEqual((done.returncode, done.stdout), (2, ""))
                self.assertIn("study: --methods: method 'guard/pictures' needs pictures: add --pictures", done.stderr)

    def test_every_number_has_a_range(self):
        """-1 is refused. Each option is given twice, so the command does not run even if -1 is accepted."""
        for program in PROGRAMS:
            overview = self.run_program(program, "--help").stdout
            commands = re.findall(r"^  ([a-z-]+) ", overview.partition("Subcommands:")[2], re.M)
            for command in [[name] for name in commands] or [[]]:
                for option in re.findall(r"(--[a-z-]+) (?:INT|FLOAT|UINT)(?!.* \.\.\.)", self.run_program(program, *command, "--help").stdout):
                    with self.subTest(program=program.name, command=command, option=option):
                        done = self.run_program(program, *command, f"{option}=-1", f"{option}=-1")
                        self.assertEqual((done.returncode, done.stdout), (2, ""))
                        self.assertIn("-1", done.stderr.partition(";")[0])

    def test_every_share_has_a_range(self):
        """2 is refused. Each option is given twice, so the command does not run even if 2 is accepted."""
        found = set()
        for program in PROGRAMS:
            overview = self.run_program(program, "--help").stdout
            commands = re.findall(r"^  ([a-z-]+) ", overview.partition("Subcommands:")[2], re.M)
            for command in [[name] for name in commands] or [[]]:
                help_text = self.run_program(program, *command, "--help").stdout
                for option, text in re.findall(r"^  (?:-\w,)?(--[a-z-]+) (?:FLOAT|NUMBER)((?:.*\n)(?: {5,}.*\n)*)", help_text, re.M):
                    if not re.search(r"\b(share of|fraction of|as a share|probability|confidence that|bound on the share)\b", text):
                        continue
                    found.add((program.name, option))
                    with self.subTest(program=program.name, command=command, option=option):
                        done = self.run_program(program, *command, f"{option}=2", f"{option}=2")
                        self.assertEqual((done.returncode, done.stdout), (2, ""))
                        self.assertRegex(done.stderr, rf"{option}: (Value 2 not in range|must lie in .*, not 2;)")
        for known in {("guard", "--confidence"), ("study", "--alpha"), ("dvrk_simulator", "--drop")}:
            self.assertTrue(known in found or known[0] not in {program.name for program in PROGRAMS}, known)

    def test_a_word_that_is_no_number_is_named(self):
        for program, call in [("guard", "fit none --gamma inf"), ("guard", "fit none --nu 1e400"),
                              ("study", "power --power nan"), ("dvrk_simulator", "--homing soon"), ("dvrk_simulator", "--drop nan")]:
            for path in (path for path in PROGRAMS if path.name == program):
                with self.subTest(program=program, call=call):
                    done = self.run_program(path, *shlex.split(call))
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertIn(f"'{call.split()[-1]}' is not a finite decimal number", done.stderr)

    def test_two_names_of_one_option_are_a_usage_error(self):
        for program, call, names in [
            ("study", "stress --methods dfr --controllers lwr", "--methods and --controllers"),
            ("study", "stress --controllers=dfr --methods=dfr", "--controllers and --methods"),
            ("guard", "fit none -f tip --features tip", "-f and --features"),
            ("line_tracking", "run --during --not-during", "--during and --not-during"),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                with self.subTest(program=program, call=call):
                    done = self.run_program(path, *shlex.split(call))
                    self.assertEqual((done.returncode, done.stdout), (2, ""))
                    self.assertIn(f"{names} are one option: give one of them", done.stderr)

    def test_values_that_mean_nothing_are_usage_errors(self):
        for program, *calls in [
            ("study", "prove --steps 0", "picture reach --count 0", "certificate --factor=0",
             "compare --demonstrations 2000000000", "detect demos.hdf5 --task pick", "detect --unlike", "rerun out ''",
             "stress --methods dfr/foo", "stress --methods controller-without-foo", "stress --tasks pusher --policies lwr --methods lwr",
             "stress --methods placebo-halts", "run --methods monitor/pictures", "picture foo", "picture reach --policy foo",
             "picture reach --methods monitor/pictures", "compare --first foo", "figure --methods dfr/density", "figure --methods foo",
             "certificate --task foo", "detect --task foo", "detect --policy foo", "detect --features foo", "ablate --policies foo",
             *(f"run --tasks push --pictures {features} --out x" for features in ("foo", "points:foo", "points:image:x", "image[9:8]")),
             "rerun out 0/1/2/dfr/3 --film x.png", "power --power 1", "power --bound 1", "compare --alpha 0"),
            ("pusher", "demonstrate --out x.txt", "demonstrate --out x", "evaluate --methods controller@foo", "evaluate --methods dfr/foo",
             "evaluate --methods controller-without-foo", "demonstrate --horizon 2147483647", "train-supervisor --horizon 2147483647",
             "render --out x.avi", "rerun out 0/1/2/dfr/3 --film x.html", "experiment --methods placebo-halts --out x",
             "train-supervisor --out s --checkpoint ./s", "experiment --demonstrations 60,20 --supervisor x.dfr"),
            ("line_tracking", "demonstrate --out x.txt", "run --method dfr/foo", "render --method controller@foo", "run --amplitude 1e308",
             "run --amplitude 0,0,0,0,0,2", "run --frequency=-1", "render --out x.png", "experiment --methods placebo-halts --out x",
             "rerun out 0/1/2/dfr/3 --film x.html", "demonstrate --teleoperation", "experiment --features foo --out x"),
            ("dvrk_simulator", "--period 1e308", "--arm 'a b/c'", "--arm ''", "--server 127.0.0.1", "--amplitude 1e308",
             "--discovery server --server robot.local",
             "--delay 3", "--jitter=-1", "--clock-jump 1e7", "--platform-speed 1", "--camera-fault fog"),
            ("hardware", "check --server 127.0.0.1", "check --discovery server --server robot.local", "certificates keys --participants ../a:button",
             "certificates keys --participants a:button,a:button"),
            ("guard", "export none", "convert none none.hdf5 --id a/b-v0", "fit none --nu 0", "fit none --false-alarms 0",
             "fit none --confidence 1", "fit none --hold-out 0.6"),
        ]:
            for path in (path for path in PROGRAMS if path.name == program):
                for call in calls:
                    with self.subTest(program=program, call=call):
                        done = self.run_program(path, *shlex.split(call))
                        self.assertEqual((done.returncode, done.stdout), (2, ""))
                        self.assertRegex(done.stderr, rf"\A{program}: .*\n\Z")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
