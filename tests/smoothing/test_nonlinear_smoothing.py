"""Nonlinear smoothers: the minimum of the cost of all states at once, angles as angles, outliers not believed."""

import numpy as np
import pytest
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)
from scipy.optimize import least_squares
from support import of_matrices

from robust_filterpy import RobustUnscentedKalmanFilter, smooth
from robust_filterpy.influence import Linear

F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = np.array([[0.02, 0.0], [0.0, 0.01]])
SIGMA = np.array([0.3, 0.05])


def seen(x):
    """Distance from a point beside the road, and the bearing from there."""
    x = np.ravel(x)
    return np.array([np.hypot(x[0], 3.0), np.arctan2(3.0, x[0])])


def jacobian(x):
    x = np.ravel(x)
    r2 = x[0] ** 2 + 9.0
    return np.array([[x[0] / r2**0.5, 0.0], [-3.0 / r2, 0.0]])


def turned(a, b):
    y = np.asarray(a) - b
    y[1] = (y[1] + np.pi) % (2.0 * np.pi) - np.pi
    return y


def move(x, dt=1.0):
    return np.array([x[0] + dt * np.sin(x[1]), x[1]])


class Turning(ExtendedKalmanFilter):
    """A nonlinear transition, with its Jacobian set as filterpy wants it."""

    def predict_x(self, u=0):
        angle = float(np.ravel(self.x)[1])
        self.F = np.array([[1.0, np.cos(angle)], [0.0, 1.0]])
        self.x = move(np.ravel(self.x)).reshape(np.shape(self.x))


def recording(seed, contamination=0.0, steps=40):
    rng = np.random.default_rng(seed)
    x, truth = np.array([-8.0, 0.4]), np.empty((steps, 2))
    for k in range(steps):
        x = truth[k] = move(x) + np.sqrt(np.diag(Q)) * rng.normal(size=2)
    bad = rng.random(steps) < contamination
    zs = np.array([seen(x) for x in truth]) + SIGMA * rng.normal(size=(steps, 2)) * np.where(bad, 20.0, 1.0)[:, None]
    return truth, zs


def prepared(kind):
    points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)
    kf = {
        "extended": lambda: Turning(2, 2),
        "unscented": lambda: UnscentedKalmanFilter(2, 2, 1.0, seen, move, points, residual_z=turned),
        "cubature": lambda: CubatureKalmanFilter(2, 2, 1.0, seen, move, residual_z=turned),
    }[kind]()
    kf.x, kf.P = np.array([-8.0, 0.4]), np.diag([0.5, 0.1])
    kf.Q, kf.R = Q.copy(), np.diag(SIGMA**2)
    return kf


def options(kind):
    return {"HJacobian": jacobian, "Hx": seen, "residual": turned} if kind == "extended" else {}


KINDS = {"extended": ExtendedKalmanFilter, "unscented": UnscentedKalmanFilter, "cubature": CubatureKalmanFilter}


@pytest.mark.core
@pytest.mark.parametrize("kind", KINDS)
def test_a_linear_model_gives_the_linear_smoother(kind):
    zs, H = np.cumsum(np.random.default_rng(3).normal(size=(30, 1)), axis=0), np.array([[1.0, 0.0]])
    plain, kf = (of_matrices(cls, F, H) for cls in (KalmanFilter, KINDS[kind]))
    for one in (plain, kf):
        one.x, one.P, one.Q = np.zeros(2), 5.0 * np.eye(2), Q.copy()
    functions = {"HJacobian": lambda x: H, "Hx": lambda x: H @ x} if kind == "extended" else {}
    expected, found = smooth(plain, zs, influence=Linear()), smooth(kf, list(zs), influence=Linear(), **functions)
    np.testing.assert_allclose(found.x.reshape(-1, 2), expected.x, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(found.P, expected.P, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind, change, match", [
    ("extended", {}, "HJacobian, Hx"), ("unscented", {"Fs": [F] * 40}, "Fs: expected none"),
    ("cubature", {"Rs": [np.eye(2)]}, "Rs: expected an entry"), ("unscented", {"zs": []}, "zs: expected"),
])  # fmt: skip
def test_bad_input_is_refused_by_name(kind, change, match):
    with pytest.raises((TypeError, ValueError), match=match):
        smooth(prepared(kind), **{"zs": recording(5)[1], **change})


