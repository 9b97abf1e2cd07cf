"""ParameterTracker estimates: exact where the data are, least squares where it must be, and the paper's equations."""

from functools import partial

import numpy as np
import pytest
import support
from support import paper_tracker

from robust_filterpy import Contaminated, Huber
from robust_filterpy.identification import ARMAX, FIR, BoxJenkins, LinearRegression, OutputError
from robust_filterpy.influence import Linear
from robust_filterpy.plants import simulate_arx, simulate_output_error
from robust_filterpy.plants.linear import random_walk
from robust_filterpy.testing import assert_consistent, assert_recovers_parameters, assert_tracks, draw, run_tracker

PLANT = np.array([-1.5, 0.7, 1.0, 0.5])


def white(length, seed=0):
    return np.random.default_rng(seed).choice([-1.0, 1.0], length)


# Noiseless data


@pytest.mark.parametrize("gradient", ["filtered", "pseudolinear"])
@pytest.mark.parametrize("structure, c", [(OutputError(2, 2), []), (ARMAX(2, 2, 2), [-1.0, 0.2])], ids=str)
def test_without_noise_the_truth_stays_where_it_is(structure, c, gradient):
    theta, u = np.array([*PLANT, *c]), white(500)
    y = simulate_arx(PLANT, u, na=2, nb=2).y
    result = support.paper_tracker(structure, theta=theta, Q=1e-6, R=0.01, gradient=gradient).run(y, u)
    assert np.abs(result.theta - theta).max() < 1e-10


@pytest.mark.parametrize(("gradient", "factor"), [("filtered", 1e-3), ("pseudolinear", 0.2)])
def test_noiseless_output_error_is_approached_from_zero(gradient, factor):
    u = white(2000)
    y = simulate_output_error(PLANT, u, na=2, nb=2).y
    path = support.paper_tracker(OutputError(2, 2), P=1.0, Q=1e-6, R=0.01, gradient=gradient).run(y, u).theta
    error = np.linalg.norm(path - PLANT, axis=1)
    # From 500 samples to 2000 the filtered gradient wins a factor of 1000, the pseudo-linear form of 5.
    assert error[-1] < factor * error[500] and error[-1] < 0.01, error[[100, 500, 1000, -1]]


# The paper's equations


def test_equations_8_and_48_random_walk_adds_w():
    """And an output that is missing is no information, however old the tracker is."""
    Q, u = np.array([[0.3, 0.1], [0.1, 0.2]]), white(1200)
    tracker = support.paper_tracker(FIR(2), P=2.0, Q=Q)
    for samples in (0, 1200):
        if samples:
            tracker.run(u, u)
        theta, P = tracker.theta, tracker.P
        tracker.update(None, 1.0)
        np.testing.assert_allclose(tracker.theta, theta, rtol=1e-9)
        np.testing.assert_allclose(tracker.P, P + Q)


def test_equations_9_and_10_parameters_follow_c():
    C = np.array([[0.9, 0.1], [0.0, 1.0]])
    path = random_walk([1.0, -1.0], 0.0, 200, C=C)
    phi = np.random.default_rng(0).normal(size=(200, 2))
    y = np.sum(phi * path, axis=1)
    following = support.paper_tracker(LinearRegression(2), F=C, R=1e-4).run(y, phi).theta
    np.testing.assert_allclose(following[50:], path[50:], atol=1e-6)
    still = support.paper_tracker(LinearRegression(2), R=1e-4).run(y, phi).theta
    assert np.abs(still - path)[50:].max() > 1e-3


