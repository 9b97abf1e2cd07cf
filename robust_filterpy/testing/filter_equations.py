"""Promises of the equations: what prediction and correction do to x and P, one equation at a time."""

from __future__ import annotations

import unittest

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy._checks import Array, takes
from robust_filterpy.testing import runs
from robust_filterpy.testing.bench import OLD, Check, FilterSubject, promise
from robust_filterpy.testing.models import range_bearing
from robust_filterpy.testing.runs import deviations, furthest, state

_SMALL = 1e-7

PROMISES: list[Check] = []


@promise(PROMISES, "prediction")
def prediction_moves_the_state_by_F(subject: FilterSubject) -> None:
    """x_prior = F x, with a full F that is not symmetric, for one step and for several."""
    model = subject.model()
    kf = subject.new(model)
    x = model.x
    for k in range(3):
        kf.predict()
        x = model.F @ x
        like = _alike(np.ravel(kf.x), model.F.T @ model.x, "F'") if k == 0 else ""
        words = f"prediction {k + 1}: x is off by {{}} of its standard deviations from F x{like}"
        _require_near(kf.x, x, model.P, words)


@promise(PROMISES, "prediction")
def prediction_moves_the_covariance_by_F(subject: FilterSubject) -> None:
    """P_prior of two covariances P_1 and P_2 differ by F (P_1 - P_2) F'."""
    model = subject.model()
    more = np.diag(np.arange(1.0, 5.0))
    one, two = (subject.predicted(model.with_(P=P))[2] for P in (model.P, model.P + more))
    got, wanted = two - one, model.F @ more @ model.F.T
    _compare(got, wanted, "F P F'", _alike(got, model.F.T @ more @ model.F, "F' P F"))


@promise(PROMISES, "prediction")
def prediction_adds_Q_once(subject: FilterSubject) -> None:
    """A prediction adds Q to P, neither less nor more, however old the filter is; what it adds is not moved by F."""
    model = subject.model()
    for age in (0, OLD):
        kf = subject.aged(model, age)
        kf.F = np.eye(4)
        P = state(kf)[1]
        kf.predict()
        got = state(kf)[1] - P
        ratio = float(np.trace(got) / np.trace(model.Q))
        _compare(got, model.Q, "Q", f"; the variances added after {age} steps are {ratio:.3g} times those of Q")
    less, more = (subject.predicted(one)[2] for one in (model, model.with_(Q=3.0 * model.Q)))
    got, wanted = more - less, 2.0 * model.Q
    _compare(got, wanted, "Q where F is not I", _alike(got, model.F @ wanted @ model.F.T, "F Q F'"))


@promise(PROMISES, "prediction")
def control_input_moves_the_prediction(subject: FilterSubject) -> None:
    """x_prior = F x + B u, P_prior does not depend on u, and a prediction that is given no u has none."""
    model = subject.model(dim_u=2)
    kf, still = subject.new(model), subject.new(model)
    if not hasattr(kf, "B") or not takes(kf.predict, "u"):
        raise unittest.SkipTest("has no B, or predict() takes no u")
    u = np.array([0.7, -1.3])
    runs.predict(kf, u)
    still.predict()
    still_x, moved = model.F @ model.x, model.B @ u  # type: ignore[operator]
    more = _ratio(np.ravel(kf.x) - still_x, moved)
    _require_near(kf.x, still_x + moved, model.P, f"x is off by {{}} of its standard deviations from F x + B u{more}")
    _compare(state(kf)[1], state(still)[1], "P_prior without an input", "")
    # filterpy's extended filter makes a matrix of x in a prediction without u, once it has a B.
    if np.size(still.x) != len(model.x):
        return
    x, P = state(kf)
    kf.predict()
    _require_near(kf.x, model.F @ x, P, "a prediction without u, after one with it, is off by {} deviations: u is kept")


