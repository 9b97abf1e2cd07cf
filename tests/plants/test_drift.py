"""A drifting parameter path: its steps have the covariance that was told, and what is none is refused."""

import numpy as np
import pytest

from robust_filterpy.plants.drift import random_walk


def test_one_parameter_walks_too_and_its_steps_have_the_variance_that_was_told():
    path = random_walk([0.5], [[4.0]], 20001, rng=0)
    assert path.shape == (20001, 1) and path[0] == 0.5
    assert np.diff(path[:, 0]).std() == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("Q", [-1.0, [[1.0, 0.0], [0.0, -1e-6]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.4, 1.0]]])
def test_a_q_that_is_no_covariance_is_refused(Q):
    with pytest.raises(ValueError, match=r"^Q: expected a (positive semidefinite|symmetric) matrix"):
        random_walk([0.5, 0.1], Q, 10)
