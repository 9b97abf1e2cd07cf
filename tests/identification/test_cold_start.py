"""A tracker that is given nothing: it starts by itself, follows R, says when it is lost; its drift can be tuned."""

import numpy as np
import pandas as pd
import pytest
import support
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_array_equal
from recordings import THETA, A, B, assert_refused, recording, same, silence
from scipy.integrate import trapezoid
from scipy.signal import lfilter
from scipy.stats import norm

from robust_filterpy import ARX, OutputError, ParameterTracker, RobustKalmanFilter, identify
from robust_filterpy.correction.contaminated import START, Contaminated
from robust_filterpy.identification import ARMAX, FIR, LinearRegression, LostTrackerWarning, TrackerBank
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.recursive.recursion import ordinary_mean
from robust_filterpy.influence import Huber

# The start.


@pytest.mark.parametrize(
    "structure", support.by_night([OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 2)], OutputError(2, 2)), ids=str
)
def test_given_nothing_it_finds_the_plant_the_level_and_the_noise(structure):
    y, u = recording(0, 1000)
    tracker = ParameterTracker(structure)
    tracker.run(20.0 + y, u)
    assert tracker.level == pytest.approx(20.0, abs=0.2)
    if structure.nf or structure.nc:
        np.testing.assert_allclose(tracker.theta[:4], THETA, atol=0.06)
        assert 0.05 < tracker.R < 0.2
        np.testing.assert_allclose(tracker.simulate(u[:50]), 20.0 + lfilter(B, A, u[:50]), atol=0.6)


def test_until_there_is_a_model_nothing_is_claimed():
    y, u = recording(0, 60)
    y += 5.0
    y[[0, 7]] = np.nan
    tracker = ParameterTracker(OutputError(2, 2))
    result = tracker.run(y[:40], u[:40])
    assert np.isinf(result.std).all() and np.isinf(tracker.std).all() and np.isnan(result.weights).all()
    assert tracker.predict() == np.nanmedian(y[:40])
    assert np.isfinite(tracker.run(y[40:], u[40:]).std[-1]).all()


def test_a_start_that_finds_no_model_says_why_once_and_goes_on_looking():
    y, u = recording(0, 1400, share=0.0)
    rests = np.arange(1400) < 820
    y[rests], u[rests] = 0.3 * np.random.default_rng(1).normal(size=820), 0.0
    tracker = ParameterTracker(OutputError(2, 2))
    with pytest.warns(LostTrackerWarning, match="no model can be made of 400 samples") as caught:
        tracker.run(y[:820], u[:820])
    assert len(caught) == 1 and np.isinf(tracker.std).all()
    tracker.run(y[820:], u[820:])
    np.testing.assert_allclose(tracker.theta, THETA, atol=0.1)


def test_what_is_given_keeps_its_meaning():
    assert ParameterTracker(ARX(1, 1), R=0.3).R == 0.3
    one = ParameterTracker(ARX(1, 1), theta=[0.1, 0.2])
    np.testing.assert_array_equal(one.theta, [0.1, 0.2])
    assert one.std.tolist() == [10.0, 10.0] and one.regressor == "measured" and one.offset == 0.0
    y, u = recording(0, 500)
    given = ParameterTracker(OutputError(2, 2), R=0.5)
    given.run(y, u)
    assert given.R == 0.5
    assert ParameterTracker(identify(y, u, ARX(1, 1)), R=0.5).R == 0.5
    with pytest.raises(ValueError, match="start: expected 0 with theta, P or a filter object or model"):
        ParameterTracker(ARX(1, 1), theta=0.0, start=100)
    wrong = {"start": [-1], "regressor": ["clean"], "R_memory": [1], "offset": [1.0]}
    assert_refused(ParameterTracker, {"structure": ARX(1, 1)}, wrong)


def test_a_filter_that_believes_parameters_to_move_by_one_is_asked_about():
    with pytest.warns(UserWarning, match="Q is I"):
        ParameterTracker(ARX(1, 1), filter=KalmanFilter(2, 1))
    with silence():
        ParameterTracker(ARX(1, 1), filter=KalmanFilter(2, 1), Q=1.0)
        ParameterTracker(ARX(1, 1), filter=RobustKalmanFilter)


# R.


