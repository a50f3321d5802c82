"""Waits for conditions."""
import select


def eventually(condition):
    """Waits until condition() is true. The only limit is the test's TIMEOUT."""
    while not condition():
        select.select([], [], [], 0.001)
