"""The program `guard` on files from independent writers: check, repair, convert, and the episodes that a fit uses.

Takes 4 s.

usage: guard_data_test.py PROGRAM
"""

import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
import unittest

import h5py
import numpy as np
from foreign_files import episodes, write_minari, write_robomimic
from guard_program import PROGRAM, GuardProgramTest

sys.path.append(str(pathlib.Path(__file__).parent / "lerobot"))
from parquet_bytes import parquet  # noqa: E402


class GuardDataTest(GuardProgramTest):
    def test_minari_gives_the_same_guard(self):
        self.fit("a.guard")
        self.fit("b.guard", "right-v0", "--strategy", "guard")
        a, b = (self.run_guard("show", name).splitlines() for name in ("a.guard", "b.guard"))
        self.assertNotEqual(a[0], b[0])
        self.assertEqual(a[1:], b[1:])

    def test_a_minari_dataset_without_all_episodes_is_named(self):
        write_minari(self.folder / "part-v0", episodes(1, 12))
        with h5py.File(self.folder / "part-v0/data/main_data.hdf5", "r+") as file:
            del file["episode_5"]
        out = self.run_program("check", "part-v0")
        self.assertIn("metadata.json declares 12 episodes, but the file holds 11: check that the download is complete", out.stdout + out.stderr)

    def test_check_names_episode_and_key(self):
        def spoil(file):
            file["data/demo_3/obs/tip"][5, 1] = np.nan
            file["data/demo_4/actions"][7, 0] = 1.5
            del file["data/demo_5/obs/object"]
            file["data/demo_7/obs/clock"][:] = 1.0

        data = episodes(1, 12)
        for observations, _ in data:
            observations["still"] = np.ones((21, 1))
            observations["twin"] = observations["tip"][:, :1]
        data[9] = data[2]
        mirrored = {key: -data[2][0][key] for key in ("tip", "twin")}
        data[8] = ({**data[2][0], **mirrored}, data[2][1])
        write_robomimic(self.folder / "spoilt.hdf5", data, edit=spoil)
        out = self.run_guard("check", "spoilt.hdf5", fails=True)
        self.assertRegex(out, r"error: +spoilt.hdf5: data/demo_3/obs/tip: row 5, column 1 is nan")
        self.assertRegex(out, r"error: +.*spoilt.hdf5.*data/demo_5/obs")
        self.assertRegex(out, r"bounds: +data/demo_4, action 0 is 1.5\d* at step 7, beyond \+-1")
        self.assertRegex(out, r"dead: +still\[0\] is always 1")
        self.assertRegex(out, r"doubled: +twin\[0\] always equals tip\[0\]|doubled: +tip\[0\] always equals twin\[0\]")
        self.assertRegex(out, r"doubled: +data/demo_9 is the same episode as data/demo_2")
        self.assertNotIn("demo_8 is the same", out)
        self.assertIn("2 errors", out)

    def test_episodes_of_another_robot_are_refused_by_name(self):
        self.fit("k.guard")
        data = episodes(1, 3)
        write_robomimic(self.folder / "hand.hdf5", [(o, np.hstack([u, u])) for o, u in data])
        write_robomimic(self.folder / "eye.hdf5", [({**o, "eye": o["tip"]}, u) for o, u in data])
        for command in ("evaluate", "report"):
            out = self.run_guard(command, "k.guard", "hand.hdf5", fails=True)
            self.assertRegex(out, r"guard: hand.hdf5: actions have 4 entries, but the guard's have 2: use")
            out = self.run_guard(command, "k.guard", "eye.hdf5", fails=True)
            self.assertRegex(out, r"guard: eye.hdf5: states consist of .*eye \(2\).*, but the guard's consist of .*tip \(2\).*: use")

    def test_repair_writes_the_readable_episodes(self):
        def cut_off(file):
            del file["data/demo_29"].attrs["num_samples"]
            file["data"].attrs.update({"provenance": "origin=real\n", "discarded": 3})

        def spoil(file):
            cut_off(file)
            del file["data/demo_5/obs/object"]

        write_robomimic(self.folder / "cut.hdf5", episodes(1, 30), edit=cut_off)
        out = self.run_guard("check", "cut.hdf5", "--repair", "whole.hdf5")
        self.assertIn("its 29 complete episodes are read; data/demo_29, which was being written, is left out", out)
        self.assertIn("whole.hdf5 has 29 of 29 episodes", out)
        self.assertIn("29 episodes of 20 to 20 actions", self.run_guard("check", "whole.hdf5"))
        self.assertIn("29 with 580 actions", self.fit("repaired.guard", "whole.hdf5"))
        self.run_guard("convert", "whole.hdf5", "converted.hdf5")
        for name in ("whole.hdf5", "converted.hdf5"):
            with self.subTest(name=name), h5py.File(self.folder / name) as file:
                self.assertTrue(file["data"].attrs["provenance"].startswith("origin=real\n"))
                self.assertEqual(file["data"].attrs["discarded"], 3)
        write_robomimic(self.folder / "spoilt2.hdf5", episodes(1, 30), edit=spoil)
        out = self.run_guard("check", "spoilt2.hdf5", "--repair", "rest.hdf5", fails=True)
        self.assertIn("rest.hdf5 has 28 of 29 episodes", out)

    def test_check_reports_malformed_files(self):
        """Malformed files that h5py can write. tests/demonstrations has other malformed files."""
        def widen(file):
            del file["data/demo_3/actions"]
            file["data/demo_3/actions"] = np.zeros((20, 3))

        def replace(key, **dataset):
            def edit(file):
                del file["data/demo_3/" + key]
                if dataset:
                    file["data/demo_3"].create_dataset(key, **dataset)

            return edit

        def cycle(file):
            file["data/demo_3/obs/loop"] = file["data"]

        for edit, message in [
            (replace("obs"), "data/demo_3/obs: does not exist"),
            (replace("actions", data=np.array([b"a", b"b"])), "data/demo_3/actions: is not numeric"),
            (replace("actions", shape=(0, 2), dtype="f8"), "data/demo_3/actions: has 0 rows"),
            (cycle, "groups deep"),
            (lambda file: file["data/demo_3"].attrs.create("num_samples", "many"), "num_samples is neither an integer nor a Boolean"),
            (lambda file: file.__delitem__("data"), "holds no episode"),
            (lambda file: file["data/demo_3/obs"].create_dataset("tool", data=np.zeros((20, 2))), "data/demo_3/obs: has 'tool', which the first episode lacks"),
            (lambda file: file["data/demo_3/obs"].create_dataset(b"t\xff", data=np.zeros((20, 2))), "t\\xff: has a name that is not UTF-8; rename it"),
            (widen, "data/demo_3/actions: has 3 columns in 'actions', but the first episode has 2"),
        ]:
            with self.subTest(message):
                write_robomimic(self.folder / "hostile.hdf5", episodes(1, 6), edit=edit)
                self.assertIn(message, self.run_guard("check", "hostile.hdf5", fails=True))

    def test_other_layouts_are_named_with_the_remedy(self):
        def no_observations(file):
            for demo in file["data"].values():
                del demo["obs"], demo["next_obs"]

        write_robomimic(self.folder / "robosuite.hdf5", episodes(1, 3), edit=no_observations)
        message = self.run_guard("check", "robosuite.hdf5", fails=True)
        self.assertIn("data/demo_0/obs: does not exist: the file holds only simulator states", message)
        self.assertIn("dataset_states_to_obs.py", message)
        with h5py.File(self.folder / "episode_0.hdf5", "w") as file:
            file["observations/qpos"] = file["action"] = np.zeros((5, 14))
        message = self.run_guard("check", "episode_0.hdf5", fails=True)
        self.assertIn("one episode in ALOHA's layout. Convert its folder to a LeRobot dataset", message)

    def test_check_detects_actions_out_of_step(self):
        for shift, sign in ((1, "-"), (-1, r"\+")):
            data = [(observations, np.roll(action, -shift, axis=0)) for observations, action in episodes(4, 30)]
            write_robomimic(self.folder / "late.hdf5", data)
            out = self.run_guard("check", "late.hdf5")
            self.assertRegex(out, rf"alignment: the change of tip\[\d\] .*step t {sign} 1.*out of step")
        self.assertNotIn("alignment", self.run_guard("check", "demos.hdf5"))

    def test_actions_that_are_positions_are_refused_and_converted(self):
        """Joint targets of a teleoperated arm, which covers half of the distance in a step."""
        rng = np.random.default_rng(8)
        data = []
        for _ in range(20):
            x, u = np.zeros((41, 3)), np.zeros((40, 4))
            x[0], goal = rng.normal(size=3), rng.normal(size=3)
            for t in range(40):
                u[t, :3] = x[t] + 0.2 * (goal - x[t]) + 0.002 * rng.normal(size=3)
                u[t, 3] = np.sign(20 - t)
                x[t + 1] = x[t] + 0.5 * (u[t, :3] - x[t])
            data.append(({"qpos": x}, u))
        write_robomimic(self.folder / "targets.hdf5", data)
        for command in (["check", "targets.hdf5", "--action-limit", "9"], ["fit", "targets.hdf5"]):
            message = self.run_guard(*command, fails=True)
            self.assertRegex(message, r"actions 0, 1, 2 take the values of qpos\[0\], qpos\[1\], qpos\[2\] \(correlation")
            self.assertIn("guard convert --differences", message)
        self.run_guard("fit", "targets.hdf5", "--as-recorded", "-o", "t.guard")
        out = self.run_guard("convert", "targets.hdf5", "steps.hdf5", "--differences")
        self.assertIn("action 1 becomes the action minus qpos[1]", out)
        self.assertIn("action 3 stays as recorded", out)
        with h5py.File(self.folder / "steps.hdf5") as file:
            for i, (observations, u) in enumerate(data):
                np.testing.assert_array_equal(
                    file[f"data/demo_{i}/actions"][:, :3], u[:, :3] - observations["qpos"][:-1]
                )
                np.testing.assert_array_equal(file[f"data/demo_{i}/actions"][:, 3], u[:, 3])
        self.assertIn("velocities or increments", self.run_guard("check", "steps.hdf5"))
        self.run_guard("fit", "steps.hdf5", "-o", "t.guard")
        message = self.run_guard("convert", "steps.hdf5", "twice.hdf5", "--differences", fails=True)
        self.assertIn("--differences has nothing to convert", message)

    def test_targets_of_an_angle_become_increments_modulo_its_period(self):
        rng = np.random.default_rng(3)
        data = []
        for _ in range(12):
            yaw = 2.8 + np.cumsum(np.r_[0.1 * rng.normal(), 0.06 + 0.01 * rng.normal(size=30)])
            data.append(({"yaw": np.angle(np.exp(1j * yaw))[:, None]}, np.angle(np.exp(1j * yaw[1:]))[:, None]))
        write_robomimic(self.folder / "wrapped.hdf5", data)
        out = self.run_guard("convert", "wrapped.hdf5", "steps.hdf5", "--differences")
        self.assertIn("action 0 becomes the action minus yaw[0], modulo 6.283", out)
        with h5py.File(self.folder / "steps.hdf5") as file:
            for i in range(len(data)):
                self.assertLess(np.abs(file[f"data/demo_{i}/actions"][:]).max(), 0.2)

    def test_many_doubled_entries_are_one_line(self):
        data = episodes(1, 6)
        for observations, _ in data:
            observations["all"] = np.hstack([observations["tip"]] * 11)
        write_robomimic(self.folder / "doubled.hdf5", data)
        out = self.run_guard("check", "doubled.hdf5")
        self.assertRegex(out, r"doubled: +22 entries repeat others, for example all\[2\] always equals all\[0\]: keep one of each")
        self.assertEqual(out.count("doubled"), 2)  # that line, and the file's name

    def test_failed_episodes_are_left_out_unless_all_have_failed(self):
        def mark(file):
            for i in range(12, 16):
                file[f"data/demo_{i}/dones"][:] = 0

        write_robomimic(self.folder / "mixed.hdf5", episodes(1, 12) + episodes(3, 4, drift=0.08), edit=mark)
        out = self.fit("m.guard", "mixed.hdf5")
        self.assertIn("4 episodes did not complete the task and are left out", out)
        self.assertIn("12 with 240 actions", out)
        out = self.fit("m.guard", "mixed.hdf5", "--all")
        self.assertIn("16 with 320 actions", out)
        words = "none of 12 episodes is recorded as completed"
        self.assertNotIn(words, out)
        write_robomimic(self.folder / "failed.hdf5", episodes(1, 12), done=False)
        self.assertIn(words, self.fit("m.guard", "failed.hdf5"))

    def test_isaac_labs_groups_are_read(self):
        """Nested observations, attribute success, no next_obs and no dones, with groups of the simulator."""
        data = episodes(1, 16)
        with h5py.File(self.folder / "isaac.hdf5", "w") as file:
            group = file.create_group("data")
            group.attrs["total"] = sum(len(action) for _, action in data)
            group.attrs["env_args"] = json.dumps({"env_name": "Isaac-Stack-Cube-v0", "type": 2})
            for i, (observations, action) in enumerate(data):
                demo = group.create_group(f"demo_{i}")
                demo.attrs["num_samples"], demo.attrs["seed"] = len(action), i
                demo.attrs["success"] = i % 4 != 0
                demo.create_dataset("actions", data=action.astype("f4"), compression="gzip")
                demo["processed_actions"] = action
                demo["obs/policy/eef_pos"] = observations["tip"][:-1].astype("f4")
                demo["obs/policy/object"] = observations["object"][:-1]
                demo["obs/subtask_terms/grasp_1"] = np.zeros((len(action), 1), dtype=bool)
                demo["obs/rgb_camera/table_cam"] = np.zeros((len(action), 4, 4, 3), dtype=np.uint8)
                for name, rows in (("initial_state", 1), ("states", len(action))):
                    demo[f"{name}/articulation/robot/joint_position"] = np.zeros((rows, 9), dtype="f4")
                    demo[f"{name}/rigid_object/cube_1/root_pose"] = np.zeros((rows, 7), dtype="f4")
        out = self.run_guard("fit", "isaac.hdf5", "-f", "obs/policy/eef_pos,obs/policy/object", "-o", "isaac.guard")
        self.assertIn("4 episodes did not complete the task and are left out", out)
        self.assertIn("12 with 228 actions", out)
        self.assertIn("policy/eef_pos,policy/object: 4 of 5 entries", out)
        self.assertIn("0 errors", self.run_guard("check", "isaac.hdf5"))

    def test_conversions_keep_everything(self):
        self.run_guard("convert", "demos.hdf5", "data/corridor/right-v1")
        metadata = json.loads((self.folder / "data/corridor/right-v1/data/metadata.json").read_text())
        self.assertEqual(metadata["dataset_id"], "corridor/right-v1")
        self.assertEqual(metadata["total_steps"], 600)
        self.run_guard("convert", "data/corridor/right-v1", "back.hdf5")
        self.run_guard("convert", "right-v0", "other.hdf5")
        expected = episodes(1, 30)
        with h5py.File(self.folder / "data/corridor/right-v1/data/main_data.hdf5") as file:
            for i, (observations, action) in enumerate(expected):
                for name, values in observations.items():
                    np.testing.assert_array_equal(file[f"episode_{i}/observations/{name}"], values)
                np.testing.assert_array_equal(file[f"episode_{i}/actions"], action)
                self.assertTrue(file[f"episode_{i}/terminations"][-1])
        for name in ("back.hdf5", "other.hdf5"):
            with h5py.File(self.folder / name) as file:
                self.assertEqual(file["data"].attrs["total"], 600)
                for i, (observations, action) in enumerate(expected):
                    demo = file[f"data/demo_{i}"]
                    self.assertEqual(demo.attrs["num_samples"], 20)
                    self.assertEqual(demo["dones"][-1], 1)
                    np.testing.assert_array_equal(demo["actions"], action)
                    for part, values in observations.items():
                        np.testing.assert_array_equal(demo[f"obs/{part}"], values[:-1])
                        np.testing.assert_array_equal(demo[f"next_obs/{part}"], values[1:])

    def test_minari_and_gymnasium_accept_converted_datasets(self):
        sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "demonstrations"))
        from minari_peer import check_as_minari_loads

        def name(environment):
            return lambda file: file["data"].attrs.modify("env_args", json.dumps({"env_name": environment}))

        for environment, valid in [("ns/Pick_place-v3", True), ("two words", False), ("", False)]:
            with self.subTest(environment):
                write_robomimic(self.folder / "named.hdf5", episodes(1, 4), edit=name(environment))
                self.run_guard("convert", "named.hdf5", "space/named-v2", "--id", "space/named-v2")
                metadata = json.loads((self.folder / "space/named-v2/data/metadata.json").read_text())
                check_as_minari_loads(metadata)
                self.assertEqual("env_spec" in metadata, valid)
                self.run_guard("convert", "space/named-v2", "again.hdf5")
                with h5py.File(self.folder / "again.hdf5") as file:
                    name_again = json.loads(file["data"].attrs["env_args"])["env_name"]
                # Minari's datasets without an environment are named by their ids.
                self.assertEqual(name_again, environment or "space/named-v2")
        for out, more in [("no-version", []), ("a b/x-v0", []), ("x-v0", ["--id", "x"])]:
            with self.subTest(out):
                message = self.run_guard("convert", "demos.hdf5", out, *more, fails=True)
                self.assertRegex(message, "is not the id of a Minari dataset: it must be <namespace>/<name>-v<number>")
                self.assertEqual("give --id" in message, not more)

    def test_frames_of_lerobot_that_are_not_in_order_are_refused(self):
        def write(name, order):
            folder = self.folder / name
            (folder / "meta").mkdir(parents=True)
            (folder / "data").mkdir()
            data = episodes(1, 4)
            sizes = {"observation.state": 2, "action": 2, "frame_index": 1, "episode_index": 1}
            info = {"codebase_version": "v2.1", "total_episodes": 4, "total_frames": 84,
                    "features": {key: {"dtype": "float64", "shape": [size]} for key, size in sizes.items()}}
            (folder / "meta/info.json").write_text(json.dumps(info))
            for i, (observations, action) in enumerate(data):
                rows = order if i == 2 else range(21)
                columns = {"observation.state": observations["tip"], "action": np.vstack([action, action[-1:]]),
                           "frame_index": np.arange(21), "episode_index": np.full(21, i)}
                (folder / f"data/episode_{i:06}.parquet").write_bytes(
                    parquet({key: [values[k].tolist() for k in rows] for key, values in columns.items()}))

        write("ordered", range(21))
        self.assertIn("0 errors", self.run_guard("check", "ordered"))
        write("shuffled", [0, 1, 2, 4, 3, *range(5, 21)])
        out = self.run_guard("check", "shuffled", fails=True)
        self.assertIn("episode_000002.parquet: episode 2, frame_index, frame 4: is 3 after 4: the rows are not in the "
                      "order of time; sort them", out)
        (self.folder / "shuffled/meta/info.json").unlink()
        (self.folder / "shuffled/meta/info.json").mkdir()
        self.assertIn("shuffled/meta/info.json: is a folder", self.run_guard("check", "shuffled", fails=True))
        # A pipe would block the reader until a program writes to it.
        shutil.copytree(self.folder / "right-v0", self.folder / "piped-v0")
        for file, dataset in [("piped.hdf5", "piped.hdf5"), ("piped-v0/data/metadata.json", "piped-v0"),
                              ("piped-v0/data/main_data.hdf5", "piped-v0"),
                              ("ordered/data/episode_000001.parquet", "ordered"), ("ordered/meta/info.json", "ordered")]:
            (self.folder / file).unlink(missing_ok=True)
            os.mkfifo(self.folder / file)
            self.assertIn(f"{file}: is a pipe or a device, not a file", self.run_guard("check", dataset, fails=True))

    def test_a_full_disk_is_named_in_one_line(self):
        def limit():
            resource.setrlimit(resource.RLIMIT_FSIZE, (12 << 10, 12 << 10))

        for command, out in (("convert", "full.hdf5"), ("convert", "corridor/full-v0"), ("check", "full.hdf5")):
            with self.subTest(command=command, out=out):
                arguments = ("demos.hdf5", "--repair", out) if command == "check" else ("demos.hdf5", out)
                done = subprocess.run([PROGRAM, command, *arguments], cwd=self.folder, capture_output=True, text=True,
                                      preexec_fn=limit, check=False)
                self.assertEqual(done.returncode, 1)
                self.assertRegex(done.stderr.splitlines()[0], rf"^guard: {out}.*: cannot be .*: File too large$")

    def test_a_filter_key_chooses_episodes(self):
        def mask(file):
            file["mask/train"] = np.array([b"demo_2", b"demo_10", b"demo_1"])
            file["mask/valid"] = np.array(["demo_0"], dtype=h5py.string_dtype())
            file["mask/wrong"] = np.array([b"demo_77"])
            file["mask/numbers"] = np.arange(3)
            file["mask/none"] = np.array([], dtype="S6")

        write_robomimic(self.folder / "masked.hdf5", episodes(1, 12), edit=mask)
        self.assertIn("3 episodes of", self.run_guard("check", "masked.hdf5", "--filter-key", "train"))
        self.assertIn("1 episodes of", self.run_guard("check", "masked.hdf5", "--filter-key", "valid"))
        self.assertIn("3 with 60 actions", self.fit("k.guard", "masked.hdf5", "--filter-key", "train", "--accept-any"))
        self.assertIn("of 1 episodes", self.run_guard("evaluate", "k.guard", "masked.hdf5", "--filter-key", "valid"))
        self.run_guard("report", "k.guard", "masked.hdf5", "--filter-key", "valid", "-o", "k.html")
        self.run_guard("convert", "masked.hdf5", "k.hdf5", "--filter-key", "train")
        with h5py.File(self.folder / "k.hdf5") as file:
            self.assertEqual(len(file["data"]), 3)
            np.testing.assert_array_equal(file["data/demo_1/actions"], episodes(1, 12)[2][1])
        for file, key, message in [
            ("masked.hdf5", "test", "mask/test: does not exist; the filter keys of this file are: none, numbers, train"),
            ("masked.hdf5", "wrong", "names 'demo_77', which is not an episode"),
            ("masked.hdf5", "numbers", "is not a list of strings"),
            ("masked.hdf5", "none", "names no episode"),
            ("demos.hdf5", "train", "this file has no filter keys"),
            ("right-v0", "train", "has no filter keys"),
        ]:
            with self.subTest(key):
                out = self.run_guard("check", file, "--filter-key", key, fails=True)
                self.assertIn(message, out)
                self.assertEqual(len(out.strip().splitlines()), 1)

    def test_conversion_needs_the_memory_of_one_episode(self):
        """Ten times as many episodes take little more memory, in both formats."""
        rng = np.random.default_rng(0)

        def large(count):
            with h5py.File(self.folder / "large.hdf5", "w") as file:
                file.create_group("data").attrs["total"] = 1000 * count
                for i in range(count):
                    demo = file.create_group(f"data/demo_{i}")
                    demo.attrs["num_samples"] = 1000
                    demo["actions"] = np.zeros((1000, 1))
                    demo["obs/x"] = rng.normal(size=(1000, 125))
                    demo["next_obs/x"] = demo["obs/x"][:]

        def peak():
            script = (
                "import resource, subprocess, sys; run = sys.argv[1:];"
                "subprocess.run([*run, 'large.hdf5', 'large-v0'], check=True);"
                "subprocess.run([*run, 'large-v0', 'back.hdf5'], check=True);"
                "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
            )
            done = subprocess.run([sys.executable, "-c", script, PROGRAM, "convert"], cwd=self.folder, text=True,
                                  capture_output=True, check=True)
            return int(done.stdout.split()[-1])

        large(2)
        small = peak()
        large(20)  # 36 MB more of observations, half of them next_obs
        self.assertLess(peak() - small, 12_000)


if __name__ == "__main__":
    unittest.main()
