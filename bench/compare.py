#!/usr/bin/env python3
"""Compares the speed of two builds: bench/compare.py [BASE] [--filter TEXT] [--short]

BASE is a commit, or a folder with a build of it. Default: the merge base with origin/main, or on main
the previous commit. Both builds run the same operations (bench/safety/counted_work.cc): decisions,
gradients, fits, a guided step, a guard's filter. Both builds use one folder, build/compare, one after the
other, and the second compiles only the sources that differ. Both are optimised as in a release. With --short
they are optimised as the tests are, and the second one is build/dev, the build of the tests. If BASE is a
folder, both are optimised as in a release, and --short only leaves out the times.

The comparison uses valgrind's counts of each operation's instructions. They repeat exactly, regardless of
other load on the machine, and an increase by more than 5 % is a loss. Valgrind supports no AVX-512, and
counted instructions do not show cache misses. The operations are therefore also timed, alternately and pinned to one
core, and a longer measurement confirms a loss of time. --short measures no times, because other load on the
machine must not fail it. Valgrind's model of the caches is not used: after a mere change of addresses it reported a
loss of 7 % that cost no time.

--short first compares with bench/instructions.json, the counts that --record wrote. If each count is within
2 % of its record, BASE is not built. Otherwise a change, or another compiler or processor, changed a count, and
the comparison with BASE decides.
Exits with 1 if there is a loss.
"""
import argparse
import json
import math
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = "counted_work"
MOST_COUNTED = 1.05
RECORD = ROOT / "bench" / "instructions.json"
MOST_FROM_RECORD = 1.02
SOURCES = ("libs/core", "libs/kernel", "libs/control", "libs/reduction", "libs/safety", "bench/kernel",
           "bench/control", "bench/safety", "cmake", "CMakeLists.txt", "CMakePresets.json", "components.txt")
WORK = ROOT / "build" / "compare"


def compiles_in_units(source):
    """Returns True if the tree at `source` supports unity builds, which halve the build time."""
    return "CMAKE_UNITY_BUILD" in (pathlib.Path(source) / "CMakePresets.json").read_text()


def settings_of_tests(source):
    """Returns the settings that the preset dev has in the tree at `source`, as arguments of cmake."""
    presets = json.loads((source / "CMakePresets.json").read_text())["configurePresets"]
    settings = next(preset["cacheVariables"] for preset in presets if preset["name"] == "dev")
    return [f"-D{name}={value}" for name, value in settings.items()]


def settings_of_release(units):
    return ["-DCMAKE_BUILD_TYPE=Release", "-DDFR_PRECOMPILE=ON",
            f"-DCMAKE_UNITY_BUILD={'ON' if units else 'OFF'}"]


def build(source, folder, settings):
    """Builds the program of the tree at `source` in `folder`. Returns its path."""
    subprocess.run(["cmake", "-S", source, "-B", folder, "-G", "Ninja", "--no-warn-unused-cli", "-DDFR_BUILD_TESTS=OFF",
                    "-DDFR_BUILD_BENCH=ON", "-DDFR_COMPONENTS=safety", *settings],
                   check=True, stdout=subprocess.DEVNULL)
    return build_program(folder)


def build_program(folder):
    subprocess.run(["cmake", "--build", folder, "--target", PROGRAM], check=True, stdout=subprocess.DEVNULL)
    return folder / "bin" / PROGRAM


def read_counts(folder):
    """Reads callgrind's output in `folder`: the instructions of each operation by name."""
    counts = {}
    for dump in sorted(folder.iterdir()):
        total, name = 0, None
        for line in dump.read_text().splitlines():
            if line.startswith("desc: Trigger: Client Request: "):
                name = line.split(": ", 3)[3]
            elif line.startswith("totals: "):
                total = int(line.split()[1])
        if name is not None:  # name is None in the dump at the end of the program
            counts[name] = total
    return counts


def count(commands, pattern):
    """Returns read_counts() of each command. Runs the commands in parallel, and ends them if this program ends."""
    environment = {"PATH": os.environ["PATH"]}  # the same on each machine
    with tempfile.TemporaryDirectory() as work:
        folders = [pathlib.Path(work) / str(number) for number in range(len(commands))]
        running = []
        try:
            for command, folder in zip(commands, folders):
                folder.mkdir()
                running.append(subprocess.Popen(
                    ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder}/counts",
                     "--instr-atstart=no", *command, f"--filter={pattern}"],
                    stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment))
            for command, process in zip(commands, running):
                errors = process.communicate()[1]
                if process.returncode != 0:
                    sys.exit(f"compare.py: {' '.join(map(str, command))} failed under valgrind:\n{errors[-2000:]}")
        finally:
            for process in running:
                process.kill()
                process.wait()
        return [read_counts(folder) for folder in folders]


