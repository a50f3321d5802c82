"""Demonstrations in robomimic's and Minari's layouts, written with h5py and NumPy alone.

The task: a tip goes right along y = 0 past a drifting object; actions are rotated velocities.
"""

import json
import pathlib

import h5py
import numpy as np

STEPS = 20


def episodes(seed, count, drift=0.0):
    """Return for each episode a dict of observations (STEPS + 1 rows each) and actions (STEPS rows).

    With a drift the tip leaves sideways, and the episode fails."""
    rng = np.random.default_rng(seed)
    turn = np.array([[np.cos(0.8), -np.sin(0.8)], [np.sin(0.8), np.cos(0.8)]])
    result = []
    for _ in range(count):
        tip = np.zeros((STEPS + 1, 2))
        action = np.zeros((STEPS, 2))
        tip[0] = 0.05 * rng.normal(), 0.1 * rng.normal()
        thing = np.tile(0.1 * rng.normal(size=2), (STEPS + 1, 1)) + 0.02 * np.arange(STEPS + 1)[:, None]
        for t in range(STEPS):
            wish = np.array([0.1, drift - 0.3 * tip[t, 1] * (drift == 0.0) + 0.05 * rng.normal()])
            action[t] = turn.T @ wish
            tip[t + 1] = tip[t] + wish
        clock = np.arange(STEPS + 1.0)[:, None]
        result.append(({"tip": tip, "object": thing, "clock": clock}, action))
    return result


def write_robomimic(path, data, done=True, edit=lambda file: None):
    with h5py.File(path, "w") as file:
        group = file.create_group("data")
        group.attrs["total"] = sum(len(action) for _, action in data)
        group.attrs["env_args"] = json.dumps({"env_name": "Corridor", "type": 2, "env_type": 2, "env_kwargs": {}})
        for i, (observations, action) in enumerate(data):
            demo = group.create_group(f"demo_{i}")
            demo.attrs["num_samples"] = len(action)
            demo["actions"] = action
            demo["states"] = np.zeros((len(action), 4))
            demo["rewards"] = np.zeros(len(action))
            demo["dones"] = np.r_[np.zeros(len(action) - 1, dtype=int), int(done)]
            for name, values in observations.items():
                demo[f"obs/{name}"] = values[:-1]
                demo[f"next_obs/{name}"] = values[1:]
            demo["obs/camera"] = np.zeros((len(action), 4, 4, 3), dtype=np.uint8)
        edit(file)


def write_minari(folder, data):
    folder = pathlib.Path(folder)
    (folder / "data").mkdir(parents=True)
    with h5py.File(folder / "data/main_data.hdf5", "w", track_order=True) as file:
        for i, (observations, action) in enumerate(data):
            episode = file.create_group(f"episode_{i}")
            episode.attrs["id"] = i
            episode.attrs["total_steps"] = len(action)
            episode.attrs["seed"] = 7 + i
            for name, values in observations.items():
                episode[f"observations/{name}"] = values
            episode["actions"] = action
            episode["rewards"] = np.zeros(len(action))
            episode["terminations"] = np.r_[np.zeros(len(action) - 1, dtype=bool), True]
            episode["truncations"] = np.zeros(len(action), dtype=bool)
            episode.create_group("infos")
    spaces = {
        "action_space": {"type": "Box", "dtype": "float64", "shape": [2], "low": [-1, -1], "high": [1, 1]},
        "observation_space": {"type": "Dict", "subspaces": {}},
    }
    metadata = {
        "total_episodes": len(data),
        "total_steps": sum(len(action) for _, action in data),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "dataset_id": "corridor/right-v0",
        "minari_version": "0.5.3",
        **{name: json.dumps(space) for name, space in spaces.items()},
    }
    (folder / "data/metadata.json").write_text(json.dumps(metadata))
