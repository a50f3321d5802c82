"""Writes a OneClassSVM that Python exported, with states and its decision values, for onnx_peer.cjs.

usage: onnx_python_cases.py DIR     (with the module dfr on PYTHONPATH)
"""
import json
import pathlib
import sys

import dfr
import numpy as np

folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
rng = np.random.default_rng(3)
svm = dfr.OneClassSVM(nu=0.2).fit(rng.normal(size=(60, 4)))
x = 1.5 * rng.normal(size=(100, 4))
svm.export_onnx(folder / "one_class_svm.onnx")
case = {
    "model": "one_class_svm.onnx",
    "inputs": [{"name": "x", "type": "double", "values": x.ravel().tolist(), "shape": [100, 4]}],
    "output": "g",
    "expected": svm.decision_function(x).tolist(),
    "dims": [100],
}
assert max(map(abs, case["expected"])) > 1.0  # scikit-learn's scale, not that of the estimate
(folder / "one_class_svm.json").write_text(json.dumps(case))
try:
    dfr.OneClassSVM().export_onnx(folder / "unfitted.onnx")
except ValueError as error:
    assert "not fitted" in str(error)
else:
    sys.exit("an estimator that is not fitted was exported")