def measure(command, pattern, seconds):
    """Returns the CPU time of each operation by name, in ns."""
    done = subprocess.run([*command, f"--filter={pattern}", f"--time={seconds}"], check=True,
                          stdout=subprocess.PIPE, text=True)
    return {name: float(time) for name, time in (line.split("\t") for line in done.stdout.splitlines())}


def alternate(commands, pattern, turns, seconds):
    """Returns, by operation, the new minimum time divided by the base's. NaN if the base lacks the operation.

    Uses the minimum because other load on the machine only adds time."""
    samples = [{}, {}]
    for turn in range(turns):
        for which in (0, 1) if turn % 2 == 0 else (1, 0):
            for name, time in measure(commands[which], pattern, seconds).items():
                samples[which].setdefault(name, []).append(time)
    return {name: min(times) / min(samples[0].get(name, [math.nan]))
            for name, times in samples[1].items()}


def compare(programs, counted, options):
    """Prints all ratios and returns one line per loss. `programs`, `counted`: the base's, then the new one."""
    times = {}
    if not options.short:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        times = alternate(programs, options.filter, options.turns, options.seconds)
    losses = []
    print(f"{'new / base':40s} instructions{'    time' if times else ''}")
    for name, instructions in counted[1].items():
        if name not in counted[0]:
            print(f"{name:40s} {'new':>12s}")
            continue
        ratio = instructions / counted[0][name]
        print(f"{name:40s} {ratio:12.3f}{f' {times[name]:7.3f}' if times else ''}", flush=True)
        if ratio > MOST_COUNTED:
            losses.append(f"{name}: {ratio:.3f} of the base's instructions")
    suspects = [name for name, ratio in times.items() if ratio > options.threshold]
    if suspects:
        print(f"Measuring again the time of {', '.join(suspects)}", flush=True)
        times = alternate(programs, options.filter, 2 * options.turns, 2 * options.seconds)
        losses += [f"{name}: {times[name]:.3f} of the base's time, twice"
                   for name in suspects if times[name] > options.threshold]
    return losses


def differences_from_record(counted, pattern):
    """Returns one line for each count that is not within MOST_FROM_RECORD of the count in RECORD."""
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    record = {name: count for name, count in record.items() if pattern in name}
    lines = [f"{name}: no longer counted" for name in record if name not in counted]
    for name, instructions in counted.items():
        ratio = instructions / record[name] if name in record else math.nan
        if not 1 / MOST_FROM_RECORD <= ratio <= MOST_FROM_RECORD:
            lines.append(f"{name}: {ratio:.3f} of the recorded instructions" if name in record
                         else f"{name}: not recorded")
    return lines


def self_test(program, pattern):
    """Checks that the comparison detects slow-downs of 10, 15 and 25 % in each operation, and no others.

    Returns one line per error."""
    wrong = []
    percents = (0, 10, 15, 25)
    base, *counts = count([[program], *([program, f"--slow={p}"] for p in percents)], pattern)
    for percent, slowed in zip(percents, counts):
        found = {name for name in base if slowed[name] > MOST_COUNTED * base[name]}
        wrong += [f"{name}: no slow-down of {percent} % found" for name in base if percent and name not in found]
        wrong += [f"{name}: a slow-down found without a change" for name in found if not percent]
        print(f"slowed by {percent:2d} %: {len(found)} of {len(base)} operations are found slower", flush=True)
    return wrong


def git(*arguments):
    """Returns git's output, or None if git fails."""
    done = subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True)
    return None if done.returncode else done.stdout.strip()


def check_out(commit):
    """Returns WORK / "tree", a worktree with the sources of `commit`. Writes only the files that differ."""
    tree = WORK / "tree"
    if not (tree / ".git").exists():
        shutil.rmtree(tree, ignore_errors=True)
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "--quiet", "--force", "--detach", tree, commit],
                       check=True)
    subprocess.run(["git", "-C", tree, "checkout", "--quiet", "--force", "--detach", commit], check=True)
    subprocess.run(["git", "-C", tree, "clean", "--quiet", "--force", "-d"], check=True)
    return tree


def copy_changes(commit, tree):
    """Makes `tree`, a worktree of `commit`, equal to ROOT in SOURCES: copies or deletes each file that differs."""
    names = git("diff", "--no-renames", "--name-only", "-z", commit, "--", *SOURCES)
    names += git("ls-files", "--others", "--exclude-standard", "-z", "--", *SOURCES)
    for name in filter(None, names.split("\0")):
        (tree / name).unlink(missing_ok=True)
        if (ROOT / name).exists():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tree / name)  # the copy has a new time, so ninja rebuilds the file


