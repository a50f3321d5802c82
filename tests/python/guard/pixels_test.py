"""dfr.Guard on components of pictures: shapes, the table, attribution, pickles, and files of pictures."""

import pathlib
import pickle
import tempfile
import unittest

import h5py
import numpy as np

import dfr
from corridor import demonstrations

HEIGHT, WIDTH = 8, 12


def pictures(states, seed):
    """Return colour pictures (n, HEIGHT, WIDTH, 3) of states [clock, x, y], in light that varies by 20 %."""
    rng = np.random.default_rng(seed)
    columns, rows = np.meshgrid(0.2 * np.arange(WIDTH) - 0.1, 0.2 * (np.arange(HEIGHT) - 3.5))
    seen = []
    for _, x, y in states:
        blob = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 0.25**2))
        grey = (40 + 150 * blob) * rng.uniform(0.8, 1.2) + 2 * rng.normal(size=blob.shape)
        seen.append(np.repeat(grey[:, :, None], 3, axis=2))
    return np.clip(np.round(seen), 0, 255).astype(np.uint8)


class PixelsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states, cls.actions = demonstrations(1, 40)
        cls.seen = [pictures(s, i) for i, s in enumerate(cls.states)]
        cls.fitted = dfr.Guard.fit(
            [p.reshape(len(p), -1) for p in cls.seen],
            cls.actions,
            layout={"camera": (HEIGHT, WIDTH, 3)},
            features="pca:camera:grey",
        )
        cls.guard = cls.fitted.with_settings(strategy="guard")

    def test_a_picture_is_a_block_with_a_shape(self):
        self.assertEqual(self.guard.layout, [("camera", (HEIGHT, WIDTH, 3))])
        self.assertEqual(self.guard.state_dim, HEIGHT * WIDTH * 3)
        self.assertEqual(self.guard.features, "pca:camera")

    def test_the_summary_has_the_table(self):
        rows = self.guard.summary["components"]
        self.assertGreater(len(rows), 3)
        self.assertEqual(set(rows[0]), {"components", "explained", "inside", "response_error"})
        self.assertIn("components explain", self.guard.summary["components_reason"])
        self.assertEqual(pickle.loads(pickle.dumps(self.guard)).summary, self.guard.summary)

    def test_pixels_of_the_tip_put_a_state_outside(self):
        outside = pictures([(0, 1.0, 0.45)], 7).reshape(1, -1)
        share = self.guard.attribution(outside.astype(float)).reshape(HEIGHT, WIDTH, 3)
        self.assertAlmostEqual(share.sum() / -self.guard.levels(outside.astype(float))[0], 1.0, places=6)
        near = abs(share[:, 3:9]).sum()
        self.assertGreater(near, 0.7 * abs(share).sum())
        self.assertIn("pca:camera[", self.guard.explain(outside[0].astype(float))["text"])

    def test_points_are_features_and_show_no_picture(self):
        seen = [p.reshape(len(p), -1) for p in self.seen[:12]]
        layout = {"camera": (HEIGHT, WIDTH, 3)}
        guard = dfr.Guard.fit(seen, self.actions[:12], layout=layout, features="points:camera:grey")
        self.assertEqual(guard.features, "points:camera")
        outside = pictures([(0, 1.0, 0.45)], 7).reshape(1, -1).astype(float)
        self.assertAlmostEqual(guard.attribution(outside).sum() / -guard.levels(outside)[0], 1.0, places=6)
        with self.assertRaisesRegex(ValueError, "positions of patches, which cannot be shown as a picture"):
            guard.reconstruct("camera", outside[0])
        again = pickle.loads(pickle.dumps(guard))
        self.assertEqual(again.decision(3, seen[0][3]), guard.decision(3, seen[0][3]))

    def test_components_show_the_tip(self):
        state = self.seen[0][10].ravel().astype(float)
        shown = self.guard.reconstruct("camera", state)
        self.assertEqual(shown.shape, (HEIGHT, WIDTH, 1))
        grey = self.seen[0][10, :, :, 0].astype(float)
        self.assertGreater(np.corrcoef(shown.ravel(), grey.ravel())[0, 1], 0.95)

    def test_a_bad_picture_halts_and_says_why(self):
        state = self.seen[0][0].ravel().astype(float)
        for broken, why in ((state * np.nan, "nan"), (state * 0, "the picture 'camera' is black"), (state[1:], "287")):
            self.guard.reset()
            action, info = self.guard.filter(0, broken, self.actions[0][0])
            self.assertEqual((info["mode"], info["reason"]), ("halt", "state-invalid"))
            self.assertIn(why, info["why"])
            self.assertFalse(action.any())

    def test_shapes_and_options_that_make_no_sense_are_named(self):
        def fit(layout, features):
            dfr.Guard.fit([p.reshape(len(p), -1) for p in self.seen], self.actions, layout=layout, features=features)

        for layout, features, message in [
            ((HEIGHT, WIDTH * 3 // 4, 4), "pca:camera", "needs positive sizes and 1 or 3 channels"),
            (HEIGHT * WIDTH * 3, "pca:camera:grey", "give the block the shape"),
            (HEIGHT * WIDTH * 3, "points:camera", "points are for pictures"),
            ((HEIGHT, WIDTH, 3), "camera,pca:camera", "put points: or pca: before it"),
        ]:
            with self.assertRaisesRegex(ValueError, message):
                fit({"camera": layout}, features)

    def test_pictures_are_read_from_a_file_if_asked_for(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "demos.hdf5"
            with h5py.File(path, "w") as file:
                for i, (states, actions, seen) in enumerate(zip(self.states[:4], self.actions, self.seen)):
                    demo = file.create_group(f"data/demo_{i}")
                    demo.attrs["num_samples"] = len(actions)
                    demo["actions"] = actions
                    for part, rows in (("obs", slice(0, -1)), ("next_obs", slice(1, None))):
                        demo[f"{part}/tip"] = states[rows, 1:]
                        demo[f"{part}/camera"] = seen[rows]
            plain = dfr.load_demonstrations(path)
            self.assertEqual(plain.layout, [("tip", 2)])
            loaded = dfr.load_demonstrations(path, pictures=["camera"])
            self.assertEqual(dict(loaded.layout), {"tip": 2, "camera": (HEIGHT, WIDTH, 3)})
            first = [name for name, _ in loaded.layout].index("camera") * 2
            pixels = loaded.states[2][:, first : first + HEIGHT * WIDTH * 3]
            np.testing.assert_array_equal(pixels.reshape(self.seen[2].shape), self.seen[2])
            with self.assertRaisesRegex(RuntimeError, "obs/wrist: does not exist"):
                dfr.load_demonstrations(path, pictures=["wrist"])


if __name__ == "__main__":
    unittest.main()
