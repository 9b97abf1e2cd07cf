"""A tracker that is given nothing: it starts by itself, follows R, says when it is lost; its drift is found."""

import numpy as np
import pytest
import support
from filterpy.kalman import KalmanFilter
from recordings import THETA, A, B, assert_refused, recording, silence
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
    state = tracker.state()
    state["scale"][0] = 0.25 * factor
    tracker.restore(state)
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


def runs_of(y, u, over=GRID, **options):
    return {Q: ParameterTracker(FIR(1, nk=0), Q=Q, **options).run(y, u) for Q in over}


@pytest.mark.parametrize("contamination", [0.0, 0.2])
def test_the_drift_is_found_by_the_likelihood_of_predictions(contamination):
    recordings = [drifting_gain(contamination, seed=seed) for seed in range(5)]
    recordings[0][0][600:650] = np.nan
    each = [runs_of(*one, start=0) for one in recordings]
    chosen = [max(GRID, key=lambda Q: runs[Q].log_likelihood()) for runs in each]
    assert Q_TRUE / 4.0 <= np.median(chosen) <= 4.0 * Q_TRUE


def test_the_start_and_the_samples_after_it_do_not_count_and_a_bank_has_one_of_each():
    y, u = drifting_gain(samples=900, q=1e-4)
    result = ParameterTracker(FIR(1, nk=0), start=100, Q=1e-4).run(y, u)
    first = int(np.isinf(result.std[:, 0]).sum()) + 20
    assert 40 < first < 125
    residual = result.residual[first:]
    noise = Noise(START, (1.4826 * np.median(np.abs(residual))) ** 2).refitted(residual, 50)
    assert result.log_likelihood() == pytest.approx(noise.log_likelihood(residual), abs=1e-3)
    assert result.log_likelihood() == result.log_likelihood(first) != result.log_likelihood(200)
    bank = TrackerBank(2, FIR(1, nk=0), start=100, Q=1e-4).run(np.c_[y, y], u)
    assert bank.log_likelihood() == pytest.approx(result.log_likelihood())
    with pytest.raises(ValueError, match="at least 50 measured samples from sample 870 on, got 30"):
        result.log_likelihood(870)
