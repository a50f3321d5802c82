"""Waits for conditions."""
import select


def eventually(condition):
    """Waits until condition() is true. Has no limit of its own: the test's TIMEOUT ends what never comes."""
    while not condition():
        select.select([], [], [], 0.001)