def test_the_extended_smoother_is_the_minimum_of_the_cost_of_all_states():
    _, zs = recording(1)
    zs[7, 0] = np.nan
    found = smooth(prepared("extended"), zs, influence=Linear(), max_sweeps=300, **options("extended"))

    def residuals(path):
        path = path.reshape(-1, 2)
        start = (path[0] - [-8.0, 0.4]) / np.sqrt([0.5, 0.1])
        moved = (path[1:] - np.array([move(x) for x in path[:-1]])) / np.sqrt(np.diag(Q))
        missed = np.array([turned(z, seen(x)) for z, x in zip(zs, path[1:], strict=True)]) / SIGMA
        return np.concatenate([start, moved.ravel(), missed[~np.isnan(missed)]])

    best = least_squares(residuals, np.vstack([[-8.0, 0.4], found.x]).ravel(), xtol=1e-14, ftol=1e-14)
    assert found.converged
    deviations = np.sqrt(np.diagonal(found.P, axis1=1, axis2=2))
    assert np.abs((best.x.reshape(-1, 2)[1:] - found.x) / deviations).max() < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_outliers_are_not_believed(kind):
    """Close to the smoother that knows which are outliers, far from the one that believes them."""
    error = {"learnt": [], "labelled": [], "believed": []}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth, zs = recording(seed, 0.0)
        bad = rng.random(len(zs)) < 0.2
        zs[bad] += SIGMA * 20.0 * rng.normal(size=(bad.sum(), 2))
        Rs = [np.diag(SIGMA**2) * (400.0 if one else 1.0) for one in bad]
        for name, choice in (
            ("learnt", {"grouping": "joint"}), ("labelled", {"influence": Linear(), "Rs": Rs}),
            ("believed", {"influence": Linear()}),
        ):  # fmt: skip
            found = smooth(prepared(kind), list(zs), **choice, **options(kind))
            error[name].append(np.mean((found.x - truth)[:, 0] ** 2))
    assert np.mean(error["learnt"]) < 1.5 * np.mean(error["labelled"]) < np.mean(error["believed"])


def test_bearings_may_pass_through_pi():
    """A turn of the coordinates by which bearings jump from pi to -pi changes nothing."""

    _, zs = recording(2)
    shift = np.pi - np.median(zs[:, 1])

    def behind(x):
        return turned(seen(x) + [0.0, shift], np.zeros(2))

    shifted = np.array([turned(z + [0.0, shift], np.zeros(2)) for z in zs])
    assert np.ptp(shifted[:, 1]) > 6.0
    plain = smooth(prepared("extended"), zs, **options("extended"))
    across = smooth(prepared("extended"), shifted, HJacobian=jacobian, Hx=behind, residual=turned)
    np.testing.assert_allclose(across.x, plain.x, rtol=1e-7, atol=1e-8)


def test_states_that_are_angles_use_the_filters_sum_and_difference():
    """A heading that passes through pi again and again, part of the state, with outliers on the other side."""

    def wrapped(angle):
        return (angle + np.pi) % (2.0 * np.pi) - np.pi

    def apart(a, b):
        return np.array([wrapped(a[0] - b[0]), *(np.asarray(a) - b)[1:]])

    def mean(sigmas, weights):
        heading = np.arctan2(weights @ np.sin(sigmas[:, 0]), weights @ np.cos(sigmas[:, 0]))
        return np.array([heading, *(weights @ sigmas)[1:]])

    points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0, subtract=apart)
    kf = RobustUnscentedKalmanFilter(
        2, 1, 1.0, lambda x: x[:1], lambda x, dt: x + [x[1], 0.0], points, x_mean_fn=mean, z_mean_fn=mean,
        residual_x=apart, residual_z=apart, state_add=lambda x, dx: apart(x, -dx),
    )  # fmt: skip
    kf.x, kf.P, kf.Q, kf.R = np.array([0.0, 0.2]), 0.1 * np.eye(2), np.diag([1e-4, 1e-4]), 0.04 * np.eye(1)
    truth = 0.2 * np.arange(1, 61)
    zs = wrapped(truth + 0.2 * np.random.default_rng(4).normal(size=60))
    zs[30:32] = wrapped(zs[30:32] + 2.5)
    found = smooth(kf, list(zs))
    assert found.converged and np.abs(wrapped(found.x[:, 0] - truth)).max() < 0.25
