"""Linear plants: against python-control, the recursion written out, and the statistics of a random walk."""

import control
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from robust_filterpy import Contaminated
from robust_filterpy.plants import THETA_BAR, simulate_arx, simulate_output_error
from robust_filterpy.plants.linear import LinearParameters, linear_parameters, random_walk, stable

SIMULATORS = (simulate_arx, simulate_output_error)
G = control.tf([1.0, 0.5], [1.0, -1.5, 0.7], dt=1)
THETA = np.array([-1.5, 0.7, 1.0, 0.5])


def stable_theta(rng, na, nb, radius=0.95):
    """Draw theta from poles inside a circle."""
    poles = radius * np.sqrt(rng.uniform(size=na // 2)) * np.exp(1j * rng.uniform(0, np.pi, na // 2))
    real = rng.uniform(-radius, radius, na % 2)
    a = np.atleast_1d(np.poly([*poles, *poles.conj(), *real])).real[1:]
    return np.concatenate((a, rng.normal(size=nb)))


def by_definition(theta, u, v, na, nk, inside):
    """Run eqs (11)-(14) term by term; v enters the recursion (ARX) or only what is measured (output error)."""
    fed_back, measured = [], []
    for k in range(len(u)):
        y = v[k] if inside else 0.0
        for i in range(1, na + 1):
            y -= theta[k][i - 1] * (fed_back[k - i] if k >= i else 0.0)
        for j in range(theta.shape[1] - na):
            y += theta[k][na + j] * (u[k - nk - j] if k >= nk + j else 0.0)
        fed_back.append(y)
        measured.append(y if inside else y + v[k])
    return np.array(measured)


# --- fixed parameters ---


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 5))
def test_fixed_parameters_agree_with_control(seed, na, degree):
    rng = np.random.default_rng(seed)
    den = np.concatenate(([1.0], stable_theta(rng, na, 0))) * rng.uniform(0.5, 2.0)
    system = control.tf(rng.normal(size=min(degree, na) + 1), den, dt=0.1)
    u = rng.normal(size=200)
    expected = control.forced_response(system, None, u).outputs
    for simulate in SIMULATORS:
        found = simulate(system, u)
        np.testing.assert_allclose(found.y, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_array_equal(found.y, found.y_clean)
        np.testing.assert_array_equal(found.u, u)


def test_the_papers_plant_has_the_poles_it_is_said_to_have():
    poles = np.sort_complex(np.roots(np.concatenate(([1.0], THETA_BAR[:4]))))
    expected = [-0.411 - 0.363j, -0.411 + 0.363j, 0.867 - 0.139j, 0.867 + 0.139j]
    np.testing.assert_allclose(poles, expected, atol=6e-4)
    with pytest.raises(ValueError, match="read-only"):
        THETA_BAR[0] = 0.0


def test_linear_parameters_are_normalised_and_carry_the_delay():
    found = linear_parameters(control.tf([2.0], [2.0, 1.0, 0.0, 0.0], dt=1))
    assert (found.na, found.nb, found.nk) == (3, 1, 3)
    np.testing.assert_allclose(found.theta, [0.5, 0.0, 0.0, 1.0])
    gain = linear_parameters(control.tf([3.0], [2.0], dt=1))
    assert isinstance(gain, LinearParameters)
    assert (gain.theta.tolist(), *gain[1:]) == ([1.5], 0, 1, 0)
    assert linear_parameters(control.tf([0.0], [1.0, 0.5], dt=1)).nb == 0
    assert not simulate_arx(control.tf([0.0], [1.0, 0.5], dt=1), [1.0, 1.0]).y.any()


# --- noise ---


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 3), st.integers(0, 3), st.integers(0, 3), st.booleans())
def test_equations_11_to_14_term_by_term(seed, na, nb, nk, moving):
    if na + nb == 0:
        nb = 1
    rng = np.random.default_rng(seed)
    u, v = rng.normal(size=(2, 25))
    theta = 0.2 * rng.normal(size=(25, na + nb)) if moving else stable_theta(rng, na, nb)
    path = np.broadcast_to(theta, (25, na + nb))
    for simulate, inside in zip(SIMULATORS, (True, False), strict=True):
        found = simulate(theta, u, noise=v, na=na, nb=nb, nk=nk)
        np.testing.assert_allclose(found.y, by_definition(path, u, v, na, nk, inside), atol=1e-10)
        np.testing.assert_allclose(found.y_clean, by_definition(path, u, 0 * v, na, nk, inside), atol=1e-10)
        np.testing.assert_array_equal(found.theta, path)


