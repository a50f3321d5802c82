"""Other Python threads run while dfr computes, in real time."""
import threading
import time
import unittest

import numpy as np

import dfr


class ThreadsTest(unittest.TestCase):
    def count_during(self, work):
        """Return the number of times that another Python thread ran during `work`, and its seconds."""
        count, stop = 0, threading.Event()

        def ticker():
            nonlocal count
            while not stop.is_set():
                count += 1
                time.sleep(1e-3)

        thread = threading.Thread(target=ticker)
        thread.start()
        start = time.perf_counter()
        work()
        seconds = time.perf_counter() - start
        stop.set()
        thread.join()
        return count, seconds

    def test_other_threads_run_during_fits_and_decisions(self):
        X = np.random.default_rng(0).normal(size=(4000, 9))
        svm = dfr.OneClassSVM(gamma=5.0, nu=0.2, tol=1e-6)
        queries = np.random.default_rng(1).normal(size=(100_000, 9))
        for work in (lambda: svm.fit(X), lambda: svm.decision_function(queries)):
            count, seconds = self.count_during(work)
            # A thread that never gets the lock would count only at both ends. On an idle machine one tick
            # takes a millisecond; the limit is a hundred times that.
            self.assertGreater(count, 5 + 10 * seconds)


if __name__ == "__main__":
    unittest.main()
