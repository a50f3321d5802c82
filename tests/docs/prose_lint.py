#!/usr/bin/env python3
"""What can be checked of prose: line length, dangling "Of ...", words that say something else.

usage: prose_lint.py [FILE ...]     (default: all Markdown and C++ files that git tracks)

Tables, headings, code, and lines of one link may be long. Files in OLD were written before these
rules; take one out once it follows them.
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
OLD = set("""
CHANGELOG.md
apps/line_tracking/commands.h
apps/line_tracking/experiment.cc
apps/line_tracking/model.h
apps/line_tracking/robot_config.h
apps/planar/methods.h
apps/pusher/model.h
bench/dds/dds_latency_bench.cc
docs/architecture.md
docs/decisions.md
docs/kernel.md
docs/mathematics.md
docs/pusher.md
docs/recovery.md
docs/robot.md
hardware/dvrk/include/dfr/hardware/psm_client.h
hardware/dvrk/include/dfr/hardware/psm_driver.h
hardware/dvrk/include/dfr/hardware/psm_motion.h
hardware/dvrk/src/psm_driver.cc
hardware/dvrk/src/psm_motion.cc
hardware/endoscope/include/dfr/hardware/endoscope.h
hardware/stewart/include/dfr/hardware/sprk_protocol.h
libs/control/include/dfr/control/controller.h
libs/control/include/dfr/control/guided_model.h
libs/control/include/dfr/control/guided_policy.h
libs/control/include/dfr/control/jacobian_estimate.h
libs/control/include/dfr/control/rollout.h
libs/control/include/dfr/control/switching_policy.h
libs/dds/src/participant.cc
libs/recording/src/recorder.cc
libs/runtime/include/dfr/runtime/fail_safe.h
tests/dds/watchdog_test.cc
tests/safety/task_model_test.cc
tests/sim_dvrk_scene/dvrk_scene_server_test.cc
tests/sim_dvrk_scene/dvrk_scene_test.cc
""".split())


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
        relative = str(path.relative_to(SOURCE))
        if relative in OLD:
            if not found:
                print(f"note: {relative} follows the rules now; take it out of OLD in {pathlib.Path(__file__).name}")
            continue
        for number, what in found:
            print(f"{relative}:{number}: {what}")
        failed += len(found)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
