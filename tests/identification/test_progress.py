"""A long call says what it is at, off a terminal too; a short one, and one inside another, say nothing."""

import sys

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy import OutputError, RobustKalmanFilter, _progress, estimate_noise, identify
from robust_filterpy._progress import progress_bar, stage, stages
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.identification import ARMAX, ARX, ParameterTracker, StateSpace, TrackerBank, select_structure
from robust_filterpy.identification.estimation import prediction_error as _threads
from robust_filterpy.identification.estimation import search


@pytest.fixture
def clock(monkeypatch):
    """Let time go on by a second with every look at it."""
    times = iter(range(1_000_000))
    monkeypatch.setattr(_progress.time, "monotonic", lambda: float(next(times)))


def recorded(length=150):
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], length)
    return lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + 0.3 * rng.normal(size=length), u


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARMAX(2, 2, 2), StateSpace(2)], ids=str)
def test_identify_says_what_it_is_at_once_it_takes_more_than_two_seconds(structure, clock, capsys):
    y, u = recorded()
    identify(y, u, structure)
    lines = capsys.readouterr().err.splitlines()
    assert lines
    assert all(line.startswith("identify: ") and " s, " in line for line in lines)


def test_a_fit_of_the_noise_says_what_it_is_at(clock, capsys):
    kf = RobustKalmanFilter(1, 1)
    kf.H[:] = 1.0
    found = estimate_noise(kf, recorded()[0])
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("estimate_noise: ") and "stage" in line for line in lines)
    found.intervals()
    assert "intervals: " in capsys.readouterr().err


def test_a_fit_of_several_factors_counts_its_stages(monkeypatch):
    said = []
    monkeypatch.setattr(_progress._Lines, "stage", lambda self, text: said.append(text))
    kf = RobustKalmanFilter(2, 2)
    kf.F, kf.H = np.eye(2), np.eye(2)
    estimate_noise(kf, np.random.default_rng(1).normal(size=(60, 2)), R="each")
    counted = [text.partition(",")[0] for text in said]
    assert list(dict.fromkeys(counted)) == [*(f"stage {k} of 6" for k in range(1, 6)), "last stage"]


def test_a_fusion_that_watches_tells_the_stamp_it_is_at(clock, capsys):
    table = {"time": np.arange(20.0), "sensor": ["a"] * 20, "value": np.zeros(20)}
    Fusion(constant_velocity(1, 0.1), {"a": Sensor([1.0, 0.0], R=1.0)}, 1.0, watch=True).run(table)
    assert "Fusion.run: " in (said := capsys.readouterr().err) and " of 20" in said


def test_a_short_call_says_nothing(capsys):
    identify(*recorded(), OutputError(2, 2))
    assert capsys.readouterr().err == ""


def test_a_long_call_can_be_told_to_be_silent(clock, capsys):
    identify(*recorded(), OutputError(2, 2), progress=False)
    select_structure(*recorded(), na=[1, 2], nk=[1], progress=False)
    assert capsys.readouterr().err == ""


def test_progress_asked_for_is_shown_from_the_beginning(capsys):
    identify(*recorded(), OutputError(2, 2), progress=True)
    assert "identify: 0 s, search from" in capsys.readouterr().err


def test_only_the_outer_call_speaks_and_says_how_many_structures_there_are_to_be(clock, capsys):
    select_structure(*recorded(), na=[1, 2], nk=[1])
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("select_structure: ") for line in lines)
    counts = [line.split(", ")[1].split() for line in lines]
    assert all(of == "of" and int(done) <= int(total) for done, of, total, _ in counts)


def test_an_error_ends_the_stages(clock, capsys):
    with pytest.raises(ZeroDivisionError), stages("one", None):
        raise ZeroDivisionError
    stage("of no call")
    assert capsys.readouterr().err == ""


def test_a_count_is_told_less_and_less_often(clock, capsys):
    bar = progress_bar(1000, None, "run", "study")
    for _ in range(1000):
        bar.update()
    bar.close()
    lines = capsys.readouterr().err.splitlines()
    assert 10 < len(lines) < 30
    assert lines[0] == "study: 2 s, 2 of 1000 run"
    assert lines[-1].startswith("study: ") and lines[-1].endswith(" of 1000 run")


def test_without_a_standard_error_nothing_is_said(clock, monkeypatch):
    monkeypatch.setattr("sys.stderr", None)
    identify(*recorded(), OutputError(2, 2))
    progress_bar(3, None, "run", "study").update()


@pytest.mark.parametrize(
    "make", [lambda: ParameterTracker(OutputError(2, 2), start=100), lambda: TrackerBank(1, ARX(2, 2))]
)
def test_a_tracker_says_what_a_recording_is_at_and_of_samples_nothing(make, clock, capsys):
    y, u = recorded(450)
    wide = isinstance(make(), TrackerBank)
    made, silent, online = make(), make(), make()
    made.run(y[:, None] if wide else y, u)
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith(f"{type(made).__name__}: ") for line in lines)
    assert any("a model of" in line for line in lines) or any(" of 450" in line for line in lines)
    silent.run(y[:, None] if wide else y, u, progress=False)
    for k in range(120):
        online.update(y[k : k + 1] if wide else y[k], u[k])
    assert capsys.readouterr().err == ""


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
    rng = np.random.default_rng(0)
    u = rng.normal(size=200)
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = counted()
        identify(np.convolve(u, [0.0, 1.0])[:200] + 0.1 * rng.normal(size=200), u, OutputError(0, 1))
        assert counted() == before
    assert seen and set(seen[0]) == {1}


def test_without_threadpoolctl_it_goes_its_way(monkeypatch):
    monkeypatch.setattr(_threads, "_controller", lambda: None)
    with _threads.one_thread():
        pass
