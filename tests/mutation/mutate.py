#!/usr/bin/env python3
"""Do the tests notice when the code is wrong? mutate.py [FOLDER [COUNT [SEED]]]

Changes one operator or constant of a library's sources at a time, builds its tests and runs them. A change that they
notice (a failing test, a crash, ten times its time and 30 s) is killed; one that does not compile does not count; one
that no test notices survives, and is printed to be read: it wants a test, or a reason in docs/reliability.md.

The tests are those of tests/NAME, all of the library's, that of the changed file first. Works in a copy of the tree
(git worktree) below build/mutation, so that the tree itself is never changed; of root's, changed programs can write
there and in /tmp alone. What was found of a source file as it is now is kept in build/mutation/NAME.jsonl: the same
command goes on from there and tries again what survived, and --survivors only prints it.
"""
import argparse
import hashlib
import json
import os
import pathlib
import random
import re
import subprocess
import sys
import time

# What stands there, and what is put in its place. Behind text and comments nothing is changed.
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
    """(begin, end, replacement) of every change that can be made."""
    # Comments, texts and directives become blanks of the same length.
    blank = re.sub(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|^\s*#[^\n]*',
                   lambda m: " " * len(m.group()), text, flags=re.S | re.M)
    # Angle brackets of templates are no comparisons; template lines are left alone.
    for pattern, replacements in CHANGES:
        for found in re.finditer(pattern, blank):
            line = blank[blank.rfind("\n", 0, found.start()) + 1:blank.find("\n", found.end())]
            if re.search(r"\btemplate\b|\bstatic_assert\b|\bassert\(", line):
                continue
            for replacement in replacements:
                if replacement != found.group():
                    yield found.start(), found.end(), replacement


def run(command, folder, seconds):
    try:
        return subprocess.run(command, cwd=folder, capture_output=True, timeout=seconds).returncode
    except subprocess.TimeoutExpired:
        return 124


# A changed program may do anything, replace /dev/null for one. For root's, all but its own tree and /tmp can only be
# read: the folder is "$0".
CONFINED = ["unshare", "--mount", "sh", "-c",
            'mount --bind "$0" "$0" && mount --bind /tmp /tmp && mount -o remount,bind,ro /dev'
            ' && mount -o remount,bind,ro / && exec "$@"']


def run_test(build, test, seconds):
    confined = [*CONFINED, str(build)] if os.geteuid() == 0 else []
    return run([*confined, str(build / "tests" / test)], build, seconds)


def compile_tests(build, tests):
    command = ["cmake", "--build", str(build), "--parallel", str(os.cpu_count()), "--target", *tests]
    return run(command, build, 3600) == 0


def outcome(source, build, limits):
    """Whether the change that stands in `source` is killed, survived or does not compile."""
    own = [test for test in limits if test == f"{source.stem}_test"]
    for some in (own, [test for test in limits if test not in own]):
        if not some:
            continue
        if not compile_tests(build, some):
            return "does not compile"
        if any(run_test(build, test, limits[test]) != 0 for test in some):
            return "killed"
    return "survived"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="libs/core")
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--file", help="only this file's name")
    parser.add_argument("--survivors", action="store_true", help="print what earlier runs found, and end")
    options = parser.parse_args()
    name = pathlib.Path(options.folder).name
    root = pathlib.Path(__file__).resolve().parents[2]
    copy = root / "build/mutation/tree"
    if not copy.exists():
        subprocess.run(["git", "worktree", "add", "--detach", str(copy)], cwd=root, check=True, capture_output=True)
    subprocess.run(["git", "checkout", "--force", "--detach",
                    subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=root, text=True).strip()],
                   cwd=copy, check=True, capture_output=True)
    build = copy / "build/dev"
    if os.geteuid() == 0 and not options.survivors and run([*CONFINED, str(copy), "true"], copy, 60) != 0:
        sys.exit("mutate.py: as root a changed program could replace files and devices, and unshare cannot keep it from "
                 "them here; run this as an ordinary user")
    limits = {}  # of a test, in s: ten times what it takes as it is, and what a busy machine adds
    if not options.survivors:
        subprocess.run(["cmake", "--preset", "dev", f"-DDFR_COMPONENTS={name}"], cwd=copy, check=True,
                       capture_output=True)
        limits = {path.stem: 0.0 for path in sorted((copy / "tests" / name).glob("*_test.cc"))}
        if not compile_tests(build, limits):
            sys.exit("mutate.py: the tests do not build as they are")
        for test in limits:
            begin = time.monotonic()
            if run_test(build, test, 600) != 0:
                sys.exit(f"mutate.py: {test} fails as it is")
            limits[test] = 30.0 + 10.0 * (time.monotonic() - begin)

    changes = []
    for source in sorted((copy / options.folder).glob("src/*.cc")):
        if options.file and source.name != options.file:
            continue
        text = source.read_text()
        of_file = f"{source.relative_to(copy)} {hashlib.sha256(text.encode()).hexdigest()[:16]}"
        changes += [(source, f"{of_file} {begin} {replacement}", begin, end, replacement)
                    for begin, end, replacement in places(text)]
    random.Random(options.seed).shuffle(changes)
    record = root / "build/mutation" / f"{name}.jsonl"
    known = dict(json.loads(line) for line in record.read_text().splitlines()) if record.exists() else {}
    killed = survived = 0
    for source, key, begin, end, replacement in changes:
        if killed + survived >= options.count:
            break
        if options.survivors and key not in known:
            continue
        text = source.read_text()
        if known.get(key, "survived") == "survived" and not options.survivors:
            source.write_text(text[:begin] + replacement + text[end:])
            try:
                known[key] = outcome(source, build, limits)
            finally:
                source.write_text(text)
            with record.open("a") as out:
                out.write(json.dumps([key, known[key]]) + "\n")
        killed += known[key] == "killed"
        survived += known[key] == "survived"
        if known[key] == "survived":
            line = text.count("\n", 0, begin) + 1
            shown = text.splitlines()[line - 1].strip()
            print(f"survived  {source.relative_to(copy)}:{line}: '{text[begin:end]}' -> '{replacement}' in: {shown}",
                  flush=True)
    total = killed + survived
    print(f"{options.folder}: {killed} of {total} changes noticed ({100.0 * killed / max(1, total):.0f} %), "
          f"{len(changes)} are possible, seed {options.seed}")


if __name__ == "__main__":
    main()
