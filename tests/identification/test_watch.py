"""A tracker that has lost its plant says so, and starts anew; one that has not stays silent."""

import warnings

import numpy as np
import pytest
import support
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, FIR, BoxJenkins, OutputError, ParameterTracker
from robust_filterpy.identification.models import dependence as gain
from robust_filterpy.identification.models.dependence import autocovariances, dependence
from robust_filterpy.identification.recursive.watch import LostTrackerWarning, _moved

A, B = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5])
THETA = np.array([-1.5, 0.7, 1.0, 0.5])


def plant(seed, length=400, hold=1, gain=1.0, b=B, a=A, size=1.0):
    rng = np.random.default_rng([27, seed])
    u = rng.choice([-1.0, 1.0], length).repeat(hold)[:length]
    wild = np.where(rng.random(length) < 0.1, 10.0, 1.0)
    model, true = lfilter(B, A, u), gain * lfilter(b, a, u)
    return true + 0.3 * size * wild * rng.normal(size=length) - model, model, u


def window(residual, model, u):
    return residual[-120:], np.column_stack((model, u))[-120:]


@pytest.mark.parametrize("change", [{"gain": 1.3}, {"gain": 2.0}, {"gain": -1.0}, {"a": np.poly([0.8, 0.6])}], ids=str)
def test_the_residuals_of_another_plant_follow_the_inputs(change):
    for seed in range(20):
        assert dependence(*window(*plant(seed, hold=1 + 7 * (seed % 2), **change))).significant


def test_the_residuals_of_a_right_model_do_not():
    for seed in range(100):
        quiet = plant(seed, hold=1 + 19 * (seed % 2), size=3.0 if seed % 3 else 1.0)
        assert not dependence(*window(*quiet)).significant


def test_coloured_noise_and_a_slow_input_look_alike_only_by_chance():
    found = []
    for seed in range(100):
        rng = np.random.default_rng([29, seed])
        u = rng.choice([-1.0, 1.0], 20).repeat(20)
        residual = lfilter([1.0], [1.0, -0.8], rng.normal(size=400))
        found.append(dependence(*window(residual, lfilter(B, A, u), u), whitening=(-0.8,)).significant)
    assert not any(found)


def test_windows_are_judged_each_for_itself():
    windows = [window(*plant(seed, gain=1.0 + seed % 2)) for seed in range(6)]
    windows[3][0][::7] = np.nan
    together = dependence(*(np.stack(part) for part in zip(*windows, strict=True)))
    alone = [dependence(*each) for each in windows]
    np.testing.assert_allclose(together.share, [one.share for one in alone])
    np.testing.assert_array_equal(together.significant, [False, True] * 3)


def test_nothing_known_shows_nothing():
    residual, signals = window(*plant(1))
    assert not dependence(np.full_like(residual, np.nan), signals).significant
    assert not dependence(np.zeros_like(residual), signals).significant
    assert not dependence(residual, np.ones_like(signals)).significant


def broken(seed=1, length=1600, at=900):
    rng = np.random.default_rng([28, seed])
    u = rng.choice([-1.0, 1.0], length)
    wild = np.where(rng.random(length) < 0.1, 10.0, 1.0)
    y = lfilter(B, A, u) * np.where(np.arange(length) < at, 1.0, 2.0)
    return y + 0.3 * wild * rng.normal(size=length), u


def test_a_tracker_that_has_lost_its_plant_says_so_in_time_and_starts_anew():
    y, u = broken()
    tracker = ParameterTracker(OutputError(2, 2), Q=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracker.run(y[:900], u[:900])
    with pytest.warns(LostTrackerWarning, match="the plant is no longer the model's.*starts anew, and theta may jump"):
        tracker.run(y[900:1100], u[900:1100])
    tracker.run(y[1100:], u[1100:])
    np.testing.assert_allclose(tracker.theta, THETA * [1.0, 1.0, 2.0, 2.0], atol=0.15)


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("cut", [890, 933])
@pytest.mark.parametrize("start", [0, 400])
def test_an_interrupted_tracker_finds_its_loss_at_the_same_sample_bit_for_bit(cut, start):
    y, u = broken()
    tracker = ParameterTracker(OutputError(2, 2), Q=0.0)
    other = ParameterTracker(OutputError(2, 2), Q=0.0, start=start, offset=True, regressor="cleaned")
    tracker.run(y[:cut], u[:cut])
    other.restore(tracker.state())
    with pytest.warns(LostTrackerWarning):
        expected = tracker.run(y[cut:], u[cut:])
    with pytest.warns(LostTrackerWarning):
        found = other.run(y[cut:], u[cut:])
    for one, two in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, two)
    assert_same(tracker.state(), other.state())


