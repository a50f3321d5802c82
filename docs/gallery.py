"""Writes the manual's page of all tasks: pictures by `study picture`, figures from docs/recorded/gallery.csv.

usage: gallery.py STUDY RECORDED OUTPUT      as in gallery.py build/dev/bin/study docs/recorded/gallery.csv gallery.html
"""
import csv
import html
import os
import pathlib
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

POLICY, METHOD, RECORDED_METHOD = "weak", "guard", "controller"
STYLE = """
.tasks { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(520px, 100%), 1fr)); gap: 18px; }
a { color: var(--s2); }
.tasks section { background: var(--card); border-radius: 8px; padding: 12px 16px 14px; }
.tasks h2 { margin: 0; } .tasks p { margin: 4px 0 8px; }
.tasks .row { grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 8px; }
.tasks .label, .tasks .tick, .tasks .grid, .tasks .axis, .tasks .mark { display: none; } .tasks .panel { font-size: 30px; }
.tasks .line { stroke-width: 3; }
"""
INTRODUCTION = """<p>Every task of <code>study</code>. Its pictures show the first two entries of the state in five
demonstrations, in five episodes of a weak policy alone, and in five episodes from the same start states with
strategy <code>guard</code>. A guard is fitted to demonstrations only. <code>study picture TASK</code> draws the
same paths, with axes.</p>
<p>The figures are those of the <a href="md_docs_recorded_README.html">recorded run</a>: per cent of the episodes around five
policies together, alone and with strategy <code>controller</code>.</p>
"""


def tasks(listed):
    """Return the name, summary and conditions of each task that `study list` prints."""
    return re.findall(r"^  (\S+) +(\S.*)\n   +(\S.*)$", listed, re.M)


def figures(recorded):
    """Return the shares of completed and failed episodes over all policies, for each task and method."""
    sums = {}
    for row in csv.DictReader(recorded):
        counts = sums.setdefault((row["task"], row["method"]), [0, 0, 0])
        for i, key in enumerate(("episodes", "ok", "failed")):
            counts[i] += int(row[key])
    return {key: (100 * ok / episodes, 100 * failed / episodes) for key, (episodes, ok, failed) in sums.items()}


def picture(study, task):
    """Return the page that `study picture` writes."""
    with tempfile.TemporaryDirectory() as folder:
        page = pathlib.Path(folder, "page.html")
        subprocess.run([study, "picture", task, "--policy", POLICY, "--methods", METHOD, "--out", page],
                       check=True, stdout=subprocess.DEVNULL)
        return page.read_text()


def section(task, page, shares):
    name, summary, facts = task
    panels = re.findall(r"<svg viewBox=\"0 0 380.*?</svg>", page, re.S)
    if len(panels) != 3:
        sys.exit(f"gallery.py: study picture {name} drew {len(panels)} plots instead of 3")
    told = "Newer than the recorded run."
    if (name, "alone") in shares:
        told = "; ".join(f"{shown}: completed {shares[name, key][0]:.1f} %, failed {shares[name, key][1]:.1f} %"
                         for key, shown in (("alone", "Alone"), (RECORDED_METHOD, RECORDED_METHOD))) + "."
    return (f'<section id="{html.escape(name)}"><h2>{html.escape(name)}</h2>\n<p>{html.escape(summary)}.</p>\n'
            f'<div class="row">{"".join(panels)}</div>\n<p>{told}</p>\n<p class="caption">{html.escape(facts[0].upper() + facts[1:])}.</p></section>\n')


def write(study, recorded, output):
    listed = tasks(subprocess.run([study, "list"], check=True, capture_output=True, text=True).stdout)
    with recorded.open(newline="") as file:
        shares = figures(file)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        pages = list(pool.map(lambda task: picture(study, task[0]), listed))
    head, body = re.match(r"(.*?<style>.*?)(</style>.*?<main>)", pages[0], re.S).groups()
    key = re.search(r'<div class="key">.*?</div>\n', "".join(pages), re.S).group()
    sections = "".join(section(task, page, shares) for task, page in zip(listed, pages))
    output.write_text(
        re.sub("<title>.*?</title>", "<title>dfr: gallery</title>", head) + STYLE + body +
        '<h1>Gallery</h1>\n<p><a href="index.html">To the manual</a></p>\n' + INTRODUCTION + key +
        f'<div class="tasks">\n{sections}</div>\n</main>\n</body>\n</html>\n')


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    write(sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3]))