@promise(PROMISES)
def measurement_counts_at_once(subject: FilterSubject) -> None:
    """The state after update(z) depends on this z, not only on those before, be z zero or as it was before."""
    model = subject.model()
    zs = subject.recording(model, 4)
    after = []
    for shift in (0.0, 1.0):
        kf = subject.advance(subject.new(model), zs, model)
        kf.predict()
        subject.meet(kf, model, shift)
        after.append(np.ravel(kf.x).astype(float))
    if np.allclose(after[0], after[1], rtol=1e-12, atol=0.0):
        raise AssertionError(
            "two measurements a standard deviation apart gave the same state: z is used later, or never"
        )
    again = subject.advance(subject.new(model), zs, model)
    again.predict()
    S = model.innovation_covariance(model.P)
    # From here a measurement of zeros is an ordinary one.
    near = subject.at_prior(model.with_(x=0.5 * model.P @ model.H.T @ np.linalg.solve(S, np.sqrt(S.diagonal()))))
    for kf, z, words in ((again, zs[-1], "equal to the one before"), (near, np.zeros(2), "of zeros")):
        x = np.array(kf.x, dtype=float)
        runs.measure(kf, z, model)
        if np.array_equal(np.asarray(kf.x, dtype=float), x):
            raise AssertionError(f"a measurement {words} moved nothing: it is taken for none")


@promise(PROMISES)
def measurement_makes_the_state_more_certain(subject: FilterSubject) -> None:
    """After a small innovation P - P+ is positive semidefinite and not zero."""
    model = subject.model()
    kf = subject.at_prior(model)
    _, P, _, _ = subject.meet(kf, model, 0.1)
    gained = (P - state(kf)[1]) / np.outer(deviations(P), deviations(P))
    if not np.isfinite(gained).all():
        raise AssertionError("P holds NaN or infinity after an update")
    values = np.linalg.eigvalsh((gained + gained.T) / 2)
    if values[-1] <= _SMALL:
        raise AssertionError("P did not shrink in any direction: the correction leaves it as it was")
    if values[0] < -_SMALL:
        raise AssertionError(f"P grew in one direction by {-values[0]:.2g} of its size, expected P+ <= P")


@promise(PROMISES)
def nonlinear_sensor_is_linearised_at_the_prediction(subject: FilterSubject) -> None:
    """An extended filter asks for sensor and Jacobian at x_prior, and is the Kalman filter of that line."""
    model = range_bearing()
    kf = subject.new(model)
    if not runs.is_extended(kf):
        raise unittest.SkipTest("update() takes no HJacobian")
    z = model.measured(model.F @ model.x) + 0.3 * np.sqrt(model.R.diagonal())
    runs.step(kf, z, model)
    line = runs.load(KalmanFilter(4, 2), model)
    line.predict()
    x = np.ravel(line.x)
    line.H = model.jacobian(x)
    line.update(z - model.measured(x) + line.H @ x)
    # A robust filter's psi is nearly linear for innovations as small as these.
    words = "x is off by {} of its standard deviations from the filter of the linearized sensor"
    _require_near(kf.x, np.ravel(line.x), line.P, words, _SMALL if subject.is_exact else 0.2)


def _require_near(x: Array, wanted: Array, P: Array, words: str, most: float = _SMALL) -> None:
    """Fail with these words, and by how much, where x is not as wanted, in its standard deviations."""
    off = furthest(np.ravel(x) - wanted, P)
    if off > most:
        raise AssertionError(words.format(f"{off:.2g}"))


def _compare(got: Array, wanted: Array, name: str, more: str) -> None:
    """Compare matrices in the size of the whole."""
    size = float(np.abs(wanted).max())
    difference = float(np.abs(got - wanted).max()) if np.isfinite(got).all() else np.inf
    if not difference <= 1e-6 * size:
        raise AssertionError(f"differs from {name} by {difference / size:.2g} of its size{more}")


def _alike(got: Array, other: Array, name: str) -> str:
    """Say so where the result is that of a well-known slip."""
    same = np.shape(got) == np.shape(other) and np.allclose(got, other, rtol=1e-6, atol=1e-9 * np.abs(other).max())
    return f"; it is {name}" if same else ""


def _ratio(got: Array, wanted: Array) -> str:
    """Say so where the result is a multiple of what it should be."""
    ratio = float(np.vdot(got, wanted) / np.vdot(wanted, wanted))
    if np.allclose(got, ratio * wanted, atol=1e-6 * np.abs(wanted).max()):
        return f"; it is {ratio:.3g} times that"
    return ""
