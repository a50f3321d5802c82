"""A guard through its C interface, for any language with a foreign function interface.

usage: guard_by_ctypes.py LIBRARY GUARD     (libdfr_guard.so.0, and the file that fit_a_guard writes)
"""

import ctypes
import sys


class Verdict(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int32) for name in ("size", "mode", "changed", "alarm", "step", "alarm_step")] + [
        ("g", ctypes.c_double), ("threshold", ctypes.c_double), ("reason", ctypes.c_char_p)]


if len(sys.argv) != 3:
    print("usage: guard_by_ctypes.py libdfr_guard.so.0 GUARD   (fit_a_guard makes one)", file=sys.stderr)
    sys.exit(2)
library = ctypes.CDLL(sys.argv[1])
library.dfr_guard_load.restype = ctypes.c_void_p
library.dfr_guard_last_error.restype = ctypes.c_char_p
doubles = ctypes.POINTER(ctypes.c_double)
library.dfr_guard_reset.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
library.dfr_guard_free.argtypes = [ctypes.c_void_p]
library.dfr_guard_filter.argtypes = [ctypes.c_void_p, ctypes.c_int32, doubles, ctypes.c_size_t, doubles,
                                     ctypes.c_size_t, doubles, ctypes.POINTER(Verdict)]

guard = library.dfr_guard_load(sys.argv[2].encode())
if not guard:
    sys.exit(library.dfr_guard_last_error().decode())
library.dfr_guard_reset(guard, 1)
tip, safe = (ctypes.c_double * 2)(), (ctypes.c_double * 2)()
verdict = Verdict(size=ctypes.sizeof(Verdict))
for t in range(40):
    action = (ctypes.c_double * 2)(0.09, 0.06)  # your policy
    library.dfr_guard_filter(guard, t, tip, 2, action, 2, safe, verdict)
    print(f"{t:2}  g {verdict.g:6.3f}  {verdict.reason.decode()}")
    tip[0] += safe[0]  # your robot
    tip[1] += safe[1]
    if verdict.mode == 3 or tip[0] >= 1.8:  # DFR_GUARD_HALT
        break
library.dfr_guard_free(guard)
assert tip[0] >= 1.8, list(tip)