def test_the_mean_that_R_is_followed_by_is_that_of_the_noise():
    e = np.linspace(-60.0, 60.0, 400001)
    for influence, density in (
        (None, norm.pdf(e)),
        (Contaminated(0.2, 5.0), 0.8 * norm.pdf(e) + 0.2 * norm.pdf(e, scale=5.0)),
    ):
        assert ordinary_mean(influence) == pytest.approx(trapezoid(np.minimum(e * e, 4.0) * density, e), abs=1e-6)
    # With a wide mixture it is no difference of large numbers.
    assert ordinary_mean(Contaminated(0.05, 5e9)) == pytest.approx(0.95 * ordinary_mean(None) + 0.05 * 4.0)


@pytest.mark.parametrize("factor", [1e-6, 1e-2, 1e2, 1e6])
def test_R_is_found_from_far_away_follows_a_step_of_the_noise_and_stays_once_it_is_set(factor):
    rng = np.random.default_rng(2)
    X = rng.normal(size=(4500, 3))
    y = X @ [1.0, 2.0, 3.0] + np.where(np.arange(4500) < 3000, 0.5, 1.5) * rng.normal(size=4500)
    tracker = ParameterTracker(LinearRegression(3), start=0)
    tracker.filter.R = np.array([[0.25 * factor]])
    for first, end, expected in ((0, 3000, 0.25), (3000, 3700, 2.25)):
        tracker.run(y[first:end], X[first:end])
        assert tracker.R == pytest.approx(expected, rel=0.4)
    tracker.R = 4.0
    tracker.run(y[3700:], X[3700:])
    assert tracker.R == 4.0


# The regressor.


@support.draws(1, 3)
def test_cleaned_outputs_keep_outliers_out_of_the_regressor(draws):
    errors = {"measured": [], "cleaned": []}
    for seed in range(draws):
        y, u = recording(seed, 600, share=0.0, sigma=0.5, inside=True)
        rng = np.random.default_rng(seed)
        y += np.where(rng.random(600) < 0.1, 5.0 * rng.normal(size=600), 0.0)
        for regressor, wrong in errors.items():
            tracker = ParameterTracker(ARX(2, 2), regressor=regressor)
            tracker.run(y, u)
            wrong.append(np.linalg.norm(tracker.theta - THETA))
    assert np.mean(errors["cleaned"]) < 0.4 * np.mean(errors["measured"])


def test_outliers_that_are_part_of_the_output_are_taken_back_into_the_regressor():
    """Outliers of the noise that drives an ARX are passed on by it: the outputs as measured explain the next sample."""
    y, u = recording(3, 1000, sigma=0.5, inside=True)
    measured, cleaned = (ParameterTracker(ARX(2, 2), regressor=name) for name in ("measured", "cleaned"))
    measured.run(y, u), cleaned.run(y, u)
    np.testing.assert_allclose(cleaned.theta, measured.theta, atol=0.03)


# Lost.


@pytest.mark.parametrize(("options", "change", "words"), [
    ({"R": 1e-6, "theta": THETA, "P": 1e-12}, lambda y: y, "R=1e-06 is too small"),
    ({"start": 0, "R": 0.09, "theta": THETA, "P": 1e-8}, lambda y: y + 20.0, "use offset=True"),
])  # fmt: skip
def test_a_lost_tracker_says_so_once(options, change, words):
    y, u = recording(0, 1000)
    tracker = ParameterTracker(OutputError(2, 2), **options)
    with pytest.warns(LostTrackerWarning, match=words) as caught:
        tracker.run(change(y), u)
        tracker.run(change(y), u)
    assert len([w for w in caught if w.category is LostTrackerWarning]) == 1


# Banks.


def test_a_bank_names_the_actuators_of_which_no_model_can_be_made():
    y, u = recording(0, 300)
    bank = TrackerBank(2, OutputError(2, 2), start=200, influence=Huber())
    with pytest.warns(LostTrackerWarning, match=r"actuator 1: no model can be made of 200 samples, it goes on looking"):
        bank.run(np.c_[y, np.zeros(300)], u)
    assert np.isfinite(bank.std[0]).all() and np.isinf(bank.std[1]).all()


