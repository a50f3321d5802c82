"""The program `guard` as its users run it: fit, show, evaluate, report and export.

Takes 4 s. Only this test checks the output and the exit code of each command.

usage: guard_app_test.py PROGRAM
"""

import re
import subprocess
import unittest

import numpy as np
from foreign_files import episodes, write_robomimic
from guard_program import PROGRAM, GuardProgramTest


class GuardAppTest(GuardProgramTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        write_robomimic(cls.folder / "fresh.hdf5", episodes(2, 60))
        write_robomimic(cls.folder / "failures.hdf5", episodes(3, 10, drift=0.08), done=False)

    def test_a_picture_is_a_feature(self):
        rows, columns = np.mgrid[-0.7:0.8:0.2, -0.2:2.3:0.2]
        rng = np.random.default_rng(5)
        data = episodes(1, 20)
        for observations, _ in data:
            tips = observations["tip"]
            blobs = [np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 0.125) for x, y in tips]
            light = rng.uniform(0.8, 1.2, size=(len(tips), 1, 1))
            observations["eye"] = np.round((40 + 150 * np.array(blobs)) * light).astype(np.uint8)
        write_robomimic(self.folder / "seen.hdf5", data)
        out = self.run_guard("fit", "seen.hdf5", "-f", "pca:obs/eye,obs/object", "-o", "seen.guard")
        self.assertRegex(out, r"components +2: of left-out demonstrations, actions explained")
        self.assertRegex(out, r"\d+ components explain -?\d+ % of the variance")
        self.assertRegex(out, r"warning +pca:eye,object explain -?\d+ % of the actions")
        self.assertRegex(out, r"pca:eye,object: \d+ of the 109 entries of a state")
        self.assertEqual(self.run_guard("show", "seen.guard"), out.replace("seen.guard\n", ""))
        self.assertIn("episodes raise an alarm", self.run_guard("evaluate", "seen.guard", "seen.hdf5"))
        self.run_guard("report", "seen.guard", "seen.hdf5", "-o", "seen.html")
        self.assertIn("pca:eye[0]", (self.folder / "seen.html").read_text())
        error = self.run_guard("export", "seen.guard", "--onnx", "seen.onnx", fails=True)
        self.assertIn("pca:eye,object, cannot be exported", error)
        out = self.run_guard("fit", "seen.hdf5", "-f", "points:obs/eye:3", "-o", "points.guard")
        self.assertRegex(out, r"points:eye: 3 of the 109 entries of a state")
        self.assertRegex(out, r"strategy +guard")
        self.assertEqual(self.run_guard("show", "points.guard"), out.replace("points.guard\n", ""))
        error = self.run_guard("fit", "seen.hdf5", "-f", "points:obs/object", fails=True)
        self.assertIn("'points:object': points are for pictures", error)
        error = self.run_guard("fit", "seen.hdf5", "-f", "pca:obs/wrist", fails=True)
        self.assertIn("obs/wrist: does not exist", error)

    def test_commands_follow_one_another(self):
        out = self.run_guard("check", "demos.hdf5")
        self.assertIn("30 episodes of 20 to 20 actions", out)
        self.assertIn("0 errors", out)
        out = self.fit("task.guard")
        self.assertIn("object,tip: 4 of 5 entries", out)
        self.assertIn("30 with 600 actions, from demos.hdf5", out)
        self.assertIn("support fits: 11", out)
        changed = float(re.search(r"the guard would change ([\d.]+) %", out).group(1))
        self.assertEqual(self.run_guard("show", "task.guard"), out.replace("task.guard\n", ""))
        out = self.run_guard("evaluate", "task.guard", "fresh.hdf5")
        alarms = int(re.search(r"(\d+) of 60 episodes raise an alarm", out).group(1))
        # The mean rate is .1. Its standard deviation is sqrt(.1 .9 / 32) = .053 between sets of 30
        # demonstrations and sqrt(.1 .9 / 60) = .039 by chance, together .066. The limit is three of these.
        self.assertLess(alarms / 60, 0.1 + 3 * 0.066)
        passed = float(re.search(r"([\d.]+) % of the 1200 actions pass unchanged", out).group(1))
        # The fit estimates the share from left-out demonstrations.
        self.assertAlmostEqual(passed, 100.0 - changed, delta=4.0)
        out = self.run_guard("evaluate", "task.guard", "failures.hdf5")
        self.assertIn("10 of 10 episodes raise an alarm", out)
        self.assertIn("0 pass untouched", out)
        self.assertRegex(out, r"[\d.]+ % of the \d+ actions pass unchanged; \d+ are changed, by [\d.]+ ordinary")
        self.run_guard("report", "task.guard", "fresh.hdf5", "--failures", "failures.hdf5", "-o", "r.html")
        page = (self.folder / "r.html").read_text()
        self.assertIn("10 of 10, 100.0 %", page)
        self.assertIn("the alarm precedes the end by", page)
        self.assertRegex(page, rf"Strategy guard passes {passed} % of their actions unchanged")
        for name in ("tip[1]", "object[0]", "data/demo_59", "demos.hdf5"):
            self.assertIn(name, page)
        self.assertNotIn("clock", page)
        self.assertNotRegex(page, "https?://")

    def test_the_report_tells_the_clearance_that_demonstrations_must_have_kept(self):
        shown = self.fit("clear.guard")
        moved = episodes(2, 20)
        for observations, _ in moved:
            observations["object"] += (3.0, 4.0)
        write_robomimic(self.folder / "moved.hdf5", moved)

        def rows(demonstrations):
            self.run_guard("report", "clear.guard", demonstrations, "-o", "clear.html")
            page = (self.folder / "clear.html").read_text()
            table = re.search(r"Clearance</h2>.*?</table>", page, re.S).group()
            found = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in re.findall(r"<tr>(.*?)</tr>", table, re.S)]
            self.assertEqual(found[0], ["Block", "Required", "Step", "Median", "Strayed", "Median strayed"])
            return {row[0]: row[1:] for row in found[1:]}, re.search(r"with an alarm: (\d+) of", page).group(1)

        own, alarms = rows("demos.hdf5")
        self.assertEqual((set(own), alarms), ({"object", "tip"}, "0"))
        for block, (required, step, median, strayed, middle) in own.items():
            self.assertRegex(shown, rf"clearance +{block}: .* within {required} in it \(step {step}; median {median}\)")
            # None of these states raises an alarm.
            self.assertLess(0.0, float(strayed))
            self.assertLessEqual(float(middle), float(strayed))
            self.assertLessEqual(float(strayed), float(required))
        # Objects are within .6 of one another, in the unit of the file. Those of moved.hdf5 are 5 units away.
        away, alarms = rows("moved.hdf5")
        self.assertEqual(alarms, "20")
        for distance in away["object"][3:]:
            self.assertAlmostEqual(float(distance), 5.0, delta=0.6)
        self.assertGreater(float(away["object"][3]), float(away["object"][0]))

    def test_a_strict_fit_fails_if_the_guard_has_a_warning(self):
        out = self.run_guard("fit", "demos.hdf5", "--gamma", "100", "--accept-any", "-o", "narrow.guard")
        self.assertRegex(out, "warning .*of the states of left-out demonstrations are inside")
        self.assertIn("warning ", self.run_guard("show", "narrow.guard"))
        strict = self.run_program("fit", "demos.hdf5", "--gamma", "100", "--accept-any", "--strict", "-o", "narrow.guard")
        self.assertEqual(strict.returncode, 3, strict.stderr)
        out = self.run_guard("fit", "demos.hdf5", "--gamma", "1e6", "-o", "isolated.guard", fails=True)
        self.assertIn("choose a smaller gamma", out)

    def test_rotations_and_features_that_are_too_many_are_named(self):
        data = episodes(1, 30)
        rng = np.random.default_rng(4)
        for observations, _ in data:
            angles = 0.1 * rng.normal() + 0.05 * np.arange(21)
            zero = np.zeros(21)
            observations["quat"] = np.stack([np.cos(angles), zero, zero, np.sin(angles)], axis=1)
            observations["yaw"] = np.angle(np.exp(10j * angles))[:, None]
            observations["noise"] = rng.normal(size=(21, 30))
        write_robomimic(self.folder / "turned.hdf5", data)
        out = self.run_guard("check", "turned.hdf5")
        self.assertRegex(out, r"rotation +quat\[0:4\] is a unit quaternion: a guard treats q and -q as the same")
        self.assertRegex(out, r"rotation +yaw\[0\] is an angle that jumps by 6.28.* cosine and sine")
        out = self.run_guard("fit", "turned.hdf5", "-f", "obs/tip,obs/yaw", "--accept-any", "-o", "yaw.guard")
        self.assertIn("tip,yaw: 3 of 40 entries of a state, angles by cosine and sine", out)
        self.assertNotIn("yaw[0]", out)
        out = self.run_guard("fit", "turned.hdf5", "-f", "obs/tip,obs/noise", "-o", "noisy.guard", fails=True)
        self.assertRegex(out, r"the share inside\): .*tip \(\d+ %\).*--accept-any")

    def test_invalid_numbers_are_refused(self):
        for option, message in [
            ("--gamma nan", "nan"), ("--nu 0x1", "0x1"), ("--horizon 2147483648", "horizon"), ("--action-limit inf", "inf"),
            *((f"--action-limit{sign}{limits}", f"--action-limit: '{limits}' has an empty entry")
              for sign in " =" for limits in ("1,,2", "1,2,", ",1", ",")),
        ]:
            with self.subTest(option):
                out = self.run_guard("fit", "demos.hdf5", *option.split(), "-o", "none.guard", fails=True)
                self.assertIn(message, out)
                self.assertFalse((self.folder / "none.guard").exists())

    def test_exports(self):
        self.fit("e.guard")
        self.run_guard("export", "e.guard", "--onnx", "e.onnx", "--libsvm", "models")
        self.assertGreater((self.folder / "e.onnx").stat().st_size, 1000)
        models = sorted((self.folder / "models").glob("t_*.model"))
        self.assertEqual(models[0].name, "t_000.model")
        self.assertIn("svm_type one_class", models[0].read_text())
        features = np.loadtxt(self.folder / "models/features.csv", delimiter=",", skiprows=1)
        # Parts of a state are in the order of their names: clock, object, tip.
        np.testing.assert_array_equal(features[:, 0], [1, 2, 3, 4])
        self.assertEqual(np.loadtxt(self.folder / "models/t_000.csv", delimiter=",").shape, (4, 4))
        done = self.run_program("export", "e.guard")
        self.assertEqual((done.returncode, "--onnx FILE or --libsvm FOLDER" in done.stderr), (2, True), done.stderr)
        # A shorter guard would not overwrite the last models of a longer guard.
        before = {path.name: path.read_bytes() for path in (self.folder / "models").iterdir()}
        done = self.run_program("export", "e.guard", "--libsvm", "models")
        self.assertEqual((done.returncode, "remove the folder or name another" in done.stderr), (2, True), done.stderr)
        self.assertEqual({path.name: path.read_bytes() for path in (self.folder / "models").iterdir()}, before)
        for onnx, libsvm in (("both", "both"), ("./both", "both/")):
            self.assertIn("both", self.run_guard("export", "e.guard", "--onnx", onnx, "--libsvm", libsvm, fails=True))
            self.assertFalse((self.folder / "both").exists())

    def test_names_in_files_cannot_control_a_terminal(self):
        rude = [({name + "\x1b[2J": values for name, values in observations.items()}, action)
                for observations, action in episodes(1, 30)]
        write_robomimic(self.folder / "rude.hdf5", rude)
        self.run_guard("fit", "rude.hdf5", "-o", "rude.guard")
        for arguments in (["show", "rude.guard"], ["check", "rude.hdf5"], ["evaluate", "rude.guard", "rude.hdf5"],
                          ["fit", "rude.hdf5", "--features", "gripper", "-o", "none.guard"]):
            with self.subTest(arguments):
                done = self.run_program(*arguments)
                self.assertNotIn("\x1b", done.stdout + done.stderr)
        self.assertIn("tip\\x1b[2J", done.stderr)

    def test_mistakes_are_one_line_with_a_remedy(self):
        self.fit("x.guard")
        content = (self.folder / "x.guard").read_bytes()
        (self.folder / "cut.guard").write_bytes(content[:-20])
        for arguments, message in [
            (["fit", "missing.hdf5"], "missing.hdf5"),
            (["fit", "demos.hdf5", "--features", "gripper"], "feature 'gripper' is not part of the state; it has"),
            (["fit", "demos.hdf5", "--strategy", "brave"], "unknown strategy 'brave'; valid: guard, controller"),
            (["fit", "demos.hdf5", "--features", "tip", "--nu", "2"], "nu"),
            (["fit", "demos.hdf5", "--action-limit", "1,2,3"],
             "guard: --action-limit: has 3 entries, but actions have 2: give one entry for all, or 2\n"),
            (["fit", "demos.hdf5", "--action-limit", "0,0"], "guard: --action-limit: is zero in all entries: nothing could move\n"),
            (["fit", "missing.hdf5", "--strategy", "brave"], "unknown strategy 'brave'"),
            (["check", "missing.hdf5", "--repair", "x.txt"], "--repair: x.txt: the name must end in .hdf5; --help"),
            (["check", "demos.hdf5", "--action-limit", "-1"], "--action-limit: must be positive, not -1; --help"),
            (["check", "."], ".: has neither data/main_data.hdf5 (Minari) nor meta/info.json (LeRobot)"),
            (["show", "cut.guard"], "cut.guard: is truncated or damaged"),
            (["show", "demos.hdf5"], "is not a file written by dfr"),
            (["show", "/dev/zero"], "/dev/zero: is a pipe or a device, not a file"),
            (["fit", "missing.hdf5", "-o", ""], "--out: '': names no file; add a name"),
            (["convert", "missing.hdf5", ""], "OUT: '': names no folder; add a name"),
            (["fit", "missing.hdf5", "--strict=0x10"], "--strict: '0x10' is neither true nor false"),
            ([], "subcommand"),
        ]:
            with self.subTest(arguments):
                self.assertIn(message, self.run_guard(*arguments, fails=True))
        self.assertIn("--features", self.run_guard("fit", "--help"))

    def test_lost_output_is_a_failure(self):
        self.fit("lost.guard")
        with open("/dev/full", "w") as full:
            for arguments in (["--version"], ["show", "lost.guard"], ["check", "demos.hdf5"]):
                done = subprocess.run([PROGRAM, *arguments], cwd=self.folder, stdout=full, stderr=subprocess.PIPE, text=True)
                self.assertEqual(done.returncode, 1, arguments)
                self.assertIn("guard: standard output could not be written, and is incomplete", done.stderr)

    def test_files_are_not_mixed_with_closed_standard_streams(self):
        """A file opened later would get the number of a closed stream, and then its messages."""
        self.fit("open.guard", "demos.hdf5", "--gamma", ".25")
        for closed in (">&-", "2>&-", "<&- >&- 2>&-"):
            call = f'"{PROGRAM}" fit demos.hdf5 -f obs/object,obs/tip --gamma .25 -o closed.guard {closed}'
            self.assertEqual(subprocess.run(call, shell=True, cwd=self.folder, stdout=subprocess.DEVNULL).returncode, 0, closed)
            written = (self.folder / "closed.guard").read_bytes()
            self.assertEqual(written, (self.folder / "open.guard").read_bytes(), closed)

    def test_inputs_are_not_overwritten(self):
        self.fit("kept.guard")
        (self.folder / "alias.hdf5").symlink_to("demos.hdf5")
        inputs = ("demos.hdf5", "fresh.hdf5", "failures.hdf5", "kept.guard", "right-v0/data/main_data.hdf5")
        before = {name: hash((self.folder / name).read_bytes()) for name in inputs}
        for arguments, says in (
            ("fit demos.hdf5 -f tip -o demos.hdf5", "--out: demos.hdf5: would overwrite DEMOS; name another file"),
            ("check demos.hdf5 --repair demos.hdf5", "demos.hdf5: would overwrite DEMOS"),
            ("fit demos.hdf5 -f tip -o alias.hdf5", "--out: alias.hdf5: would overwrite DEMOS"),
            ("report kept.guard fresh.hdf5 -o ./fresh.hdf5", "--out: ./fresh.hdf5: would overwrite DEMOS"),
            ("report kept.guard fresh.hdf5 -o kept.guard", "--out: kept.guard: would overwrite GUARD"),
            ("report kept.guard fresh.hdf5 --failures failures.hdf5 -o failures.hdf5", "would overwrite --failures"),
            ("export kept.guard --onnx kept.guard", "--onnx: kept.guard: would overwrite GUARD"),
            ("convert demos.hdf5 demos.hdf5", "OUT: demos.hdf5: would overwrite DEMOS"),
            ("convert right-v0 right-v0 --id a/right-v0", "right-v0: would overwrite the episodes to convert; name another"),
            ("convert right-v0 right-v0/data/main_data.hdf5", "data/main_data.hdf5: would overwrite DEMOS"),
            ("fit right-v0 -f tip -o right-v0/data/main_data.hdf5", "data/main_data.hdf5: would overwrite DEMOS; name another"),
            ("report kept.guard right-v0 -o right-v0/data/metadata.json", "data/metadata.json: would overwrite DEMOS"),
            ("convert demos.hdf5 other.hdf5 --id a/b-v0", "--id: applies only to the folder of a Minari dataset, not to other.hdf5"),
        ):
            with self.subTest(arguments):
                self.assertIn(says, self.run_guard(*arguments.split(), fails=True))
        self.assertEqual({name: hash((self.folder / name).read_bytes()) for name in inputs}, before)

    def test_outputs_are_checked_before_the_work(self):
        (self.folder / "taken").mkdir()
        (self.folder / "text").write_text("kept")
        (self.folder / "circle").symlink_to("circle")
        (self.folder / "astray").symlink_to("none/x")
        # No input exists: a message about an option or the output proves that it is checked first.
        done = self.run_program("fit", "none", "--horizon", "2000000000")
        self.assertEqual((done.returncode, "--horizon: " in done.stderr), (2, True), done.stderr)
        for command, kinds in (("fit none -o", "file"), ("report none none -o", "file"), ("check none --repair", "file"),
                               ("export none --onnx", "file"), ("export none --libsvm", "folder"),
                               ("convert none", "folder")):
            for path, says in {"file": (("none/x", "there is no folder none; create it"), ("/proc/x", "nothing can be created in /proc; name"),
                                        ("taken", "is a folder; name a file in it"), ("text/x", "text is not a folder"),
                                        ("circle", "Too many levels of symbolic links; name another"),
                                        ("astray", "cannot be created: No such file or directory; name another")),
                               "folder": (("text", "text is not a folder; name another"), ("text/x", "text is not a folder"),
                                          ("/proc/x", "nothing can be created in /proc; name"))}[kinds]:
                with self.subTest(command=command, path=path):
                    done = self.run_program(*command.split(), path)
                    self.assertEqual(done.returncode, 2, done.stderr)
                    self.assertIn(f"{path}: ", done.stderr)
                    self.assertIn(says, done.stderr)
        self.assertEqual((self.folder / "text").read_text(), "kept")
        (self.folder / "taken/task.guard").mkdir()
        done = self.run_program("fit", "none", folder="taken")
        self.assertEqual((done.returncode, "task.guard: is a folder" in done.stderr), (2, True), done.stderr)


if __name__ == "__main__":
    unittest.main()
