"""The program `pusher` as its users run it: each command with small numbers, and each kind of usage error.

Takes 6 s. Only this test runs the commands in sequence, each on the files of the previous one.

usage: pusher_test.py PROGRAM
"""
import os
import shutil
import unittest
import unittest.mock

from pusher_program import SMALL, ProgramTest


class PusherTest(ProgramTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.run_pusher("experiment", *SMALL, "--threads", 1, "--out", "whole")

    def test_commands_follow_one_another(self):
        out = self.run_pusher("demonstrate", "--count", 12, "--out", "d.hdf5")
        self.assertIn("12 demonstrations", out)
        out = self.run_pusher("fit", "--demonstrations", "d.hdf5", "--out", "m")
        self.assertIn("policy 8", out)
        out = self.run_pusher("evaluate", "--model", "m", "--episodes", 1)
        for method in ("baseline", "early-stopping", "dfr", "controller"):
            self.assertIn(method, out)

    def test_a_video_that_cannot_be_made_fails_before_the_experiment(self):
        small = [word for word in SMALL if word != "--no-video"]
        name = self.run_pusher("episodes", "whole", "--most", 1).split("  ")[0]
        for variables, says in [({"OPENCV_VIDEOIO_PRIORITY_FFMPEG": "0"}, "the video cannot be encoded"),
                                ({"DFR_GL": "egl", "EGL_PLATFORM": "none", "__EGL_VENDOR_LIBRARY_FILENAMES": "none"}, "cannot draw")]:
            with self.subTest(variables=variables), unittest.mock.patch.dict(os.environ, variables):
                line = self.run_pusher("experiment", *small, "--out", "filmed", fails=True)
                self.assertIn(says, line)
                self.assertIn("--no-video leaves the videos out", line)
                self.assertFalse((self.folder / "filmed/ledger.jsonl").exists())
                self.assertIn(says, self.run_pusher("rerun", "whole", name, "--film", "film.mp4", fails=True))
        self.assertFalse(list(self.folder.glob("**/*.mp4")))

    def test_an_interrupted_experiment_resumes_on_any_number_of_threads(self):
        ledger = (self.folder / "whole/ledger.jsonl").read_text().splitlines(keepends=True)
        (self.folder / "half").mkdir()
        # The run was killed while it wrote its second unit.
        (self.folder / "half/ledger.jsonl").write_text("".join(ledger[:2]) + ledger[2][:20])
        self.run_pusher("experiment", *SMALL, "--threads", 2, "--out", "half")
        self.assertEqual(self.summary_text("whole"), self.summary_text("half"))

    def test_options_override_a_preset_and_other_settings_need_a_restart(self):
        shutil.copytree(self.folder / "whole", self.folder / "authors")
        authors = ["--learners", "8", "--demonstrations", "8", "--trials", 1, "--episodes", 1, "--no-video", "--no-convergence",
                   "--methods", "baseline,controller", "--out", "authors", "--preset", "authors", "--gamma", 7,
                   "--supervisors", 2]
        error = self.run_pusher("experiment", *authors, fails=True)
        self.assertIn("was begun with other settings", error)
        self.run_pusher("experiment", *authors, "--restart")
        settings = self.settings("authors")
        self.assertEqual([settings[k] for k in ("learning_rate", "horizon", "nu", "gamma")], ["0.01", "100", "0.1", "7"])
        self.assertNotEqual(settings["supervisor 2's hash"], settings["supervisor's hash"])

    def test_a_restart_with_a_mistake_deletes_nothing(self):
        shutil.copytree(self.folder / "whole", self.folder / "kept")
        for mistake in (["experiment", *SMALL, "--learners", "8x0"], ["experiment", "--demonstrations", 2],
                        ["experiment", "--demonstrations", "8,6"], ["experiment", "--methods", "baseline,guard,guard"]):
            self.run_pusher(*mistake, "--restart", "--out", "kept", fails=True)
        self.assertTrue((self.folder / "kept/ledger.jsonl").exists())

    def test_mistakes_get_one_clear_line(self):
        (self.folder / "text").write_text("not a file of ours, and long enough to be looked into\n")
        (self.folder / "empty").mkdir()
        for arguments, says in [
            (["fit", "--demonstrations", "absent.hdf5"], "absent.hdf5"),
            (["evaluate", "--model", "empty"], "policy.dfr"),
            (["demonstrate", "--supervisor", "text"], "text: is not a file written by dfr"),
            (["experiment", "--methods", "baseline,magic"], "unknown method 'magic'"),
            (["experiment", "--learners", "8x0"], "learner '8x0'"),
            (["experiment", "--supervisors", 9], "--supervisors"),
            (["experiment", "--out", "text/below"], "text/below"),
            (["experiment", *SMALL, "--red-y", "0.05", "--out", "r"], "red"),
            (["experiment", *SMALL, "--features", "gripper", "--out", "f"], "gripper"),
            (["rerun", "whole", "7/8/8/controller/0"], "trials are 0 to 1"),
        ]:
            with self.subTest(arguments=arguments):
                self.assertIn(says, self.run_pusher(*arguments, fails=True))


if __name__ == "__main__":
    unittest.main()
