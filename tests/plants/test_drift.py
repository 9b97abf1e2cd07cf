"""A drifting parameter path that is judged many steps at a time is the one judged step by step."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robust_filterpy.plants import THETA_BAR, random_walk, stable


@pytest.mark.parametrize("radius", [1.0, 0.9])
@pytest.mark.parametrize("Q", [1e-6, 1e-4, 1e-2])
def test_path_is_that_of_the_test_called_for_every_step(Q, radius):
    inside = stable(4, radius)
    path = random_walk(THETA_BAR, Q, 700, rng=3, accept=inside)
    # A function is called with one theta after the other.
    assert_array_equal(path, random_walk(THETA_BAR, Q, 700, rng=3, accept=lambda theta: inside(theta)))
    if Q > 1e-5:
        assert (np.diff(path, axis=0) == 0).all(axis=1).any()


@pytest.mark.parametrize("na", [0, 1, 2, 4])
def test_many_thetas_are_judged_as_each_alone_also_on_the_circle(na):
    rng = np.random.default_rng(na)
    thetas = np.zeros((3000, na + 1))
    for theta in thetas:
        size = rng.choice([1.0, 1.0 - 1e-13, 1.0 + 1e-13, rng.uniform(0.9, 1.1)], size=na)
        poles = size * np.exp(1j * rng.uniform(0, np.pi, na))
        poles[1::2] = poles[: na // 2 * 2 : 2].conj()
        poles[na // 2 * 2 :] = size[na // 2 * 2 :]
        theta[:na] = np.poly(poles).real[1:] if na else []
    inside = stable(na)
    expected = [inside(theta) for theta in thetas]
    assert_array_equal(inside.rows(thetas), expected)
    assert na == 0 or 0 < np.mean(expected) < 1


def test_one_parameter_walks_too_and_its_steps_have_the_variance_that_was_told():
    path = random_walk([0.5], [[4.0]], 20001, rng=0)
    assert path.shape == (20001, 1) and path[0] == 0.5
    assert np.diff(path[:, 0]).std() == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("Q", [-1.0, [[1.0, 0.0], [0.0, -1e-6]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.4, 1.0]]])
def test_a_q_that_is_no_covariance_is_refused(Q):
    with pytest.raises(ValueError, match=r"^Q: expected a (positive semidefinite|symmetric) matrix"):
        random_walk([0.5, 0.1], Q, 10)
