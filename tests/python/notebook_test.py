"""The notebook of the first guard runs from top to bottom and prints its stated results.

usage: notebook_test.py EXAMPLES_DIR     (without Jupyter: its cells are executed in order)
"""

import json
import os
import pathlib
import sys
import tempfile
import unittest

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

EXAMPLES = pathlib.Path(sys.argv[1]).resolve()
del sys.argv[1]
sys.path.insert(0, str(EXAMPLES))


class NotebookTest(unittest.TestCase):
    def test_runs_and_the_guard_does_its_work(self):
        notebook = json.loads((EXAMPLES / "first_guard.ipynb").read_text())
        self.assertEqual(notebook["nbformat"], 4)
        self.assertEqual(len({cell["id"] for cell in notebook["cells"]}), len(notebook["cells"]))
        names = {}
        figures = 0
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)  # it writes a file
            for cell in notebook["cells"]:
                if cell["cell_type"] != "code":
                    continue
                # Output in the repository would go stale unseen.
                self.assertEqual(cell["outputs"], [])
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
                figures += len(pyplot.get_fignums())
                pyplot.close("all")
            self.assertTrue(pathlib.Path("task.guard").is_file())
            os.chdir(EXAMPLES)
        self.assertEqual(figures, 3)
        self.assertGreater(names["outcomes"]["alone"]["collided"], 30)
        self.assertGreaterEqual(names["outcomes"]["guarded"]["completed"], 95)
        self.assertEqual(names["outcomes"]["guarded"]["collided"], 0)


if __name__ == "__main__":
    unittest.main()
