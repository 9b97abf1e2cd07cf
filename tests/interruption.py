"""Ctrl-C line by line: a call that is interrupted has happened, or it has not."""

import copy
import sys

import numpy as np

import robust_filterpy

PACKAGE = robust_filterpy.__path__[0]


def interrupted(call, at, calls=False):
    """Call, and raise KeyboardInterrupt before that line of the package is run; tell whether it fell into the call.

    With `calls` only where Python itself looks for signals: after so many calls and returns.
    """
    count = 0

    def trace(frame, event, arg):
        nonlocal count
        if not frame.f_code.co_filename.startswith(PACKAGE):
            return None
        if calls or event == "line":
            count += 1
            if count == at:
                raise KeyboardInterrupt
        return trace

    before, settle = (sys.getprofile(), sys.setprofile) if calls else (sys.gettrace(), sys.settrace)
    settle(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        settle(before)
    return False


def half_steps(ready, call, seen, most=100_000, every=1):
    """Interrupt a call at each of its lines, and return those after which it has happened in part.

    Parameters
    ----------
    ready : object
        What is called; a deep copy of it for each line.
    call : callable
        Takes it, and makes the call.
    seen : callable
        Takes it, and returns a dictionary of arrays: all that a step moves.
    most : int
        Lines at most.
    every : int
        Only each of so many lines.

    Returns
    -------
    half : list of (int, list of str)
        Number of the line, and what differs from before the call as well as from behind it.
    lines : int
        How many lines were interrupted.
    """
    done = copy.deepcopy(ready)
    call(done)
    before, behind = copy.deepcopy(seen(ready)), copy.deepcopy(seen(done))
    half, lines = [], 0
    for line in range(1, most, every):
        one = copy.deepcopy(ready)
        if not interrupted(lambda one=one: call(one), line):
            return half, lines
        lines += 1
        now = seen(one)
        apart = [[name for name in whole if not _same(whole[name], now.get(name))] for whole in (before, behind)]
        if all(apart):
            half.append((line, min(apart, key=len)))
            continue
        # What goes on from there goes on as if nothing had been.
        if apart[0] == []:
            call(one)
            again = seen(one)
            if not all(_same(behind[name], again.get(name)) for name in behind):
                half.append((line, ["what comes after"]))
    raise AssertionError(f"the call has more than {most} lines")


def _same(one, other):
    """Tell whether two arrays, or lists of them, are the same to the last bit."""
    return other is not None and np.array_equal(np.asarray(one, float), np.asarray(other, float), equal_nan=True)
