#!/usr/bin/env python3
"""Runs a command COUNT times on a busy machine: busy.py COUNT COMMAND ...

Four loops occupy the processors. Every 5 s the script stops the command and its descendants for 0.3 s. Exits with 1 after
the first run that fails. `./dev test --busy COUNT` calls it.
"""
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

LOOPS = 4
EVERY_S = 5.0
STOPPED_S = 0.3


def descendants(pid):
    """Return the process and all its descendants, parents first."""
    children = {}
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue  # the process has ended
        children.setdefault(parent, []).append(int(stat.parent.name))
    found = [pid]
    for each in found:
        found += children.get(each, [])
    return found


def send(number, processes):
    for pid in processes:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            pass


def stop_now_and_then(pid, ended):
    while not ended.wait(EVERY_S):
        stopped = descendants(pid)
        send(signal.SIGSTOP, stopped)
        time.sleep(STOPPED_S)
        send(signal.SIGCONT, reversed(stopped))


def main():
    count, *command = sys.argv[1:]
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(LOOPS)]
    try:
        for run in range(1, int(count) + 1):
            began = time.monotonic()
            process = subprocess.Popen(command)
            ended = threading.Event()
            stopper = threading.Thread(target=stop_now_and_then, args=(process.pid, ended))
            stopper.start()
            failed = process.wait() != 0
            ended.set()
            stopper.join()
            print(f"busy.py: run {run} of {count} {'failed' if failed else 'passed'} after "
                  f"{time.monotonic() - began:.0f} s", flush=True)
            if failed:
                sys.exit(1)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


if __name__ == "__main__":
    main()
