"""Lays out reports in headless Chromium at two widths: no text overlaps, is cut or is too small to read.

usage: report_layout_test.py CHROMIUM FAKE_EXPERIMENT GUARD STUDY SOURCE_DIR
"""

import csv
import html
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

CHROMIUM, FAKE, GUARD, STUDY, SOURCE = sys.argv[1:6]
del sys.argv[1:6]
WIDTHS = (500, 1300)

# Collects the boxes of visible text, one per line, and reports those that overlap, are cut or are small.
MEASURE = """<script>
addEventListener("load", () => {
  const boxes = [], found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walk.nextNode());) {
    const parent = node.parentElement;
    if (!node.data.trim() || parent.closest("script, style, title, [hidden], details:not([open]) > :not(summary)")) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    const rects = parent instanceof SVGElement ? [parent.getBoundingClientRect()] : range.getClientRects();
    for (const r of rects) {
      if (r.width > 0) boxes.push({text: node.data.trim().slice(0, 40), node, parent, r});
    }
  }
  for (const {text, parent, r} of boxes) {
    if (r.height < 10) found.push(`${text}: ${r.height.toFixed(1)} px high`);
    if (!parent.closest(".wide") && (r.left < 0 || r.right > innerWidth + 1)) found.push(`${text}: outside the page`);
    for (let e = parent; e instanceof HTMLElement; e = e.parentElement) {
      if (getComputedStyle(e).overflowX !== "hidden") continue;
      const b = e.getBoundingClientRect();
      if (r.left < b.left - 1 || r.right > b.right + 1) found.push(`${text}: cut`);
    }
  }
  boxes.sort((a, b) => a.r.top - b.r.top);
  for (let i = 0; i < boxes.length; ++i) {
    for (let j = i + 1; j < boxes.length && boxes[j].r.top < boxes[i].r.bottom - 1; ++j) {
      const a = boxes[i], b = boxes[j];
      const across = Math.min(a.r.right, b.r.right) - Math.max(a.r.left, b.r.left);
      const down = Math.min(a.r.bottom, b.r.bottom) - Math.max(a.r.top, b.r.top);
      // Lines of a block may touch, because glyphs fill two thirds of their boxes.
      if (a.node !== b.node && across > 1 && down > 4) found.push(`${a.text} | ${b.text}`);
    }
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page scrolls sideways");
  const answer = document.createElement("pre");
  answer.id = "measured";
  answer.textContent = JSON.stringify({boxes: boxes.length, width: innerWidth, found});
  document.body.append(answer);
});
</script></body>"""


def measure(page, width):
    """Return the findings of the script on the page in a window of this width."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        hooked = pathlib.Path(folder, "page.html")
        hooked.write_text(page.replace("</body>", MEASURE))
        dumped = subprocess.run(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}/profile",
             f"--window-size={width},900", "--virtual-time-budget=5000", "--dump-dom", hooked.as_uri()],
            capture_output=True, text=True, timeout=200)
        answer = re.search(r'<pre id="measured">(.*?)</pre>', dumped.stdout, re.S)
        assert answer, dumped.stderr[-2000:]
        return json.loads(html.unescape(answer[1]))


class Layout(unittest.TestCase):
    def expect_legible(self, page, texts):
        for width in WIDTHS:
            with self.subTest(width=width):
                measured = measure(page, width)
                self.assertEqual(measured["width"], width)
                self.assertGreater(measured["boxes"], texts)
                self.assertEqual(measured["found"], [])

    def test_finds_what_is_wrong(self):
        bad = """<!DOCTYPE html><html><head><meta name="viewport" content="width=device-width"></head><body>
          <p style="position:absolute;left:20px;top:20px">one</p><p style="position:absolute;left:25px;top:22px">two</p>
          <p style="position:absolute;left:480px;top:90px;white-space:nowrap">beyond the right edge</p>
          <p style="position:absolute;top:150px;font-size:6px">small</p></body></html>"""
        found = " ".join(measure(bad, 500)["found"])
        for expected in ("one | two", "beyond the right edge: outside", "small: "):
            self.assertIn(expected, found)

    def test_experiment_with_all_methods(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([FAKE, "experiment", "--all-methods", "--out", f"{folder}/out"], check=True, capture_output=True)
            self.expect_legible(pathlib.Path(folder, "out/report.html").read_text(), 300)

    def test_guard(self):
        with tempfile.TemporaryDirectory() as folder:
            demos = f"{folder}/demos.hdf5"
            subprocess.run([sys.executable, f"{SOURCE}/examples/record_demonstrations.py", demos], check=True, capture_output=True)
            subprocess.run([GUARD, "fit", demos, "--features", "obs/tip", "-o", f"{folder}/task.guard"], check=True, capture_output=True)
            subprocess.run([GUARD, "report", f"{folder}/task.guard", demos, "-o", f"{folder}/report.html"], check=True,
                           capture_output=True)
            page = pathlib.Path(folder, "report.html").read_text()
            self.assertRegex(page, r'</h1>\s*<p class="verdict">(Fit for use|Doubtful|Do not use)')
            self.assertLess(page.index("<svg"), page.index("<table"))
            self.expect_legible(page, 80)

    def test_study(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([STUDY, "run", "--tasks", "reach,push", "--policies", "good,weak", "--trials", "1", "--episodes", "3",
                            "--out", f"{folder}/out"], check=True, capture_output=True)
            page = pathlib.Path(folder, "out/report.html").read_text()
            self.assertRegex(page, r'</h1>\s*<div class="verdict"><b>(Fit for use|Doubtful|Do not use)</b>')
            self.assertLess(page.index("% of the controls"), page.index("<svg"))
            self.assertLess(page.rindex("<figure"), page.index("<table"))
            self.expect_legible(page, 150)

    def test_gallery(self):
        with tempfile.TemporaryDirectory() as folder:
            recorded = pathlib.Path(SOURCE, "docs/recorded/gallery.csv")
            subprocess.run([sys.executable, "-B", f"{SOURCE}/docs/gallery.py", STUDY, recorded, f"{folder}/gallery.html"], check=True)
            page = pathlib.Path(folder, "gallery.html").read_text()
            listed = subprocess.run([STUDY, "list"], check=True, capture_output=True, text=True).stdout
            names = re.findall(r"^  ([a-z]\S+)", listed, re.M)
            self.assertGreater(len(names), 20)
            self.assertEqual(re.findall(r'<section id="(.*?)">', page), names)
            self.assertEqual(page.count('role="img"'), 3 * len(names))
            # Computes the first task's shares from its counts.
            with recorded.open(newline="") as file:
                rows = [row for row in csv.DictReader(file) if (row["task"], row["method"]) == (names[0], "alone")]
            done = sum(int(row["ok"]) for row in rows) / sum(int(row["episodes"]) for row in rows)
            self.assertIn(f"Alone: completed {100 * done:.1f} %", page)
            self.expect_legible(page, 100)


if __name__ == "__main__":
    unittest.main()
