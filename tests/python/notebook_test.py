"""The notebooks run from top to bottom, and print and draw what they store.

usage: notebook_test.py EXAMPLES_DIR             (without Jupyter: the cells are executed in order)
       notebook_test.py EXAMPLES_DIR --store     writes the outputs into the notebooks

push_t.ipynb runs where PUSHT names the folder of its data.
"""

import ast
import base64
import contextlib
import io
import json
import os
import pathlib
import re
import sys
import tempfile
import unittest

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

EXAMPLES = pathlib.Path(sys.argv[1]).resolve()
STORE = "--store" in sys.argv
del sys.argv[1:]
sys.path.insert(0, str(EXAMPLES))
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
HAS_DATA = "PUSHT" in os.environ


def execute(notebook):
    """Return the names that the cells define, and the outputs of each code cell."""
    names, outputs = {}, []
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # cells write files
        for cell in notebook["cells"]:
            if cell["cell_type"] != "code":
                continue
            tree = ast.parse("".join(cell["source"]), cell["id"])
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            printed, made = io.StringIO(), []
            with contextlib.redirect_stdout(printed):
                exec(compile(tree, cell["id"], "exec"), names)
                value = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names) if last else None
            if printed.getvalue():
                made.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(True)})
            for number in pyplot.get_fignums():
                png = io.BytesIO()
                pyplot.figure(number).savefig(png, format="png", dpi=70, bbox_inches="tight", metadata={"Software": None})
                made.append({"output_type": "display_data", "metadata": {},
                             "data": {"image/png": base64.b64encode(png.getvalue()).decode()}})
            pyplot.close("all")
            if value is not None:
                made.append({"output_type": "execute_result", "execution_count": len(outputs) + 1, "metadata": {},
                             "data": {"text/plain": repr(value).splitlines(True)}})
            outputs.append(made)
        os.chdir(EXAMPLES)
    return names, outputs


def text_of(outputs):
    return "".join("".join(output.get("text", output.get("data", {}).get("text/plain", []))) for output in outputs)


def pictures_in(outputs):
    return sum("image/png" in output.get("data", {}) for output in outputs)


def store(path):
    notebook = json.loads(path.read_text())
    _, outputs = execute(notebook)
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for i, (cell, made) in enumerate(zip(code, outputs)):
        cell["outputs"], cell["execution_count"] = made, i + 1
    path.write_text(json.dumps(notebook, indent=1) + "\n")


class NotebookTest(unittest.TestCase):
    def read(self, name):
        notebook = json.loads((EXAMPLES / name).read_text())
        self.assertEqual(notebook["nbformat"], 4)
        self.assertEqual(len({cell["id"] for cell in notebook["cells"]}), len(notebook["cells"]))
        return notebook

    def expect_stored(self, notebook, outputs):
        """Expect the stored text to equal the text of the run. Numbers agree within a per mille, because compilers differ."""
        stored = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
        self.assertEqual(len(stored), len(outputs))
        for old, new in zip(stored, outputs):
            self.assertEqual(pictures_in(old), pictures_in(new))
            self.assertEqual(NUMBER.sub("#", text_of(old)), NUMBER.sub("#", text_of(new)))
            for a, b in zip(NUMBER.findall(text_of(old)), NUMBER.findall(text_of(new))):
                self.assertAlmostEqual(float(a), float(b), delta=1e-3 * abs(float(a)) + 1e-9)

    def test_first_guard_runs_and_the_guard_does_its_work(self):
        notebook = self.read("first_guard.ipynb")
        names, outputs = execute(notebook)
        self.expect_stored(notebook, outputs)
        self.assertEqual(sum(map(pictures_in, outputs)), 3)
        self.assertGreater(names["outcomes"]["alone"]["collided"], 30)
        self.assertGreaterEqual(names["outcomes"]["guarded"]["completed"], 95)
        self.assertEqual(names["outcomes"]["guarded"]["collided"], 0)

    def test_push_t_has_its_outputs(self):
        notebook = self.read("push_t.ipynb")
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        self.assertEqual(sum(pictures_in(cell["outputs"]) for cell in code), 2)
        text = "".join(text_of(cell["outputs"]) for cell in code)
        self.assertRegex(text, r"another goal: \d+ of 151")
        self.assertNotRegex("".join("".join(cell["source"]) for cell in code), r"[\"'/]/")  # an absolute path

    @unittest.skipUnless(HAS_DATA, "PUSHT does not name the folder of the data")
    def test_push_t_runs(self):
        notebook = self.read("push_t.ipynb")
        names, outputs = execute(notebook)
        self.expect_stored(notebook, outputs)
        self.assertLess(names["alarms"]["left out"] / 56, 0.2)
        self.assertGreater(names["alarms"]["another goal"] / 151, 0.7)


if __name__ == "__main__":
    if STORE:
        for name in ("first_guard.ipynb", "push_t.ipynb") if HAS_DATA else ("first_guard.ipynb",):
            store(EXAMPLES / name)
    else:
        unittest.main()
