"""The correction, sensor by sensor: what its equations promise, held to formulas from elsewhere."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robust_filterpy.correction import SingularInnovationError
from robust_filterpy.correction.definition import correct, innovation_moments
from robust_filterpy.correction.options import Choices, typical_length

pytestmark = pytest.mark.core


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
