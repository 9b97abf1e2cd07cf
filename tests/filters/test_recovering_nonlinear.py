"""Nonlinear filters that recover: on a linear model the linear one's numbers, on a radar what it promises."""

import copy
import pickle

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints
from support import (
    FILTERPY_2,
    RECOVERING,
    load,
    polar,
    polar_jacobian,
    random_problem,
    recovering,
    simulate,
    with_,
    wrapped,
)

from robust_filterpy.filters import RobustCubatureKalmanFilter, RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter

DT = 0.1
F = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = 0.1 * np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
R = np.diag([0.25, 1e-4])
# West of the radar bearings go round from pi to -pi, which filterpy's cubature filter cannot average; east they do not.
WEST = np.array([-40.0, 0.0, -6.0, 1.2])
CLASSES = [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter]
PLAIN = {**RECOVERING, "patience": None, "scaling": "innovation"}


def straight(x, dt):
    return F @ x


def mean_of_polar(sigmas, weights):
    """Return the mean of ranges and bearings, the bearings around the first."""
    turns = (sigmas[:, 1] - sigmas[0, 1] + np.pi) % (2 * np.pi) - np.pi
    return np.array([weights @ sigmas[:, 0], sigmas[0, 1] + weights @ turns])


def made(cls, n, m, fx, hx, **options):
    """Return a filter of any of the kinds, by default one that comes back."""
    options = {**RECOVERING, **options}
    if issubclass(cls, RobustExtendedKalmanFilter):
        return cls(n, m, **options)
    if issubclass(cls, RobustUnscentedKalmanFilter):
        points = MerweScaledSigmaPoints(n, 0.5, 2.0, 3.0 - n)
        return cls(n, m, DT, hx, fx, points, **options)
    return cls(n, m, DT, hx, fx, **options)


def start(cls):
    return np.where([issubclass(cls, RobustCubatureKalmanFilter), False, False, False], -1.0, 1.0) * WEST


def radar(cls, **options):
    kf = made(cls, 4, 2, straight, polar, **options)
    kf.residual_z = wrapped
    if isinstance(kf, RobustUnscentedKalmanFilter):
        kf.z_mean = mean_of_polar
    kf.x, kf.P, kf.Q, kf.R = start(cls), np.diag([4.0, 1.0, 4.0, 1.0]), Q.copy(), R.copy()
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.F = F.copy()
    return kf


def recording(cls, seed, jump=(0.0, 0.0), run=0, size=0.0, at=50, steps=150):
    rng = np.random.default_rng(seed)
    x, truth, zs = start(cls), np.empty((steps, 4)), np.empty((steps, 2))
    for k in range(steps):
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4)
        x[[0, 2]] += np.asarray(jump) * (k == at)
        truth[k] = x
        zs[k] = polar(x) + np.sqrt(np.diag(R)) * rng.normal(size=2)
        zs[k, 0] += size * (at <= k < at + run)
        zs[k, 1] = (zs[k, 1] + np.pi) % (2 * np.pi) - np.pi
    return truth, zs


def correct(kf, z):
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.update(z, polar_jacobian, polar, residual=wrapped)
    else:
        kf.update(z)


def errors(kf, truth, zs):
    found = []
    for z in zs:
        kf.predict()
        correct(kf, z)
        found.append(np.ravel(kf.x)[[0, 2]].copy())
    return np.hypot(*(found - truth[:, [0, 2]]).T)


