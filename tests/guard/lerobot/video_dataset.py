"""Datasets of LeRobot with videos: a disc that moves to the middle, from two cameras.

usage: video_dataset.py WRITE_VIDEO FOLDER [VERSION [CODEC]]     writes 30 episodes of 30 frames
"""

import json
import pathlib
import subprocess
import sys

import numpy as np
from parquet_bytes import parquet

FPS = 30
TOP = "observation.images.top"
SIDE = "observation.images.side"


def episodes(seed, count, frames):
    """Return for each episode positions in [-1, 1], (frames, 2), and actions, the changes between positions."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        states = [rng.uniform(-0.7, 0.7, 2)]
        while len(states) < frames + 1:
            states.append(states[-1] - 0.12 * states[-1] + rng.normal(0, 0.004, 2))
        states = np.array(states)
        found.append((states[:-1], np.diff(states, axis=0)))
    return found


def draw(states, height, width, seed=0):
    """Return pictures (frames, height, width, 3): an orange disc on a blue ground, with noise."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:height, 0:width]
    pictures = []
    for x, y in states:
        distance = np.hypot(columns - width * (0.5 + 0.4 * x), rows - height * (0.5 + 0.4 * y))
        inside = np.clip(height / 8 - distance + 0.5, 0, 1)[:, :, None]
        picture = inside * np.array([220, 140, 30]) + (1 - inside) * np.array([30, 60, 150])
        pictures.append(np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8))
    return np.array(pictures)


def write_videos(program, videos, codec="mp4v", fps=FPS):
    """Write the frames of each (path, frames)."""
    content = b""
    for path, frames in videos:
        path.parent.mkdir(parents=True, exist_ok=True)
        count, height, width, _ = frames.shape
        content += f"{codec} {fps} {height} {width} {count} {path}\n".encode() + frames.tobytes()
    subprocess.run([program], input=content, check=True, capture_output=True)


def write_video(program, path, frames, codec="mp4v", fps=FPS):
    write_videos(program, [(path, frames)], codec, fps)


def write_dataset(program, folder, version, data, size=(64, 64), codec="MJPG", per_file=4, cameras=(TOP,), edit=None):
    """Write the dataset. Version 3 has per_file episodes in each video."""
    folder = pathlib.Path(folder)
    index = np.repeat(np.arange(len(data)), [len(states) for states, _ in data]).tolist()
    rows = {
        "observation.state": np.concatenate([states for states, _ in data]).tolist(),
        "action": np.concatenate([actions for _, actions in data]).tolist(),
        "episode_index": index,
    }
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    (folder / "data/chunk-000/file-000.parquet").write_bytes(parquet(rows))
    pictures = [draw(states, *size, seed=i) for i, (states, _) in enumerate(data)]
    meta = {"episode_index": list(range(len(data)))}
    videos = []
    for camera in cameras:
        turned = [p[:, ::-1] if camera == SIDE else p for p in pictures]
        if version == "v2.1":
            videos += [(folder / f"videos/chunk-000/{camera}/episode_{i:06d}.mp4", p) for i, p in enumerate(turned)]
            continue
        prefix = f"videos/{camera}/"
        for key in ("chunk_index", "file_index", "from_timestamp", "to_timestamp"):
            meta[prefix + key] = []
        for first in range(0, len(data), per_file):
            part = turned[first:first + per_file]
            videos.append((folder / f"videos/{camera}/chunk-000/file-{first // per_file:03d}.mp4", np.concatenate(part)))
            start = 0
            for frames in part:
                meta[prefix + "chunk_index"].append(0)
                meta[prefix + "file_index"].append(first // per_file)
                meta[prefix + "from_timestamp"].append(start / FPS)
                start += len(frames)
                meta[prefix + "to_timestamp"].append(start / FPS)
    write_videos(program, videos, codec)
    if version != "v2.1":
        (folder / "meta/episodes/chunk-000").mkdir(parents=True)
        (folder / "meta/episodes/chunk-000/file-000.parquet").write_bytes(parquet(meta))
    video = {"dtype": "video", "shape": [3, *size], "names": ["channels", "height", "width"]}
    vector = {"dtype": "float64", "shape": [2], "names": ["x", "y"]}
    patterns = {"v2.1": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
                "v3.0": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"}
    info = {
        "codebase_version": version, "robot_type": "disc", "fps": FPS, "chunks_size": 1000,
        "total_episodes": len(data), "total_frames": len(index), "splits": {"train": f"0:{len(data)}", "end": f"5:{len(data)}"},
        "video_path": patterns[version],
        "features": {"observation.state": vector, "action": vector, **{camera: video for camera in cameras}},
    }
    if edit:
        edit(info)
    (folder / "meta/info.json").write_text(json.dumps(info))


if __name__ == "__main__":
    write_dataset(sys.argv[1], sys.argv[2], *(sys.argv[3:4] or ["v3.0"]), episodes(1, 30, 30),
                  codec=(sys.argv[4:5] or ["mp4v"])[0])
