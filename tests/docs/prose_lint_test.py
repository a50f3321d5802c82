"""The lint of prose finds what it says, and nothing in what it should leave."""

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
        # The second line of a sentence, a word, and code.
        self.assertEqual(self.found("a.h", "/// The mean\n/// Of all.\n// Offset\nint Of;\n// Of course\n"), [])

    def test_words(self):
        self.assertEqual(self.found("a.md", "Utilize it.\nLikewise.\nuse it, like wise people\n"), [1, 2])
        self.assertEqual(self.found("a.cc", 'f("likewise");  // likewise\nf("likewise");\n'), [1])


if __name__ == "__main__":
    unittest.main()
