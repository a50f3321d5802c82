"""Checks that the prose lint finds each of its patterns, and nothing in correct text."""

import contextlib
import io
import pathlib
import tempfile
import unittest

import prose_lint


class ProseLintTest(unittest.TestCase):
    def found(self, name, text):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / name
            path.write_text(text)
            return [number for number, _ in prose_lint.problems(path)]

    def test_long_lines_of_markdown(self):
        long = "word " * 30 + "end"
        self.assertEqual(self.found("a.md", f"short\n{long}\n"), [2])
        self.assertEqual(self.found("a.md", f"| {long} |\n# {long}\n```\n{long}\n```\n[a]({'x' * 150})\n"), [])

    def test_dangling_of(self):
        self.assertEqual(self.found("a.h", "int a;  ///< Of the action.\n/// Of a set.\n"), [1, 2])
        # Allowed: the second line of a sentence, a word, and code.
        self.assertEqual(self.found("a.h", "/// The mean\n/// Of all.\n// Offset\nint Of;\n// Of course\n"), [])

    def test_openings_and_style_of_pages(self):
        self.assertEqual([number for number, _ in prose_lint.markdown_problems(
            "What it does.\n\n- Whether it holds\n\n**How many?** Two.\n\nIt holds\nWhat is left\n"
            "```\nWhat\n```\n\nsit so that\nit stands\n")], [1, 3, 13])
        self.assertEqual(self.found("a.md", "What it does.\n"), [])  # only README and docs have a style
        self.assertEqual([number for number, _ in prose_lint.comment_problems(
            "/// By how much it moves\n/// what is left\n", style=True)], [1])

    def test_sentences_that_an_editor_would_rewrite(self):
        for comment in ("What a loop works with.", "naming what there is", "By how much any entry may change",
                        "a camera that the model has not", "Actions must be such that zero holds the robot still"):
            self.assertTrue(list(prose_lint.comment_problems("/// " + comment, style=True)), comment)
        for comment in ("Maximum deviation of the jaw tips, m.", "A zero action must hold the robot still"):
            self.assertFalse(list(prose_lint.comment_problems("/// " + comment, style=True)), comment)

    def test_subjects_of_commits(self):
        for subject in ("dds: that a participant leaves is not handed on", "docs: what was not measured is not said",
                        "control: a view is passed as one", "kernel: a test's samples are reserved", "Adds a test",
                        "Fixed a bug", "tests: renaming of cases", "kernel: " + "pad " * 17):
            self.assertTrue(list(prose_lint.subject_problems(subject)), subject)
        for subject in ("kernel: pad support vectors to whole lanes", "Print the cost of each task",
                        "control: pass the view by value", "Focus, then embed and bring the view", "docs, tests: need it"):
            self.assertEqual(list(prose_lint.subject_problems(subject)), [], subject)

    def test_message_of_a_commit(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "COMMIT_EDITMSG"
            for message, failed in (("Adds a test\n", 1), ("Add a test\n\nAdds nothing else.\n", 0),
                                    ("fixup! Add a test " + "again " * 12, 0)):
                path.write_text(message)
                with contextlib.redirect_stdout(io.StringIO()):
                    self.assertEqual(prose_lint.lint_message(path), failed, message)

    def test_words(self):
        self.assertEqual(self.found("a.md", "Utilize it.\nLikewise.\nuse it, like wise people\n"), [1, 2])
        self.assertEqual(self.found("a.cc", 'f("likewise");  // likewise\nf("likewise");\n'), [1])


if __name__ == "__main__":
    unittest.main()
