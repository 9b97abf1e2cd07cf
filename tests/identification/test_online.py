"""Samples that come one by one: the numbers of `run` to the last bit, and states that were stored before."""

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import recordings
import support
from filterpy.kalman import KalmanFilter
from recordings import same, silence

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.identification import ARX, FIR, OutputError, ParameterTracker, TrackerBank

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
STATES = Path(__file__).parent / "states"


def recording(n=460, seed=5, inside=0.0):
    """A recording with outliers and gaps, that of the stored states; a share of the noise drives the plant."""
    rng, u = recordings.binary(seed, n)
    w, v = np.zeros(n), np.where(rng.random(n) < 0.1, 1.0, 0.1) * rng.normal(size=n)
    for k in range(2, n):
        w[k] = 1.5 * w[k - 1] - 0.7 * w[k - 2] + u[k - 1] + 0.5 * u[k - 2] + inside * v[k]
    y = w + (1.0 - inside) * v
    y[rng.random(n) < 0.02] = np.nan
    return y, u


MADE = [
    lambda: ParameterTracker(OutputError(2, 2), start=200),
    lambda: ParameterTracker(ARX(2, 2), start=200),
    lambda: ParameterTracker(ARX(2, 2), theta=0.0, P=1.0, R=0.01, Q=1e-6),
    lambda: ParameterTracker(OutputError(2, 2), start=0, forgetting=0.99, offset=True),
    lambda: ParameterTracker(FIR(3), start=0, filter=KalmanFilter, R=0.01),
    lambda: ParameterTracker(FIR(3), start=0, filter=RobustKalmanFilter(3, 1), R=0.01, Q=0.0),
]


@pytest.mark.parametrize("make", MADE)
def test_update_gives_the_numbers_of_run_to_the_last_bit(make):
    # An ARX that starts by itself would be found wrong where the noise is the sensor's alone.
    y, u = recording(560, inside=float(repr(make().structure).startswith("ARX")))
    # Samples that the kernel leaves to the definition; a sensor that is stuck; a plant that changes, which is said.
    y[[120, 300]] = 1e9, -1e12
    y[350:358] = y[350] + 3.0
    y[400:] = -y[400:]
    one, other, samples = make(), make(), []
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for k in range(len(y)):
            samples.append((*other.update(y[k], u[k]), other.theta, other.std))
        online = len(said)
        result = one.run(y, u)
    assert [str(each.message) for each in said[:online]] == [str(each.message) for each in said[online:]]
    # A model that is made of the samples so far is in the next row: at a look, and after the change.
    k = np.arange(1, len(y) + 1)
    others = (k <= 400) & ~np.isin(k, [25, 50, 100, 200])
    columns = ("prediction", "residual", "weights", "guard", "theta", "std")
    for name, expected in zip(columns, zip(*samples, strict=True), strict=True):
        rows = others if name in ("theta", "std") else slice(None)
        np.testing.assert_array_equal(getattr(result, name)[rows], np.array(expected)[rows], err_msg=name)
    same(one.state(), other.state())


def test_what_is_set_between_two_samples_counts():
    y, u = recording(80)
    same_filter = Same(4, 1, scaling="innovation")
    one = support.paper_tracker(ARX(2, 2), R=0.01)
    other = support.paper_tracker(ARX(2, 2), filter=same_filter, P=100.0, Q=0.0, R=0.01)
    moves = {30: lambda state: {"P": 4.0 * state["P"]}, 40: lambda state: {"theta": state["theta"] + 0.5}}
    sets = {20: {"Q": 1e-4}, 50: {"forgetting": 0.97, "R": 0.04}, 60: {"enabled": False}, 65: {"enabled": True}}
    for k in range(80):
        for tracker in (one, other):
            if k in moves:
                tracker.restore({**tracker.state(), **moves[k](tracker.state())})
            for name, value in sets.get(k, {}).items():
                setattr(tracker, name, value)
            tracker.update(y[k], u[k])
        for ours, theirs in ((one.theta, other.theta), (one.P, other.P), (one.filter.x, other.filter.x)):
            np.testing.assert_allclose(np.ravel(ours), np.ravel(theirs), rtol=1e-8, atol=1e-10)