@pytest.mark.parametrize("noise", [
    stats.norm(scale=0.3), stats.t(3), stats.norm, Contaminated(0.1, 10.0, 0.1**0.5),
], ids=["frozen", "heavy", "generic", "contaminated"])  # fmt: skip
@pytest.mark.parametrize("simulate", SIMULATORS)
def test_any_distribution_serves_as_noise(simulate, noise):
    u = np.ones(400)
    first = simulate(G, u, noise=noise, rng=5)
    for again in (noise, noise.rvs(size=400, random_state=np.random.default_rng(5))):
        np.testing.assert_array_equal(first.y, simulate(G, u, noise=again, rng=5).y)
    assert (first.y != simulate(G, u, noise=noise, rng=6).y).any()
    np.testing.assert_array_equal(first.y_clean, simulate(G, u).y)


def test_the_global_random_state_is_neither_used_nor_moved():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    simulate_arx(G, np.ones(10), noise=stats.norm)
    random_walk(THETA, 1e-3, 10)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert (simulate_arx(G, np.ones(9), noise=stats.norm).y != simulate_arx(G, np.ones(9), noise=stats.norm).y).any()


@pytest.mark.parametrize("simulate", SIMULATORS)
def test_the_result_shares_no_memory_with_the_arguments_which_may_be_columns_of_pandas(simulate):
    given = np.ones(5), np.ones(5), np.tile(THETA, (5, 1))
    found = simulate(given[2], given[0], noise=given[1], na=2, nb=2)
    u, noise = (pd.Series(values, range(5, 10)) for values in given[:2])
    np.testing.assert_array_equal(simulate(given[2], u, noise=noise, na=2, nb=2).y, found.y)
    assert not any(np.shares_memory(part, one) for part in found for one in (*given, *found) if part is not one)


# --- eqs (8)-(10) ---


def test_equation_8_steps_have_covariance_Q():
    Q, n = np.array([[2.0, 0.6], [0.6, 0.5]]) * 1e-4, 20_000
    path = random_walk([1.0, -1.0], Q, n, rng=0)
    assert path[0].tolist() == [1.0, -1.0]
    steps, variances = np.diff(path, axis=0), np.diag(Q)
    # Five standard errors of a normal sample's moments.
    bound = 5 * np.sqrt(np.outer(variances, variances) / n)
    assert (np.abs(steps.T @ steps / (n - 1) - Q) < np.sqrt(bound**2 + 25 * Q**2 / n)).all()
    assert (np.abs(steps.mean(0)) < 5 * np.sqrt(variances / n)).all()
    assert (np.abs(steps[1:].T @ steps[:-1] / n) < bound).all()


def test_equations_9_and_10_are_an_autoregression_by_the_steps_of_equation_8():
    C = np.array([[0.9, 0.1], [0.0, 0.8]])
    for Q in (0.0, 0.19 * np.eye(2)):
        walk, path = (random_walk([1.0, 2.0], Q, 500, rng=3, C=matrix) for matrix in (None, C))
        np.testing.assert_allclose(path[1:] - path[:-1] @ C.T, np.diff(walk, axis=0), atol=1e-12)


def test_a_number_stands_for_its_multiple_of_the_identity_and_what_a_singular_Q_lets_stand_stays():
    np.testing.assert_array_equal(random_walk(THETA, 1e-3, 20, rng=1), random_walk(THETA, 1e-3 * np.eye(4), 20, rng=1))
    path = random_walk(THETA, np.diag([1e-3, 0.0, 1e-3, 0.0]), 200, rng=0)
    assert (path[:, [1, 3]] == THETA[[1, 3]]).all() and (np.diff(path[:, [0, 2]], axis=0) != 0).all()


def test_a_refused_step_keeps_theta_also_under_C():
    calls = []

    def accept(theta):
        calls.append(theta.copy())
        return len(calls) != 3

    path = random_walk([1.0], 0, 4, accept=accept, C=[[0.5]])
    assert path.ravel().tolist() == [1.0, 0.5, 0.5, 0.25]


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 6), st.floats(0.2, 1.5))
def test_stable_looks_at_the_poles(seed, na, radius):
    rng = np.random.default_rng(seed)
    theta = stable_theta(rng, na, 2, radius=0.999 * radius)
    assert stable(na, radius)(theta)
    if na:
        outside = np.poly([1.01 * radius, *rng.uniform(-radius, radius, na - 1)])[1:]
        assert not stable(na, radius)(outside)