def test_what_was_watched_belongs_to_the_state_and_not_to_the_object():
    y, u = broken()
    tracker, fresh = (ParameterTracker(OutputError(2, 2)) for _ in range(2))
    with pytest.warns(LostTrackerWarning):
        tracker.run(y, u)
    tracker.reset()
    assert_same(tracker.state(), fresh.state())
    assert not tracker.state()["followed"].size
    without = {name: value for name, value in tracker.state().items() if name not in ("watch", "followed")}
    tracker.run(y[:600], u[:600])
    tracker.restore(without)
    assert_same(tracker.state(), fresh.state())


@pytest.mark.parametrize("place, value", [(0, 0.5), (1, 0.0), (2, -1.0), (2, 1.5), (3, -1.0), (4, np.nan)])
def test_a_watch_that_cannot_be_is_refused_and_changes_nothing(place, value):
    tracker = ParameterTracker(OutputError(2, 2))
    before = tracker.state()
    damaged = before["watch"].copy()
    damaged[place] = value
    changes = ({"watch": damaged}, {"watch": np.array(1.0)}, {"followed": np.zeros((3, 2))})
    for change in changes:
        with pytest.raises(ValueError, match=r"watch|followed"):
            tracker.restore({**before, **change})
    assert_same(tracker.state(), before)


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)


def test_a_model_that_the_user_gave_is_not_replaced():
    y, u = broken(3)
    tracker = ParameterTracker(OutputError(2, 2), theta=THETA, P=1e-6, R=0.09)
    tracker.run(y, u)
    assert not tracker.now.starts


# What a model leaves from the beginning is usual.


def arx_on_an_output_error(seed, length=1200, change=1.0):
    rng = np.random.default_rng([30, seed])
    u = rng.choice([-1.0, 1.0], length)
    y = lfilter(B, A, u) * np.where(np.arange(length) < 800, 1.0, change)
    return y + 0.3 * np.where(rng.random(length) < 0.1, 10.0, 1.0) * rng.normal(size=length), u


def restarts(structure, y, u):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ParameterTracker(structure).run(y, u)
    return sum("starts anew" in str(w.message) for w in caught)


@support.draws(1, 2)
@pytest.mark.parametrize("structure", [ARX(2, 2), FIR(6)], ids=str)
def test_a_structure_that_does_not_fit_is_no_other_plant(structure, draws):
    assert sum(restarts(structure, *arx_on_an_output_error(seed)) for seed in range(draws)) == 0


def test_another_plant_is_still_seen_by_a_structure_that_does_not_fit():
    assert all(restarts(ARX(2, 2), *arx_on_an_output_error(seed, change=-1.0)) for seed in range(1))


def test_a_structure_that_is_too_small_is_said_once_and_by_its_name():
    y, u = arx_on_an_output_error(0)
    tracker = ParameterTracker(FIR(2))
    with pytest.warns(
        LostTrackerWarning, match=r"leaves follow the inputs: the structure is too small.*FIR\(nb=2"
    ) as caught:
        tracker.run(y, u)
    assert len(caught) == 1


def test_a_state_from_before_the_usual_share_was_kept_is_taken():
    y, u = broken()
    tracker = ParameterTracker(OutputError(2, 2))
    tracker.run(y[:600], u[:600])
    state = tracker.state()
    for numbers in (6, 7, 8):
        tracker.restore({**state, "watch": state["watch"][:numbers]})
        np.testing.assert_array_equal(tracker.state()["watch"][:numbers], state["watch"][:numbers])
        assert tracker.state()["watch"].shape == state["watch"].shape == (32,)
    with pytest.raises(ValueError, match="watch of 32 numbers"):
        tracker.restore({**state, "watch": state["watch"][:3]})