class Same(RobustKalmanFilter):
    """A filter that the kernel does not take."""


# Stored before this file was written, by the release that was then current.


def kinds():
    """What each stored state belongs to."""
    return {
        "tracker": ParameterTracker(OutputError(2, 2)),
        "tracker_paper": ParameterTracker(ARX(2, 2), start=0, Q=1e-6, R=0.01, forgetting=0.995),
        "tracker_kalman": ParameterTracker(ARX(2, 2), filter=KalmanFilter, start=0, R=0.01),
        "bank": TrackerBank(2, ARX(1, 1), start=100),
    }


@pytest.mark.parametrize("kind", list(kinds()))
def test_a_state_that_was_stored_before_goes_on(kind):
    y, u = recording()
    with np.load(STATES / f"{kind}.npz") as file:
        state = dict(file)
    expected = state.pop("theta_after")
    tracker = kinds()[kind]
    tracker.restore(state)
    if kind == "bank":
        y, u = np.stack((y, 2.0 * y), axis=1), np.stack((u, u), axis=1)
    for name, value in tracker.state().items():
        np.testing.assert_array_equal(value, state[name], err_msg=name)
    np.testing.assert_allclose(tracker.run(y[430:], u[430:]).theta[-1], expected, rtol=1e-9)


def test_matrices_in_any_order_of_memory_serve():
    y, u = recording(60)
    F = np.asfortranarray(0.99 * np.eye(4) + np.triu(np.full((4, 4), 0.01), 1))
    one, other = (ParameterTracker(ARX(2, 2), start=0, R=0.01) for _ in range(2))
    bank = TrackerBank(1, ARX(2, 2), start=0, R=0.01)
    one.F, other.F, bank.F = F, F.copy(order="C"), F
    for k in range(60):
        assert one.update(y[k], u[k])[0] == other.update(y[k], u[k])[0] == bank.update(y[k : k + 1], u[k])[0][0]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("size", support.by_night([1e9, 1e100, 1e300], 1e300))
@pytest.mark.parametrize("at", [100, 400])
def test_one_reading_of_any_size_is_as_one_that_is_missing(size, at):
    y, u = recordings.recording(30, 500, 0.0, 0.2, inside=True)
    far, missing = y.copy(), y.copy()
    far[at], missing[at] = size, np.nan
    one, other = (ParameterTracker(ARX(2, 2), start=200) for _ in range(2))
    one.run(far, u), other.run(missing, u)
    for tracker in (one, other):
        np.testing.assert_allclose(tracker.theta, recordings.THETA, atol=4.0 * tracker.std.max())
    np.testing.assert_allclose(one.std, other.std, rtol=0.02)


# What a state replaces is said: a tracker that was made with another forgetting does not keep it in silence.


@pytest.mark.parametrize("make", [ParameterTracker, partial(TrackerBank, 2)], ids=["tracker", "bank"])
def test_another_forgetting_or_q_is_said_with_both_values_and_the_same_is_not(make):
    y, u = np.random.default_rng(10_300).normal(size=(2, 50))
    several = make is not ParameterTracker
    one = make(ARX(1, 1), start=0, forgetting=0.99)
    one.run(*((np.tile(column[:, None], 2) for column in (y, u)) if several else (y, u)))
    state = one.state()
    with silence():
        make(ARX(1, 1), start=0, forgetting=0.99).restore(state)
        one.reset()
    both = r"restore: forgetting of the state, 0\.99, took the place of what was set, 0\.9;"
    with pytest.warns(UserWarning, match=both):
        make(ARX(1, 1), start=0, forgetting=0.9).restore(state)
    both = r"Q of the state, 0, took the place of what was set, 0\.001; forgetting of the state, 0\.99,"
    with pytest.warns(UserWarning, match=both):
        make(ARX(1, 1), start=0, Q=1e-3).restore(state)
