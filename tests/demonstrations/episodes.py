"""The episodes of episodes.h, for scripts that read and write them with h5py alone."""

import numpy as np

LENGTHS = [3, 1, 12]
BLOCKS = [("tip", 0, 3), ("object", 3, 2), ("angle", 5, 1)]


def states(episode):
    t, k = np.mgrid[0 : LENGTHS[episode] + 1, 0:6]
    return episode + 0.25 * t + k / 3.0


def controls(episode):
    t, k = np.mgrid[0 : LENGTHS[episode], 0:2]
    return (episode - t) / 16.0 + k / 2.0
