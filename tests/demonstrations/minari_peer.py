"""Writes and checks Minari datasets with h5py alone, for minari_test.

minari_peer.py check FOLDER        exits non-zero unless FOLDER holds the test's Episodes()
minari_peer.py check-plain FOLDER  the same with observations that are one dataset
minari_peer.py write FOLDER        writes such a dataset like Minari's own tools: observations in groups
minari_peer.py write-plain FOLDER  with plain observations
"""

import json
import pathlib
import re
import sys

import h5py
import numpy as np
from episodes import BLOCKS, LENGTHS, controls, states


def check_as_minari_loads(metadata):
    """Check the metadata that Minari 0.5.3's MinariDataset and Gymnasium 1.2's EnvSpec.from_json require."""
    assert metadata["minari_version"] in {"0.5.0", "0.5.1", "0.5.2", "0.5.3"}
    assert re.fullmatch(r"([-_\w][-_\w/]*[-_\w]+/)?[-_\w]+?-v\d+", metadata["dataset_id"])
    assert isinstance(metadata["dataset_size"], float)  # `minari list` and `show` print it
    assert metadata["jpeg_encoding"] is False  # Minari's default is true
    for name in ("observation_space", "action_space"):
        assert isinstance(metadata[name], str)
        box = json.loads(metadata[name])
        for box in box["subspaces"].values() if box["type"] == "Dict" else [box]:
            low, high = (np.array(box[key], dtype=box["dtype"]) for key in ("low", "high"))
            assert low.shape == high.shape == tuple(box["shape"])
    if "env_spec" in metadata:
        assert isinstance(metadata["env_spec"], str)
        spec = json.loads(metadata["env_spec"])
        # Gymnasium pops this entry without a default; the others are arguments of a dataclass.
        assert spec.pop("additional_wrappers") == []
        assert set(spec) <= {"id", "entry_point", "reward_threshold", "nondeterministic", "max_episode_steps",
                             "order_enforce", "disable_env_checker", "kwargs", "vector_entry_point"}
        assert re.fullmatch(r"([\w:-]+/)?[\w:.-]+?(-v\d+)?", spec["id"])


def check(folder, plain):
    metadata = json.loads((folder / "data/metadata.json").read_text())
    assert metadata["total_episodes"] == len(LENGTHS)
    assert metadata["total_steps"] == sum(LENGTHS)
    assert metadata["data_format"] == "hdf5"
    assert metadata["jpeg_encoding"] is False
    assert metadata["dataset_id"] == "dfr/test-v0"
    assert metadata["minari_version"]
    # The name is not a valid id for Gymnasium. With it, Minari would refuse the whole dataset.
    assert "env_spec" not in metadata and metadata["environment"] == 'pusher "P"'
    check_as_minari_loads(metadata)
    # Spaces are JSON inside a string.
    action = json.loads(metadata["action_space"])
    assert action == {"type": "Box", "dtype": "float64", "shape": [2], "low": [-1.0] * 2, "high": [1.0] * 2}
    observation = json.loads(metadata["observation_space"])
    if plain:
        boxes = [(observation, 6)]
    else:
        assert observation["type"] == "Dict"
        assert list(observation["subspaces"]) == [name for name, _, _ in BLOCKS]
        boxes = [(observation["subspaces"][name], size) for name, _, size in BLOCKS]
    for box, size in boxes:
        assert box["type"] == "Box" and box["shape"] == [size], box
        assert box["low"] == [-np.inf] * size and box["high"] == [np.inf] * size

    with h5py.File(folder / "data/main_data.hdf5", "r") as f:
        # Reads the order from the root group, because a reopened file does not return its creation properties.
        order = h5py.h5g.open(f.id, b"/").get_create_plist().get_link_creation_order()
        assert order == h5py.h5p.CRT_ORDER_TRACKED | h5py.h5p.CRT_ORDER_INDEXED
        assert list(f) == ["episode_0", "episode_1", "episode_2"]
        for i, n in enumerate(LENGTHS):
            episode = f[f"episode_{i}"]
            assert episode.attrs["id"] == i
            assert episode.attrs["total_steps"] == n
            assert episode.attrs["seed"].dtype == np.int64
            if plain:
                np.testing.assert_array_equal(episode["observations"][()], states(i))
            else:
                for name, offset, size in BLOCKS:
                    block = episode["observations"][name]
                    np.testing.assert_array_equal(block[()], states(i)[:, offset : offset + size])
                    assert block.maxshape == (None, size) and block.chunks is not None
            np.testing.assert_array_equal(episode["actions"][()], controls(i))
            done = np.zeros(n, bool)
            done[-1] = True
            completed = i != 1  # episode 1 was halted
            np.testing.assert_array_equal(episode["rewards"][()], done * completed)
            for name, expected in (("terminations", completed), ("truncations", not completed)):
                dataset = episode[name]
                assert dataset.dtype == bool, dataset.dtype  # h5py's enumeration
                assert dataset.maxshape == (None,)
                np.testing.assert_array_equal(dataset[()], done & expected)
            assert isinstance(episode["infos"], h5py.Group)


def write(folder, plain):
    data = folder / "data"
    data.mkdir(parents=True)
    metadata = {
        "total_episodes": 3,
        "total_steps": sum(LENGTHS),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "dataset_id": "peer/lift-v0",
        "minari_version": "0.5.1",
        "env_spec": json.dumps({"id": "Lift-v1", "kwargs": {}}),
        "author": ["somebody"],
    }
    (data / "metadata.json").write_text(json.dumps(metadata))
    with h5py.File(data / "main_data.hdf5", "w", track_order=True) as f:
        for i, n in enumerate(LENGTHS):
            # episode_10 comes before episode_9 by name, but after it by number.
            episode = f.create_group(f"episode_{8 + i}")
            # Minari 0.4 writes the text "None" for an unknown seed.
            episode.attrs.update({"id": 8 + i, "total_steps": n, "seed": "None" if i == 1 else 70 + i})
            x = states(i)
            if plain:
                episode.create_dataset("observations", data=x, maxshape=(None, 6), chunks=True)
            else:
                for name, offset, size in BLOCKS:
                    key = "goal/" + name if name == "object" else name  # a space within a space
                    block = x[:, offset] if size == 1 else x[:, offset : offset + size]
                    episode.create_dataset(f"observations/{key}", data=block, compression="gzip")
                episode.create_dataset("observations/image", data=np.zeros((n + 1, 4, 4, 3), np.uint8))
            episode.create_dataset("actions", data=controls(i).astype(np.float32), maxshape=(None, 2), chunks=True)
            episode.create_dataset("rewards", data=np.zeros(n))
            episode.create_dataset("terminations", data=np.zeros(n, bool))
            episode.create_dataset("truncations", data=np.arange(n) == n - 1)
            episode.create_dataset("infos/success", data=np.arange(n + 1) == (n if i == 2 else -1))


if __name__ == "__main__":
    mode, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    {"check": check, "write": write}[mode.removesuffix("-plain")](folder, mode.endswith("-plain"))
