#!/usr/bin/env python3
"""Checks some rules of prose: line length, words, openings of sentences, subjects of commits.

usage: prose_lint.py [FILE ...]            (default: all Markdown and C++ files that git tracks)
       prose_lint.py --commits BASE..HEAD  subjects of these commits, merges excepted
       prose_lint.py --message FILE        the subject of the commit message in FILE

Tables, headings, code, and lines of one link may be long. README.md and docs also obey STYLE and OPENING.
"""

import pathlib
import re
import subprocess
import sys

SOURCE = pathlib.Path(__file__).resolve().parents[2]
MARKDOWN_COLUMNS = 110
SUBJECT_COLUMNS = 72
# Pattern of a word or phrase, and its replacement.
WORDS = {
    r"\blikewise\b": "also, or the same sentence again",
    r"\bsomebody\b": "a person, an operator, a user",
    r"\bwhosoever\b": "whoever",
    r"\butili[sz]e": "use",
    r"\bleverage\b": "use",
    r"\bseamless(ly)?\b": "say what works",
    r"\bin order to\b": "to",
}
STYLE = {
    r"\bso that\b": "two sentences, or 'therefore'",
    r"\bof (its|their|my|our|your) own\b": "separate, its, or nothing",
    r"\bnobody\b": "no user, no program, or the passive",
    r"\banew\b": "again",
    r"\bhardly\b": "barely, rarely, or the number",
    r"\bbesides\b": "also, except",
    r"\bin turn\b": "one after the other",
    r"\bas it is\b": "unchanged",
    r"\bsuch that\b": "the condition as a sentence",
    r"\bwhat there is\b|\bthose there are\b": "the valid names",
    r"\bthe room there is\b": "the margin",
    r"\bwhere there (was|were) some\b": "near them",
    r"\bown motion of what\b": "drift",
    r"\b(model|file|key|state|program) has not\b": "a noun and 'does not have'",
    r"\bnot be told from\b": "cannot be distinguished from",
}
# Openings of a clause that is a subject or object.
OPENING = re.compile(r"(What|Which|Where|How|Whether|By how much)\b", re.I)
# Markup before the first word of a comment or paragraph.
LEAD = re.compile(r"(?:[-*] |\d+\. )?[*`]*")
NOT_IMPERATIVE = re.compile(
    r"(a|an|the|this|that|these|those|what|which|where|when|how|whether|if|no|one|two|each|every|all|it|its|is|are|"
    r"new|more|some|any|there|by|for|from|in|of|on|to|with|also|now|only)$", re.I)
ENDS_IN_S = re.compile(r"(ss|us|is|focus|alias)$")


def markdown_problems(text, style=True):
    fence = False
    begins = True  # true at the beginning of a paragraph or list item
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("```"):
            fence = not fence
        if fence:
            continue
        if len(line) > MARKDOWN_COLUMNS and not re.match(r"[|#!<]|\s*\S*\]\(\S*\)\S*$|\s*\S+$", line):
            yield number, f"{len(line)} columns; Markdown has {MARKDOWN_COLUMNS} at most"
        if not line.startswith("|"):
            yield from word_problems(number, line, WORDS | STYLE if style else WORDS)
        begins = begins or re.match(r"\s*([-*]|\d+\.) ", line) is not None
        if style and begins and not line.startswith(("|", "#", "!")):
            yield from opening_problems(number, line.strip())
        begins = not line.strip()


def comment_problems(text, style=False):
    inside = False  # true after the first line of a comment: later lines do not begin a sentence
    for number, line in enumerate(text.split("\n"), 1):
        match = re.search(r"(?:^|\s)//[/!]?<?\s?(.*)$", line)
        if not match:
            inside = False
            continue
        comment = match.group(1)
        if not inside and re.match(r"Of (?!course)\w", comment):
            yield number, 'the comment begins with a dangling "Of": name what it is of'
        if style and not inside:
            yield from opening_problems(number, comment)
        inside = line.lstrip().startswith("//")
        yield from word_problems(number, comment, WORDS | STYLE if style else WORDS)


def opening_problems(number, line):
    match = OPENING.match(line, LEAD.match(line).end())
    if match and "?" not in line:
        yield number, f'begins with "{match.group(0)}": begin with a noun phrase or a verb'


def word_problems(number, line, words):
    for pattern, instead in words.items():
        match = re.search(pattern, line, re.I)
        if match:
            yield number, f'"{match.group(0)}": write {instead}'


def subject_problems(subject):
    """Check the subject of a commit: at most SUBJECT_COLUMNS, and an imperative after the place."""
    if len(subject) > SUBJECT_COLUMNS:
        yield f"{len(subject)} columns; a subject has {SUBJECT_COLUMNS} at most"
    words = re.sub(r"^[\w.,/ -]+: ", "", subject).split()
    first = words[0].strip(",.`'\"").lower() if words else ""
    if (NOT_IMPERATIVE.match(first) or re.search(r"[^e]ed$|ing$", first) and first not in ("bring", "embed")
            or first.endswith("s") and not ENDS_IN_S.search(first)):
        yield f'begins with "{first}": begin with an imperative'


def problems(path):
    text = path.read_text()
    if path.suffix != ".md":
        return list(comment_problems(text))
    relative = path.relative_to(SOURCE).as_posix() if path.is_relative_to(SOURCE) else path.name
    return list(markdown_problems(text, relative == "README.md" or relative.startswith("docs/")))


def lint_commits(commits):
    log = subprocess.run(["git", "log", "--no-merges", "--format=%h %s", commits], cwd=SOURCE, text=True,
                         capture_output=True, check=True).stdout
    found = [f'{line}: {what}' for line in log.splitlines() for what in subject_problems(line.split(" ", 1)[1])]
    print("\n".join(found) or f"{len(log.splitlines())} subjects are short and imperative")
    return 1 if found else 0


def lint_message(path):
    """Check the subject in the file that git passes to a commit-msg hook. Accepts fixups, which --autosquash removes."""
    subject = next(iter(path.read_text().strip().splitlines()), "")
    found = [] if subject.startswith(("Merge ", "fixup! ", "squash! ", "amend! ")) else list(subject_problems(subject))
    print("\n".join(f"{subject}: {what}" for what in found), end="\n" if found else "")
    return 1 if found else 0


def main(names):
    if names[:1] == ["--commits"]:
        return lint_commits(names[1])
    if names[:1] == ["--message"]:
        return lint_message(pathlib.Path(names[1]))
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
