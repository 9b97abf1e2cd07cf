"""The filtering model of Darts gives a series like its own, with our estimates."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from robust_filterpy import RobustKalmanFilter

pytest.importorskip("darts")
from darts import TimeSeries
from darts.models.filtering.filtering_model import FilteringModel

from robust_filterpy.adapters.darts import RobustKalmanModel
from robust_filterpy.adapters.series import SeriesModel


def recording(dtype=np.float64):
    rng = np.random.default_rng(0)
    z = np.cumsum(rng.normal(size=(60, 2)), axis=0) + rng.normal(size=(60, 2))
    z[30], z[40] = 1000.0, np.nan
    times = pd.date_range("2026-01-01", periods=60)
    return TimeSeries.from_times_and_values(times, z.astype(dtype), columns=["north", "south"])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("smoothed", [False, True])
def test_estimates_are_those_of_the_model_with_times_components_and_kind_of_number(dtype, smoothed):
    series = recording(dtype)
    model = RobustKalmanModel(smoothed=smoothed)
    assert isinstance(model, FilteringModel)
    found = model.filter(series)
    assert found.time_index.equals(series.time_index) and list(found.components) == ["north", "south"]
    assert found.dtype == dtype
    values = series.values().astype(float)
    assert_allclose(found.values(), SeriesModel.of(None, values).estimates(values, smoothed=smoothed), rtol=1e-5)


def test_what_was_fitted_is_what_filters_other_series():
    series = recording()
    model = RobustKalmanModel().fit(series)
    assert_allclose(model.filter(series + 1e4).values() - 1e4, model.filter(series).values(), atol=1e-6)


def test_a_filter_that_does_not_fit_and_samples_of_a_distribution_are_refused():
    series = recording()
    with pytest.raises(ValueError, match=r"expected 1 column\(s\), the filter's dim_z, got 2"):
        RobustKalmanModel(RobustKalmanFilter(2, 1)).filter(series)
    drawn = TimeSeries.from_values(np.zeros((30, 1, 5)))
    with pytest.raises(ValueError, match="deterministic"):
        RobustKalmanModel().filter(drawn)
