"""filterpy's functions and `filter_series` take the options that a filter takes."""

import inspect

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robust_filterpy import Contaminated, RobustKalmanFilter, filter_series
from robust_filterpy.correction import SingularInnovationError
from robust_filterpy.filters import functions


def test_functions_show_every_option_of_a_filter():
    options = [name for name in inspect.signature(RobustKalmanFilter).parameters if not name.startswith("dim")]
    for function in (functions.update, functions.batch_filter, filter_series):
        assert set(options) <= set(inspect.signature(function).parameters)


def test_update_with_a_noise_is_that_of_a_filter_with_it():
    kf = RobustKalmanFilter(1, 1, noise=Contaminated(0.1, 8.0))
    kf.x, kf.P, kf.H, kf.R = np.zeros(1), np.eye(1), np.eye(1), np.eye(1)
    kf.update(7.0)
    x, P = functions.update(np.zeros(1), np.eye(1), 7.0, 1.0, np.eye(1), noise=Contaminated(0.1, 8.0))
    assert_allclose(x, kf.x)
    assert_allclose(P, kf.P)


def test_many_series_have_no_patience():
    with pytest.raises(ValueError, match="patience: expected None for filter_series"):
        filter_series(np.zeros((1, 3, 1)), np.eye(1), np.eye(1), np.eye(1), np.eye(1), [0.0], np.eye(1), patience=3)


def test_under_noise_a_user_s_inverse_changes_nothing_and_a_singular_S_is_an_error():
    kf, other = (RobustKalmanFilter(1, 1, noise=Contaminated(0.1, 8.0)) for _ in range(2))
    for one in (kf, other):
        one.x, one.P, one.H, one.R = np.zeros(1), np.eye(1), np.eye(1), np.eye(1)
    kf.inv = np.linalg.pinv
    kf.update(7.0)
    other.update(7.0)
    assert_allclose(kf.x, other.x, rtol=1e-12)
    kf.P, kf.R = np.zeros((1, 1)), np.zeros((1, 1))
    with pytest.raises(SingularInnovationError, match="without noise="):
        kf.update(7.0)
