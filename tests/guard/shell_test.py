"""The manual page and the completion in bash of an installed program.

usage: shell_test.py GUARD MAN_PAGE COMPLETION
"""

import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

GUARD, MAN_PAGE, COMPLETION = (pathlib.Path(p).resolve() for p in sys.argv[1:4])
del sys.argv[1:4]


def help_of(*subcommand):
    return subprocess.run([GUARD, *subcommand, "--help"], text=True, capture_output=True, check=True).stdout


class ManPageTest(unittest.TestCase):
    def test_formats_without_a_warning_and_contains_the_help(self):
        done = subprocess.run(["groff", "-man", "-ww", "-Tascii", "-P-cbou", MAN_PAGE], text=True, capture_output=True)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        # Ignores line breaks and hyphens, which groff chooses.
        page = "".join(done.stdout.split()).replace("-", "")
        for subcommand in [(), ("fit",), ("check",), ("export",)]:
            for word in help_of(*subcommand).split():
                word = word.replace("-", "").replace(str(GUARD).replace("-", ""), "guard")
                if word not in ("Usage:", "Options:", "Positionals:", "Subcommands:", "Examples:") and word.isascii():
                    self.assertIn(word, page)
        self.assertIn("GUARDFIT", page)


class CompletionTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        shutil.copy(COMPLETION, self.folder / "guard")  # the installed name

    def complete(self, *words):
        script = f"""source {self.folder}/guard && complete -p guard | grep -q _dfr_complete || exit 1
          COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
          _dfr_complete {GUARD}
          printf '%s\\n' "${{COMPREPLY[@]}}\""""
        done = subprocess.run(["bash", "-c", script, "bash", "guard", *words], text=True, capture_output=True)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return set(done.stdout.split())

    def test_subcommands(self):
        self.assertEqual(self.complete(""), {"check", "convert", "fit", "show", "report", "evaluate", "export"})
        self.assertEqual(self.complete("e"), {"evaluate", "export"})

    def test_options_of_the_subcommand(self):
        self.assertEqual(self.complete("fit", "--fe"), {"--features"})
        self.assertIn("-o", self.complete("fit", "demos.hdf5", "-"))
        self.assertIn("--out", self.complete("fit", "demos.hdf5", "-"))
        self.assertNotIn("--strategy", self.complete("check", "-"))
        self.assertEqual(self.complete("-"), {"-h", "--help", "--version"})

    def test_other_words_are_left_to_the_completion_of_files(self):
        self.assertEqual(self.complete("fit", "dem"), set())


if __name__ == "__main__":
    unittest.main()