def build_as_tested():
    """Builds the program of the sources here in the build of the tests. Returns its path."""
    subprocess.run(["cmake", "--preset", "dev"], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return build_program(ROOT / "build" / "dev")


def build_both(base, tested):
    """Returns the programs of the commit `base` and of the sources here, or None if `base` has no such program.

    `tested`: the new program in the build of the tests, or None. The base is then built with the tests' settings."""
    commit = git("rev-parse", "--verify", "--quiet", base + "^{commit}")
    if commit is None:
        sys.exit(f"compare.py: '{base}' is neither a commit nor a build with bin/{PROGRAM}")
    tree = check_out(commit)
    if not (tree / "bench/safety" / (PROGRAM + ".cc")).exists():
        return None
    if tested:
        return [build(tree, WORK / "tested", settings_of_tests(tree)), tested]
    settings = settings_of_release(compiles_in_units(tree))  # the same for both builds
    programs = []
    for name in "base", "head":
        if name == "head":
            copy_changes(commit, tree)
        (WORK / name).mkdir(exist_ok=True)
        programs.append(shutil.copy(build(tree, WORK / "build", settings), WORK / name))
    return programs


def default_base():
    """Returns the merge base with origin/main, or on main the first parent. None if there is no history."""
    head = git("rev-parse", "HEAD")
    base = git("merge-base", "HEAD", "origin/main")
    if base is None or base == head:
        base = git("rev-parse", "--verify", "--quiet", "HEAD~1")
    return base


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("base", nargs="?", help="a commit, or a build folder with its bin/")
    parser.add_argument("--filter", default="", help="only operations whose name contains FILTER")
    parser.add_argument("--turns", type=int, default=5, help="number of time measurements of each build")
    parser.add_argument("--seconds", type=float, default=0.1, help="CPU time per operation in one measurement, s")
    parser.add_argument("--threshold", type=float, default=1.10, help="a larger ratio of times is a loss")
    parser.add_argument("--short", action="store_true",
                        help="count instructions in the build of the tests; build BASE only if the record differs")
    parser.add_argument("--record", action="store_true",
                        help="write the counts of the tests' build to bench/instructions.json")
    parser.add_argument("--self-test", action="store_true",
                        help="check that slow-downs of each operation by 10, 15 and 25 %% are found")
    return parser.parse_args()


def main():
    options = arguments()
    if shutil.which("valgrind") is None:
        sys.exit("compare.py: valgrind is missing. Install it with: apt-get install valgrind")
    if options.self_test:
        wrong = self_test(build(ROOT, WORK / "here", settings_of_release(True)), options.filter)
        for line in wrong:
            print(f"compare.py: {line}", file=sys.stderr)
        sys.exit(1 if wrong else 0)
    if options.record:
        counted, = count([[build_as_tested(), "--few"]], "")
        RECORD.write_text(json.dumps(counted, indent=1) + "\n")
        return
    base = options.base or default_base()
    if base is None:
        print("There is no commit before this one: there is nothing to compare with.")
        return
    program = pathlib.Path(base) / "bin" / PROGRAM
    tested = None
    if program.exists():
        programs = program, build(ROOT, WORK / "here", settings_of_release(True))
    elif git("diff", "--quiet", base, "--", *SOURCES) is not None:
        print(f"The sources of the operations are those of {base[:10]}: there is nothing to compare.")
        return
    else:
        if options.short:
            tested = build_as_tested()
            counted, = count([[tested, "--few"]], options.filter)
            differences = differences_from_record(counted, options.filter)
            if counted and not differences:
                print(f"All {len(counted)} counts of instructions are within "
                      f"{100 * (MOST_FROM_RECORD - 1):.0f} % of {RECORD.relative_to(ROOT)}.")
                return
            print("\n".join(differences))
            print(f"The comparison with {base[:10]} decides. Then record the counts: bench/compare.py --record",
                  flush=True)
        programs = build_both(base, tested)
        if programs is None:
            print(f"The base has no {PROGRAM} yet: there is nothing to compare with.")
            return
    commands = [[program] for program in programs]
    counted = count(commands, options.filter)
    if not counted[1]:
        sys.exit(f"compare.py: no operation has '{options.filter}' in its name")
    losses = compare(commands, counted, options)
    for loss in losses:
        print(f"SLOWER: {loss}", file=sys.stderr)
    sys.exit(1 if losses else 0)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # count() then ends valgrind
    main()