def test_equations_18_to_23_and_53_and_table_1_in_the_papers_own_letters():
    k_eps, W = 1.5, 1e-4 * np.eye(4)
    u = white(120)
    y = simulate_output_error(PLANT, u, noise=Contaminated(0.1, 10.0, 0.5), rng=2, na=2, nb=2).y
    theta, P, yhat = np.zeros(4), 0.01 * np.eye(4), np.zeros(122)
    past = np.concatenate((np.zeros(2), u))
    tracker = support.paper_tracker(
        OutputError(2, 2), P=P, Q=W, R=1.0, influence=Huber(k_eps), scaling="unit", gradient="pseudolinear",
        guard="none",
    )  # fmt: skip
    result = tracker.run(y, u)
    for k in range(120):
        phi = np.array([-yhat[k + 1], -yhat[k], past[k + 1], past[k]])
        nu = y[k] - phi @ theta
        np.testing.assert_allclose([result.prediction[k], result.residual[k]], [phi @ theta, nu], atol=1e-12)
        prior = P + W
        gain = prior @ phi
        theta = theta + gain * np.clip(nu, -k_eps, k_eps)
        P = prior - np.outer(gain, phi @ prior) * (abs(nu) <= k_eps)
        yhat[k + 2] = phi @ theta
        np.testing.assert_allclose(result.theta[k], theta, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(result.std[k], np.sqrt(np.diag(P)), rtol=1e-9)


# Robustness


@pytest.mark.parametrize("guard", ["reject", "halve"])
@pytest.mark.parametrize("structure", [OutputError(2, 2), BoxJenkins(2, 1, 1, 2)], ids=str)
def test_guard_keeps_every_model_stable(structure, guard):
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=500), 20.0 * rng.standard_t(1, size=500)

    def radii(guard):
        result = support.paper_tracker(structure, Q=0.01, guard=guard, influence=Linear()).run(y, u)
        parts = [theta[part] for theta in result.theta for part in structure.stable_parts]
        return (result.guard != 0).any(), max(np.abs(np.roots([1.0, *part])).max() for part in parts)

    acted, largest = radii(guard)
    assert acted and largest < 1.0
    acted, largest = radii("none")
    assert not acted and largest > 1.0


def test_guard_watches_a_transition_matrix_too():
    tracker = support.paper_tracker(OutputError(1, 1), theta=[0.9, 1.0], F=1.2 * np.eye(2), guard="reject")
    result = tracker.run([np.nan] * 5, np.ones(5))
    assert (np.abs(result.theta[:, 0]) < 1).all() and (result.guard == -1).all()


# Against the plants of the test bench: intervals, drift, colored noise, every kind of outlier


def runs(make, plant, count, samples, **options):
    scenarios = [draw(plant, samples, rng=seed, **options) for seed in range(count)]
    return [run_tracker(one.load(make(one.structure)), one) for one in scenarios]


def test_intervals_hold_the_truth_and_moving_parameters_are_followed():
    assert_consistent(runs(partial(paper_tracker, influence=Linear()), "fir", 80, 30))
    assert_consistent(runs(paper_tracker, "fir", 80, 30), factor=1.2)
    assert_tracks(runs(paper_tracker, "fir", 30, 80, drift=0.05), at_least=0.5, skip=20)
    wild = {"mixture": {"scale_ratio": 30.0}}
    assert_tracks(runs(paper_tracker, "fir", 40, 120, contamination=wild), at_least=0.4, skip=40)


@pytest.mark.parametrize(("plant", "limits"), [("output error", {0: 0.2}), ("armax", {0: 0.1, 4: 0.4})])
def test_noise_with_a_colour_gives_no_bias(plant, limits):
    found = runs(paper_tracker, plant, 9, 400, sigma=1.0)
    median, truth = np.median([run.x[-1] for run in found], axis=0), found[0].scenario.theta[-1]
    assert all(abs(median[i] - truth[i]) <= limit for i, limit in limits.items())


@pytest.mark.parametrize("contamination", ["mixture", "bursts", "student", ("mixture", "missing")], ids=str)
@pytest.mark.parametrize("plant", ["arx", "fir"])
def test_parameters_are_recovered_through_every_kind_of_outlier(plant, contamination):
    assert_recovers_parameters(runs(paper_tracker, plant, 4, 300, contamination=contamination), factor=4.0)
