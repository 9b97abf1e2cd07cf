"""What the adapters to libraries of series share: a model where none was given, each series from its own beginning."""

import re
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from numpy.testing import assert_allclose

from robust_filterpy import RobustKalmanFilter, robust
from robust_filterpy.adapters import series
from robust_filterpy.adapters.series import SeriesModel


def recording(seed=0, steps=100, columns=2):
    """Levels that wander, measured with an outlier in twenty, and values that are missing."""
    rng = np.random.default_rng(seed)
    levels = np.cumsum(0.5 * rng.normal(size=(steps, columns)), axis=0)
    values = levels + np.where(rng.random(levels.shape) < 0.05, 30.0, 1.0) * rng.normal(size=levels.shape)
    values[60:63, 0] = np.nan
    return values, levels


@pytest.mark.parametrize("smoothed", [False, True])
def test_estimates_are_near_the_truth_also_where_values_are_missing_or_wild(smoothed):
    values, levels = recording()
    found = SeriesModel.of(None, values).estimates(values, smoothed=smoothed)
    assert found.shape == values.shape and np.abs(found - levels).max() < 5.0
    assert np.sqrt(np.mean((found - levels) ** 2)) < (0.7 if smoothed else 0.9)


def test_units_change_nothing():
    values, _ = recording()
    units = np.array([1e-6, 1e5])
    found = [SeriesModel.of(None, z).estimates(z) / u for z, u in ((values, np.ones(2)), (values * units, units))]
    assert_allclose(found[1], found[0], rtol=1e-3, atol=1e-3)


def test_each_column_is_looked_after_by_itself():
    values, _ = recording()
    both = SeriesModel.of(None, values).estimates(values)
    alone = SeriesModel.of(None, values[:, 1:]).estimates(values[:, 1:])
    assert_allclose(both[:, 1:], alone)


def test_a_series_begins_at_its_own_level_and_changes_no_other():
    values, _ = recording()
    model = SeriesModel.of(None, values)
    first = model.estimates(values)
    assert_allclose(model.estimates(values + 1e6) - 1e6, first, atol=1e-6)
    assert_allclose(model.estimates(values), first)


def test_an_outlier_in_front_is_not_where_a_series_begins():
    values, levels = recording(steps=60, columns=1)
    values[0] = 1e4
    assert np.abs(SeriesModel.of(None, values).estimates(values)[5:] - levels[5:]).max() < 5.0


def test_a_filter_that_is_told_is_used_as_it_stands():
    values, _ = recording()
    theirs = KalmanFilter(2, 2)
    theirs.H, theirs.Q, theirs.P = np.eye(2), 0.25 * np.eye(2), 100.0 * np.eye(2)
    model = SeriesModel.of(theirs, values)
    expected = robust(theirs).batch_filter(values)[0][..., 0]
    assert_allclose(model.estimates(values), expected)
    assert_allclose(SeriesModel.of(robust(theirs), values).estimates(values, states=True), expected)
    assert not theirs.x.any()


def test_a_column_that_stands_still_is_its_own_estimate():
    column = np.full((30, 1), 7.0)
    assert_allclose(SeriesModel.of(None, column).estimates(column), column, atol=1e-6)


@pytest.mark.parametrize("column", [np.arange(4.0), np.full(20, np.nan)])
def test_columns_too_short_to_tell_their_noises_are_said_and_estimated(column):
    with pytest.warns(UserWarning, match=r"value\(s\) do not tell their noises, which are guessed"):
        model = SeriesModel.of(None, column[:, None])
    assert np.isfinite(model.estimates(column[:, None])).all()


def test_of_a_long_series_the_latest_values_tell_the_noises(monkeypatch):
    monkeypatch.setattr(series, "LATEST", 50)
    values = recording(columns=1)[0]
    values[-20:] = np.nan
    whole, latest = SeriesModel.of(None, values), SeriesModel.of(None, values[~np.isnan(values)][-50:, None])
    assert_allclose(whole.filters[0].R, latest.filters[0].R, rtol=0.1)
    assert SeriesModel.of(None, values[:30]).filters[0].R[0, 0] != pytest.approx(whole.filters[0].R[0, 0], rel=0.1)


def test_what_does_not_fit_is_refused():
    values, _ = recording()
    model = SeriesModel.of(None, values[:30])
    with pytest.raises(ValueError, match=r"expected 2 column\(s\), as in fit, got 1"):
        model.estimates(values[:, :1])
    with pytest.raises(ValueError, match=r"expected 1 column\(s\), the filter's dim_z, got 2"):
        SeriesModel.of(RobustKalmanFilter(2, 1), values)
    with pytest.raises(TypeError, match="expected a linear filter of filterpy's kind or None, got Extended"):
        SeriesModel.of(ExtendedKalmanFilter(2, 2), values)
    for refused in (lambda z: SeriesModel.of(None, z), model.estimates):
        with pytest.raises(ValueError, match="got infinity"):
            refused(np.where(values == values[5], np.inf, values))


# The code of the page on adapters runs as it stands, where its library is installed.


PAGE = Path(__file__).parents[2] / "docs" / "adapters.md"


@pytest.mark.parametrize("library", ["sktime", "darts", "river"])
def test_the_code_of_the_page_runs(library):
    pytest.importorskip(library)
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if f"from {library}" in b)
    exec(compile(block, str(PAGE), "exec"), {})
