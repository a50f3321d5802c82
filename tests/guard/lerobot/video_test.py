"""LeRobot's videos: the frames that `video_frames` decodes, and the guards that are fitted to them.

Takes 20 s.

usage: video_test.py GUARD VIDEO_FRAMES WRITE_VIDEO
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy as np
from dataset_copy import copy_dataset
from parquet_bytes import parquet
from video_dataset import FPS, SIDE, TOP, draw, episodes, write_dataset, write_video

GUARD, DECODER, WRITER = (pathlib.Path(p).resolve() for p in sys.argv[1:4])
del sys.argv[1:4]
# Sets the number of components, because these tests do not cover its choice.
FEATURES = f"pca:{TOP}:2,observation.state"


class VideoTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.data = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        cls.episodes = episodes(1, 8, 12)
        for version in ("v2.1", "v3.0"):
            write_dataset(WRITER, cls.data / version / "disc", version, cls.episodes, cameras=(TOP, SIDE))

    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))

    def frames(self, *requests):
        """Return the answers to requests: arrays of frames, or the text of an error."""
        lines = "".join(" ".join(map(str, r)) + "\n" for r in requests)
        done = subprocess.run([DECODER], input=lines.encode(), capture_output=True, check=True, timeout=60)
        self.assertEqual(done.stderr, b"")
        out, answers = done.stdout, []
        for _, _, count, _, _, _, height, width, _ in requests:
            found = []
            while out and len(found) < count:
                if out[:1] == b"-":
                    found, out = out[1:].split(b"\n", 1)
                    break
                size = 3 * height * width
                found.append(np.frombuffer(out[1:size + 1], np.uint8).reshape(height, width, 3))
                out = out[size + 1:]
            answers.append(found.decode() if isinstance(found, bytes) else np.array(found))
        self.assertEqual(out, b"")
        return answers

    def guard(self, *arguments, fails=False, **options):
        done = subprocess.run([GUARD, *map(str, arguments)], cwd=self.folder, text=True, capture_output=True, timeout=60,
                              check=False, **options)
        self.assertEqual(done.returncode, int(fails), done.stdout + done.stderr)
        if fails:
            self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        return done.stderr if fails else done.stdout

    def copy(self, version, edit=None):
        return copy_dataset(self.data / version / "disc", self.folder / version, edit)

    def test_frames_are_those_that_were_written(self):
        pictures = draw(np.random.default_rng(3).uniform(-0.7, 0.7, (20, 2)), 48, 80)
        for codec in ("mp4v", "MJPG", "avc1"):
            with self.subTest(codec):
                path = self.folder / f"{codec}.mp4"
                write_video(WRITER, path, pictures, codec)
                whole, last, middle, tail = self.frames(
                    (0, 0, 20, FPS, 48, 80, 48, 80, path), (0, 19, 1, FPS, 48, 80, 48, 80, path),
                    (0, 5, 3, FPS, 48, 80, 48, 80, path), (0, 8, 2, FPS, 48, 80, 48, 80, path))
                # Noise and compression cause errors of a few grey values. A wrong order of channels causes tens.
                errors, others = (np.abs(whole[n:].astype(float) - pictures[:20 - n]).mean(axis=(1, 2, 3)) for n in (0, 1))
                self.assertLess(errors.max(), 5.0)
                self.assertLess(errors.max(), others.min())
                np.testing.assert_array_equal(last, whole[19:])
                np.testing.assert_array_equal(middle, whole[5:8])
                np.testing.assert_array_equal(tail, whole[8:10])

    def test_frames_are_averaged(self):
        path = self.folder / "video.mp4"
        write_video(WRITER, path, draw(self.episodes[0][0], 48, 80))
        whole, half = self.frames((0, 0, 12, FPS, 48, 80, 48, 80, path), (1, 0, 12, FPS, 48, 80, 24, 40, path))
        average = whole.reshape(12, 24, 2, 40, 2, 3).mean(axis=(2, 4))
        self.assertLessEqual(np.abs(half - average).max(), 0.75)

    def test_cameras_do_not_disturb_each_other(self):
        pictures = [draw(e[0], 48, 48) for e in self.episodes[:2]]
        paths = [self.folder / f"{i}.mp4" for i in range(2)]
        for path, frames in zip(paths, pictures):
            write_video(WRITER, path, frames)
        answers = self.frames(*((i, first, 4, FPS, 48, 48, 48, 48, paths[i]) for first in (0, 4, 8) for i in (0, 1)))
        for i in (0, 1):
            self.assertLess(np.abs(np.concatenate(answers[i::2]).astype(float) - pictures[i]).mean(), 8.0)

    def test_both_versions_give_the_same_guard(self):
        """In version 3 an episode's frames begin within a file."""
        for version in ("v2.1", "v3.0"):
            out = self.guard("fit", self.data / version / "disc", "-f", FEATURES + f",pca:{SIDE}:2:16x16:grey", "--all",
                             "--accept-any", "-o", f"{version}.guard")
            self.assertIn("of the 3842 entries of a state", out)  # 32 x 32 x 3 + 16 x 16 x 3 + 2
            self.assertRegex(out, r" of left-out demonstrations, \d+\.\d % have a picture unlike all others")
        same = [(self.folder / f"{version}.guard").read_bytes() for version in ("v2.1", "v3.0")]
        self.assertEqual(*same)
        # A split begins in the middle of a file. The guard determines the size of pictures.
        whole, part = (self.guard("evaluate", "v3.0.guard", self.data / "v3.0/disc", *more)
                       for more in ([], ["--filter-key", "end"]))
        row = next(line for line in whole.splitlines() if line.startswith("episode 7 "))
        self.assertIn(row, part)

    def test_a_frame_of_another_state_changes_the_guard(self):
        """Shows that test_both_versions_give_the_same_guard depends on the frames."""
        moved = self.copy("v3.0")
        file = moved / "meta/episodes/chunk-000/file-000.parquet"
        meta = {"episode_index": list(range(8))}
        for key in (TOP, SIDE):
            at = [(i % 4) * 12 for i in range(8)]
            meta[f"videos/{key}/chunk_index"] = [0] * 8
            meta[f"videos/{key}/file_index"] = [i // 4 for i in range(8)]
            meta[f"videos/{key}/from_timestamp"] = [a / FPS for a in at]
            meta[f"videos/{key}/to_timestamp"] = [(a + 12) / FPS for a in at]
        fit = ("fit", moved, "-f", FEATURES, "--all", "--accept-any", "-o")
        self.guard(*fit, "whole.guard")
        meta[f"videos/{TOP}/from_timestamp"][1] -= 1 / FPS
        file.write_bytes(parquet(meta))
        self.guard(*fit, "moved.guard")
        self.assertNotEqual(*((self.folder / f"{n}.guard").read_bytes() for n in ("moved", "whole")))

    def test_shapes_may_have_any_order(self):
        for shape, names in [([3, 64, 64], None), ([64, 3, 64], ["width", "channels", "height"])]:
            def edit(info):
                info["features"][TOP].update(shape=shape, names=names)
            out = self.guard("fit", self.copy("v2.1", edit), "-f", FEATURES, "--all", "--accept-any", "-o", "x.guard")
            self.assertIn("of the 3074 entries", out)

    def test_without_a_feature_videos_are_left_alone(self):
        target = self.copy("v3.0")
        shutil.rmtree(target / "videos")
        shutil.rmtree(target / "meta/episodes")
        self.assertIn(f"images and videos are skipped: {SIDE}, {TOP}; to read a video, use the feature points:{SIDE}",
                      self.guard("check", target))

    def test_mistakes_name_file_and_remedy(self):
        v2, v3 = f"videos/chunk-000/{TOP}/episode_000003.mp4", f"videos/{TOP}/chunk-000/file-000.mp4"

        def cut(path):
            path.write_bytes(path.read_bytes()[:-400])

        def damage(path):
            content = bytearray(path.read_bytes())
            content[len(content) // 3:len(content) * 2 // 3] = bytes(len(content) * 2 // 3 - len(content) // 3)
            path.write_bytes(content)

        def codec(path):
            write_video(WRITER, path, draw(self.episodes[3][0], 64, 64), "avc1")
            path.write_bytes(path.read_bytes().replace(b"avc1", b"zzzz"))

        def pointer(path):
            path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12345\n")

        def fewer(path):
            write_video(WRITER, path, draw(self.episodes[3][0][:9], 64, 64))

        def smaller(path):
            write_video(WRITER, path, draw(self.episodes[3][0], 48, 64))

        def slower(path):
            write_video(WRITER, path, draw(self.episodes[3][0], 64, 64), fps=15)

        def pipe(path):
            path.unlink()
            os.mkfifo(path)

        def setting(**values):
            return lambda info: info.update(values)

        def shape(info):
            info["features"][TOP]["shape"] = [64, 64]

        def image(info):
            info["features"][TOP]["dtype"] = "image"

        for version, file, change, edit, message, remedy in [
            ("v2.1", v2, pathlib.Path.unlink, None, f"{v2}: episode 3, {TOP}: does not exist", "download"),
            ("v3.0", v3, pathlib.Path.unlink, None, f"{v3}: episode 0, {TOP}: does not exist", "download"),
            ("v2.1", v2, cut, None, f"{v2}: episode 3, {TOP}: is not a video that can be decoded", "download"),
            ("v2.1", v2, damage, None, "cannot decode frame", "the file is damaged"),
            ("v2.1", v2, pointer, None, "is a Git LFS pointer", "git lfs pull"),
            ("v2.1", v2, pipe, None, f"{v2}: is a pipe or a device", ""),
            ("v2.1", None, None, setting(video_path="/dev/{video_key}"), f"video_path leads to /dev/{TOP}", "folder"),
            ("v2.1", None, None, setting(video_path="a/../../b"), "video_path leads to a/../../b", "folder"),
            ("v2.1", v2, codec, None, "cannot decode any frame of its codec 'zzzz'", "ffmpeg -i OLD.mp4 -c:v libx264 NEW.mp4"),
            ("v2.1", v2, fewer, None, "ends after 9 frames; the episode has more states", "download"),
            ("v2.1", v2, smaller, None, "frames have 48 x 64 pixels (height x width); meta/info.json states 64 x 64",
             "correct"),
            ("v2.1", v2, slower, None, "has 15 frames per second; meta/info.json states 30", "correct fps"),
            ("v3.0", None, None, setting(fps=15), "0 s to 0.4 s are 6 frames; the episode has 12 states", "fps"),
            ("v3.0", None, None, setting(fps=0), "info.json: fps is not a frame rate", "set it"),
            ("v3.0", "meta/episodes/chunk-000/file-000.parquet", pathlib.Path.unlink, None, "holds no Parquet file", ""),
            ("v2.1", None, None, shape, f"the video {TOP} does not have the shape of pictures", "[480, 640, 3]"),
            ("v2.1", None, None, image, f"{TOP} is neither a vector of numbers nor a video; the dataset's videos are "
             f"{SIDE}. Images in Parquet files are not read", "load them in Python"),
        ]:
            with self.subTest(message):
                target = self.copy(version, edit)
                if change:
                    change(target / file)
                error = self.guard("fit", target, "-f", FEATURES, "--all", "-o", "x.guard", fails=2 if edit is image else 1)
                self.assertIn(message, error)
                self.assertIn(remedy, error)
        error = self.guard("fit", self.copy("v2.1"), "-f", f"pca:{TOP}:2:65x64", "-o", "x.guard", fails=2)
        self.assertIn("have 64 x 64 pixels, fewer than 65 x 64; request a smaller size", error)

    def test_a_missing_decoder_is_named(self):
        (self.folder / "bin").mkdir()
        alone = self.folder / "bin/guard"
        shutil.copy(GUARD, alone)
        command = [alone, "fit", self.data / "v2.1/disc", "-f", FEATURES, "--all", "--accept-any", "-o", self.folder / "x"]
        done = subprocess.run(command, text=True, capture_output=True, check=False, env={**os.environ, "PATH": "/nowhere"})
        self.assertEqual(done.returncode, 1)
        self.assertRegex(done.stderr, "the program video_frames, which decodes videos, does not start: No such file.*; "
                                      "build the component video_frames.*package dfr-video-frames")
        found = {**os.environ, "PATH": str(DECODER.parent)}
        subprocess.run(command, check=True, capture_output=True, env=found)

    def test_invalid_requests_are_refused(self):
        for line in ("", "0 0 1 30 64 64 65 64 x.mp4", "0 0 1 30 64 64 64 64", "0 -1 1 30 64 64 64 64 x.mp4", "a"):
            done = subprocess.run([DECODER], input=line + "\n", text=True, capture_output=True, check=True, timeout=60)
            self.assertEqual(done.stdout, "-invalid request; video_frames --help describes the format\n")


if __name__ == "__main__":
    unittest.main()
