"""dfr.TimeVaryingSupport against its definition: one estimate per time step."""

import pickle
import pathlib
import tempfile
import unittest

import numpy as np

import dfr

LENGTHS = [30, 22, 30, 27, 30, 30, 25, 30]


def demonstrations(seed=0):
    rng = np.random.default_rng(seed)
    return [
        np.stack([np.sin(0.1 * np.arange(n)), 0.05 * np.arange(n), np.ones(n)], axis=1)
        + 0.05 * rng.normal(size=(n, 3))
        for n in LENGTHS
    ]


def states_at(demos, t):
    """Return the states of all demonstrations at step t. Demonstrations that have ended hold their last state."""
    return np.array([d[min(t, len(d) - 1)] for d in demos])


class TimeVaryingSupportTest(unittest.TestCase):
    def test_every_step_has_its_own_estimate(self):
        demos = demonstrations()
        support = dfr.TimeVaryingSupport.fit(demos, nu=0.3, gamma=2.0, tolerance=1e-9)
        self.assertEqual(support.num_steps, 30)
        self.assertEqual(support.state_dim, 3)
        queries = np.random.default_rng(1).normal(size=(40, 3))
        for t in (0, 11, 24, 29):
            alone, _ = dfr.SupportEstimate.fit(states_at(demos, t), nu=0.3, gamma=2.0, tolerance=1e-9)
            np.testing.assert_array_equal(support.decision(t, queries), alone.decision(queries))
            peer = dfr.OneClassSVM(nu=0.3, gamma=2.0, tol=1e-9).fit(states_at(demos, t))
            np.testing.assert_allclose(
                support.decision(t, queries) * support.at(t).libsvm_scale, peer.decision_function(queries), atol=1e-8
            )
        np.testing.assert_array_equal(support.decision(99, queries), support.decision(29, queries))
        with self.assertRaisesRegex(ValueError, "t must not be negative"):
            support.gradient(-1, queries[0])

    def test_one_state_a_batch_and_a_step_per_row_give_the_same_bits(self):
        support = dfr.TimeVaryingSupport.fit(demonstrations(), nu=0.3, gamma=2.0)
        x = np.random.default_rng(2).normal(size=(50, 3))
        steps = np.arange(50) % 31
        each = np.array([support.decision(int(t), row) for t, row in zip(steps, x)])
        np.testing.assert_array_equal(support.decision(steps, x), each)
        np.testing.assert_array_equal(support.decision(steps.tolist(), x.tolist()), each)
        np.testing.assert_array_equal(support.decision(5, x), [support.decision(5, row) for row in x])
        self.assertIsInstance(support.decision(5, x[0]), float)
        self.assertEqual(support.decision(5, [np.nan, 0.0, 0.0]), -np.inf)

    def test_the_gradient_is_the_derivative(self):
        support = dfr.TimeVaryingSupport.fit(demonstrations(), nu=0.3, gamma=2.0)
        x = np.array([0.2, 0.3, 1.1])
        g, gradient = support.gradient(4, x)
        self.assertEqual(g, support.decision(4, x))
        for k in range(3):
            step = np.zeros(3)
            step[k] = 1e-5
            difference = (support.decision(4, x + step) - support.decision(4, x - step)) / 2e-5
            # Second-order error: 1e-10 times a third derivative of about gamma^1.5.
            self.assertAlmostEqual(gradient[k], difference, delta=1e-8)
        self.assertLess(np.linalg.norm(gradient), support.lipschitz_bound(4))

    def test_threads_weights_and_pooling(self):
        demos = demonstrations()
        queries = np.random.default_rng(3).normal(size=(20, 3))
        one = dfr.TimeVaryingSupport.fit(demos, nu=0.3, gamma=2.0)
        two = dfr.TimeVaryingSupport.fit(demos, nu=0.3, gamma=2.0, threads=2)
        np.testing.assert_array_equal(one.decision(7, queries), two.decision(7, queries))
        twice = dfr.TimeVaryingSupport.fit(demos + demos[:1], nu=0.3, gamma=2.0, tolerance=1e-9)
        weighted = dfr.TimeVaryingSupport.fit(
            demos, nu=0.3, gamma=2.0, tolerance=1e-9, weights=[2] + [1] * (len(demos) - 1)
        )
        np.testing.assert_allclose(twice.decision(7, queries), weighted.decision(7, queries), atol=1e-8)
        own = np.arange(1.0, 1.0 + len(demos))
        for weights, of_states in ((None, None), (own, np.repeat(own, LENGTHS))):
            pooled = dfr.TimeVaryingSupport.fit(demos, nu=0.3, gamma=2.0, pooled=True, weights=weights)
            self.assertEqual(pooled.num_steps, 1)
            whole, _ = dfr.SupportEstimate.fit(np.vstack(demos), nu=0.3, gamma=2.0, weights=of_states)
            np.testing.assert_array_equal(pooled.decision(0, queries), whole.decision(queries))
        with self.assertRaisesRegex(ValueError, "there are 2 weights for 8 demonstrations"):
            dfr.TimeVaryingSupport.fit(demos, pooled=True, weights=own[:2])

    def test_files_and_pickles_keep_all_bits(self):
        support = dfr.TimeVaryingSupport.fit(demonstrations(), nu=0.3, gamma=2.0, num_steps=12)
        queries = np.random.default_rng(4).normal(size=(20, 3))
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "support.dfr"
            support.save(path)
            loaded = dfr.TimeVaryingSupport.load(str(path))
            path.write_bytes(path.read_bytes()[:-9])
            with self.assertRaisesRegex(RuntimeError, "support.dfr"):
                dfr.TimeVaryingSupport.load(path)
        rebuilt = dfr.TimeVaryingSupport([support.at(t) for t in range(12)])
        for other in (loaded, rebuilt, pickle.loads(pickle.dumps(support))):
            self.assertEqual(other.num_steps, 12)
            for t in (0, 11):
                np.testing.assert_array_equal(other.decision(t, queries), support.decision(t, queries))

    def test_wrong_calls_are_named(self):
        demos = demonstrations()
        fit = dfr.TimeVaryingSupport.fit
        bad = [d.copy() for d in demos]
        bad[2][5, 1] = np.nan
        for arguments, message in [
            (bad, "demonstration 2, state 5 has a non-finite entry"),
            ([demos[0], demos[1][:, :2]], "demonstration 1 has states of 2 entries"),
            ([demos[0], demos[1][:, 0]], "demonstration 1 must have 2 dimensions"),
            ([], "there are no demonstrations"),
        ]:
            with self.subTest(message), self.assertRaisesRegex(ValueError, message):
                fit(arguments)
        with self.assertRaisesRegex(ValueError, "nu must lie in"):
            fit(demos, nu=2.0)
        with self.assertRaisesRegex(ValueError, "num_steps must be 1000000 at most, not 1000001"):
            fit(demos, num_steps=1_000_001)
        support = fit(demos)
        with self.assertRaisesRegex(ValueError, "states of 2 entries; the support has 3"):
            support.decision(0, np.zeros((4, 2)))
        with self.assertRaisesRegex(ValueError, "one row for each"):
            support.decision([0, 1], np.zeros((4, 3)))
        with self.assertRaises(TypeError):
            fit(demos, 0.1)  # options are keyword-only


if __name__ == "__main__":
    unittest.main()
