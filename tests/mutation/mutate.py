#!/usr/bin/env python3
"""Mutation testing: measures the share of wrong changes that the tests detect. mutate.py [FOLDER [COUNT [SEED]]]

Changes one operator or constant in the sources of a library at a time, builds its tests and runs them. A change is
killed if a test fails or crashes, or if the tests need more than 8 GiB or five times their processor time plus 5 s. A
change that does not compile does not count. Prints each change that survives: it needs a test, or a reason in
docs/reliability.md. Draws COUNT changes at random. Prints the killed share with its 95 % interval (Wilson).

The tests are the unit tests of tests/NAME, one program. Works in a copy of the tree (git worktree) below
build/mutation, and never changes the tree itself. Each run has a temporary TMPDIR. If root runs it, changed programs
can write only there and below the copy's build folder. build/mutation/NAME.jsonl keeps the results for the
present content of each source file. The same command continues from there, and repeats changes that survived an
earlier version of the tests. --survivors only prints the results.
"""
import argparse
import hashlib
import json
import math
import os
import pathlib
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time

# Patterns and their replacements. Strings and comments stay unchanged.
CHANGES = [
    (r"(?<![<>=!+\-*/&|])<(?![<=])(?=\s)", ["<=", ">"]), (r"(?<=\s)>(?![>=])(?=\s)", [">=", "<"]),
    (r"<=", ["<", ">"]), (r"(?<![->])>=", [">", "<"]), (r"==", ["!="]), (r"!=", ["=="]),
    (r"&&", ["||"]), (r"\|\|", ["&&"]),
    (r"(?<=[\w)\]] )\+(?= [\w(])", ["-"]), (r"(?<=[\w)\]] )-(?= [\w(])", ["+"]),
    (r"(?<=[\w)\]] )\*(?= [\w(])", ["/"]), (r"(?<=[\w)\]] )/(?= [\w(])", ["*"]),
    (r"\+=", ["-="]), (r"-=", ["+="]), (r"\+\+(?=\w)", ["--"]),
    (r"\btrue\b", ["false"]), (r"\bfalse\b", ["true"]),
    (r"\bstd::min\b", ["std::max"]), (r"\bstd::max\b", ["std::min"]),
    (r"(?<![\w.])\d+\.\d+(?![\w.])", ["0.0", "2.0"]), (r"(?<![\w.\[])[1-9]\d*(?![\w.])", ["0", "3"]),
]


def places(text):
    """Yield (begin, end, replacement) of every possible change."""
    # Replaces comments, strings and directives with blanks of the same length.
    blank = re.sub(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|^\s*#[^\n]*',
                   lambda m: " " * len(m.group()), text, flags=re.S | re.M)
    # Lines with a template stay unchanged, because their angle brackets are not comparisons. Lines that unroll
    # a loop stay unchanged, because the unrolling does not affect results.
    for pattern, replacements in CHANGES:
        for found in re.finditer(pattern, blank):
            line = blank[blank.rfind("\n", 0, found.start()) + 1:blank.find("\n", found.end())]
            if re.search(r"\btemplate\b|\bstatic_assert\b|\bassert\(|\bHWY_UNROLL\b", line):
                continue
            for replacement in replacements:
                if replacement != found.group():
                    yield found.start(), found.end(), replacement


def run(command, folder, seconds, **more):
    """Return the exit status; processes started by the command end with it."""
    process = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, start_new_session=True, **more)
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return 124
    finally:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        process.wait()


# A changed program may do anything, for example replace /dev/null. Run by root, it can write only to two folders.
CONFINED = ["unshare", "--mount", "sh", "-c",
            'mount --bind /tmp /tmp && mount --bind "$0" "$0" && mount --bind "$1" "$1" && shift'
            ' && for ro in /tmp /dev /; do mount -o remount,bind,ro $ro || exit; done && exec "$@"']


def confined(command, build, scratch):
    return [*CONFINED, str(build), scratch, *command] if os.geteuid() == 0 else command


def run_tests(build, program, cpu_s):
    def limit():
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu_s), math.ceil(cpu_s)))
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    with tempfile.TemporaryDirectory(prefix="dfr_mutate_") as scratch:
        command = confined([str(build / "tests" / program), "--gtest_fail_fast"], build, scratch)
        # On a shared machine a test may wait. A test that hangs uses no processor time.
        return run(command, build, 30.0 + 5.0 * cpu_s, preexec_fn=limit,
                   env={**os.environ, "TMPDIR": scratch, "TEST_TMPDIR": scratch})


def compile_tests(build, program, jobs):
    return run(["cmake", "--build", str(build), "--parallel", str(jobs), "--target", program], build, 3600) == 0


