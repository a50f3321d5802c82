#!/usr/bin/env python3
"""Reports the executed lines of the libraries. usage: line_coverage.py BUILD [--missed TEXT]

BUILD is a tree that was built with -DDFR_COVERAGE=ON and whose tests have run (./dev coverage does both). Prints a
table by library; with --missed, the lines that no test ran in files whose path contains TEXT. A line counts once,
even if it is compiled for several instruction sets and template arguments.
"""
import argparse
import collections
import json
import pathlib
import subprocess


def lines_of(build, root):
    """Returns {path below libs: {line: True if it ran}}."""
    lines = collections.defaultdict(dict)
    for notes in sorted(build.glob("libs/**/*.gcno")):
        done = subprocess.run(["gcov", "--json-format", "--stdout", notes.name], cwd=notes.parent, check=True,
                              capture_output=True, text=True)
        for document in done.stdout.splitlines():
            report = json.loads(document)
            for file in report["files"]:
                path = (pathlib.Path(report["current_working_directory"]) / file["file"]).resolve()
                if not path.is_relative_to(root / "libs"):
                    continue
                known = lines[path.relative_to(root).as_posix()]
                for line in file["lines"]:
                    number = line["line_number"]
                    known[number] = known.get(number, False) or line["count"] > 0
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--missed", metavar="TEXT")
    options = parser.parse_args()
    root = pathlib.Path(__file__).resolve().parents[2]
    lines = lines_of(options.build.resolve(), root)
    if options.missed is not None:
        for path in sorted(lines):
            missed = sorted(number for number, ran in lines[path].items() if not ran)
            if options.missed in path and missed:
                print(f"{path}: {', '.join(map(str, missed))}")
        return
    of_library = collections.defaultdict(lambda: [0, 0])
    for path, known in lines.items():
        for name in (path.split("/")[1], "all"):
            of_library[name][0] += sum(known.values())
            of_library[name][1] += len(known)
    for name, (ran, count) in sorted(of_library.items(), key=lambda entry: (entry[0] == "all", entry[0])):
        print(f"{name:16} {ran:6} of {count:6} lines  {100.0 * ran / count:5.1f} %")


if __name__ == "__main__":
    main()
