"""Videos of LeRobot as parts of states. usage: video_test.py WRITE_VIDEO VIDEO_FRAMES"""

import os
import pathlib
import sys
import tempfile
import unittest

import numpy as np

import dfr

WRITER, DECODER = (pathlib.Path(p) for p in sys.argv[1:3])
del sys.argv[1:3]
sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "guard/lerobot"))
from video_dataset import TOP, draw, episodes, write_dataset  # noqa: E402


class VideoTest(unittest.TestCase):
    def test_each_state_has_the_frame_that_was_recorded_with_it(self):
        os.environ["PATH"] += os.pathsep + str(DECODER.parent)  # dfr finds no decoder beside the interpreter
        data = episodes(1, 5, 8)
        for version in ("v2.1", "v3.0"):
            with self.subTest(version), tempfile.TemporaryDirectory() as folder:
                write_dataset(WRITER, pathlib.Path(folder) / "disc", version, data)
                loaded = dfr.load_demonstrations(pathlib.Path(folder) / "disc", pictures=[f"{TOP}:64x64"])
                self.assertEqual(loaded.layout, [(TOP, (64, 64, 3)), ("observation.state", 2)])
                for i, (states, (positions, _)) in enumerate(zip(loaded.states, data)):
                    np.testing.assert_array_equal(states[:, -2:], positions)
                    pictures = states[:, :-2].reshape(-1, 64, 64, 3)
                    # Noise and compression cause small errors. The first frame of the next episode would show
                    # another position.
                    self.assertLess(np.abs(pictures - draw(positions, 64, 64, seed=i)).mean(axis=(1, 2, 3)).max(), 5.0)
                other = draw(data[0][0], 64, 64)
                self.assertGreater(np.abs(pictures - other).mean(), 6.0)


if __name__ == "__main__":
    unittest.main()
