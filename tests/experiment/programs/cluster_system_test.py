"""Runs dfr-cluster with Slurm on this machine alone, and with GNU parallel, also over ssh.

Skips tests whose programs (slurmctld, slurmd, munged, GNU parallel, sshd) are absent or need root.

usage: cluster_system_test.py PROGRAM DFR_CLUSTER
"""
import csv
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

CLUSTER = pathlib.Path(sys.argv.pop()).resolve()
PROGRAM = pathlib.Path(sys.argv.pop()).resolve()


def run(*arguments, fails=False, **options):
    done = subprocess.run([*map(str, arguments)], text=True, capture_output=True, check=False, timeout=280, **options)
    if (done.returncode != 0) != fails:
        raise AssertionError(f"{arguments}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def pause(folder, seconds):
    """Return a program that takes `seconds`."""
    path = folder / "pause"
    path.write_text(f"#!/bin/sh\nsleep {seconds}\n")
    path.chmod(0o755)
    return path


def wait_for(condition, what, seconds=200):
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            raise AssertionError(f"timeout after {seconds} s: waiting for {what}")
        time.sleep(0.3)


class Folder(unittest.TestCase):
    def setUp(self):
        self.temporary = tempfile.TemporaryDirectory()
        self.addCleanup(self.temporary.cleanup)
        self.folder = pathlib.Path(self.temporary.name)
        run(PROGRAM, "experiment", "--out", self.folder / "whole")
        self.expected = (self.folder / "whole/summary.json").read_bytes()


class ScriptTest(Folder):
    def test_a_grid_may_be_over_lists_flags_and_dotted_keys_and_runs_every_combination(self):
        config = self.folder / "c.toml"
        config.write_text("experiment.trials = 1\nexperiment.episodes = 2\ngrid.demonstrations = [[6], [6, 60]]\n"
                          "grid.cold = [true, false]\n")
        out = self.folder / "grid"
        run(CLUSTER, "slurm", "--tasks", 2, "--out", out, "--grid", "seed=3,4", "--", PROGRAM, "experiment",
            "--config", config)
        tasks = (out / "cluster/tasks").read_text().splitlines()
        self.assertEqual(len(tasks), 2 * 2 * 2 * 2)
        for k in range(1, len(tasks) + 1):
            run(out / "cluster/task.sh", k)
        run(out / "cluster/merge.sh")
        lines = run(CLUSTER, "table", out).splitlines()
        self.assertEqual(len(lines), 1 + len(tasks) // 2 * 4)
        self.assertTrue(any(line.startswith("demonstrations=6;cold=true;seed=4,") for line in lines), lines)
        for demonstrations, cells in (("6", 1), ("6,60", 2)):
            for cold in ("true", "false"):
                folder = out / f"demonstrations={demonstrations},cold={cold},seed=4"
                summary = json.loads((folder / "summary.json").read_text())
                self.assertEqual((summary["seed"], len(summary["cells"])), (4, cells * 4))
                self.assertIn(f"cold = {cold}\n", (folder / "run.toml").read_text())

    def test_a_table_is_csv(self):
        summary = json.loads((self.folder / "whole/summary.json").read_text())
        for cell in summary["averages"]:
            cell["learner"] = "noise, sd 2 mm"
        (self.folder / "runs/drift").mkdir(parents=True)
        (self.folder / "runs/drift/summary.json").write_text(json.dumps(summary))
        header, *rows = csv.reader(run(CLUSTER, "table", self.folder / "runs").splitlines())
        for row in rows:
            self.assertEqual((len(row), row[1]), (len(header), "noise, sd 2 mm"))
        _, *single = csv.reader(run(CLUSTER, "table", self.folder / "runs/drift").splitlines())
        self.assertEqual(single, rows)

    def test_missing_units_are_named_and_run_again(self):
        out = self.folder / "run"
        run(CLUSTER, "slurm", "--tasks", 3, "--out", out, "--time", 5, "--", PROGRAM, "experiment")
        self.assertIn("--time=5", (out / "cluster/submit.sh").read_text())
        run(out / "cluster/task.sh", 1)
        run(out / "cluster/task.sh", 3)
        self.assertIn("units are missing", run(out / "cluster/merge.sh", fails=True))
        run(out / "cluster/task.sh", 2)
        run(out / "cluster/merge.sh")
        self.assertEqual((out / "summary.json").read_bytes(), self.expected)

    def test_folders_may_have_any_name(self):
        out = self.folder / "50 % mit 'Ä' $x" / "日本 %j"
        run(CLUSTER, "slurm", "--tasks", 2, "--out", out, "--", PROGRAM, "experiment")
        # sbatch treats a file's name as a pattern, in which %% is a per cent sign.
        self.assertIn("50 %% mit", (out / "cluster/submit.sh").read_text())
        self.assertIn("%%j/cluster/%A_%a.out", (out / "cluster/submit.sh").read_text())
        for k in (1, 2):
            run(out / "cluster/task.sh", k)
        run(out / "cluster/merge.sh")
        self.assertEqual((out / "summary.json").read_bytes(), self.expected)

    def test_the_time_limit_follows_from_a_measured_unit(self):
        out = self.folder / "run"
        text = run(CLUSTER, "slurm", "--tasks", 2, "--grace", 60, "--measure", "--out", out, "--", PROGRAM, "experiment",
                   "--before", pause(self.folder, 2))
        # 10 units of 2 s per task, half as much again, two more units, and twice the grace: 154 s.
        self.assertIn("time limit 3 min", text)

    def test_mistakes_are_reported(self):
        out = self.folder / "run"
        for arguments, says in [(["slurm", "--tasks", 2, "--out", out], "the experiment is missing"),
                                (["slurm", "--tasks", 0, "--out", out, "--", "x"], "--tasks must be positive"),
                                (["slurm", "--tasks", 1, "--out", out, "--grid", "gamma", "--", "x"], "--grid takes KEY=VALUE"),
                                (["slurm", "--tasks", 1, "--out", out, "--grid", "gamma=1,1", "--", "x"],
                                 "two runs of the grid have the same folder gamma=1"),
                                (["table", out], "contains no summary.json")]:
            self.assertIn(says, run(CLUSTER, *arguments, fails=True))

    def test_usage_errors_give_two_and_one_line(self):
        for arguments, says in [([], "required: SUBCOMMAND"), (["slurm"], "required: --tasks, --out"), (["table"], "required: OUT"),
                                (["nonsense"], "invalid choice: 'nonsense'"), (["table", "x", "--versoin"], "--versoin"),
                                (["slurm", "--tasks", "x", "--out", "x", "--", "x"], "--tasks: invalid int value: 'x'"),
                                (["parallel", "--tasks", "0", "--out", "x", "--", "x"], "--tasks must be positive"),
                                (["parallel", "--tasks", "1", "--out", self.folder / "x"], "the experiment is missing")]:
            with self.subTest(arguments):
                done = subprocess.run([CLUSTER, *arguments], text=True, capture_output=True, check=False, timeout=60)
                self.assertEqual((done.returncode, done.stdout), (2, ""))
                self.assertRegex(done.stderr, r"\Adfr-cluster: .*; --help lists commands and options\n\Z")
                self.assertIn(says, done.stderr)

    def test_every_argument_has_a_description(self):
        for command in ("slurm", "parallel", "table"):
            lists = run(CLUSTER, command, "--help").partition("\n\n")[2].partition("\n\n")[2]
            arguments = re.findall(r"^  (\S.*)((?:\n {5,}.*)*)", lists, re.M)
            self.assertGreater(len(arguments), 1)
            for argument, rest in arguments:
                with self.subTest(command=command, argument=argument):
                    self.assertTrue(rest or re.search(r"\S  +\S", argument))


@unittest.skipUnless(shutil.which("parallel"), "GNU parallel is not installed")
class ParallelTest(Folder):
    def test_a_job_that_fails_is_run_again(self):
        out = self.folder / "a run of 'Ä' (50 %)"
        run(CLUSTER, "parallel", "--tasks", 4, "--at-once", 2, "--retries", 2, "--submit", "--out", out, "--", PROGRAM,
            "experiment", "--fails-once", self.folder / "failed")
        self.assertTrue((self.folder / "failed").exists())
        self.assertEqual((out / "summary.json").read_bytes(), self.expected)


@unittest.skipUnless(shutil.which("parallel") and pathlib.Path("/usr/sbin/sshd").exists() and os.getuid() == 0,
                     "needs GNU parallel, sshd and root")
class SshTest(Folder):
    def test_hosts_share_the_tasks(self):
        key, host_key = self.folder / "key", self.folder / "host_key"
        for path in (key, host_key):
            run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", path)
        port = 20000 + os.getpid() % 20000
        pathlib.Path("/run/sshd").mkdir(exist_ok=True)
        server = subprocess.Popen(["/usr/sbin/sshd", "-D", "-e", "-f", "/dev/null", "-h", host_key, "-p", str(port),
                                   "-o", f"AuthorizedKeysFile={key}.pub", "-o", "StrictModes=no", "-o",
                                   "PidFile=none", "-o", "ListenAddress=127.0.0.1"], stderr=subprocess.DEVNULL)
        self.addCleanup(server.wait)
        self.addCleanup(server.kill)
        ssh = f"ssh -q -p {port} -i {key} -o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null"
        wait_for(lambda: subprocess.run([*ssh.split(), "127.0.0.1", "true"], check=False).returncode == 0, "sshd", 30)
        out = self.folder / "from here" / "a run of 'Ä' (50 %)"
        out.parent.mkdir()
        run(CLUSTER, "parallel", "--tasks", 4, "--host", "2/127.0.0.1", "--submit", "--out", out, "--", PROGRAM,
            "experiment", "--fails-once", self.folder / "failed", env={**os.environ, "PARALLEL_SSH": ssh},
            cwd=out.parent)
        self.assertIn("127.0.0.1", (out / "cluster/joblog").read_text())
        self.assertEqual((out / "summary.json").read_bytes(), self.expected)


CONFIGURATION = """ClusterName=test
SlurmctldHost=localhost(127.0.0.1)
AuthType=auth/munge
AuthInfo=cred_expire=5,socket={folder}/munge.socket
SlurmUser=root
SlurmctldPort={port}
SlurmdPort={daemon}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
SchedulerParameters=sched_interval=2,batch_sched_delay=0
KillWait=2
MinJobAge=600
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs=4
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


@unittest.skipUnless(all(map(shutil.which, ("slurmctld", "slurmd", "munged"))) and os.getuid() == 0,
                     "needs slurmctld, slurmd, munged and root")
class SlurmTest(Folder):
    def setUp(self):
        super().setUp()
        self.home = self.folder / "slurm"
        for name in ("state", "spool"):
            (self.home / name).mkdir(parents=True)
        os.chmod(self.folder, 0o755)
        host = os.uname().nodename.split(".")[0]
        port = 20000 + os.getpid() % 20000
        (self.home / "slurm.conf").write_text(
            CONFIGURATION.format(folder=self.home, port=port, daemon=port + 1, host=host))
        self.host = host
        self.environment = {**os.environ, "SLURM_CONF": str(self.home / "slurm.conf")}
        key = self.home / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        self.daemons = {}
        self.start("munged", "--foreground", "--force", f"--key-file={key}", f"--socket={self.home}/munge.socket",
                   f"--pid-file={self.home}/munged.pid", f"--log-file={self.home}/munged.log",
                   f"--seed-file={self.home}/munged.seed")
        wait_for((self.home / "munge.socket").exists, "munged")
        self.start("slurmctld", "-D", "-i")
        self.start("slurmd", "-D", "-N", host)
        wait_for(lambda: "idle" in self.state(), "an idle node")

    def start(self, name, *arguments):
        log = open(self.home / f"{name}.out", "a", encoding="utf-8")
        self.addCleanup(log.close)
        self.daemons[name] = subprocess.Popen([name, *arguments], env=self.environment, stdout=log, stderr=log)
        self.addCleanup(self.end, name)

    def end(self, name):
        self.daemons[name].kill()
        self.daemons[name].wait()

    def slurm(self, *arguments, anyway=False):
        done = subprocess.run([*map(str, arguments)], env=self.environment, text=True, capture_output=True, check=False,
                              timeout=60)
        if done.returncode != 0 and not anyway:
            raise AssertionError(f"{arguments}: {done.stdout}{done.stderr}")
        return done.stdout

    def state(self):
        return self.slurm("sinfo", "-h", "-o", "%T", anyway=True)

    def resumes(self):
        self.slurm("scontrol", "update", f"nodename={self.host}", "state=resume", anyway=True)
        return any(word in self.state() for word in ("idle", "mixed", "allocated"))

    def units(self, out):
        ledgers = out.glob("shard-*/ledger.jsonl")
        return sum(max(0, len(path.read_text().splitlines()) - 1) for path in ledgers)

    def pids(self, out):
        found = []
        for entry in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = entry.read_bytes().decode().split("\0")
            except OSError:
                continue
            if words[0] == str(PROGRAM) and any(w.startswith(str(out)) for w in words):
                found.append(int(entry.parent.name))
        return found

    def test_survives_killed_tasks_drained_nodes_and_a_killed_controller(self):
        out = self.folder / "a run of 'Ä' (50 %)"
        run(CLUSTER, "slurm", "--tasks", 4, "--at-once", 3, "--grace", 10, "--retries", 5, "--time", 5, "--submit", "--out",
            out, "--", PROGRAM, "experiment", "--before", pause(self.folder, 4), "--fails-once", self.folder / "failed",
            env=self.environment)
        wait_for(lambda: self.units(out) >= 3, "the first units")
        pids = self.pids(out)
        self.assertTrue(pids)
        os.kill(pids[0], 9)                                  # a task is killed
        running = self.slurm("squeue", "-h", "-r", "-t", "R", "-o", "%i").split()
        self.slurm("scontrol", "requeue", running[-1], anyway=True)   # another is preempted
        # Slurm sends the signal --grace seconds before the end of a task.
        self.slurm("scancel", "--batch", "--signal=USR1", running[0], anyway=True)
        time.sleep(6)                                        # slurmctld saves its state every five seconds
        self.end("slurmctld")                                # the controller is killed
        time.sleep(2)
        self.start("slurmctld", "-D")
        wait_for(lambda: self.slurm("squeue", "-h", "-r", anyway=True) != "", "the controller's return")
        # The node is drained and resumed, then marked down, which ends its tasks, and resumed.
        for state in ("drain", "down"):
            self.slurm("scontrol", "update", f"nodename={self.host}", f"state={state}", "reason=test")
            if state == "drain":  # a node that is down comes back as soon as it answers
                wait_for(lambda: "drain" in self.state(), "a node that drains", seconds=60)
            wait_for(self.resumes, "a node that resumes", seconds=60)
        try:
            wait_for(lambda: (out / "summary.json").exists(), "the merge", seconds=200)
        except AssertionError:
            print(self.slurm("squeue", anyway=True), self.state(), *(p.read_text() for p in out.rglob("*.log")),
                  *(p.read_text() for p in (out / "cluster").glob("*.out")), (self.home / "slurmctld.log").read_text())
            raise
        self.assertEqual((out / "summary.json").read_bytes(), self.expected)
        logs = "".join(path.read_text() for path in out.glob("shard-*/task.log"))
        self.assertIn("requeued: exit code", logs)
        self.assertIn("requeued: its time limit was near", logs)
        self.assertIn("the plant fell over", logs)


if __name__ == "__main__":
    unittest.main()
