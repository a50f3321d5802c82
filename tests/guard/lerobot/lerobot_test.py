"""Datasets of LeRobot from independent writers, as the program `guard` reads them.

usage: lerobot_test.py PROGRAM DATASETS     (DATASETS: the folder that write_datasets.mjs has written)
"""

import json
import pathlib
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import unittest

import h5py
import numpy as np
from dataset_copy import copy_dataset
from parquet_bytes import field, integer, listed, text

PROGRAM, DATASETS = (pathlib.Path(p).resolve() for p in sys.argv[1:3])
del sys.argv[1:3]
READABLE = ("v21", "v30", "pages2", "plain", "hyparquet", "hyparquet_plain")


def limit_memory():
    resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))


class LeRobotTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = pathlib.Path(temporary.name)
        self.expected = json.loads((DATASETS / "expected.json").read_text())

    def guard(self, *arguments, check=True):
        done = subprocess.run([PROGRAM, *map(str, arguments)], cwd=self.folder, text=True, capture_output=True,
                              timeout=60, preexec_fn=limit_memory)
        if check:
            self.assertEqual(done.returncode, 0, done.stderr + done.stdout)
        return done.stdout + done.stderr if check else done

    def copy(self, name, edit=None):
        return copy_dataset(DATASETS / name, self.folder / name, edit)

    def test_every_value_is_read(self):
        for name in READABLE:
            with self.subTest(name):
                out = self.guard("convert", DATASETS / name, "out.hdf5")
                self.assertIn("images and videos are skipped: observation.images.top", out)
                with h5py.File(self.folder / "out.hdf5") as file:
                    self.assertEqual(len(file["data"]), 24)
                    self.assertEqual(json.loads(file["data"].attrs["env_args"])["env_name"], "so100_follower")
                    for i, episode in enumerate(self.expected):
                        demo = file[f"data/demo_{i}"]
                        frames = len(episode["action"])
                        # The state after the last action is not recorded.
                        self.assertEqual(demo.attrs["num_samples"], frames - 1)
                        np.testing.assert_array_equal(demo["actions"], episode["action"][:-1])
                        state = demo["obs/observation.state"], demo["next_obs/observation.state"]
                        np.testing.assert_array_equal(state[0], episode["state"][:-1])
                        np.testing.assert_array_equal(state[1], episode["state"][1:])
                        other = demo["obs/observation.environment_state"]
                        np.testing.assert_array_equal(np.ravel(other), episode["environment"][:-1])
                        self.assertEqual(demo["dones"][-1], int(i != 3))

    def test_half_precision_unsigned_numbers_and_single_frames(self):
        out = self.guard("convert", DATASETS / "half", "out.hdf5")
        self.assertIn("episodes of one frame are left out: 1", out)
        index = 0
        with h5py.File(self.folder / "out.hdf5") as file:
            self.assertEqual(len(file["data"]), 24)
            for i, episode in enumerate(self.expected):
                demo, frames = file[f"data/demo_{i}"], len(episode["action"])
                other = demo["obs/observation.environment_state"]
                np.testing.assert_array_equal(np.ravel(other), episode["environment"][:-1])
                counter = np.ravel(demo["next_obs/observation.counter"])
                np.testing.assert_array_equal(counter, 4294967295 - np.arange(index + 1, index + frames))
                index += frames

    def test_all_versions_give_the_same_guard(self):
        shown = set()
        for name in ("v21", "v30"):
            out = self.guard("fit", DATASETS / name, "-f", "observation.state", "-o", f"{name}.guard")
            self.assertIn("1 episodes did not complete the task and are left out", out)
            shown.add(self.guard("show", f"{name}.guard").replace(name, ""))
        self.assertEqual(len(shown), 1)
        self.assertIn("observation.state: 2 of 3 entries", shown.pop())
        self.guard("evaluate", "v21.guard", DATASETS / "v30", "--filter-key", "test")

    def test_splits_are_filter_keys(self):
        self.assertIn("20 episodes of", self.guard("check", DATASETS / "v30", "--filter-key", "train"))
        self.assertIn("4 episodes of", self.guard("check", DATASETS / "v21", "--filter-key", "test"))

    def test_mistakes_are_one_line(self):
        def without(*keys):
            def edit(info):
                for key in keys[:-1]:
                    info = info[key]
                del info[keys[-1]]
            return edit

        def setting(key, value):
            return lambda info: info.__setitem__(key, value)

        def size(info):
            info["features"]["observation.state"]["shape"] = [3]

        for name, edit, more, message in [
            ("gzip", None, [], "file-000.parquet: column episode_index is compressed with GZIP; uncompressed, SNAPPY"),
            ("delta", None, [], "column episode_index has the encoding DELTA_BINARY_PACKED; PLAIN, dictionaries and"),
            ("v30", None, ["--filter-key", "valid"], "info.json: has no split 'valid'; it has test, train"),
            ("v30", setting("splits", {"valid": "a:b"}), ["--filter-key", "valid"], 'split \'valid\' is "a:b", not'),
            ("v30", setting("total_episodes", 25), [], "total_episodes is 25, but the files below data hold 24: check that the download"),
            ("v30", setting("total_frames", "many"), [], 'total_frames is "many"'),
            ("v30", setting("codebase_version", "v1.6"), [], "codebase_version is 'v1.6'; v2.0 to v3.0 can be read"),
            ("v30", without("features", "action"), [], "has no feature 'action'"),
            ("v30", without("features"), [], "has no features"),
        ]:
            with self.subTest(message):
                done = self.guard("check", self.copy(name, edit), *more, check=False)
                self.assertEqual(done.returncode, 1)
                self.assertIn(message, done.stderr)
                self.assertEqual(len(done.stderr.splitlines()), 1)
        for name, edit, message in [
            ("holes", None, "episode 2, observation.state, frame 8: entry 0 is missing or not finite"),
            ("ragged", None, "episode 2, action, frame 8: has 3 entries; meta/info.json states 2"),
            ("v30", size, "episode 0, observation.state, frame 0: has 2 entries; meta/info.json states 3"),
        ]:
            with self.subTest(message):
                done = self.guard("check", self.copy(name, edit), check=False)
                self.assertEqual(done.returncode, 1)
                self.assertIn(message, done.stdout)
        broken = self.copy("v30")
        (broken / "meta/info.json").write_text("[")
        self.assertIn("is not a JSON object", self.guard("check", broken, check=False).stderr)
        shutil.rmtree(broken / "data")
        shutil.copy(DATASETS / "v30/meta/info.json", broken / "meta/info.json")
        self.assertIn("holds no Parquet file", self.guard("check", broken, check=False).stderr)

    def test_cut_files_are_refused(self):
        for name in ("plain", "hyparquet"):
            target = self.copy(name)
            file = target / "data/chunk-000/file-000.parquet"
            content = file.read_bytes()
            for size in (0, 3, 4, 11, 12, 100, len(content) // 2, len(content) - 5, len(content) - 1):
                with self.subTest(name=name, size=size):
                    file.write_bytes(content[:size])
                    done = self.guard("check", target, check=False)
                    self.assertEqual(done.returncode, 1, done.stderr)
                    self.assertRegex(done.stderr, r"file-000.parquet: (is not a Parquet|is truncated|declares metadata)")

    def test_hostile_files_are_read_or_refused_within_the_budget(self):
        """For any changed bytes the program neither crashes nor uses unbounded memory."""
        rng = random.Random(11)
        for name in ("v30", "pages2", "hyparquet"):
            target = self.copy(name)
            file = target / "data/chunk-000/file-000.parquet"
            content = file.read_bytes()
            length = int.from_bytes(content[-8:-4], "little")
            footer = len(content) - 8 - length
            refused = 0
            for trial in range(60):
                damaged = bytearray(content)
                low, high = (footer, len(content) - 4) if trial % 2 else (4, footer)
                for _ in range(rng.choice((1, 1, 4, 30))):
                    damaged[rng.randrange(low, high)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
                file.write_bytes(damaged)
                done = self.guard("check", target, check=False)
                self.assertIn(done.returncode, (0, 1), f"{name}, trial {trial}: {done.stderr}")
                self.assertNotIn("bad_alloc", done.stderr + done.stdout)
                refused += done.returncode
            self.assertGreater(refused, 10)

    def test_declared_sizes_beyond_the_budget_are_refused(self):
        def file(values, page_size, rows=None, page_values=4):
            """Return a file with one column episode_index of INT32 in one page."""
            header = field(1, 5, integer(0)) + field(1, 5, integer(page_size)) + field(1, 5, integer(16)) + field(
                2, 12, field(1, 5, integer(page_values)) + field(1, 5, integer(0)) + field(1, 5, integer(3))
                + field(1, 5, integer(3)) + b"\0") + b"\0"
            page = header + b"\0" * 16
            root = field(4, 8, text("root")) + field(1, 5, integer(1)) + b"\0"
            leaf = field(1, 5, integer(1)) + field(2, 5, integer(0)) + field(1, 8, text("episode_index")) + b"\0"
            meta = (field(1, 5, integer(1)) + field(1, 9, listed(5, integer(0))) + field(1, 9, listed(8, text("e")))
                    + field(1, 5, integer(0)) + field(1, 6, integer(values)) + field(1, 6, integer(page_size))
                    + field(1, 6, integer(len(page))) + field(2, 6, integer(4)) + b"\0")
            group = (field(1, 9, listed(12, field(3, 12, meta) + b"\0")) + field(1, 6, integer(len(page)))
                     + field(1, 6, integer(values if rows is None else rows)) + b"\0")
            footer = (field(1, 5, integer(1)) + field(1, 9, listed(12, root, leaf)) + field(1, 6, integer(values))
                      + field(1, 9, listed(12, group)) + b"\0")
            return b"PAR1" + page + footer + len(footer).to_bytes(4, "little") + b"PAR1"

        target = self.copy("v30")
        shutil.rmtree(target / "data")
        (target / "data").mkdir()
        nested = b"\x1c" * 200000
        for content, message in [
            (file(4, 16), "total_episodes is 24, but the files below data hold 1"),  # a valid file
            (file(4, 2**31 - 1), "declares a page of 2147483647 bytes, too many for a file"),
            (file(4, 64), "does not decompress to the size it claims"),
            (file(4, 16, page_values=2**30), "pages with more values than the column"),
            (file(2**20, 16, page_values=2**20), "ends in the middle of a page"),
            (file(4, 16, rows=9), "has 4 rows; its row group has 9"),
            (b"PAR1" + nested + len(nested).to_bytes(4, "little") + b"PAR1", "nested too deep"),
            (b"PAR1" + b"\xff" * 4 + b"PAR1", "declares metadata of 4294967295 bytes"),
        ]:
            with self.subTest(message):
                (target / "data/file.parquet").write_bytes(content)
                done = self.guard("check", target, check=False)
                self.assertEqual(done.returncode, 1)
                self.assertIn(message, done.stderr)


if __name__ == "__main__":
    unittest.main()
