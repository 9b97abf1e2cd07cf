"""Theorems of the correction, on problems and measurements that hypothesis draws."""

import numpy as np
import pytest
import support
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core

# The comparisons below are exact but for rounding, hence matrices of modest condition; the measurements have no
# such limit.
ENTRIES = st.floats(-2.0, 2.0).map(lambda v: round(v, 6))
MEASUREMENT = st.one_of(st.floats(-10.0, 10.0), st.floats(-1e300, 1e300))
INFLUENCES = st.sampled_from([Huber(), Huber(0.5), Hampel(), TukeyBiweight(), StudentT()])
SCALINGS = st.sampled_from(["innovation", "bounded"])
INFORMATION = st.sampled_from(["realized", "expected", "weight"])
GROUPINGS = st.sampled_from(["component", "joint"])

fewer = settings(max_examples=60, deadline=None)


def matrices(rows, columns):
    return arrays(float, (rows, columns), elements=ENTRIES)


@st.composite
def definite(draw, n, smallest=0.1):
    """A symmetric positive definite matrix, over six decades of size."""
    a = draw(matrices(n, n))
    return (a @ a.T + smallest * np.eye(n)) * 10.0 ** draw(st.integers(-3, 3))


@st.composite
def problems(draw, sensors=1):
    """A problem with at most four states and at least that many sensors."""
    n, m = draw(st.integers(1, 4)), draw(st.integers(sensors, 4))
    F = draw(matrices(n, n))
    size = np.abs(np.linalg.eigvals(F)).max()
    return support.Problem(
        x=draw(matrices(n, 1)), P=draw(definite(n)), F=F / max(size, 1.0), H=draw(matrices(m, n)), Q=draw(definite(n)),
        R=draw(definite(m)), B=None, M=np.zeros((n, m)),
    )  # fmt: skip


@st.composite
def choices(draw, scalings=SCALINGS, groupings=GROUPINGS):
    return {
        "influence": draw(INFLUENCES), "scaling": draw(scalings), "information": draw(INFORMATION),
        "grouping": draw(groupings),
    }  # fmt: skip


def measurements(m, elements=MEASUREMENT):
    return arrays(float, (m, 1), elements=elements)


def spread(problem):
    """The prior standard deviation, below which a difference in x is nothing."""
    return np.sqrt(np.abs(problem.P).max())


def updated(problem, z, **options):
    kf = support.make(RobustKalmanFilter, problem, **options)
    kf.update(z)
    return kf


@fewer
@given(st.data(), problems())
def test_the_bounded_transformation_never_amplifies(data, problem):
    """No sensor is scaled by more than 1 or by more than its standard deviation asks for."""
    kf = updated(problem, data.draw(measurements(len(problem.R))), scaling="bounded")
    assert np.abs(np.diag(kf.T)).max() <= 1 + 1e-7
    assert (np.diag(kf.T) <= 1 / np.sqrt(np.diag(kf.S)) * np.sqrt(np.maximum(np.diag(kf.S), 1)) + 1e-7).all()


@fewer
@given(st.data(), problems(), choices())
def test_p_stays_positive_definite_after_any_sequence(data, problem, options):
    kf = support.make(RobustKalmanFilter, problem, **options)
    m, size = len(problem.R), 0.0
    values = st.one_of(st.none(), measurements(m, st.one_of(MEASUREMENT, st.just(np.nan))))
    for action in data.draw(st.lists(st.sampled_from(["predict", "update", "correlated"]), min_size=1, max_size=8)):
        if action == "predict":
            kf.predict()
        elif action == "update":
            kf.update(data.draw(values))
        else:
            kf.update_correlated(data.draw(values))
        size = max(size, np.abs(kf.P).max())
        support.assert_positive_definite(kf.P, size=size)
        assert np.all(np.isfinite(kf.x))


@fewer
@given(st.data(), problems(), choices(scalings=st.just("unit")))
def test_unit_scaling_keeps_p_positive_definite_or_says_that_it_cannot(data, problem, options):
    kf = support.make(RobustKalmanFilter, problem, **options)
    size = np.abs(kf.P).max()
    for _ in range(3):
        before = support.snapshot(kf)
        try:
            kf.update(data.draw(measurements(len(problem.R))))
        except NotPositiveDefiniteError:
            support.assert_unchanged(before, kf)
        support.assert_positive_definite(kf.P, size=size)


@fewer
@given(st.data(), problems(sensors=2), choices())
def test_permuting_the_sensors_permutes_nothing_else(data, problem, options):
    m = len(problem.R)
    order = np.array(data.draw(st.permutations(range(m))))
    z = data.draw(measurements(m, st.floats(-1e3, 1e3)))
    permuted = support.with_(problem, H=problem.H[order], R=problem.R[np.ix_(order, order)], M=problem.M[:, order])
    one, two = updated(problem, z, **options), updated(permuted, z[order], **options)
    away_from_kinks(one)
    support.assert_close(two.x, one.x, 1e-6, "x", spread(problem))
    support.assert_close(two.P, one.P, 1e-6, "P")
    np.testing.assert_allclose(two.weights, one.weights[order], rtol=1e-6)
    assert two.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-6)


def away_from_kinks(kf):
    """Set aside the draws in which rounding decides on which side of a kink of psi a component falls."""
    e = np.ravel(kf.e)
    if kf.grouping == "joint":
        e = np.array([np.linalg.norm(e)])
    kinks = [getattr(kf.influence, name) for name in ("threshold", "a", "b", "c") if hasattr(kf.influence, name)]
    assume(all(abs(abs(component) - kink) > 1e-5 for component in e for kink in kinks))


