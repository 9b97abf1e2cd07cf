"""The drift that a tracker is given comes from the recording, whatever its outliers, and nothing else changes."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from recordings import same
from scipy.stats import norm

from robust_filterpy import OutputError, ParameterTracker
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification import FIR
from robust_filterpy.identification.models.noise import Noise

Q_TRUE = 1e-3
GRID = Q_TRUE * 4.0 ** np.arange(-4, 5)


def drifting_gain(contamination=0.1, samples=1000, seed=1, q=Q_TRUE):
    """A gain that walks, with outliers ten times as large as the noise."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], samples)
    gain = 2.0 + np.cumsum(np.sqrt(q) * rng.normal(size=samples))
    noise = 0.3 * np.where(rng.random(samples) < contamination, 10.0, 1.0) * rng.normal(size=samples)
    return gain * u + noise, u


def tracker(**options):
    return ParameterTracker(FIR(1, nk=0), start=0, **options)


@pytest.mark.parametrize("contamination", [0.0, 0.2])
def test_the_drift_is_found(contamination):
    chosen = [
        tracker().tuned(*drifting_gain(contamination, seed=seed), over={"Q": GRID}).best.values["Q"]
        for seed in range(5)
    ]
    assert Q_TRUE / 4.0 <= np.median(chosen) <= 4.0 * Q_TRUE


def test_without_outliers_the_ranking_is_that_of_the_gaussian_likelihood():
    y, u = drifting_gain(0.0)
    found = tracker().tuned(y, u, over={"Q": GRID}, leave_out=100)
    gaussian = []
    for Q in GRID:
        residual = tracker(Q=Q).run(y, u).residual[100:]
        gaussian.append(norm.logpdf(residual, scale=residual.std()).sum())
    assert int(np.argmax(gaussian)) == found.rows.index(found.best)


def test_a_wild_sample_changes_no_choice():
    y, u = drifting_gain()
    wild = y.copy()
    wild[300:900:100] = 1e9
    pairs = [tracker().tuned(signal, u, over={"Q": GRID}).best.values for signal in (y, wild)]
    assert pairs[0] == pairs[1]


def test_the_chosen_tracker_has_the_value_and_has_seen_nothing():
    y, u = drifting_gain()
    given = tracker(forgetting=0.99)
    before = given.state()
    found = given.tuned(y, u, over={"forgetting": [0.5, 0.9, 0.95, 0.98, 0.999]})
    assert found.tracker.forgetting == pytest.approx(found.best.values["forgetting"])
    assert found.tracker.get_params()["forgetting"] == found.best.values["forgetting"]
    same(given.state(), before)
    assert_array_equal(found.tracker.theta, given.theta)
    # The run is that of a tracker made with the value, also after a reset.
    expected = tracker(forgetting=found.best.values["forgetting"]).run(y, u).theta
    assert_array_equal(found.tracker.run(y, u).theta, expected)
    found.tracker.reset()
    assert_array_equal(found.tracker.run(y, u).theta, expected)


def test_the_start_is_the_same_for_every_value_and_does_not_count():
    y, u = drifting_gain(samples=900, q=1e-4)
    found = ParameterTracker(FIR(1, nk=0)).tuned(y, u, over={"Q": [1e-6, 1e-4, 1e-2]})
    assert found.samples == 900 - 400 - 20
    for row in found.rows:
        residual = ParameterTracker(FIR(1, nk=0), Q=row.values["Q"]).run(y, u).residual[420:]
        scale = 1.4826 * np.median(np.abs(residual))
        noise = Noise(START, scale**2).refitted(residual, 50)
        assert row.log_likelihood == pytest.approx(noise.log_likelihood(residual), abs=1e-3)


def test_every_pair_of_values_is_tried_and_shown():
    y, u = drifting_gain()
    found = tracker().tuned(y, u, over={"Q": [0.0, 1e-3, 1.0], "forgetting": [0.5, 0.9, 1.0]})
    assert len(found.rows) == 9
    assert {tuple(row.values) for row in found.rows} == {("Q", "forgetting")}
    text = str(found)
    assert len(text.splitlines()) == 11 and "chosen" in text
    frame = found.to_frame()
    assert list(frame) == ["Q", "forgetting", "log_likelihood"]
    assert frame.log_likelihood.max() == found.best.log_likelihood


def test_covariances_are_values_too():
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (1200, 2))
    first = np.cumsum(0.05 * rng.normal(size=1200))
    y = first * u[:, 0] + 1.0 * u[:, 1] + 0.3 * rng.normal(size=1200)
    right, wrong = np.diag([0.0025, 0.0]), np.diag([0.0, 0.0025])
    found = ParameterTracker(FIR((1, 1), nk=0), start=0).tuned(y, u, over={"Q": [wrong, right]})
    assert_array_equal(found.best.values["Q"], right)
    assert "trace 0.0025" in str(found)


@pytest.mark.parametrize("q, over, ones", [(Q_TRUE, [1e-9, 1e-8], "larger"), (1e-6, [0.0, 1e-5, 1e-2], "smaller")])
def test_the_end_of_the_grid_is_said_though_0_was_tried(q, over, ones):
    with pytest.warns(UserWarning, match=f"at the end of what was tried; try {ones} ones"):
        found = tracker().tuned(*drifting_gain(q=q), over={"Q": over})
    assert found.best.values == {"Q": over[1]} and "Doubtful" in str(found)


def test_missing_samples_and_tables_are_taken():
    y, u = drifting_gain()
    y[600:650] = np.nan
    table = pd.DataFrame({"y": y, "u": u}, index=pd.date_range("2024", periods=y.size, freq="s"))
    found = tracker().tuned(table.y, table.u, over={"Q": GRID}, leave_out=20)
    assert found.samples == 1000 - 50 - 20
    assert found.best == tracker().tuned(y, u, over={"Q": GRID}, leave_out=20).best
    with pytest.raises(ValueError, match="uniform index"):
        tracker().tuned(table.y.drop(table.index[9]), table.u.drop(table.index[9]), over={"Q": GRID})


@pytest.mark.parametrize(("over", "match"), [
    ({}, "over: expected values to try by name"),
    ({"R": [1.0]}, "over: expected values to try by name"),
    ([1e-6], "over: expected values to try by name"),
    ({"Q": 1e-6}, r"over\['Q'\]: expected a sequence"),
    ({"Q": []}, r"got no value of Q"),
    ({"Q": [-1.0]}, "Q: expected"),
    ({"forgetting": [1.5]}, "forgetting: expected"),
])  # fmt: skip
def test_what_cannot_be_tried_is_refused(over, match):
    with pytest.raises((ValueError, TypeError), match=match):
        tracker().tuned(*drifting_gain(), over=over)


def test_too_short_a_recording_is_refused_and_a_frozen_tracker():
    y, u = drifting_gain(samples=430)
    words = "at least 50 measured samples after the first 420, of which 400 are the start"
    with pytest.raises(ValueError, match=words):
        ParameterTracker(FIR(1, nk=0)).tuned(y, u, over={"Q": [1e-6, 1e-5]})
    frozen = tracker()
    frozen.enabled = False
    with pytest.raises(ValueError, match="enabled=False"):
        frozen.tuned(y, u, over={"Q": [1e-6]})
    # The values are looked at before the recording is.
    with pytest.raises(ValueError, match="Q: expected"):
        ParameterTracker(OutputError(1, 1)).tuned(y, u, over={"Q": [np.nan]})
