"""Theorems of the correction, on problems and measurements that hypothesis draws."""

import numpy as np
import pytest
import support
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError, SingularInnovationError
from robust_filterpy.correction.definition import correct, innovation_moments
from robust_filterpy.correction.options import Choices, typical_length
from robust_filterpy.correction.spread import _ratio
from robust_filterpy.influence import Hampel

pytestmark = pytest.mark.core

# The comparisons below are exact but for rounding, hence matrices of modest condition; the measurements have no
# such limit.
ENTRIES = st.floats(-2.0, 2.0).map(lambda v: round(v, 6))
MEASUREMENT = st.one_of(st.floats(-10.0, 10.0), st.floats(-1e300, 1e300))
INFLUENCES = st.sampled_from([Huber(), Huber(0.5), Hampel(), TukeyBiweight(), StudentT()])
SCALINGS = st.sampled_from(["innovation", "bounded"])
INFORMATION = st.sampled_from(["realized", "expected", "weight"])
GROUPINGS = st.sampled_from(["component", "joint", ((0, 1),)])

fewer = settings(max_examples=60, deadline=None)


def matrices(rows, columns):
    return arrays(float, (rows, columns), elements=ENTRIES)


@st.composite
def definite(draw, n, smallest=0.1):
    """A symmetric positive definite matrix, over six decades of size."""
    a = draw(matrices(n, n))
    return (a @ a.T + smallest * np.eye(n)) * 10.0 ** draw(st.integers(-3, 3))


@st.composite
def problems(draw, sensors=2):
    """A problem with at most four states and at least that many sensors."""
    n, m = draw(st.integers(1, 4)), draw(st.integers(sensors, 4))
    F = draw(matrices(n, n))
    size = np.abs(np.linalg.eigvals(F)).max()
    return support.Problem(
        x=draw(matrices(n, 1)), P=draw(definite(n)), F=F / max(size, 1.0), H=draw(matrices(m, n)), Q=draw(definite(n)),
        R=draw(definite(m)), B=None, M=np.zeros((n, m)),
    )  # fmt: skip


@st.composite
def choices(draw, scalings=SCALINGS):
    return {
        "influence": draw(INFLUENCES), "scaling": draw(scalings), "information": draw(INFORMATION),
        "grouping": draw(GROUPINGS),
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


def away_from_kinks(kf):
    """Set aside the draws in which rounding decides on which side of a kink of psi a component falls."""
    e = np.ravel(kf.e)
    if kf.grouping == "joint":
        e = np.array([np.linalg.norm(e)])
    kinks = [getattr(kf.influence, name) for name in ("threshold", "a", "b", "c") if hasattr(kf.influence, name)]
    assume(all(abs(abs(component) - kink) > 1e-5 for component in e for kink in kinks))


def other_coordinates(data, p, options):
    L = data.draw(matrices(len(p.x), len(p.x))) + 5 * np.eye(len(p.x))
    assume(np.linalg.cond(L) < 50)
    return support.with_(p, x=L @ p.x, P=L @ p.P @ L.T, H=np.linalg.solve(L.T, p.H.T).T), np.eye(len(p.R)), L, 0.0 * p.x


def rotated_sensors(data, p, options):
    U = np.linalg.qr(data.draw(matrices(len(p.R), len(p.R))) + 3 * np.eye(len(p.R)))[0]
    options["grouping"] = "joint"
    # A sensor whose row of H is zero says nothing about the state and is not one of the group.
    assume(np.all(np.abs(p.H).max(axis=1) > 1e-6) and np.all(np.abs(U @ p.H).max(axis=1) > 1e-6))
    return support.with_(p, H=U @ p.H, R=U @ p.R @ U.T), U, np.eye(len(p.x)), 0.0 * p.x


def another_place(data, p, options):
    shift = data.draw(matrices(len(p.x), 1))
    return support.with_(p, x=p.x + shift), np.eye(len(p.R)), np.eye(len(p.x)), shift


@pytest.mark.parametrize("change", [other_coordinates, rotated_sensors, another_place], ids=lambda one: one.__name__)
@fewer
@given(data=st.data(), problem=problems(), options=choices())
def test_what_must_not_matter_does_not(change, data, problem, options):
    """z' = A z and x' = L x + shift, for another problem that says the same; check_filter has units and order."""
    z, other = data.draw(measurements(len(problem.R), st.floats(-1e3, 1e3))), dict(options)
    changed, A, L, shift = change(data, problem, other)
    options["scaling"] = other["scaling"]
    if other["grouping"] == "joint":
        options["grouping"] = "joint"
    one, two = updated(problem, z, **options), updated(changed, A @ z + changed.H @ shift, **other)
    away_from_kinks(one)
    support.assert_close(two.x - shift, L @ one.x, 1e-6, "x", np.abs(L).max() * spread(problem) + np.abs(shift).max())
    support.assert_close(two.P, L @ one.P @ L.T, 1e-6, "P")


def test_how_much_a_prediction_is_worth_to_a_sensor_does_not_depend_on_units():
    """Also of one without noise, next to which all but rounding of S is the prediction's."""
    unit, seen, R, S = np.array([1.0, 1e-4, 1e4]), np.array([1.0, 2.0, 3.0]), np.diag([0.0, 0.0, 1.0]), np.eye(3) + 1.0
    for u in (np.ones(3), unit):
        ratio = _ratio(seen * u**2, R * np.outer(u, u), S * np.outer(u, u))
        np.testing.assert_allclose(ratio, [0.5e12, 1e12, 3.0])


# One correction, sensor by sensor.


def test_the_threshold_is_in_units_of_the_spread():
    one = np.eye(1)
    plain = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one)
    wide = correct(np.zeros(1), one, np.array([6.0]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert plain.clipped[0] and not wide.clipped[0]
    wild = correct(np.zeros(1), one, np.array([1e9]), one, 2.0 * one, Choices(scaling="learnt"), widths=np.array([5.0]))
    assert wild.x[0] == pytest.approx(5.0 * plain.x[0])


def test_a_sensor_that_the_others_determine_is_refused_or_left_out():
    P, H = np.eye(2), np.array([[1.0, 0.0], [2.0, 0.0]])
    C, S = innovation_moments(P, H, np.zeros((2, 2)))
    given = np.zeros(2), P, np.array([1.0, 2.0]), C, S
    with pytest.raises(SingularInnovationError, match="singular"):
        correct(*given)
    found = correct(*given, skip_singular=True)
    assert_allclose(found.x, [1.0, 0.0])
    assert_allclose(found.P, np.diag([0.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize("k", [1, 2, 5])
def test_the_typical_length_of_a_group_is_in_units_of_one_sensors(k):
    lengths = np.linalg.norm(np.random.default_rng(k).normal(size=(200_000, k)), axis=1)
    # Five standard errors of the median.
    assert np.median(lengths) * typical_length(k) == pytest.approx(0.674490, abs=5 * 1.2533 / 200_000**0.5)
