#!/usr/bin/env python3
"""Which files clang-tidy must look at: stamps.py BUILD STAMPS < FILES > FILES

Reads names of source files, one a line. Writes "STAMP FILE" for each to STAMPS, and to standard output those whose
stamp is not in the cache. A stamp is a hash of all that decides what clang-tidy says of a file: its text, that of the
headers of this repository that the compiler noted for it, its compile command, the rules, and clang-tidy's version.
"""
import functools
import hashlib
import json
import os
import pathlib
import shlex
import subprocess
import sys


@functools.cache
def digest(path):
    try:
        return hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest()
    except OSError:
        return "absent"


def headers(build):
    """Object -> the files that it was compiled from, as ninja noted them."""
    noted, current = {}, None
    text = subprocess.run(["ninja", "-C", build, "-t", "deps"], capture_output=True, text=True).stdout
    for line in text.splitlines():
        if line and not line.startswith(" "):
            current = noted.setdefault(line.split(":")[0], [])
        elif line.strip() and current is not None:
            current.append(line.strip())
    return noted


def output_of(command):
    """The object that a compile command writes, which CMake 3.25 does not say beside the command."""
    words = shlex.split(command)
    return words[words.index("-o") + 1]


def main():
    build, stamps = sys.argv[1:]
    root = os.getcwd()
    cache = pathlib.Path(os.environ.get("DFR_LINT_CACHE") or
                         pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "dfr/lint")
    version = subprocess.run(["clang-tidy", "--version"], capture_output=True, text=True).stdout
    rules = version + "".join(digest(str(p)) for p in sorted(pathlib.Path(".").glob("**/.clang-tidy"))
                              if "build" not in p.parts)
    commands = {}
    for entry in json.loads(pathlib.Path(build, "compile_commands.json").read_text()):
        commands[os.path.relpath(entry["file"], root)] = (output_of(entry["command"]), entry["command"])
    noted = headers(build)
    with open(stamps, "w") as out:
        for line in sys.stdin:
            name = line.strip()
            output, command = commands[name]
            own = sorted({os.path.relpath(os.path.join(build, path), root) for path in noted.get(output, [])})
            parts = [rules, command.replace(root, "."), digest(name)]
            parts += [digest(path) for path in own if not path.startswith("..") and not path.startswith(build)]
            stamp = hashlib.sha256("\n".join(parts).encode()).hexdigest()
            out.write(f"{stamp} {name}\n")
            # Without the compiler's notes a header may have changed unseen.
            if output not in noted or not (cache / stamp).exists():
                print(name)


if __name__ == "__main__":
    main()
