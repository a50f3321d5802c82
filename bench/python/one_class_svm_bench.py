#!@DFR_PYTHON@
"""Compares fits and decisions of dfr.OneClassSVM with those of sklearn.svm.OneClassSVM in one run,
and decisions of dfr.OneClassSVM with the same decisions in C++.

usage: python_one_class_svm_bench [--benchmark_min_time=0]   (a smoke test: small sizes, timed once)

Times are processor seconds of the process, which runs one thread, the minimum of several
repetitions. If the decisions differ, the program fails without timing them.
"""

import os
import subprocess
import sys
import tempfile
import time

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
sys.path.insert(0, "@PROJECT_BINARY_DIR@/python")

import numpy as np
import sklearn.svm

import dfr

# samples, features, gamma ("scale" of whitened data is 1/features), and the required speed-ups
CASES = [
    (1200, 9, "scale", None, None),
    (12000, 9, "scale", 10.0, 20.0),
    (12000, 9, 5.0, 10.0, 20.0),
    (12000, 32, "scale", None, None),
]
NU = 0.05
IN_CPP = "@CMAKE_RUNTIME_OUTPUT_DIRECTORY@/decision_in_cpp"
SLOWEST = 1.25  # limit of the time relative to C++: batches of milliseconds vary by a tenth


def least_time(work, repetitions):
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def in_cpp(X, queries, svm, repetitions):
    """Returns the time, in s, of the same decisions in C++ after a fit to the same samples."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(X.tobytes() + queries.tobytes())
        file.flush()
        command = [IN_CPP, file.name, *X.shape, repr(svm.estimate_.gamma), NU, repetitions]
        out = subprocess.run([str(a) for a in command], capture_output=True, text=True, check=True).stdout
    return float(out.split()[0]) / 1e3


def main():
    smoke = "--benchmark_min_time=0" in sys.argv
    print(f"dfr {dfr.__version__} ({dfr._core.build_commit}), scikit-learn {sklearn.__version__}, nu {NU}, tol 1e-3")
    print(f"{'n':>6} {'d':>3} {'gamma':>6} | {'fit ms':>8} {'sklearn':>9} {'factor':>7} | {'decide ms':>9} {'sklearn':>9} {'factor':>7} {'in C++':>7}")
    missed = []
    for n, d, gamma, fit_goal, decide_goal in CASES:
        if smoke:
            n //= 20
        rng = np.random.default_rng(1)
        phase = rng.uniform(0, 6, size=(n, 1))  # states along trajectories, whitened
        X = np.sin(phase * (1 + np.arange(d)) / 2) + 0.3 * rng.normal(size=(n, d))
        X = (X - X.mean(axis=0)) / X.std(axis=0)
        queries = X + 0.2 * rng.normal(size=X.shape)
        ours = dfr.OneClassSVM(nu=NU, gamma=gamma, n_jobs=1)
        theirs = sklearn.svm.OneClassSVM(nu=NU, gamma=gamma)
        fit = least_time(lambda: ours.fit(X), 1 if smoke else 5)
        peer_fit = least_time(lambda: theirs.fit(X), 1 if smoke else 2)
        # The solvers stop at a tolerance, so decisions differ slightly. The limit grows with rho, their scale.
        difference = np.abs(ours.decision_function(queries) - theirs.decision_function(queries)).max()
        if not difference < 5e-3 + 1e-3 * ours.offset_[0]:
            sys.exit(f"n {n}, d {d}, gamma {gamma}: decisions differ by {difference}")
        decide = least_time(lambda: ours.decision_function(queries), 1 if smoke else 9)
        peer_decide = least_time(lambda: theirs.decision_function(queries), 1 if smoke else 2)
        bare = in_cpp(X, queries, ours, 1 if smoke else 9)
        print(
            f"{n:>6} {d:>3} {gamma!s:>6} | {1e3 * fit:>8.2f} {1e3 * peer_fit:>9.1f} {peer_fit / fit:>6.1f}x"
            f" | {1e3 * decide:>9.2f} {1e3 * peer_decide:>9.1f} {peer_decide / decide:>6.1f}x {1e3 * bare:>7.2f}",
            flush=True,
        )
        if n >= 12000 and decide > SLOWEST * bare:
            missed.append(f"decision at n {n}, d {d}, gamma {gamma}: {decide / bare:.2f} times as long as in C++")
        for what, factor, goal in (("fit", peer_fit / fit, fit_goal), ("decision", peer_decide / decide, decide_goal)):
            if goal is not None and factor < goal:
                missed.append(f"{what} at n {n}, d {d}, gamma {gamma}: {factor:.1f} times, not {goal:.0f}")
    if smoke:
        print("smoke test: these times mean nothing")
    elif missed:
        sys.exit("below the goal: " + "; ".join(missed))


if __name__ == "__main__":
    main()
