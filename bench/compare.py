#!/usr/bin/env python3
"""Compares the speed of two builds: bench/compare.py [BASE] [--filter TEXT] [--short]

BASE is a commit, or a folder with a build of it; without it, where this branch left origin/main, or
on main itself the commit before. The base and the working tree run the same benchmark in turn, pinned
to one core, several times; a case is judged by the ratio of the medians of its CPU time. A suspected
loss is measured again, longer, before it counts. Exits with 1 if one is confirmed. Only ratios within
this one run mean anything: machines drift.
"""
import argparse
import json
import math
import os
import pathlib
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
SHORT = "d=9 sv=64"  # one small decision function, for continuous integration
SOURCES = ("libs/core", "libs/kernel", "bench", "cmake", "CMakeLists.txt", "CMakePresets.json")


def build(source, folder, bench):
    """Builds `bench` of the tree at `source` in `folder`; returns the program."""
    subprocess.run(["cmake", "-S", source, "-B", folder, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release",
                    "-DDFR_BUILD_TESTS=OFF", "-DDFR_BUILD_BENCH=ON", "-DDFR_COMPONENTS=kernel"],
                   check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", folder, "--target", bench], check=True,
                   stdout=subprocess.DEVNULL)
    return folder / "bin" / bench


def measure(program, pattern, min_time):
    """CPU nanoseconds of our own entry, by case."""
    with tempfile.NamedTemporaryFile(suffix=".json") as out:
        subprocess.run([program, f"--benchmark_filter={pattern}", f"--benchmark_min_time={min_time}",
                        "--rounds=3", f"--benchmark_out={out.name}"],
                       check=True, stdout=subprocess.DEVNULL)
        cases = json.load(open(out.name))["cases"]
    # Cold queries are timed by the wall clock and swing with the neighbours on the machine.
    return {c["name"]: c["timings"][0]["cpu_nanoseconds"] for c in cases
            if not c["name"].startswith("cold") and c["timings"][0]["cpu_nanoseconds"] > 0}


def alternate(programs, pattern, turns, min_time):
    """Ratio new / base of the medians, by case that both have; NaN for one that is new."""
    samples = [{}, {}]
    for turn in range(turns):
        for which in (0, 1) if turn % 2 == 0 else (1, 0):
            for name, time in measure(programs[which], pattern, min_time).items():
                samples[which].setdefault(name, []).append(time)
    return {name: statistics.median(times) / statistics.median(samples[0].get(name, [math.nan]))
            for name, times in samples[1].items()}


def confirmed_losses(first, look_again, threshold):
    """Cases that lost in both looks; the second is taken only if the first has a suspect."""
    suspects = [name for name, ratio in sorted(first.items()) if ratio > threshold]
    if not suspects:
        return {}
    print(f"Looking again, for {len(suspects)} that may be slower: {', '.join(suspects)}", flush=True)
    second = look_again()
    return {name: second[name] for name in suspects if second.get(name, first[name]) > threshold}


def git(*arguments):
    """What git prints, or None if it fails."""
    done = subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True)
    return None if done.returncode else done.stdout.strip()


def default_base():
    """The merge base with origin/main; on main itself, the first parent. None: no history."""
    head = git("rev-parse", "HEAD")
    base = git("merge-base", "HEAD", "origin/main")
    if base is None or base == head:
        base = git("rev-parse", "--verify", "--quiet", "HEAD~1")
    return base


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", nargs="?", help="a commit, or a build folder with the base's bin/")
    parser.add_argument("--bench", default="kernel_decision_bench")
    parser.add_argument("--filter", default="d=9")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--threshold", type=float, default=1.10, help="ratio that is a loss")
    parser.add_argument("--short", action="store_true", help=f"only '{SHORT}', three turns, looser")
    options = parser.parse_args()
    if options.base is None:
        options.base = default_base()
        if options.base is None:
            print("There is no commit before this one: there is nothing to compare with.")
            return
        if git("diff", "--quiet", options.base, "--", *SOURCES) is not None:
            print(f"Nothing that the kernel library is built from differs from {options.base[:10]}.")
            return
    if options.short:
        options.filter, options.turns = SHORT, 3
        options.threshold = max(options.threshold, 1.25)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

    work = pathlib.Path(tempfile.mkdtemp(prefix="dfr_compare_"))
    worktree = None
    try:
        base = pathlib.Path(options.base) / "bin" / options.bench
        if not base.exists():
            commit = git("rev-parse", "--verify", "--quiet", options.base + "^{commit}")
            if commit is None:
                sys.exit(f"compare.py: '{options.base}' is neither a commit nor a build with {base}")
            worktree = work / "base"
            subprocess.run(["git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", worktree,
                            commit], check=True)
            if not (worktree / "bench/kernel" / (options.bench + ".cc")).exists():
                print(f"The base has no {options.bench} yet: there is nothing to compare with.")
                return
            base = build(worktree, work / "build_base", options.bench)
        new = build(ROOT, ROOT / "build" / "compare", options.bench)  # kept: built faster next time
        ratios = alternate((base, new), options.filter, options.turns, 0.01)
        if not ratios:
            sys.exit(f"compare.py: no case matches '{options.filter}'")
        for name, ratio in sorted(ratios.items()):
            print(f"{name:40s} " + ("is not in the base" if math.isnan(ratio)
                                    else f"{ratio:6.3f} of the base's time"))
        losses = confirmed_losses(
            ratios, lambda: alternate((base, new), options.filter, 2 * options.turns, 0.02),
            options.threshold)
        for name, ratio in losses.items():
            print(f"SLOWER: {name}: {ratio:.3f} of the base's time, twice", file=sys.stderr)
        sys.exit(1 if losses else 0)
    finally:
        if worktree is not None:
            subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", worktree],
                           stderr=subprocess.DEVNULL)
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the base's worktree goes too
    main()
