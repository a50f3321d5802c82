"""The pages of docs: links lead somewhere, and the commands of the first guard do what the page says.

usage: docs_test.py SOURCE_DIR GUARD     (with the module dfr on PYTHONPATH)
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

SOURCE, GUARD = (pathlib.Path(p).resolve() for p in sys.argv[1:3])
del sys.argv[1:3]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)


def pages():
    if shutil.which("git"):
        tracked = subprocess.run(["git", "ls-files", "*.md"], cwd=SOURCE, capture_output=True, text=True)
        if tracked.returncode == 0:
            return [SOURCE / name for name in tracked.stdout.split()]
    return sorted(SOURCE.glob("docs/*.md")) + [SOURCE / "README.md"]


def anchors(page):
    """Return GitHub's anchors of the headings of a page."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.M)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


class Links(unittest.TestCase):
    def test_each_leads_to_a_file_and_a_heading(self):
        self.assertGreater(len(pages()), 10)
        for page in pages():
            for link in re.findall(r"\]\(([^() ]+)\)", FENCE.sub("", page.read_text())):
                if re.match(r"[a-z]+:", link):
                    continue
                with self.subTest(page=page.name, link=link):
                    path, _, anchor = link.partition("#")
                    target = (page.parent / path).resolve() if path else page
                    self.assertTrue(target.exists())
                    if anchor:
                        self.assertIn(anchor, anchors(target))


class Folders(unittest.TestCase):
    def test_says_what_each_component_needs(self):
        rows = [[cell.strip() for cell in row.split("|")[:3]]
                for row in (SOURCE / "components.txt").read_text().splitlines() if re.match("[a-z]", row)]
        listed = {name: needs.split() for name, folder, needs in rows
                  if re.match("(libs|hardware|sim)/", folder)}
        told = {}
        for names, needs in re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| (no other|(?:`\w+`(?:, )?)+) \|$",
                                       (SOURCE / "docs/folders.md").read_text(), re.M):
            told |= {name: re.findall(r"`(\w+)`", needs) for name in re.findall(r"`(\w+)`", names)}
        self.assertEqual(told, listed)


class Glossary(unittest.TestCase):
    def test_has_each_name_that_a_program_prints(self):
        told = set(re.findall(r"`([a-z-]+)`", (SOURCE / "docs/glossary.md").read_text()))
        for source, least in (("libs/control/src/controller.cc", 15), ("libs/runtime/src/fail_safe.cc", 25),
                              ("libs/safety/src/guard.cc", 6), ("libs/safety/src/guard_model.cc", 6),
                              ("libs/control/src/published/switching_controller.cc", 3)):
            names = set(re.findall(r'return "([a-z-]+)";', (SOURCE / source).read_text())) - {"unknown"}
            self.assertGreaterEqual(len(names), least, source)
            self.assertEqual(names - told, set(), source)
        binding = (SOURCE / "python/src/guard.cc").read_text()
        keys = set(re.findall(r'(?:info|result|values)\["(\w+)"\]', binding))
        self.assertGreater(len(keys), 30)
        told = set(re.findall(r"[a-z_]+", (SOURCE / "docs/glossary.md").read_text()))
        self.assertEqual(keys - told, set())


class FirstGuard(unittest.TestCase):
    def test_the_commands_print_what_the_page_shows(self):
        with tempfile.TemporaryDirectory() as folder:
            programs = pathlib.Path(folder) / "bin"
            programs.mkdir()
            (programs / "guard").symlink_to(GUARD)
            (programs / "python3").symlink_to(sys.executable)
            environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"}
            printed = ""
            commands = 0
            for language, text in FENCE.findall((SOURCE / "docs/first_guard.md").read_text()):
                if language == "sh" and not text.startswith("apt "):
                    text = text.replace("/usr/share/dfr/examples", str(SOURCE / "examples"))
                    done = subprocess.run(["bash", "-ec", text], cwd=folder, env=environment, text=True,
                                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=100)
                    self.assertEqual(done.returncode, 0, text + done.stderr)
                    printed = done.stdout
                    commands += len(text.splitlines())
                elif language == "":
                    # Other processors may round otherwise: numbers are not compared here.
                    plain = re.sub(r"[\d.]+", "#", printed)
                    for line in text.splitlines():
                        if line != "...":
                            self.assertIn(re.sub(r"[\d.]+", "#", line), plain)
            self.assertEqual(commands, 5)
            alone, guarded = re.findall(r"'collided': (\d+)|(?<=guarded:) \{'completed': (\d+)\}", printed)
            self.assertGreater(int(alone[0]), 40)
            self.assertEqual(int(guarded[1]), 100)


if __name__ == "__main__":
    unittest.main()