@pytest.mark.skipif(not FILTERPY_2, reason="filterpy 1.4.5 corrects by sigma points without Q")
@pytest.mark.parametrize(
    "options", [{}, {"grouping": "joint"}, {"scaling": "bounded", "information": "weight"}], ids=str
)
@pytest.mark.parametrize("dims", [(1, 1), (3, 2)])
@pytest.mark.parametrize("cls", CLASSES)
def test_on_a_linear_model_they_are_the_linear_filter(cls, dims, options):
    problem = random_problem(7, *dims)
    # Without Q, on which see below, a P that F shrinks would not stay definite.
    problem = with_(problem, F=0.99 * np.linalg.qr(problem.F)[0])
    zs, _ = simulate(problem, 80, seed=7, contamination=0.1)
    zs[30:] += problem.H @ np.full(dims[0], 40.0)
    zs[5, 0] = zs[9] = zs[33, 0] = np.nan
    linear = load(recovering(*dims, patience=4, **options), problem)
    kf = made(cls, *dims, lambda x, dt: problem.F @ x, lambda x: problem.H @ x, patience=4, **options)
    kf.x, kf.P, kf.Q, kf.R = np.ravel(problem.x).astype(float), problem.P.copy(), problem.Q.copy(), problem.R.copy()
    if isinstance(kf, RobustExtendedKalmanFilter):
        kf.F = problem.F.copy()
    # filterpy's cubature filter corrects by the sigma points from before Q was added.
    if isinstance(kf, RobustCubatureKalmanFilter):
        kf.Q = linear.Q = np.zeros_like(problem.Q)
    for z in zs:
        linear.predict(), kf.predict()
        linear.update(z)
        if isinstance(kf, RobustExtendedKalmanFilter):
            kf.update(z, lambda x: problem.H, lambda x: problem.H @ x)
        else:
            kf.update(z)
        assert (kf.refused, kf.recoveries) == (linear.refused, linear.recoveries)
        states = [{**one.state(), "weights": one.weights} for one in (kf, linear)]
        for name in ("x", "P", "weights", "insisting"):
            ours, theirs = (np.ravel(state[name]) for state in states)
            scale = np.nanmax(np.abs(theirs), initial=1.0)
            np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9 * scale, err_msg=name)
    assert linear.recoveries > 0


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("jump", [(5.0, 0.0), (0.0, 10.0), (0.0, -15.0)])
def test_a_track_that_jumps_is_followed(cls, jump):
    lost = []
    for seed in range(5):
        truth, zs = recording(cls, seed, jump)
        kf, plain = radar(cls), radar(cls, **PLAIN)
        # A jump that bends the line takes a second recovery, or a third.
        assert errors(kf, truth, zs)[50 + 3 * kf.patience + 10 :].max() < 2.0, seed
        assert 0 < kf.recoveries <= 3
        lost.append(errors(plain, truth, zs)[60:].mean())
    assert max(lost) > 2.0


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("run, size", [(1, 1e6), (5, -8.0), (11, 4.0), (11, 30.0)])
def test_a_run_of_outliers_shorter_than_the_patience_is_left_out(cls, run, size):
    for seed in range(4):
        truth, zs = recording(cls, seed, run=run, size=size)
        kf, plain = radar(cls), radar(cls, **PLAIN)
        found = errors(kf, truth, zs)
        assert found[50:].max() < 3.0 and kf.recoveries == 0
        # Until it recovers it is the same filter; the other one is stepped by the kernel.
        np.testing.assert_allclose(found, errors(plain, truth, zs), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("column", [False, True])
@pytest.mark.parametrize("cls", CLASSES)
def test_refused_angles_agree_by_their_residual(cls, column):
    """After half a turn innovations lie on both sides of pi."""

    def turned(a, b):
        assert np.shape(a) == np.shape(b) == np.shape(predicted(kf.x))
        return (a - b + np.pi) % (2 * np.pi) - np.pi

    def predicted(x):
        return np.reshape(np.ravel(x), (1, 1) if column and isinstance(kf, RobustExtendedKalmanFilter) else (1,))

    # Points of a widened P have to lie within a turn.
    points = (MerweScaledSigmaPoints(1, 0.1, 2.0, 2.0),) if issubclass(cls, RobustUnscentedKalmanFilter) else ()
    functions = () if issubclass(cls, RobustExtendedKalmanFilter) else (DT, predicted, lambda x, dt: x)
    kf = cls(1, 1, *functions, *points, **RECOVERING)
    kf.residual_z = turned
    if issubclass(cls, RobustCubatureKalmanFilter):
        # Its predicted measurement is a column.
        kf.residual_z = lambda a, b: (a - b + np.pi) % (2 * np.pi) - np.pi
    kf.x, kf.Q, kf.R = np.zeros((1, 1) if column else 1), 1e-4 * np.eye(1), 0.01 * np.eye(1)
    noise = 0.1 * np.random.default_rng(3).normal(size=60)
    for k in range(60):
        kf.predict()
        z = (noise[k] + np.pi * (k >= 20) + np.pi) % (2 * np.pi) - np.pi
        if isinstance(kf, RobustExtendedKalmanFilter):
            kf.update(z, lambda x: np.eye(1), predicted, residual=turned)
        else:
            kf.update(np.array([z]))
    assert kf.recoveries == 1
    assert abs(abs(kf.x.item()) - np.pi) < 0.2


@pytest.mark.parametrize("cls", CLASSES)
def test_copies_state_batch_and_refused_calls(cls):
    truth, zs = recording(cls, 2, (0.0, -15.0))
    zs[55, 1], zs[57] = np.nan, np.nan
    kf, functions, last = radar(cls), (), {}
    if isinstance(kf, RobustExtendedKalmanFilter):
        functions, last = (polar_jacobian, polar), {"residual": wrapped}
    errors(kf, truth[:58], zs[:58])
    assert kf.refused > 2
    twins = [copy.deepcopy(kf), pickle.loads(pickle.dumps(kf)), radar(cls)]
    twins[2].restore(kf.state())
    before = {name: copy.deepcopy(value) for name, value in vars(kf).items() if not callable(value)}
    infinite = np.array([np.inf, 0.0])
    with pytest.raises(ValueError):
        correct(kf, infinite)
    with pytest.raises(ValueError, match=r"step 3: z: expected finite"):
        kf.batch_filter([*zs[58:61], infinite], *functions, **last)
    for name, value in before.items():
        np.testing.assert_equal(getattr(kf, name), value) if isinstance(value, (np.ndarray, int, float)) else None
    means, covariances = kf.batch_filter(zs[58:], *functions, **last)
    assert kf.recoveries > 0
    for twin in twins:
        errors(twin, truth[58:], zs[58:])
        np.testing.assert_array_equal(np.ravel(twin.x), means[-1])
        np.testing.assert_array_equal(twin.P, covariances[-1])
        assert (twin.refused, twin.recoveries) == (kf.refused, kf.recoveries)


def test_a_residual_that_fails_while_innovations_are_compared_changes_nothing():
    kf, calls = radar(RobustExtendedKalmanFilter), []

    def failing(a, b):
        calls.append(a)
        if len(calls) == 2:
            raise RuntimeError("enough")
        return wrapped(a, b)

    far = polar(WEST) + [20.0, 0.0]
    for z in (polar(WEST), far):
        kf.predict()
        correct(kf, z)
    assert kf.refused == 1
    kf.predict()
    before = copy.deepcopy(kf.state())
    with pytest.raises(RuntimeError, match="enough"):
        kf.update(far, polar_jacobian, polar, residual=failing)
    np.testing.assert_equal(kf.state(), before)
    assert kf.refused == 1


@pytest.mark.parametrize("cls", CLASSES)
def test_bad_patience_is_refused(cls):
    for patience in (1, 2.5, True):
        with pytest.raises((ValueError, TypeError), match="patience"):
            radar(cls, patience=patience)
    kf = radar(cls, patience=3)
    with pytest.raises(ValueError, match="patience"):
        kf.patience = 1
    assert kf.patience == 3


def test_a_residual_function_may_write_into_what_it_is_given():
    for residual in (np.subtract, lambda a, b: np.subtract(a, b, out=a)):
        kf = RobustExtendedKalmanFilter(1, 1, **{**RECOVERING, "patience": 3})
        kf.x, kf.Q = np.zeros(1), 0.01 * np.eye(1)
        for _ in range(5):
            kf.predict()
            kf.update(np.array([50.0]), lambda x: np.eye(1), lambda x: x, residual=residual)
        assert kf.recoveries == 1 and abs(kf.x.item() - 50.0) < 1.0


def test_a_difference_of_another_length_is_named_and_changes_nothing():
    kf, calls = radar(RobustExtendedKalmanFilter), []

    def shrinking(z, predicted):
        calls.append(z)
        return wrapped(z, predicted) if len(calls) < 3 else np.zeros(1)

    z = polar(kf.x) + [500.0, 0.0]
    kf.update(z, polar_jacobian, polar, residual=shrinking)
    before = kf.x.copy(), kf.P.copy(), kf.refused
    with pytest.raises(ValueError, match="residual: expected 2"):
        kf.update(z, polar_jacobian, polar, residual=shrinking)
    for one, other in zip((kf.x, kf.P, kf.refused), before, strict=True):
        np.testing.assert_array_equal(one, other)
