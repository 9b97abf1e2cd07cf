"""A million updates, two in five of them outliers of any size."""

import numpy as np
import pytest
import support

from robust_filterpy import RobustKalmanFilter

# The joint one goes by the definition, some half a millisecond a step.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(2400)]

STEPS = 1_000_000
CHUNK = 10_000


def outliers(rng, shape):
    """Outliers of either sign, their size uniform in the exponent up to 1e300."""
    return rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(0, 300, shape)


@pytest.mark.parametrize("dims, choices", [((2, 1), {}), ((4, 2), {"scaling": "bounded", "grouping": "joint"})])
def test_p_stays_positive_definite_and_x_finite(dims, choices):
    problem = support.random_problem(71, *dims)
    kf, rng = support.make(RobustKalmanFilter, problem, **choices), np.random.default_rng(0)
    largest = 0.0
    for _ in range(STEPS // CHUNK):
        zs = rng.normal(size=(CHUNK, dims[1])) * np.sqrt(np.diag(problem.R))
        bad = rng.random(zs.shape) < 0.4
        zs[bad] = outliers(rng, bad.sum())
        support.through(kf, zs)
        support.assert_positive_definite(kf.P)
        support.assert_all_finite(kf)
        largest = max(largest, np.abs(kf.x).max(), np.abs(kf.P).max())
    assert largest < 1e3
