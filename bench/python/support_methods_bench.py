#!@DFR_PYTHON@
"""Cost of exactness: compares the exact support with approximations of it and other support estimates.

usage: python_support_methods_bench [--samples N ...] [--gamma G] [--benchmark_min_time=0]

Each method learns from the same N states in a separate process and classifies the same queries as inside or
outside: half of them states of new trajectories, half of them such states moved away. Times are wall
times (on all cores that the method uses). Memory is the growth of the process from before learning to
its peak. The reference is the exact support of dfr.OneClassSVM: "false inside" is the fraction of the
states outside it that the method accepts, "false outside" the fraction of the states inside it that the
method rejects. A method of another kind estimates another set. These fractions then measure the
difference of the sets.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, "@PROJECT_BINARY_DIR@/python")

import numpy as np

NU = 0.05
DIM = 9
QUERIES = 20000


def exact(gamma):
    import dfr

    return dfr.OneClassSVM(nu=NU, gamma=gamma)


def linear_in_features(components):
    def make(gamma):
        from sklearn.kernel_approximation import Nystroem
        from sklearn.linear_model import SGDOneClassSVM
        from sklearn.pipeline import make_pipeline

        features = Nystroem(gamma=gamma, n_components=components, random_state=0)
        return make_pipeline(features, SGDOneClassSVM(nu=NU, random_state=0, shuffle=True))

    return make


def forest(_):
    from sklearn.ensemble import IsolationForest

    return IsolationForest(contamination=NU, random_state=0, n_jobs=-1)


class Neighbors:
    """Accepts a state if the distance to its k-th neighbour is at most the 1 - NU quantile over the samples."""

    COUNT = 10

    def fit(self, X):
        import faiss

        X = X.astype(np.float32)
        self.index_ = faiss.IndexFlatL2(X.shape[1])
        self.index_.add(X)
        some = np.random.default_rng(0).choice(len(X), min(len(X), 5000), replace=False)
        # The nearest neighbour of a sample is the sample itself.
        squared, _ = self.index_.search(X[some], self.COUNT + 1)
        self.threshold_ = np.quantile(squared[:, self.COUNT], 1 - NU)
        return self

    def decision_function(self, X):
        squared, _ = self.index_.search(X.astype(np.float32), self.COUNT)
        return self.threshold_ - squared[:, -1]


METHODS = {
    "exact support (dfr)": exact,
    "SGD, Nystroem of 100": linear_in_features(100),
    "SGD, Nystroem of 1000": linear_in_features(1000),
    "IsolationForest": forest,
    "k-NN (faiss)": lambda _: Neighbors(),
}


def trajectories(count, rng):
    """Returns states along trajectories with random phases and noise."""
    phase = rng.uniform(0, 6, size=(count, 1))
    return np.sin(phase * (1 + np.arange(DIM)) / 2) + 0.3 * rng.normal(size=(count, DIM))


def problem(samples):
    rng = np.random.default_rng(1)
    X = trajectories(samples, rng)
    queries = trajectories(QUERIES, rng)
    queries[::2] += rng.normal(size=(QUERIES // 2, DIM)) * rng.uniform(0, 1.5, size=(QUERIES // 2, 1))
    return (X - X.mean(axis=0)) / X.std(axis=0), (queries - X.mean(axis=0)) / X.std(axis=0)


def peak_mib():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run_one(name, samples, gamma, labels):
    """Runs one method in a separate process: prints its cost and writes the queries that are inside."""
    try:
        estimate = METHODS[name](gamma)
        estimate.fit(problem(50)[0])  # imports modules and starts threads
    except ImportError as e:
        print(json.dumps({"missing": e.name}))
        return
    X, queries = problem(samples)
    before = peak_mib()
    start = time.perf_counter()
    estimate.fit(X)
    fitted = time.perf_counter()
    inside = np.asarray(estimate.decision_function(queries)) > 0
    decided = time.perf_counter()
    np.save(labels, inside)
    print(json.dumps({"fit": fitted - start, "decide": decided - fitted, "mib": peak_mib() - before}))


def compare(samples, gamma, folder):
    print(f"{samples} x {DIM}, gamma {gamma:.3g}, nu {NU}: {QUERIES} queries")
    print(f"{'':24} {'learn':>10} {'a state':>10} {'memory':>10} {'inside':>8} {'false inside':>13} {'false outside':>14}")
    reference = None
    for name in METHODS:
        labels = folder / "inside.npy"
        command = [sys.executable, __file__, "--one", name, "--samples", samples, "--gamma", gamma, "--labels", labels]
        out = subprocess.run([str(a) for a in command], capture_output=True, text=True, check=False)
        if out.returncode != 0:
            sys.exit(f"{name} failed:\n{out.stderr}")
        cost = json.loads(out.stdout.splitlines()[-1])
        if "missing" in cost:
            print(f"{name:24} skipped: {cost['missing']} is not installed (apt-get install python3-{cost['missing']})")
            continue
        inside = np.load(labels)
        if reference is None:
            reference = inside
        print(
            f"{name:24} {cost['fit']:>8.3f} s {1e6 * cost['decide'] / QUERIES:>7.2f} us {cost['mib']:>6.0f} MiB"
            f" {100 * inside.mean():>6.1f} % {100 * inside[~reference].mean():>11.2f} % {100 * (~inside[reference]).mean():>12.2f} %",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, nargs="+", default=[10000, 100000])
    parser.add_argument("--gamma", type=float, default=1 / DIM)
    parser.add_argument("--benchmark_min_time", help="any value: 1000 samples, as a smoke test")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--labels", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        run_one(options.one, options.samples[0], options.gamma, options.labels)
        return
    with tempfile.TemporaryDirectory() as folder:
        for samples in [1000] if options.benchmark_min_time is not None else options.samples:
            compare(samples, options.gamma, pathlib.Path(folder))


if __name__ == "__main__":
    main()