@fewer
@given(st.data(), problems(), choices(scalings=st.just("innovation")), st.integers(-6, 6))
def test_units_of_z_and_x_changed_together_change_nothing(data, problem, options, decades):
    unit = 10.0**decades
    z = data.draw(measurements(len(problem.R), st.floats(-1e3, 1e3)))
    scaled = support.with_(
        problem, x=unit * problem.x, P=unit**2 * problem.P, Q=unit**2 * problem.Q, R=unit**2 * problem.R
    )
    one, two = updated(problem, z, **options), updated(scaled, unit * z, **options)
    away_from_kinks(one)
    support.assert_close(two.x / unit, one.x, 1e-6, "x", spread(problem))
    support.assert_close(two.P / unit**2, one.P, 1e-6, "P")
    np.testing.assert_allclose(two.weights, one.weights, rtol=1e-6)


@fewer
@given(st.data(), problems(), choices())
def test_other_coordinates_of_the_state_change_nothing(data, problem, options):
    n = len(problem.x)
    L = data.draw(matrices(n, n)) + 5 * np.eye(n)
    assume(np.linalg.cond(L) < 50)
    z = data.draw(measurements(len(problem.R), st.floats(-1e3, 1e3)))
    other = support.with_(problem, x=L @ problem.x, P=L @ problem.P @ L.T, H=np.linalg.solve(L.T, problem.H.T).T)
    one, two = updated(problem, z, **options), updated(other, z, **options)
    away_from_kinks(one)
    support.assert_close(two.x, L @ one.x, 1e-6, "x", spread(problem))
    support.assert_close(two.P, L @ one.P @ L.T, 1e-6, "P")


@fewer
@given(st.data(), problems(sensors=2), choices(groupings=st.just("joint")))
def test_joint_grouping_is_rotation_invariant(data, problem, options):
    m = len(problem.R)
    U = np.linalg.qr(data.draw(matrices(m, m)) + 3 * np.eye(m))[0]
    z = data.draw(measurements(m, st.floats(-1e3, 1e3)))
    # A sensor whose row of H is zero says nothing about the state and is not one of the group.
    assume(np.all(np.abs(problem.H).max(axis=1) > 1e-6) and np.all(np.abs(U @ problem.H).max(axis=1) > 1e-6))
    rotated = support.with_(problem, H=U @ problem.H, R=U @ problem.R @ U.T)
    one, two = updated(problem, z, **options), updated(rotated, U @ z, **options)
    away_from_kinks(one)
    support.assert_close(two.x, one.x, 1e-6, "x", spread(problem))
    support.assert_close(two.P, one.P, 1e-6, "P")


def test_component_grouping_is_not_rotation_invariant():
    """So that the test above can fail."""
    problem = support.random_problem(3, 3, 2)
    U, z = np.linalg.qr(np.array([[1.0, 2.0], [-2.0, 1.0]]))[0], np.array([[50.0], [0.1]])
    rotated = support.with_(problem, H=U @ problem.H, R=U @ problem.R @ U.T)
    assert np.abs(updated(problem, z).x - updated(rotated, U @ z).x).max() > 1e-3


@fewer
@given(st.data(), problems(), choices())
def test_the_correction_is_bounded_in_z(data, problem, options):
    """|x_post - x_prior| <= m sqrt(|P|) max |psi|, whatever z: no C_i t_i is longer than the root of P's eigenvalue."""
    kf = updated(problem, data.draw(measurements(len(problem.R))), **options)
    influence, m = kf.influence, len(problem.R)
    bound = max(getattr(influence, "threshold", 0), getattr(influence, "a", 0), getattr(influence, "df", 0) + 1)
    gain = np.sqrt(np.linalg.eigvalsh(problem.P)[-1])
    moved = np.linalg.norm(kf.x_post - problem.x)
    assert moved <= gain * bound * m * (1 + 1e-6) + 1e-9 * np.linalg.norm(problem.x)


@fewer
@given(st.data(), problems(), choices())
def test_information_is_gained_and_never_more_than_kalmans(data, problem, options):
    """P - C S^-1 C' <= P+ <= P: what D between 0 and 1 means."""
    kf = updated(problem, data.draw(measurements(len(problem.R))), **options)
    C = problem.P @ problem.H.T
    kalman = problem.P - C @ np.linalg.solve(kf.S, C.T)
    tolerance = 1e-8 * np.abs(problem.P).max()
    assert np.linalg.eigvalsh(problem.P - kf.P).min() >= -tolerance
    assert np.linalg.eigvalsh(kf.P - kalman).min() >= -tolerance


@fewer
@given(st.data(), problems(), choices())
def test_a_shift_of_everything_shifts_the_estimate(data, problem, options):
    shift = data.draw(matrices(len(problem.x), 1))
    z = data.draw(measurements(len(problem.R), st.floats(-1e3, 1e3)))
    shifted = support.with_(problem, x=problem.x + shift)
    one, two = updated(problem, z, **options), updated(shifted, z + problem.H @ shift, **options)
    away_from_kinks(one)
    np.testing.assert_allclose(two.x - shift, one.x, atol=1e-6 * (1 + np.abs(one.x).max()))
    support.assert_close(two.P, one.P, 1e-6, "P")