# The drift that a tracker is given comes from the recording, whatever its outliers, and nothing else changes.


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
    recordings = [drifting_gain(contamination, seed=seed) for seed in range(5)]
    chosen = [tracker().tuned(*one, over={"Q": GRID}).best.values["Q"] for one in recordings]
    assert Q_TRUE / 4.0 <= np.median(chosen) <= 4.0 * Q_TRUE


def test_the_chosen_tracker_has_the_value_and_has_seen_nothing():
    y, u = drifting_gain()
    given = tracker(forgetting=0.99)
    before = given.state()
    found = given.tuned(y, u, over={"forgetting": [0.5, 0.9, 0.95, 0.98, 0.999]})
    assert found.tracker.forgetting == pytest.approx(found.best.values["forgetting"])
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


def test_every_pair_of_values_is_tried_and_shown_and_covariances_are_values_too():
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (1200, 2))
    y = np.cumsum(0.05 * rng.normal(size=1200)) * u[:, 0] + 1.0 * u[:, 1] + 0.3 * rng.normal(size=1200)
    right, wrong = np.diag([0.0025, 0.0]), np.diag([0.0, 0.0025])
    over = {"Q": [wrong, right], "forgetting": [0.5, 0.9, 1.0]}
    found = ParameterTracker(FIR((1, 1), nk=0), start=0).tuned(y, u, over=over)
    assert_array_equal(found.best.values["Q"], right)
    assert len(found.rows) == 6 and len(str(found).splitlines()) == 8
    assert "chosen" in str(found) and "trace 0.0025" in str(found)
    frame = found.to_frame()
    assert list(frame) == ["Q", "forgetting", "log_likelihood"]
    assert frame.log_likelihood.max() == found.best.log_likelihood


@pytest.mark.parametrize("q, over, ones", [(Q_TRUE, [1e-9, 1e-8], "larger"), (1e-6, [0.0, 1e-5, 1e-2], "smaller")])
def test_the_end_of_the_grid_is_said_though_0_was_tried(q, over, ones):
    with pytest.warns(UserWarning, match=f"at the end of what was tried; try {ones} ones"):
        found = tracker().tuned(*drifting_gain(q=q), over={"Q": over})
    assert found.best.values == {"Q": over[1]} and "Doubtful" in str(found)


def test_missing_samples_and_tables_are_taken():
    y, u = drifting_gain()
    y[600:650] = np.nan
    table = pd.DataFrame({"y": y, "u": u}, index=pd.date_range("2024", periods=y.size, freq="s"))
    found = tracker().tuned(table.y, table.u, over={"Q": GRID})
    assert found.samples == 1000 - 50 - 20
    assert found.best == tracker().tuned(y, u, over={"Q": GRID}).best
    with pytest.raises(ValueError, match="uniform index"):
        tracker().tuned(table.y.drop(table.index[9]), table.u.drop(table.index[9]), over={"Q": GRID})


@pytest.mark.parametrize(("over", "match"), [
    ({}, "over: expected values to try by name"),
    ({"R": [1.0]}, "over: expected values to try by name"),
    ([1e-6], "over: expected values to try by name"),
    ({"Q": 1e-6}, r"over\['Q'\]: expected a sequence"),
    ({"Q": []}, r"over\['Q'\]: expected a sequence.*got \[\]"),
    ({"Q": [-1.0]}, "Q: expected"),
    ({"forgetting": [1.5]}, "forgetting: expected"),
])  # fmt: skip
def test_what_cannot_be_tried_is_refused(over, match):
    with pytest.raises((ValueError, TypeError), match=match):
        tracker().tuned(*drifting_gain(), over=over)


def test_too_short_a_recording_is_refused_and_a_frozen_tracker():
    y, u = drifting_gain(samples=430)
    words = "at least 50 measured samples after the first 420, of the start"
    with pytest.raises(ValueError, match=words):
        ParameterTracker(FIR(1, nk=0)).tuned(y, u, over={"Q": [1e-6, 1e-5]})
    frozen = tracker()
    frozen.enabled = False
    with pytest.raises(ValueError, match="enabled=False"):
        frozen.tuned(y, u, over={"Q": [1e-6]})
    # The values are looked at before the recording is.
    with pytest.raises(ValueError, match="Q: expected"):
        ParameterTracker(OutputError(1, 1)).tuned(y, u, over={"Q": [np.nan]})
