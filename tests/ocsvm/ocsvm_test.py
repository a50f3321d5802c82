"""Runs ocsvm as a user would: train, predict and tune on small files, and wrong calls."""
import math
import os
import pathlib
import random
import re
import signal
import stat
import subprocess
import sys
import tempfile
import unittest
from xml.etree import ElementTree


def run(*arguments):
    return subprocess.run([OCSVM, *map(str, arguments)], capture_output=True, text=True)


class OcsvmTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.path = pathlib.Path(self.folder.name)
        rng = random.Random(1)
        self.rows = [[rng.gauss(0, 1), 0.0, rng.gauss(0, 1)] for _ in range(400)]
        (self.path / "data.csv").write_text(
            "a,b,c\n" + "".join(",".join(map(repr, r)) + "\n" for r in self.rows))
        (self.path / "data.svm").write_text("".join(
            "1 " + " ".join(f"{k + 1}:{v!r}" for k, v in enumerate(r) if v) + "\n" for r in self.rows))

    def tearDown(self):
        self.folder.cleanup()

    def test_numbers_that_are_none_are_refused(self):
        data, model = self.path / "data.csv", self.path / "model"
        for option, value in [("-g", "nan"), ("-g", "inf"), ("-g", "0x1"), ("-n", "nan"), ("-e", "nan"),
                              ("-g", "1e" + "9" * 309), ("-m", "infinity"), ("--threads", "-1"),
                              ("--threads", "010x"), ("--threads", "99999999999999999999")]:
            wrong = run("train", option, value, data, model)
            self.assertNotEqual(wrong.returncode, 0, (option, value))
            self.assertIn(value, wrong.stderr)
            self.assertFalse(model.exists())

    def test_what_is_written_respects_links_and_devices(self):
        data, model, out = self.path / "data.csv", self.path / "model", self.path / "out"
        link = self.path / "link"
        link.symlink_to(model)
        self.assertEqual(run("train", "-q", data, link).returncode, 0)
        self.assertTrue(link.is_symlink())
        printed = run("predict", data, model, "/dev/stdout").stdout.split()
        self.assertEqual(run("predict", data, model, out).returncode, 0)
        self.assertEqual(printed[:400], out.read_text().split())
        device = "/dev/full"
        if os.geteuid() == 0:  # who could replace the machine's: one of this test's own
            device = data.parent / "own_full"
            os.mknod(device, 0o600 | stat.S_IFCHR, os.makedev(1, 7))
        full = run("predict", data, model, device)
        self.assertNotEqual(full.returncode, 0)
        self.assertIn("No space left", full.stderr)

    def test_train_and_predict_agree_with_the_model_file(self):
        model, out = self.path / "model", self.path / "out"
        trained = run("train", "-n", 0.1, "-g", 0.5, "-e", 1e-6, self.path / "data.csv", model)
        self.assertEqual(trained.returncode, 0, trained.stderr)
        self.assertIn("support vectors", trained.stdout)
        header, _, vectors = model.read_text().partition("SV\n")
        header = dict(line.split(" ", 1) for line in header.splitlines())
        self.assertEqual(header["svm_type"], "one_class")
        support = []
        for line in vectors.splitlines():
            alpha, *entries = line.split()
            x = [0.0] * 3
            for entry in entries:
                index, value = entry.split(":")
                x[int(index) - 1] = float(value)
            support.append((float(alpha), x))
        self.assertAlmostEqual(sum(a for a, _ in support), 40.0, places=9)

        self.assertEqual(run("predict", "--decision-values", self.path / "data.csv", model, out).returncode, 0)
        values = [float(v) for v in out.read_text().split()]
        for x, value in zip(self.rows[:50], values):
            g = sum(a * math.exp(-0.5 * sum((p - q) ** 2 for p, q in zip(x, s))) for a, s in support)
            self.assertAlmostEqual(value, g - float(header["rho"]), places=10)
        # The nu-property.
        self.assertLessEqual(sum(v < -1e-5 for v in values), 40)

        predicted = run("predict", self.path / "data.svm", model, out)
        self.assertEqual(predicted.returncode, 0, predicted.stderr)
        self.assertEqual([int(v) for v in out.read_text().split()], [1 if v > 0 else -1 for v in values])
        self.assertIn("of 400 inside", predicted.stdout)

    def test_ctrl_c_writes_the_model_as_it_stands_and_says_so(self):
        data, model = self.path / "large.csv", self.path / "model"
        rng = random.Random(2)
        data.write_text("".join(",".join(f"{rng.gauss(0, 1):.4f}" for _ in range(4)) + "\n"
                                for _ in range(20_000)))
        # It shows its progress on a terminal.
        terminal, its_end = os.openpty()
        self.addCleanup(os.close, terminal)
        training = subprocess.Popen([OCSVM, "train", "-n", "0.5", "-g", "3", "-e", "1e-9", str(data), str(model)],
                                    stdout=subprocess.DEVNULL, stderr=its_end)
        os.close(its_end)
        errors, told = "", False
        try:
            while part := os.read(terminal, 4096).decode():
                errors += part
                # All samples were looked at. The tolerance is far from there.
                if not told and re.search(r"[1-9]\d* iterations, largest violation \S+, to reach 1e-09", errors):
                    training.send_signal(signal.SIGINT)
                    told = True
        except OSError:  # as the terminal of a program that has ended says
            pass
        self.assertEqual(training.wait(), 130, errors)
        self.assertRegex(errors, "interrupted at a KKT gap of .* above the tolerance of 1e-09; the model is written")
        self.assertIn("total_sv", model.read_text())

    def test_any_number_of_threads_writes_the_same_model(self):
        models = []
        for threads in (0, 1, 3):
            model = self.path / f"model{threads}"
            run("train", "-q", "--threads", threads, self.path / "data.csv", model)
            models.append(model.read_bytes())
        self.assertEqual(len(set(models)), 1)

    def test_one_value_that_is_no_number_is_named_by_its_line(self):
        for value, line in (("nan", 301), ("inf", 301)):
            lines = (self.path / "data.csv").read_text().splitlines()
            lines[300] = f"0.5,{value},1"
            (self.path / "broken.csv").write_text("\n".join(lines) + "\n")
            failed = run("train", self.path / "broken.csv", self.path / "model")
            self.assertNotEqual(failed.returncode, 0)
            self.assertIn(str(line), failed.stderr)

    def test_a_model_without_trailing_zeros_meets_wider_data(self):
        model, out = self.path / "model", self.path / "out"
        model.write_text("svm_type one_class\nkernel_type rbf\ngamma 1\nnr_class 2\ntotal_sv 1\n"
                         "rho 0.5\nSV\n1 1:0 \n")
        (self.path / "wide.csv").write_text("0,0\n0,1\n")
        run("predict", "--decision-values", self.path / "wide.csv", model, out)
        near, far = map(float, out.read_text().split())
        self.assertAlmostEqual(near, 0.5, places=15)
        self.assertAlmostEqual(far, math.exp(-1) - 0.5, places=15)

    def test_tune_prints_a_table_and_a_command(self):
        picture = self.path / "tune.svg"
        tuned = run("tune", "-n", "0.05,0.1", "-g", "0.1,1", "--length", 4, "--picture", picture,
                    self.path / "data.csv")
        self.assertEqual(tuned.returncode, 0, tuned.stderr)
        self.assertIn("->", tuned.stdout)
        self.assertIn("ocsvm train -n ", tuned.stdout)
        svg = ElementTree.parse(picture)
        names = {text.text for text in svg.iter("{http://www.w3.org/2000/svg}text")}
        self.assertLessEqual({"nu = 0.05", "nu = 0.1", "volume", "chosen", "gamma"}, names)

    def test_wrong_calls_get_one_clear_line_and_a_failing_exit(self):
        data, model = self.path / "data.csv", self.path / "model"
        (self.path / "broken.csv").write_text("1,2\n3,x\n")
        for arguments, reason in [
                (["train", self.path / "none.csv", model], "none.csv: cannot be opened"),
                (["train", self.path / "broken.csv", model], "broken.csv:2: an entry must be a finite number"),
                (["train", "-n", 0, data, model], "nu must lie in (0, 1]"),
                (["train", data, self.path / "no" / "model"], "cannot be created"),
                (["predict", data, data, model], "data.csv:1: unknown key"),
                (["tune", "-l", 7, data], "no whole number of demonstrations of 7")]:
            result = run(*arguments)
            self.assertNotEqual(result.returncode, 0)
            self.assertIn(reason, result.stderr)
            self.assertEqual(len(result.stderr.splitlines()), 1, result.stderr)
        self.assertNotEqual(run("train", "-g", -1, data, model).returncode, 0)
        self.assertNotEqual(run().returncode, 0)


OCSVM = sys.argv.pop(1)
unittest.main()
