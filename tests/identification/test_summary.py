"""The summary of a model shows its own numbers, as a table that fits a screen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import FIR


@pytest.fixture(scope="module")
def model():
    rng = np.random.default_rng(3)
    u = rng.choice([-1.0, 1.0], 500)
    y = np.zeros(500)
    for k in range(1, 500):
        y[k] = 0.5 * y[k - 1] + u[k - 1]
    y += 3.0 + np.where(rng.random(500) < 0.1, 5.0, 0.2) * rng.normal(size=500)
    y[::50] = np.nan
    return identify(y, u, OutputError(1, 1))


def test_rows_are_the_parameters_and_the_offset(model):
    rows = model.summary(level=0.9).rows
    assert [row.name for row in rows] == ["a1", "b1", "offset"]
    half = norm.ppf(0.95)
    for row, value, std in zip(rows, [*model.theta, model.offset], [*model.std, model.offset_std], strict=True):
        assert (row.estimate, row.std, row.z) == (value, std, pytest.approx(value / std))
        assert (row.lower, row.upper) == (pytest.approx(value - half * std), pytest.approx(value + half * std))


def test_the_text_fits_a_screen_and_says_everything(model):
    text = str(model.summary())
    assert repr(model.summary()) == text
    with pytest.warns(DeprecationWarning, match="findings"):
        assert replace(model.summary(), findings="a step").found == "a step"
    lines = text.splitlines()
    assert max(map(len, lines)) <= 78
    # The rules are as wide as the columns between them.
    head = next(line for line in lines if "estimate" in line)
    assert {len(line) for line in lines if not line.strip("=-")} == {len(head)}
    known = int((~np.isnan(model.weights)).sum())
    for part in (
        "OutputError(na=1, nb=1, nk=1)",
        f"{known} of 500",
        f"{model.R:.4g}",
        "2.5 %",
        "97.5 %",
        "Fit, 1 step",
    ):
        assert part in text
    assert "Doubtful" not in text


def test_own_fit_is_that_of_the_ordinary_samples(model):
    # Noise .2 beside a signal of variance 1/(1 - .25).
    assert model.own_fit == pytest.approx(100 * (1 - 0.2 / np.sqrt(4 / 3 + 0.04)), abs=2.0)


def test_a_warning_is_in_the_text(model):
    assert "Doubtful: two models" in str(replace(model, warning="two models").summary())


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2)], ids=str)
def test_a_parameter_that_is_held_has_no_z_and_the_table_says_held(structure):
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], 400)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + 0.1 * rng.normal(size=400)
    summary = identify(y, u, structure, fixed={"a1": -1.5}).summary()
    held, *free = summary.rows
    assert (held.name, held.estimate, held.std, held.lower, held.upper) == ("a1", -1.5, 0.0, -1.5, -1.5)
    assert np.isnan(held.z)
    assert all(np.isfinite(row.z) and row.std > 0.0 for row in free)
    said = {line.split()[0]: line.split()[1:] for line in str(summary).splitlines() if line.startswith(("a", "b"))}
    assert said["a1"] == ["-1.5", "held"]
    assert all(len(said[row.name]) == 5 for row in free if row.name != "offset")
    assert "inf" not in str(summary)


def test_as_a_frame(model):
    pytest.importorskip("pandas")
    frame = model.summary().to_frame()
    assert list(frame.index) == ["a1", "b1", "offset"] and list(frame) == ["estimate", "std", "z", "lower", "upper"]
    assert frame.loc["b1", "estimate"] == model.theta[1]


def test_a_tracker_has_one_too():
    tracker = ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0], P=0.01, R=0.1)
    rows = tracker.summary().rows
    assert [(row.name, row.estimate) for row in rows] == [("a1", -0.5), ("b1", 2.0)]
    assert rows[0].std == pytest.approx(0.1)
    assert "has not found a model" in str(ParameterTracker(FIR(1)).summary())


@pytest.mark.parametrize("level", [0.0, 1.0, 95])
def test_a_level_that_is_no_probability_is_refused(model, level):
    with pytest.raises(ValueError, match="level"):
        model.summary(level)
