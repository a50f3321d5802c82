"""Writes and checks robomimic files with h5py alone, for demonstrations_test.

robomimic_peer.py check FILE   exits non-zero unless FILE holds the test's Episodes()
robomimic_peer.py write FILE   writes such a file like robomimic's own tools
"""

import json
import sys

import h5py
import numpy as np
from episodes import BLOCKS, LENGTHS, controls, states


def check(path):
    # robomimic opens data sets for training in this way.
    with h5py.File(path, "r", swmr=True, libver="latest") as f:
        data = f["data"]
        env_args = json.loads(data.attrs["env_args"])
        assert env_args["env_name"] == 'pusher "P"', env_args
        assert env_args["env_type"] == 2 and env_args["type"] == 2 and env_args["env_kwargs"] == {}
        assert data.attrs["total"] == sum(LENGTHS)
        assert data.attrs["discarded"] == 2
        assert sorted(data) == ["demo_0", "demo_1", "demo_2"]
        for i, n in enumerate(LENGTHS):
            demo = data[f"demo_{i}"]
            assert demo.attrs["num_samples"] == n
            assert demo.attrs["model_file"] == "<mujoco/>"
            x, u = states(i), controls(i)
            np.testing.assert_array_equal(demo["states"][()], x[:-1])
            np.testing.assert_array_equal(demo["actions"][()], u)
            done = np.zeros(n)
            done[-1] = i != 1  # episode 1 was halted
            np.testing.assert_array_equal(demo["rewards"][()], done)
            np.testing.assert_array_equal(demo["dones"][()], done)
            assert np.issubdtype(demo["dones"].dtype, np.integer)
            assert sorted(demo["obs"]) == sorted(name for name, _, _ in BLOCKS)
            for name, offset, size in BLOCKS:
                block = x[:, offset : offset + size]
                assert demo["obs"][name].dtype == np.float64
                np.testing.assert_array_equal(demo["obs"][name][()], block[:-1])
                np.testing.assert_array_equal(demo["next_obs"][name][()], block[1:])


def write(path):
    with h5py.File(path, "w") as f:
        data = f.create_group("data")
        data.attrs["total"] = sum(LENGTHS)
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {}})
        for i, n in enumerate(LENGTHS):
            # demo_10 comes before demo_9 by name, but after it by number.
            demo = data.create_group(f"demo_{8 + i}")
            demo.attrs["num_samples"] = n
            x = states(i)
            demo.create_dataset("states", data=np.zeros((n, 40)))  # states of the simulator, which dfr does not read
            demo.create_dataset("actions", data=controls(i).astype(np.float32))
            demo.create_dataset("rewards", data=np.zeros(n))
            demo.create_dataset("dones", data=np.arange(n) == n - 1)  # booleans
            for group, rows in (("obs", x[:-1]), ("next_obs", x[1:])):
                for name, offset, size in BLOCKS:
                    block = rows[:, offset : offset + size]
                    if size == 1:
                        block = block[:, 0]  # one-dimensional
                    demo.create_dataset(f"{group}/{name}", data=block, compression="gzip")
                demo.create_dataset(f"{group}/image", data=np.zeros((n, 4, 4, 3), np.uint8))
        f.create_dataset("mask/train", data=np.array(["demo_8"], dtype="S"))


if __name__ == "__main__":
    {"check": check, "write": write}[sys.argv[1]](sys.argv[2])