def outcome(build, program, limit_s, jobs):
    """Return "killed", "survived" or "does not compile" for the present change of a source."""
    if not compile_tests(build, program, jobs):
        return "does not compile"
    return "killed" if run_tests(build, program, limit_s) != 0 else "survived"


def wilson(hits, total):
    """Return Wilson's 95 % interval of a share."""
    if total == 0:
        return 0.0, 1.0
    z2 = 1.96 ** 2
    middle = (hits + z2 / 2) / (total + z2)
    half = math.sqrt(z2 * (hits * (total - hits) / total + z2 / 4)) / (total + z2)
    return middle - half, middle + half


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="libs/core")
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--file", help="change only source files with this name")
    parser.add_argument("--minutes", type=float, default=math.inf, help="start no change after this time")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="parallel build jobs (default: all)")
    parser.add_argument("--survivors", action="store_true", help="print the results of earlier runs, and exit")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("mutate.py: terminated"))  # cleans up
    name = pathlib.Path(options.folder).name
    root = pathlib.Path(__file__).resolve().parents[2]
    copy = root / "build/mutation/tree"
    if not copy.exists():
        subprocess.run(["git", "worktree", "add", "--detach", str(copy)], cwd=root, check=True, capture_output=True)
    subprocess.run(["git", "checkout", "--force", "--detach",
                    subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=root, text=True).strip()],
                   cwd=copy, check=True, capture_output=True)
    build = copy / "build/dev"
    program = f"{name}_unit_tests"
    limit_s = None  # limit of processor time: five times the time of the unchanged tests, plus 5 s
    if not options.survivors:
        with tempfile.TemporaryDirectory(prefix="dfr_mutate_") as scratch:
            if run(confined(["true"], copy, scratch), copy, 60) != 0:
                sys.exit("mutate.py: unshare does not work here, so a changed program that root runs could replace "
                         "files and devices. Run mutate.py as an ordinary user.")
        subprocess.run(["cmake", "--preset", "dev", f"-DDFR_COMPONENTS={name}",
                        "-DCMAKE_UNITY_BUILD=OFF"], cwd=copy, check=True,
                       capture_output=True)
        if not compile_tests(build, program, options.jobs):
            sys.exit(f"mutate.py: {program} does not build without a change")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        if run_tests(build, program, 600) != 0:
            sys.exit(f"mutate.py: {program} fails without a change")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        limit_s = 5.0 + 5.0 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    of_tests = hashlib.sha256(b"".join(path.read_bytes() for path in sorted((copy / "tests" / name).rglob("*"))
                                       if path.is_file())).hexdigest()[:16]

    changes = []
    for source in sorted((copy / options.folder / "src").rglob("*.cc")):
        if options.file and source.name != options.file:
            continue
        text = source.read_text()
        of_file = f"{source.relative_to(copy)} {hashlib.sha256(text.encode()).hexdigest()[:16]}"
        changes += [(source, f"{of_file} {begin} {replacement}", begin, end, replacement)
                    for begin, end, replacement in places(text)]
    # Random order that does not depend on other files.
    changes.sort(key=lambda change: hashlib.sha256(f"{options.seed} {change[1]}".encode()).digest())
    record = root / "build/mutation" / f"{name}.jsonl"
    known = {}  # maps a change to its result and the hash of the tests
    if record.exists():
        known = {key: found for key, *found in map(json.loads, record.read_text().splitlines())}
    killed = survived = 0
    end_s = time.monotonic() + 60.0 * options.minutes
    for source, key, begin, end, replacement in changes:
        if killed + survived >= options.count or time.monotonic() > end_s:
            break
        if options.survivors and key not in known:
            continue
        text = source.read_text()
        before, *tests_before = known.get(key, ["survived"])
        if before == "survived" and tests_before != [of_tests] and not options.survivors:
            source.write_text(text[:begin] + replacement + text[end:])
            try:
                known[key] = [outcome(build, program, limit_s, options.jobs), of_tests]
            finally:
                source.write_text(text)
            with record.open("a") as out:
                out.write(json.dumps([key, *known[key]]) + "\n")
        killed += known[key][0] == "killed"
        survived += known[key][0] == "survived"
        if known[key][0] == "survived":
            line = text.count("\n", 0, begin) + 1
            shown = text.splitlines()[line - 1].strip()
            print(f"survived  {source.relative_to(copy)}:{line}: '{text[begin:end]}' -> '{replacement}' in: {shown}",
                  flush=True)
    total = killed + survived
    low, high = wilson(killed, total)
    print(f"{options.folder}: {killed} of {total} changes killed ({100.0 * killed / max(1, total):.0f} %, "
          f"{100.0 * low:.0f} to {100.0 * high:.0f}), {len(changes)} are possible, seed {options.seed}")


if __name__ == "__main__":
    main()
