"""Checks the pages of docs: link targets, glossary, tables of components, and the commands of the first guard.

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


    def test_no_link_and_no_formula_wraps_a_line(self):
        # docs/for_doxygen.awk reads line by line.
        for page in pages():
            with self.subTest(page=page.name):
                shown = FENCE.sub("", page.read_text())
                self.assertEqual(re.findall(r"\[[^\[\]`]*\n[^\[\]`]*\]\([^() \n]+\)", shown), [])
                self.assertEqual([line for line in shown.splitlines() if line.count("$`") != line.count("`$")], [])


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


def words(label):
    """Return a column heading or printed label in lower case and without its unit: "passed" for "Passed, %"."""
    return re.sub(r"( %|, (%|steps)| \[.*\]| \+- .*|:)$", "", label.strip()).lower()


def text(source):
    """Return a source with its adjacent string literals joined."""
    return re.sub(r'"\s*\n\s*"', "", (SOURCE / source).read_text())


# Rows: source file, pattern of its lists of labels, pattern of a label in a list, minimum number of labels.
STRINGS = r'"([^"]+)"'
LABELS = (
    ("apps/guard/fit.cc", r'Print\(\s*("[a-z_][^\n]*?  )', r'"([\w ]+?)  ', 12),
    ("apps/guard/check.cc", r'(?:Warning|Say)\(\s*("\w+")', STRINGS, 6),
    ("apps/guard/check.cc", r'Print\(\s*("[a-z]+:? )', r'"(\w+)', 4),
    ("apps/guard/evaluate.cc", r'Print\("%-24s[^"]*",(.*?)\);', STRINGS, 6),
    ("apps/guard/report.cc", r"header = \{([^}]*)\}", STRINGS, 12),
    ("apps/guard/report.cc", r'\.name = ("[a-z ]+")', STRINGS, 4),
    ("apps/study/tables.cc", r"header = \{([^}]*)\}", STRINGS, 25),
    ("apps/study/tables.cc", r"header\.emplace_back\(([^)]*)\)", STRINGS, 2),
    ("apps/study/planar/commands.cc", r'printf\("%-1[02]s[^"]*?s\\n",(.*?)\);', STRINGS, 15),
    ("apps/study/planar/proof.cc", r'return ("[a-z-]+");', STRINGS, 4),
    ("apps/study/runner.cc", r'return ("\w+");', STRINGS, 1),
    ("apps/pusher/experiment.cc", r"header = \{([^}]*)\}", STRINGS, 2),
    ("apps/line_tracking/commands/experiment.cc", r"header = \{([^}]*)\}", STRINGS, 8),
    ("apps/line_tracking/commands/run.cc", r'Say\(("episode .*?")', r'(\w+(?: \[mm\])?)(?:  |\\n)', 6),
    ("apps/line_tracking/commands/vision.cc", r'(blur  .*?vision)', r"(\w[\w %]*?)(?:  |$)", 10),
    ("apps/hardware/check/check.cc", r'return ("(?:ok|note|wrong)")', STRINGS, 3),
    ("libs/experiment/src/summary.cc", r"Format\(heads, name_width,([^)]*)\)", STRINGS, 8),
    ("libs/study/include/dfr/study/policies.h", r"kPolicies = \{([^}]*)\}", STRINGS, 12),
    ("libs/study/include/dfr/study/supports.h", r"kSupports = \{([^}]*)\}", STRINGS, 5),
    ("libs/study/src/placebo.cc", r"names = \{([^}]*)\}", STRINGS, 2),
    ("apps/study/study.cc", r"controllers = \{([^}]*)\}", STRINGS, 10),
    ("apps/pusher/experiment.cc", r"methods = \{([^}]*)\}", STRINGS, 12),
    ("libs/control/src/guided/guided_options.cc", r"kParts = \{([^}]*)\}", STRINGS, 7),
)


class Glossary(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.page = (SOURCE / "docs/glossary.md").read_text()
        # The words of the first column, without units and emphasis.
        cells = re.findall(r"^\| (.*?) \|", cls.page.replace("\\|", "!"), re.M)
        cls.terms = {words(term) for cell in cells for term in re.split("[,;] ", cell.replace("`", ""))}
        cls.code = set(re.findall(r"`([a-z-]+)`", cls.page))

    def test_has_each_label_that_a_program_prints(self):
        for source, lists, labels, least in LABELS:
            with self.subTest(source=source, lists=lists):
                found = re.findall(lists, text(source), re.S)
                found = {words(label) for part in found for labelled in re.findall(labels, part)
                         for label in re.split(" / |, (?=[a-z])", labelled)} - {"", "-", "unknown"}
                found = {label for label in found if "@" not in label}
                self.assertGreaterEqual(len(found), least, sorted(found))
                self.assertEqual(found - self.terms - self.code, set())

    def test_has_each_condition_of_the_study(self):
        conditions = re.findall(r'\.name = "([^"]+)"', text("apps/study/task.cc"))
        conditions = set(conditions) - {"pusher", "line-tracking"}
        self.assertGreater(len(conditions), 25)
        table = re.search(r"^\| condition \|.*?(\n\n|\Z)", self.page, re.M | re.S).group()
        known = [term for cell in re.findall(r"^\| (.*?) \|", table, re.M)[1:] for term in cell.split(", ")]
        self.assertEqual({name for name in conditions if not any(term in name for term in known)}, set())

    def test_has_each_name_that_a_program_prints(self):
        for source, least in (("libs/control/src/controller.cc", 15), ("libs/runtime/src/fail_safe.cc", 25),
                              ("libs/safety/src/guard.cc", 6), ("libs/safety/src/guard_model.cc", 6),
                              ("libs/control/src/published/switching_controller.cc", 3)):
            names = set(re.findall(r'return "([a-z-]+)";', (SOURCE / source).read_text())) - {"unknown"}
            self.assertGreaterEqual(len(names), least, source)
            self.assertEqual(names - self.code, set(), source)
        binding = (SOURCE / "python/src/guard.cc").read_text()
        keys = set(re.findall(r'(?:info|result|values)\["(\w+)"\]', binding))
        self.assertGreater(len(keys), 30)
        told = set(re.findall(r"[a-z_]+", self.page))
        self.assertEqual(keys - told, set())


class Strategies(unittest.TestCase):
    def test_each_text_recommends_one_that_exists(self):
        help_text = subprocess.run([GUARD, "fit", "--help"], text=True, capture_output=True, check=True).stdout
        known = set(re.findall(r"([a-z-]+) \(", re.search(r"--strategy.*", help_text).group()))
        self.assertIn("monitor", known)
        named = set()
        for folder in ("apps", "libs", "python", "examples", "docs"):
            for path in (SOURCE / folder).rglob("*"):
                if path.suffix in (".cc", ".h", ".py", ".md"):
                    named |= set(re.findall(r"--strategy ([a-z-]+)", path.read_text()))
        self.assertGreater(len(named), 2)
        self.assertEqual(named - known, set())


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
                    # Other processors may round differently: numbers are not compared here.
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
