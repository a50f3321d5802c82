#!/usr/bin/env python3
"""Do the tests notice when the code is wrong? mutate.py [FOLDER [COUNT [SEED]]]

Changes one operator or constant of a library's sources at a time, builds its tests and runs them. A change that they
notice (a failing test, a crash, 60 s without an end) is killed; one that does not compile does not count; one that no
test notices survives, and is printed as a patch to be read: it wants a test, or a reason in docs/reliability.md.

The tests are those of tests/NAME, all of the library's; the sources are restored whatever happens. Works in a copy of
the tree (git worktree) below build/mutation, so that the tree itself is never changed.
"""
import argparse
import os
import pathlib
import random
import re
import subprocess
import sys

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
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=seconds).returncode
    except subprocess.TimeoutExpired:
        return 124


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="libs/core")
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("seed", nargs="?", type=int, default=1)
    parser.add_argument("--file", help="only this file's name")
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
    subprocess.run(["cmake", "--preset", "dev", f"-DDFR_COMPONENTS={name}"], cwd=copy, check=True, capture_output=True)
    tests = sorted(path.stem for path in (copy / "tests" / name).glob("*_test.cc"))
    targets = ["cmake", "--build", str(build), "--parallel", str(os.cpu_count()), "--target", *tests]
    if run(targets, copy, 3600) != 0:
        sys.exit("mutate.py: the tests do not build as they are")

    changes = []
    for source in sorted((copy / options.folder).glob("src/*.cc")):
        if options.file and source.name != options.file:
            continue
        changes += [(source, *place) for place in places(source.read_text())]
    random.Random(options.seed).shuffle(changes)
    killed = survived = 0
    for source, begin, end, replacement in changes:
        if killed + survived >= options.count:
            break
        text = source.read_text()
        line = text.count("\n", 0, begin) + 1
        source.write_text(text[:begin] + replacement + text[end:])
        try:
            if run(targets, copy, 3600) != 0:
                continue
            noticed = any(run([str(build / "tests" / test)], copy, 60) != 0 for test in tests)
        finally:
            source.write_text(text)
        killed += noticed
        survived += not noticed
        if not noticed:
            shown = text.splitlines()[line - 1].strip()
            print(f"survived  {source.relative_to(copy)}:{line}: '{text[begin:end]}' -> '{replacement}' in: {shown}",
                  flush=True)
    total = killed + survived
    print(f"{options.folder}: {killed} of {total} changes noticed ({100.0 * killed / max(1, total):.0f} %), "
          f"{len(changes)} are possible, seed {options.seed}")


if __name__ == "__main__":
    main()
