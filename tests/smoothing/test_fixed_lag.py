"""The live smoother: x is the filter's, and xSmooth the backward pass over what the filter made of each measurement."""

import copy

import filterpy.kalman
import numpy as np
import pytest
import support
from dense import CART, drive
from interruption import half_steps

from robust_filterpy import AdaptiveKalmanFilter, RobustKalmanFilter, smooth
from robust_filterpy.correction import Contaminated
from robust_filterpy.influence import Linear
from robust_filterpy.kalman import FixedLagSmoother


def ready(cls=FixedLagSmoother, problem=CART, N=None, **choices):
    smoother = cls(len(problem.x), len(problem.R), N, **choices)
    for name in ("x", "P", "F", "H", "Q", "R"):
        setattr(smoother, name, getattr(problem, name).copy())
    return smoother


@pytest.mark.core
def test_linear_is_filterpys_filter_and_the_exact_smoother():
    """After each measurement xSmooth is what smoothing all data so far gives, back to the lag."""
    _, zs, _ = drive(1, 0.0, steps=30)
    zs[12] += 50.0
    ours = ready(N=4, influence=Linear())
    theirs = ready(filterpy.kalman.FixedLagSmoother, N=4)
    expected = []
    for k, z in enumerate(zs):
        ours.smooth(z)
        theirs.smooth(z)
        support.assert_same_state(ours, theirs, ("x", "P", "y", "S"), 1e-9)
        so_far = support.make(filterpy.kalman.KalmanFilter, CART)
        means, covariances, _, _ = so_far.batch_filter(list(zs[: k + 1]))
        expected = [*expected[: max(k - 4, 0)], *so_far.rts_smoother(means, covariances)[0][max(k - 4, 0) :]]
        np.testing.assert_allclose(np.array(ours.xSmooth), np.array(expected), rtol=1e-7, atol=1e-8)
    np.testing.assert_array_equal(ours.x_s, ours.xSmooth[-5])
    assert ours.count == theirs.count and len(ours.xSmooth) == len(theirs.xSmooth)


@pytest.mark.parametrize("P", [10.0 * np.eye(2), np.zeros((2, 2))], ids=["vague", "exact"])
@pytest.mark.parametrize("choices", [{}, {"noise": Contaminated()}], ids=["default", "given"])
def test_it_is_the_backward_pass_over_what_the_filter_made_of_each_measurement(choices, P):
    """The oracle is filterpy's pass over all steps so far, with a pseudoinverse for a state that is known exactly."""
    zs = drive(7, 0.2, steps=30)[1] + np.repeat([0.0, 15.0], [20, 10])
    problem = support.with_(CART, P=P)
    smoother = ready(problem=problem, N=6, **choices)
    kf = support.make(RobustKalmanFilter if choices else AdaptiveKalmanFilter, problem, **choices)
    states, predicted = [(kf.x, kf.P)], []
    for k, z in enumerate(zs):
        smoother.smooth(z)
        kf.predict()
        predicted.append(kf.P)
        kf.update(z)
        states.append((kf.x, kf.P))
        x, expected = kf.x, [kf.x]
        for i in range(k, max(k - 6, 0), -1):
            gain = states[i][1] @ kf.F.T @ np.linalg.pinv(predicted[i], rcond=1e-12, hermitian=True)
            x = states[i][0] + gain @ (x - kf.F @ states[i][0])
            expected.insert(0, x)
        np.testing.assert_allclose(smoother.xSmooth[-len(expected) :], expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("N", [8, 15])
def test_a_jump_is_put_where_readings_were_first_rejected(N):
    """What is believed after them says nothing of the states before."""
    for seed in range(4):
        truth, zs, _ = drive(seed, 0.0, steps=100)
        truth[60:] += 20.0
        zs[60:] += 20.0
        live, _ = ready().smooth_batch(list(zs), N)
        assert np.abs(live[50:60, 0, 0] - truth[50:60]).max() < 4.0


def test_a_batch_changes_nothing_and_is_a_loop():
    _, zs, _ = drive(3, 0.1, steps=40)
    smoother = ready(N=3)
    before = copy.deepcopy(vars(smoother))
    states, latest = smoother.smooth_batch(list(zs), 3)
    assert smoother.count == 0 and not smoother.xSmooth
    np.testing.assert_array_equal(smoother.x, before["x"])
    for z in zs:
        smoother.smooth(z)
    np.testing.assert_array_equal(states, np.array(smoother.xSmooth))
    np.testing.assert_array_equal(latest[-1], smoother.x)


def test_missing_measurements_inputs_and_matrices_that_change():
    _, zs, _ = drive(4, 0.0, steps=12)
    smoother = ready(N=20, influence=Linear())
    smoother.B = np.array([[0.0], [1.0]])
    kf = support.make(filterpy.kalman.KalmanFilter, CART)
    kf.B = smoother.B
    Rs = [np.eye(1) * (1.0 + k % 3) for k in range(12)]
    us = [np.array([0.1 * k]) for k in range(12)]
    zs = [None if k == 5 else z for k, z in enumerate(zs)]
    for z, u, R in zip(zs, us, Rs, strict=True):
        smoother.R = R
        smoother.smooth(z, u)
        assert np.isnan(smoother.weights).all() == (z is None)
    found = smooth(kf, zs, influence=Linear(), Rs=Rs, us=us)
    np.testing.assert_allclose(np.array(smoother.xSmooth), found.x, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("z, match", [(np.inf, "z: expected a finite"), ([1.0, 2.0], "z: expected 1"), ("a", "z:")])
def test_a_refused_measurement_changes_nothing(z, match):
    smoother = ready(N=3)
    smoother.smooth(1.0)
    before = copy.deepcopy(vars(smoother))
    with pytest.raises((TypeError, ValueError), match=match):
        smoother.smooth(z)
    assert vars(smoother).keys() == before.keys() and smoother.count == 1
    np.testing.assert_array_equal(smoother.x, before["x"])
    with pytest.raises(ValueError, match="step 1: z: expected a finite"):
        ready().smooth_batch([1.0, np.inf], 2)


def test_bad_arguments_are_refused():
    for arguments, choices, match in (
        ((0, 1), {}, "dim_x"), ((1, 1, 0), {}, "N: expected"), ((1, 1), {"grouping": "x"}, "grouping"),
        ((1, 1), {"influence": 3}, "influence"), ((1, 1), {"process": 3}, "process"),
    ):  # fmt: skip
        with pytest.raises((TypeError, ValueError), match=match):
            FixedLagSmoother(*arguments, **choices)
    with pytest.raises(ValueError, match="N: expected a lag"):
        ready().smooth(1.0)


@pytest.mark.parametrize("steps", [1, 6])
@pytest.mark.parametrize("choices", [{}, {"influence": Linear()}], ids=["learnt", "linear"])
def test_an_interrupt_leaves_no_half_step(steps, choices):
    smoother = ready(N=3, **choices)
    for z in drive(2, 0.1, steps=steps)[1]:
        smoother.smooth(z)

    def seen(one):
        shown = {name: getattr(one, name) for name in ("x", "P", "y", "S", "x_s", "count", "xSmooth", "weights")}
        return {**one.state(), **shown}

    half, lines = half_steps(smoother, lambda one: one.smooth(1.5), seen)
    assert half == [] and lines > 20
