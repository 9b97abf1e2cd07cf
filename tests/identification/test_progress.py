"""A long call says what it is at, off a terminal too; a short one, and one inside another, say nothing."""

import re
import sys

import numpy as np
import pytest
from recordings import recording

from robust_filterpy import OutputError, RobustKalmanFilter, _progress, estimate_noise, identify
from robust_filterpy._progress import stage, stages
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.identification import ARMAX, ARX, ParameterTracker, StateSpace, TrackerBank, select_structure
from robust_filterpy.identification.estimation import prediction_error as _threads
from robust_filterpy.identification.estimation import search


@pytest.fixture
def clock(monkeypatch):
    """Let time go on by a second with every look at it."""
    times = iter(range(1_000_000))
    monkeypatch.setattr(_progress.time, "monotonic", lambda: float(next(times)))


Y, U = recording(1, 450, share=0.0)
SHORT = Y[:150], U[:150]
WATCHED = {"time": np.arange(20.0), "sensor": ["a"] * 20, "value": np.zeros(20)}


def level():
    """A filter of a level."""
    kf = RobustKalmanFilter(1, 1)
    kf.H[:] = 1.0
    return kf


def watching():
    return Fusion(constant_velocity(1, 0.1), {"a": Sensor([1.0, 0.0], R=1.0)}, 1.0, watch=True)


@pytest.mark.parametrize(("who", "call", "word"), [
    ("identify", lambda: identify(*SHORT, OutputError(2, 2)), " s, search from"),
    ("identify", lambda: identify(*SHORT, ARMAX(2, 2, 2)), " s, "),
    ("identify", lambda: identify(*SHORT, StateSpace(2)), " s, "),
    # Only the outer call speaks.
    ("select_structure", lambda: select_structure(*SHORT, na=[1, 2], nk=[1]), " of "),
    ("estimate_noise", lambda: estimate_noise(level(), SHORT[0]), "stage 2 of 3"),
    ("(estimate_noise|intervals)", lambda: estimate_noise(level(), SHORT[0]).intervals(), "intervals: "),
    ("Fusion.run", lambda: watching().run(WATCHED), " of 20"),
    ("ParameterTracker", lambda: ParameterTracker(OutputError(2, 2), start=100).run(Y, U), "a model of"),
    ("TrackerBank", lambda: TrackerBank(1, ARX(2, 2)).run(Y[:, None], U), " of 450"),
])  # fmt: skip
def test_a_long_call_says_what_it_is_at(who, call, word, clock, capsys):
    call()
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(re.match(f"{who}: ", line) for line in lines) and any(word in line for line in lines)


def test_a_call_that_is_asked_for_silence_and_one_of_a_sample_say_nothing(clock, capsys):
    tracker, bank = ParameterTracker(OutputError(2, 2), start=100), TrackerBank(1, ARX(2, 2))
    identify(*SHORT, OutputError(2, 2), progress=False)
    select_structure(*SHORT, na=[1, 2], nk=[1], progress=False)
    for k in range(120):
        tracker.update(Y[k], U[k]), bank.update(Y[k : k + 1], U[k])
    tracker.run(Y, U, progress=False), bank.run(Y[:, None], U, progress=False)
    assert capsys.readouterr().err == ""


def test_a_short_call_says_nothing_and_progress_asked_for_is_shown_from_the_beginning(capsys):
    identify(*SHORT, OutputError(2, 2))
    assert capsys.readouterr().err == ""
    identify(*SHORT, OutputError(2, 2), progress=True)
    assert "identify: 0 s, search from" in capsys.readouterr().err


def test_an_error_ends_the_stages(clock, capsys):
    with pytest.raises(ZeroDivisionError), stages("one", None):
        raise ZeroDivisionError
    stage("of no call")
    assert capsys.readouterr().err == ""


def test_a_count_is_shown_less_and_less_often(clock, capsys):
    with stages("study", None):
        for k in range(1000):
            stage(f"{k + 1} of 1000")
    lines = capsys.readouterr().err.splitlines()
    assert 10 < len(lines) < 30
    assert lines[0] == "study: 2 s, 2 of 1000"
    assert lines[-1].startswith("study: ") and lines[-1].endswith(" of 1000")


def test_without_a_standard_error_nothing_is_said(clock, monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    identify(*SHORT, OutputError(2, 2))


# The search for a model leaves the threads of BLAS as it found them, and needs none.


def test_a_search_has_one_thread_and_gives_the_others_back(monkeypatch):
    threadpoolctl = pytest.importorskip("threadpoolctl")
    seen, ends = [], search.ends

    def counted():
        return [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]

    def noted(*args):
        seen.append(counted())
        return ends(*args)

    monkeypatch.setattr(sys.modules["robust_filterpy.identification.estimation.estimate"], "ends", noted)
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = counted()
        identify(*SHORT, OutputError(0, 1))
        assert counted() == before
    assert seen and set(seen[0]) == {1}


def test_without_threadpoolctl_it_goes_its_way(monkeypatch):
    monkeypatch.setattr(_threads, "_controller", lambda: None)
    with _threads.one_thread():
        pass