def test_a_step_in_the_samples_of_the_first_model_is_taken_off_and_said():
    _, model, u = plant(5, 800)
    y = model + 0.3 * np.random.default_rng(5).normal(size=800) + 8.0 * (np.arange(800) >= 250)
    tracker = ParameterTracker(ARX(2, 2))
    with pytest.warns(LostTrackerWarning, match=r"of its first 400 samples: the level of y steps by 7.* at sample 250"):
        tracker.run(y, u)
    np.testing.assert_allclose(tracker.theta[:4], THETA, atol=0.1)


# A gain that changes by less than a window of residuals shows.

RESONANT = np.real(np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j), 0.8 * np.exp(1.5j), 0.8 * np.exp(-1.5j)]))


def faint(seed, gain, constant=0.0, length=1500):
    """Return y and u of an ARX whose gain changes after 600 samples, by a fifth of the residuals' variance."""
    rng = np.random.default_rng([31, seed])
    u, v = rng.choice([-1.0, 1.0], length), rng.normal(size=length) * np.where(rng.random(length) < 0.1, 10.0, 1.0)
    driven = 1.1 * lfilter(np.append(0.0, NUMERATOR), [1.0], u) * np.where(np.arange(length) < 600, 1.0, gain)
    return lfilter([1.0], RESONANT, driven + v), u + constant


NUMERATOR = np.array([1.0, 0.5, -0.3, 0.2])


@pytest.mark.pairwise(1)
@support.draws(1, 2)
@pytest.mark.parametrize("constant", [0.0, 5e6])
@pytest.mark.parametrize("gain", [0.5, 1.5])
def test_a_gain_that_changes_faintly_is_said_and_followed(gain, constant, draws):
    for seed in range(draws):
        y, u = faint(seed, gain, constant)
        tracker = ParameterTracker(ARX(4, 4))
        with pytest.warns(LostTrackerWarning, match="its gain is .* in the mean of the last [0-9]+ samples") as said:
            tracker.run(y, u)
        assert all("its gain" in str(one.message) for one in said)
        b = tracker.theta[4:] / (1.1 * NUMERATOR)
        # One standard deviation of a gain from 480 such samples is .08.
        assert b @ NUMERATOR**2 / (NUMERATOR @ NUMERATOR) == pytest.approx(gain, abs=0.25)
        assert (np.abs(tracker.theta[:4] - RESONANT[1:]) < 5.0 * tracker.std[:4]).all()


@support.draws(2, 6)
def test_a_gain_that_does_not_change_is_not_said_to(draws):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(draws):
            ParameterTracker(ARX(4, 4)).run(*faint(100 + seed, 1.0))


def test_the_score_of_a_gain_is_that_of_its_definition():
    rng = np.random.default_rng(32)
    x, e = rng.normal(size=(2, 120))
    s, i = gain.score(e, x, 40)
    level = np.median(e)
    clipped = np.clip(e - level, *(np.array([-2.0, 2.0]) * 1.4826 * np.median(np.abs(e - level))))
    R = np.mean(clipped**2)
    np.testing.assert_allclose(s, ((clipped - clipped.mean()) * (x - x.mean()))[80:].sum() / R)
    np.testing.assert_allclose(i, ((x - x.mean()) ** 2)[80:].sum() / R)


def test_scores_that_scatter_more_than_their_information_says_are_judged_by_their_scatter():
    steady = np.column_stack((np.full(12, 10.0), np.full(12, 30.0)))
    assert gain.changed(steady) == pytest.approx(1 / 3)
    assert gain.changed(steady + np.outer((-1.0) ** np.arange(12), [40.0, 0.0])) == 0.0
    assert gain.changed(np.vstack((steady[:5], np.zeros((7, 2))))) == 0.0
    assert gain.changed(steady * [0.1, 1.0]) == 0.0


def test_an_input_that_moves_once_tells_a_gain_only_once():
    """Noise of a colour has one value in such a block, which scatters more than white noise would."""
    scores = np.column_stack((np.full(12, 1e-3), np.full(12, 1e-3)))
    scores[4] = 60.0, 90.0
    assert gain.changed(scores) == 0.0


