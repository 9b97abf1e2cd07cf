"""The transformer keeps sktime's contract, and its estimates are those of the filters that it stands for."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("sktime")
from sktime.utils.estimator_checks import check_estimator

from robust_filterpy.adapters.series import SeriesModel
from robust_filterpy.adapters.sktime import RobustKalmanTransformer


def recording():
    rng = np.random.default_rng(0)
    z = np.cumsum(rng.normal(size=60)) + rng.normal(size=60)
    z[30] = 1000.0
    return pd.Series(z, index=pd.period_range("2026-01", periods=60, freq="M"), name="sold")


@pytest.mark.engines
def test_it_passes_the_checks_of_estimators():
    results = check_estimator(RobustKalmanTransformer(), verbose=False)
    assert len(results) > 50 and {name: found for name, found in results.items() if found != "PASSED"} == {}


def test_estimates_are_those_of_the_model_with_the_index_of_the_series():
    series = recording()
    found = RobustKalmanTransformer().fit_transform(series)
    values = series.to_numpy()[:, None]
    assert_allclose(found, SeriesModel.of(None, values).estimates(values)[:, 0])
    assert found.index.equals(series.index) and abs(found.iloc[30] - found.iloc[29]) < 10


def test_every_series_of_a_panel_is_filtered_by_itself():
    series = recording()
    panel = pd.concat({"a": series.to_frame(), "b": 100.0 * series.to_frame()}, names=["key", "month"])
    found = RobustKalmanTransformer(smoothed=True).fit_transform(panel)
    assert found.index.equals(panel.index)
    assert_allclose(found.loc["b"], 100.0 * found.loc["a"], rtol=1e-3)
