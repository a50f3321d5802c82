#!/usr/bin/env python3
"""What can be checked of prose: line length, dangling "Of ...", words that say something else.

usage: prose_lint.py [FILE ...]     (default: all Markdown and C++ files that git tracks)

Tables, headings, code, and lines of one link may be long.
"""

import pathlib
import re
import subprocess
import sys

SOURCE = pathlib.Path(__file__).resolve().parents[2]
MARKDOWN_COLUMNS = 110
# Word or phrase, and what to write instead.
WORDS = {
    r"\blikewise\b": "also, or the same sentence again",
    r"\bsomebody\b": "a person, an operator, a user",
    r"\bwhosoever\b": "whoever",
    r"\butili[sz]e": "use",
    r"\bleverage\b": "use",
    r"\bseamless(ly)?\b": "say what works",
    r"\bin order to\b": "to",
}


def markdown_problems(text):
    fence = False
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("```"):
            fence = not fence
        if fence:
            continue
        if len(line) > MARKDOWN_COLUMNS and not re.match(r"[|#!<]|\s*\S*\]\(\S*\)\S*$|\s*\S+$", line):
            yield number, f"{len(line)} columns; Markdown has {MARKDOWN_COLUMNS} at most"
        if not line.startswith("|"):
            yield from word_problems(number, line)


def comment_problems(text):
    inside = False  # a comment that goes on: only its first line begins a sentence
    for number, line in enumerate(text.split("\n"), 1):
        match = re.search(r"(?:^|\s)//[/!]?<?\s?(.*)$", line)
        if not match:
            inside = False
            continue
        comment = match.group(1)
        if not inside and re.match(r"Of (?!course)\w", comment):
            yield number, 'the comment begins with a dangling "Of": name what it is of'
        inside = line.lstrip().startswith("//")
        yield from word_problems(number, comment)


def word_problems(number, line):
    for pattern, instead in WORDS.items():
        match = re.search(pattern, line, re.I)
        if match:
            yield number, f'"{match.group(0)}": write {instead}'


def problems(path):
    text = path.read_text()
    return list((markdown_problems if path.suffix == ".md" else comment_problems)(text))


def main(names):
    if not names:
        tracked = ["git", "ls-files", "*.md", "*.h", "*.cc"]
        names = subprocess.run(tracked, cwd=SOURCE, text=True, capture_output=True, check=True).stdout.split()
    failed = 0
    for name in names:
        path = (SOURCE / name).resolve()
        found = problems(path)
        relative = path.relative_to(SOURCE)
        for number, what in found:
            print(f"{relative}:{number}: {what}")
        failed += len(found)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
