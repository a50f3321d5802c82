#!/usr/bin/env python3
"""The sources of the page compile for WebAssembly.

They include no header of a library that the page does not use, and call no algorithm of std::ranges: the standard
library of Debian's Emscripten has none.

usage: sources_test.py PROJECT INCLUDE_FOLDER ... -- SOURCE ...
"""

import pathlib
import re
import sys

separator = sys.argv.index("--")
PROJECT, *FOLDERS = (pathlib.Path(name) for name in sys.argv[1:separator])
SOURCES = [pathlib.Path(name).resolve() for name in sys.argv[separator + 1:]]
RANGES = re.compile(r"std::ranges::(?!s?size\b|c?begin\b|c?end\b|data\b|\w*range\b)\w+")


def main():
    reached = set(SOURCES)
    left = list(SOURCES)
    wrong = []
    while left:
        file = left.pop()
        for number, line in enumerate(file.read_text().splitlines(), 1):
            algorithm = RANGES.search(line.partition("//")[0])
            if algorithm:
                wrong.append(f"{file.relative_to(PROJECT)}:{number}: Emscripten has no {algorithm[0]}; "
                             "call the algorithm of namespace std")
            match = re.match(r'#include "([^"]+)"', line)
            if match is None:
                continue
            found = next((folder / match[1] for folder in [file.parent, *FOLDERS]
                          if (folder / match[1]).exists()), None)
            if found is None and not match[1].startswith("hwy/"):
                wrong.append(f"{file.relative_to(PROJECT)}:{number}: the page has no {match[1]}; "
                             "a source with it belongs to left_out in apps/planar_page/CMakeLists.txt")
            elif found is not None and found.resolve() not in reached:
                reached.add(found.resolve())
                left.append(found.resolve())
    for line in wrong:
        print(line, file=sys.stderr)
    sys.exit(1 if wrong or not SOURCES else 0)


if __name__ == "__main__":
    main()
