"""Compares dfr.OneClassSVM with scikit-learn's, and uses it as a scikit-learn estimator and without scikit-learn."""

import pickle
import subprocess
import sys
import textwrap
import unittest
import warnings

import numpy as np
import sklearn.svm
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import estimator_checks

import dfr


def cloud(kind, n, d, rng):
    """Return samples of one kind, and queries of which some are new and some are far away."""
    if kind == "normal":
        X = rng.normal(size=(n, d))
    elif kind == "uniform":
        X = rng.uniform(-1, 1, size=(n, d))
    elif kind == "tube":  # states along trajectories
        phase = rng.uniform(0, 6, size=(n, 1))
        X = np.sin(phase * (1 + np.arange(d)) / 2) + 0.1 * rng.normal(size=(n, d))
    elif kind == "clusters":
        X = rng.normal(size=(n, d)) + 6.0 * rng.integers(0, 3, size=(n, 1))
    elif kind == "repeated":  # every sample three times
        X = np.repeat(rng.normal(size=(n // 3, d)), 3, axis=0)
    elif kind == "scales":  # features from thousandths to thousands
        X = rng.normal(size=(n, d)) * np.logspace(-3, 3, d)
    else:  # "offset": large coordinates, small spread
        X = 1e3 + 0.1 * rng.normal(size=(n, d))
    spread = X.std(axis=0)
    return X, np.vstack([X[: n // 2] + 0.3 * spread * rng.normal(size=(n // 2, d)), X[:20] + 5 * spread])


# kind, samples, features, nu, gamma
DATA_SETS = [
    ("normal", 60, 1, 0.5, "scale"),
    ("normal", 500, 9, 0.05, 5.0),
    ("normal", 300, 40, 0.1, "auto"),
    ("uniform", 80, 3, 0.9, 2.0),
    ("tube", 600, 9, 0.05, "scale"),
    ("clusters", 400, 3, 0.95, 1.0),
    ("repeated", 600, 5, 0.1, 0.5),
    ("scales", 1000, 5, 0.05, "scale"),
    ("offset", 800, 2, 0.5, 30.0),
]


class AgainstSklearn(unittest.TestCase):
    def test_decision_values(self):
        for seed, (kind, n, d, nu, gamma) in enumerate(DATA_SETS):
            with self.subTest(kind=kind, n=n, d=d, nu=nu, gamma=gamma):
                X, queries = cloud(kind, n, d, np.random.default_rng(seed))
                ours = dfr.OneClassSVM(nu=nu, gamma=gamma, tol=1e-9).fit(X)
                theirs = sklearn.svm.OneClassSVM(nu=nu, gamma=gamma, tol=1e-9).fit(X)
                # Decision values are differences of two sums, so the tolerance is relative to the larger sum.
                scale = np.maximum(theirs.score_samples(queries), theirs.offset_)
                error = np.abs(ours.decision_function(queries) - theirs.decision_function(queries)) / scale
                self.assertLess(error.max(), 1e-6)
                np.testing.assert_allclose(
                    ours.score_samples(queries), theirs.score_samples(queries), rtol=1e-6, atol=1e-6 * theirs.offset_[0]
                )
                np.testing.assert_allclose(ours.offset_, theirs.offset_, rtol=1e-6)
                sure = np.abs(theirs.decision_function(queries)) > 1e-6 * scale
                np.testing.assert_array_equal(ours.predict(queries)[sure], theirs.predict(queries)[sure])

    def test_attributes_have_sklearns_shapes_types_and_values(self):
        X, _ = cloud("tube", 300, 3, np.random.default_rng(5))
        ours = dfr.OneClassSVM(nu=0.1, gamma=20.0, tol=1e-9).fit(X)
        theirs = sklearn.svm.OneClassSVM(nu=0.1, gamma=20.0, tol=1e-9).fit(X)
        for name in ("support_", "support_vectors_", "dual_coef_", "intercept_", "offset_", "n_support_"):
            a, b = getattr(ours, name), getattr(theirs, name)
            self.assertEqual(np.asarray(a).dtype, np.asarray(b).dtype, name)
            self.assertEqual(np.shape(a), np.shape(b), name)
            # For this well-conditioned problem alpha is accurate to the square root of the tolerance.
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-7, err_msg=name)
        self.assertEqual(ours.shape_fit_, theirs.shape_fit_)
        self.assertEqual(ours.fit_status_, theirs.fit_status_)
        self.assertEqual(ours.n_features_in_, 3)
        self.assertIsInstance(ours.n_iter_, int)
        np.testing.assert_array_equal(X[ours.support_], ours.support_vectors_)
        np.testing.assert_allclose(
            ours.score_samples(X) - ours.offset_, ours.decision_function(X), atol=1e-12 * ours.offset_[0]
        )

    def test_sample_weights_agree(self):
        X, queries = cloud("tube", 400, 3, np.random.default_rng(6))
        weights = np.random.default_rng(7).uniform(0.0, 3.0, size=400)
        weights[::7] = 0.0
        for gamma in (0.5, 20.0):
            ours = dfr.OneClassSVM(nu=0.2, gamma=gamma, tol=1e-9).fit(X, sample_weight=weights)
            theirs = sklearn.svm.OneClassSVM(nu=0.2, gamma=gamma, tol=1e-9).fit(X, sample_weight=weights)
            np.testing.assert_allclose(
                ours.decision_function(queries), theirs.decision_function(queries), atol=1e-6 * theirs.offset_[0]
            )

    def test_it_works_in_pipelines_and_searches(self):
        X, queries = cloud("offset", 200, 3, np.random.default_rng(8))
        piped = make_pipeline(StandardScaler(), dfr.OneClassSVM(nu=0.1)).fit(X)
        peer = make_pipeline(StandardScaler(), sklearn.svm.OneClassSVM(nu=0.1, tol=1e-9)).fit(X)
        np.testing.assert_allclose(piped.decision_function(queries), peer.decision_function(queries), atol=1e-6)
        search = GridSearchCV(
            dfr.OneClassSVM(), {"nu": [0.05, 0.2], "gamma": ["scale", 1.0]}, scoring=lambda e, X, y=None: e.predict(X).mean()
        ).fit(X)
        self.assertEqual(search.best_params_["nu"], 0.05)


class AsEstimator(unittest.TestCase):
    def test_sklearns_41_estimator_checks_pass(self):
        checks = list(estimator_checks.check_estimator(dfr.OneClassSVM(), generate_only=True))
        self.assertEqual(len(checks), 41)
        for estimator, check in checks:
            with self.subTest(check=check), warnings.catch_warnings():
                warnings.simplefilter("ignore", FutureWarning)
                try:
                    check(estimator)
                except unittest.SkipTest as skip:
                    # Only checks that need pandas may be skipped without pandas.
                    self.assertIn("pandas", str(skip))

    def test_a_pickled_estimator_decides_the_same_bits(self):
        X, queries = cloud("normal", 200, 4, np.random.default_rng(2))
        svm = dfr.OneClassSVM(nu=0.1).fit(X)
        other = pickle.loads(pickle.dumps(svm))
        np.testing.assert_array_equal(other.decision_function(queries), svm.decision_function(queries))
        np.testing.assert_array_equal(other.support_, svm.support_)
        self.assertEqual(other.fit_summary_.iterations, svm.n_iter_)

    def test_attributes_need_a_fit(self):
        for name in ("support_vectors_", "dual_coef_", "intercept_", "n_support_", "offset_"):
            self.assertFalse(hasattr(dfr.OneClassSVM(), name), name)

    def test_names_of_features_are_kept_and_compared(self):
        class Frame:  # the relevant part of a pandas data frame
            def __init__(self, values, columns):
                self.values, self.columns, self.shape = values, columns, values.shape

            def __array__(self, dtype=None, copy=None):
                return np.asarray(self.values, dtype=dtype)

        X = np.random.default_rng(1).normal(size=(40, 2))
        svm = dfr.OneClassSVM().fit(Frame(X, ["x", "y"]))
        np.testing.assert_array_equal(svm.feature_names_in_, ["x", "y"])
        svm.predict(Frame(X, ["x", "y"]))
        with self.assertRaisesRegex(ValueError, r"feature names should match.*\['x', 'y'\].*\['y', 'x'\]"):
            svm.predict(Frame(X, ["y", "x"]))
        with self.assertWarnsRegex(UserWarning, "does not have valid feature names"):
            svm.predict(X)
        svm.fit(X)
        self.assertFalse(hasattr(svm, "feature_names_in_"))
        with self.assertWarnsRegex(UserWarning, "fitted without feature names"):
            svm.predict(Frame(X, ["x", "y"]))


class WrongCalls(unittest.TestCase):
    def test_parameters_are_named_with_the_remedy(self):
        X = np.random.default_rng(0).normal(size=(20, 2))
        for parameters, message in [
            ({"kernel": "linear"}, "only the kernel 'rbf', not 'linear'. sklearn.svm.OneClassSVM"),
            ({"kernel": np.dot}, "only the kernel 'rbf'"),
            ({"gamma": "narrow"}, "gamma must be 'scale', 'auto' or a positive number, not 'narrow'"),
            ({"gamma": 0.0}, "gamma must"),
            ({"gamma": float("nan")}, "gamma must"),
            ({"nu": 0.0}, r"nu must lie in \(0, 1\], not 0.0"),
            ({"nu": 1.5}, "nu must lie"),
            ({"tol": -1e-3}, "tol must be a positive number"),
            ({"cache_size": 0}, "cache_size must be a positive number"),
            ({"max_iter": 2.5}, "max_iter must be -1"),
        ]:
            with self.subTest(**parameters), self.assertRaisesRegex(ValueError, message):
                dfr.OneClassSVM(**parameters).fit(X)

    def test_invalid_data_are_located(self):
        X = np.random.default_rng(0).normal(size=(20, 2))
        row = np.arange(20)
        for data, weight, message in [
            (np.where((row == 7)[:, None] & [False, True], np.nan, X), None, "contains NaN: row 7, column 1"),
            (np.where((row == 7)[:, None] & [False, True], np.inf, X), None, "contains infinity: row 7, column 1"),
            (1e200 * X, None, "gamma='scale' needs the variance of X, which overflows: scale X"),
            (X[:1], None, "n_samples=1 .* minimum of 2"),
            (X, np.where(row == 3, -1.0, 1.0), "the weight of sample 3 is -1"),
            (X, np.zeros(20), "the weights must have a positive and finite sum"),
            (np.ma.masked_less(X, 0.0), None, "X has masked entries: fill or drop them"),
            (X, np.ma.masked_equal(row, 3), "sample_weight has masked entries: fill or drop them"),
            (X, [1, 2, 3], r"sample_weight.shape == \(3,\), expected \(20,\)"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                dfr.OneClassSVM().fit(data, sample_weight=weight)

    def test_a_failed_fit_leaves_the_last_one(self):
        X = np.random.default_rng(0).normal(size=(20, 2))
        svm = dfr.OneClassSVM().fit(X)
        values, parameters = svm.decision_function(X), dict(vars(svm))
        for more in ({"X": X[:, :1], "sample_weight": np.full(20, -1.0)}, {"X": 1e200 * X[:, :1]}):
            with self.assertRaises(ValueError):
                svm.fit(**more)
            self.assertEqual(vars(svm), parameters)
            np.testing.assert_array_equal(svm.decision_function(X), values)

    def test_a_fit_that_does_not_reach_its_tolerance_warns(self):
        X = np.random.default_rng(0).normal(size=(400, 3))
        with self.assertWarnsRegex(ConvergenceWarning, r"\(max_iterations\) after 3 steps.*above tol=0.001"):
            svm = dfr.OneClassSVM(max_iter=3, gamma=5.0).fit(X)
        self.assertEqual(svm.fit_status_, 1)
        self.assertTrue(np.isfinite(svm.decision_function(X)).all())


class TinyNu(unittest.TestCase):
    def test_samples_are_inside_for_any_nu_below_one_sample(self):
        X = np.random.default_rng(0).normal(size=(200, 3))
        one = dfr.OneClassSVM(nu=1 / 200, gamma=0.5).fit(X)
        for nu in (1e-6, 1e-12, 1e-200, 1e-320):
            svm = dfr.OneClassSVM(nu=nu, gamma=0.5).fit(X)
            np.testing.assert_array_equal(svm.support_, one.support_)
            self.assertEqual(svm.estimate_.rho, one.estimate_.rho)
            self.assertEqual((svm.estimate_.decision(X) < -1e-9).sum(), 0)

    def test_scaled_weights_take_the_same_iterations(self):
        random = np.random.default_rng(0)
        X, weights = random.normal(size=(200, 3)), random.uniform(0.5, 1.5, 200)
        counts = [dfr.OneClassSVM(nu=0.1, gamma=0.5).fit(X, sample_weight=weights * scale).n_iter_
                  for scale in (1.0, 2.0**-10, 2.0**-20)]
        self.assertEqual(counts, [counts[0]] * 3)


class Memory(unittest.TestCase):
    def test_contiguous_float64_is_read_in_place(self):
        """Decisions about 40 MB of states allocate no second 40 MB."""
        script = """
            import resource, sys
            sys.modules["sklearn"] = None  # blocks the slowest import
            import numpy as np
            import dfr
            svm = dfr.OneClassSVM().fit(np.random.default_rng(0).normal(size=(50, 50)))
            X = np.ones((100_000, 50))
            X.setflags(write=False)
            svm.decision_function(X[:10])
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            g = svm.decision_function(X)
            svm.predict(X)
            print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, "KiB more")
        """
        out = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
        # Allows for the decisions, 0.8 MB, and the result of predict.
        self.assertLess(int(out.stdout.split()[0]), 8_000)

    def test_other_layouts_and_types_give_the_same(self):
        X, queries = cloud("normal", 100, 3, np.random.default_rng(3))
        X, queries = np.round(X * 64) / 64, np.round(queries * 64) / 64  # exact in float32
        expected = dfr.OneClassSVM().fit(X).decision_function(queries)
        wide = np.zeros((len(queries), 6))
        wide[:, ::2] = queries
        for x, q in [
            (np.asfortranarray(X), np.asfortranarray(queries)),
            (X.astype(np.float32), queries.astype(np.float32)),
            (X.tolist(), queries.tolist()),
            (X, wide[:, ::2]),
        ]:
            np.testing.assert_array_equal(dfr.OneClassSVM().fit(x).decision_function(q), expected)

    def test_results_outlive_the_estimator_and_cannot_be_written_to(self):
        svm = dfr.OneClassSVM().fit(np.random.default_rng(0).normal(size=(500, 4)))
        vectors = svm.support_vectors_
        before = vectors.copy()
        self.assertFalse(vectors.flags.writeable)
        del svm
        np.testing.assert_array_equal(vectors, before)


class Threads(unittest.TestCase):
    def test_jobs_are_counted_as_in_sklearn(self):
        X = np.random.default_rng(5).normal(size=(300, 4))
        one = dfr.OneClassSVM(nu=0.1, n_jobs=1).fit(X)
        for jobs in (None, -1, 2):
            np.testing.assert_array_equal(dfr.OneClassSVM(nu=0.1, n_jobs=jobs).fit(X).dual_coef_, one.dual_coef_)
        for jobs in (0, -2, 1.5, 2**31, 2**40):
            with self.assertRaisesRegex(ValueError, "n_jobs must be -1"):
                dfr.OneClassSVM(n_jobs=jobs).fit(X)

    def test_other_threads_run_during_calls_and_ctrl_c_stops_a_fit(self):
        script = """
            import os, select, signal, sys, threading
            sys.modules["sklearn"] = None  # blocks the slowest import
            import numpy as np
            import dfr
            sys.setswitchinterval(1000)  # no thread has to give up the interpreter's lock
            X = np.random.default_rng(0).normal(size=(30_000, 9))
            during, seen = [], []
            def see():
                while not during:
                    select.select([], [], [], 0.001)
                seen.extend(during)
            threading.Thread(target=see, daemon=True).start()
            estimate, _ = dfr.SupportEstimate.fit(X[:3000], nu=0.2, gamma=5.0)
            while not seen:
                during.append("seen")
                estimate.decision(X)
                during.clear()
            print(*seen)
            main = threading.get_ident()
            def interrupt():
                while sys._current_frames()[main].f_code.co_name != "fit":
                    select.select([], [], [], 0.001)
                os.kill(os.getpid(), signal.SIGINT)
            try:
                threading.Thread(target=interrupt).start()
                dfr.OneClassSVM(gamma=5.0, nu=0.3, tol=1e-12).fit(X)
                print("was not stopped")
            except KeyboardInterrupt:
                print("stopped")
        """
        out = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
        self.assertEqual(out.stdout, "seen\nstopped\n")


class WithoutSklearn(unittest.TestCase):
    def test_the_same_results_and_the_same_interface(self):
        script = """
            import sys
            sys.modules["sklearn"] = None  # as if it were not installed
            import numpy as np
            import dfr
            X = np.arange(40.0).reshape(20, 2) % 7
            svm = dfr.OneClassSVM(nu=0.3)
            assert svm.get_params()["nu"] == 0.3 and len(svm.get_params()) == 11
            assert svm.set_params(nu=0.2) is svm and svm.nu == 0.2
            assert repr(svm) == "OneClassSVM(nu=0.2)", repr(svm)
            try:
                svm.set_params(mu=1)
            except ValueError as error:
                assert "Invalid parameter 'mu'" in str(error)
            else:
                raise AssertionError("mu is accepted")
            try:
                svm.predict(X)
            except (ValueError, AttributeError) as error:
                assert "not fitted" in str(error)
            else:
                raise AssertionError("predicts without a fit")
            assert (svm.fit_predict(X) == svm.predict(X)).all()
            assert not [name for name in sys.modules if name.startswith("sklearn.")]
            print(svm.decision_function(X).tolist())
        """
        out = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True)
        self.assertEqual(out.returncode, 0, out.stderr)
        X = np.arange(40.0).reshape(20, 2) % 7
        self.assertEqual(eval(out.stdout), dfr.OneClassSVM(nu=0.2).fit(X).decision_function(X).tolist())


class Documentation(unittest.TestCase):
    def test_everything_public_has_a_docstring_and_a_stub(self):
        import doctest
        import pathlib

        stub = pathlib.Path(dfr._core.__file__).with_name("_core.pyi").read_text()
        for name in dfr.__all__:
            thing = getattr(dfr, name)
            if not isinstance(thing, type):
                continue
            self.assertTrue(thing.__doc__, name)
            self.assertEqual(thing.__module__.split(".")[0], "dfr")
            for member, value in vars(thing).items():
                if member.startswith("_"):
                    continue
                if thing.__doc__.find(member) < 0:
                    self.assertTrue(getattr(value, "__doc__", None), f"{name}.{member}")
                if hasattr(dfr._core, name):  # other classes have annotations in their source
                    self.assertRegex(stub, rf"def {member}\(", f"{name}.{member}")
        results = doctest.testmod(sys.modules["dfr._one_class_svm"])
        self.assertEqual(results.failed, 0)
        self.assertGreater(results.attempted, 0)


if __name__ == "__main__":
    unittest.main()