@pytest.mark.nightly
@support.draws(3, 12)
def test_coloured_noise_and_an_input_that_hardly_moves_are_no_other_gain(draws):
    for seed in range(draws):
        rng = np.random.default_rng([34, seed])
        u = rng.choice([-1.0, 1.0], 10).repeat(150)
        u[:400] = rng.choice([-1.0, 1.0], 400)
        y = lfilter(B, A, u) + 0.3 * lfilter([1.0], [1.0, -0.95], rng.normal(size=1500))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            ParameterTracker(OutputError(2, 2)).run(y, u)
        assert not any("its gain" in str(one.message) for one in said)


def test_what_the_inputs_make_in_the_residuals_is_what_another_gain_leaves():
    structure, u = BoxJenkins(nb=2, nc=1, nd=1, nf=2), np.random.default_rng(33).normal(size=(200, 1))
    places, theta = structure.polynomials, np.zeros(6)
    b, f, c, d = [1.0, 0.5], [-1.5, 0.7], [0.4], [-0.3]
    for place, part in ((places.b[0], b), (places.f, f), (places.c, c), (places.d, d)):
        theta[place] = part
    driven = gain.driven(structure, theta, np.zeros(200), u)
    at_rest = u[:, 0] - np.median(u)
    true = lfilter(np.append(1.0, d), np.append(1.0, c), lfilter(np.append(0.0, b), np.append(1.0, f), at_rest))
    np.testing.assert_allclose(driven[-100:], true[-100:], rtol=1e-3, atol=1e-4 * np.abs(true).max())


# A level that moves after the first model.


def quiet(seed, length=1600, size=1.0):
    """Return a recording in which nothing changes but, halfway, the size of the noise."""
    rng = np.random.default_rng([33, seed])
    u = rng.choice([-1.0, 1.0], length).repeat((1, 5, 20)[seed % 3])[:length]
    noise = np.where(rng.random(length) < 0.1, 10.0, 1.0) * rng.normal(size=length)
    return lfilter(B, A, u), 0.3 * np.where(np.arange(length) < length // 2, 1.0, size) * noise, u


@pytest.mark.parametrize("structure, change", [(OutputError(2, 2), "step"), (ARX(2, 2), "ramp")], ids=str)
def test_a_level_that_moves_is_said_and_the_model_is_found_again(structure, change):
    y, noise, u = quiet(0)
    noise = noise if structure.nf else lfilter([1.0], A, noise)
    k = np.arange(y.size)
    moved = 4.0 * np.std(y) * ((k >= 1000) if change == "step" else np.maximum(k - 600, 0) / 1000)
    tracker = ParameterTracker(structure)
    with pytest.warns(LostTrackerWarning, match="the level of y is no longer the model's: .* off zero.*starts anew"):
        tracker.run(y + noise + moved, u)
    np.testing.assert_allclose(tracker.theta[:4], THETA, atol=0.15)


@support.draws(2, 6)
@pytest.mark.parametrize("structure", support.by_night([OutputError(2, 2), ARX(2, 2)], OutputError(2, 2)), ids=str)
def test_a_level_that_stays_is_not_said(structure, draws):
    for seed in range(draws):
        y, noise, u = quiet(seed, size=3.0)
        with warnings.catch_warnings():
            warnings.simplefilter("error", LostTrackerWarning)
            ParameterTracker(structure).run(y + (noise if structure.nf else lfilter([1.0], A, noise)), u)


def test_residuals_off_zero_are_told_from_chance():
    # White, coloured, outliers on one side, gaps.
    rng = np.random.default_rng(34)
    for colour, one_sided, gaps in [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3)]:
        for _ in range(100):
            e = rng.normal(size=600) + np.where(rng.random(600) < one_sided, 10.0, 0.0) * np.abs(rng.normal(size=600))
            e = lfilter([1.0], [1.0, -colour], e)
            usual = np.mean([autocovariances(e[k : k + 120]) for k in range(0, 480, 120)], axis=0)
            late = e[480:][rng.random(120) >= gaps]
            assert not _moved(late, usual)
            assert "residuals in a row lie about" in _moved(late + 8.0, usual)


def test_what_a_model_without_a_constant_leaves_off_zero_is_no_moved_level():
    y, noise, u = quiet(1, 1000)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ParameterTracker(OutputError(2, 2), offset=False).run(y + noise + 0.3, u)
    assert not [each for each in caught if "the level of y" in str(each.message)]
