"""A tracker that has lost its plant says so, and starts anew; one that has not stays silent."""

import warnings

import numpy as np
import pytest
import support
from recordings import THETA, A, B, binary, recording, same, silence, unchanged, unheard, wild
from scipy.signal import lfilter

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.filters import StuckSensorWarning
from robust_filterpy.identification import ARMAX, FIR, BoxJenkins
from robust_filterpy.identification.models import dependence as gain
from robust_filterpy.identification.models.dependence import autocovariances
from robust_filterpy.identification.recursive.watch import LostTrackerWarning, _moved


def broken(seed=1, length=1600, at=900, change=2.0, stream=28):
    rng, u = binary([stream, seed], length)
    return lfilter(B, A, u) * np.where(np.arange(length) < at, 1.0, change) + wild(rng, length), u


def test_a_tracker_that_has_lost_its_plant_says_so_in_time_and_starts_anew():
    y, u = broken()
    tracker = ParameterTracker(OutputError(2, 2), Q=0.0)
    with silence():
        tracker.run(y[:900], u[:900])
    with pytest.warns(LostTrackerWarning, match="the plant is no longer the model's.*starts anew, and theta may jump"):
        tracker.run(y[900:1100], u[900:1100])
    tracker.run(y[1100:], u[1100:])
    np.testing.assert_allclose(tracker.theta, THETA * [1.0, 1.0, 2.0, 2.0], atol=0.15)


def test_what_was_watched_belongs_to_the_state_and_not_to_the_object():
    y, u = broken()
    tracker, fresh = (ParameterTracker(OutputError(2, 2)) for _ in range(2))
    with pytest.warns(LostTrackerWarning):
        tracker.run(y, u)
    tracker.reset()
    same(tracker.state(), fresh.state())
    assert not tracker.state()["followed"].size


@pytest.mark.parametrize("name, value", [
    ("restarts", 0.5), ("samples", 0.0), ("seen", -1.0), ("seen", 1.5), ("usual", [-1.0, 0.0, 0.0, 0.0]),
    ("usual", np.full(4, np.nan)), ("usual", np.zeros(3)), ("scores", np.full((12, 2), -1.0)), ("kept", 1.0),
    ("followed", np.zeros((3, 2))),
])  # fmt: skip
def test_a_watch_that_cannot_be_is_refused_and_changes_nothing(name, value):
    tracker = ParameterTracker(OutputError(2, 2))
    state = tracker.state()
    without = {other: kept for other, kept in state.items() if other != name}
    for damaged in ({**state, name: np.array(value)}, without):
        with unchanged(tracker), pytest.raises(ValueError, match=f"state: expected.*{name}"):
            tracker.restore(damaged)


def test_a_model_that_the_user_gave_is_not_replaced():
    y, u = broken(3)
    tracker = ParameterTracker(OutputError(2, 2), theta=THETA, P=1e-6, R=0.09)
    tracker.run(y, u)
    assert not tracker.now.starts


# What a model leaves from the beginning is usual.


def arx_on_an_output_error(seed, change=1.0):
    return broken(seed, 1200, 800, change, 30)


def said(tracker, y, u):
    """What a run says."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tracker.run(y, u)
    return "\n".join(str(one.message) for one in caught)


def restarts(structure, y, u):
    return "starts anew" in said(ParameterTracker(structure, start=200), y, u)


@support.draws(1, 2)
def test_a_structure_that_does_not_fit_is_no_other_plant_and_another_plant_is_still_seen_by_it(draws):
    for seed in range(draws):
        assert not any(restarts(structure, *arx_on_an_output_error(seed)) for structure in (ARX(2, 2), FIR(6)))
        assert restarts(ARX(2, 2), *arx_on_an_output_error(seed, change=-1.0))


def test_a_structure_that_is_too_small_is_said_once_and_by_its_name():
    words = r"leaves follow the inputs: the structure is too small.*FIR\(nb=2"
    with pytest.warns(LostTrackerWarning, match=words) as caught:
        ParameterTracker(FIR(2)).run(*arx_on_an_output_error(0))
    assert len(caught) == 1


def test_a_step_in_the_samples_of_the_first_model_is_taken_off_and_said():
    y, u = recording([27, 5], 800, share=0.0)
    tracker = ParameterTracker(ARX(2, 2))
    with pytest.warns(LostTrackerWarning, match=r"of its first 400 samples: the level of y steps by 8.* at sample 250"):
        tracker.run(y + 8.0 * (np.arange(800) >= 250), u)
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
        with pytest.warns(LostTrackerWarning, match="its gain is .* in the mean of the last [0-9]+ samples") as caught:
            tracker.run(y, u)
        assert all("its gain" in str(one.message) for one in caught)
        b = tracker.theta[4:] / (1.1 * NUMERATOR)
        # One standard deviation of a gain from 480 such samples is .08.
        assert b @ NUMERATOR**2 / (NUMERATOR @ NUMERATOR) == pytest.approx(gain, abs=0.25)
        assert (np.abs(tracker.theta[:4] - RESONANT[1:]) < 5.0 * tracker.std[:4]).all()


@support.draws(2, 6)
def test_a_gain_that_does_not_change_is_not_said_to(draws):
    with silence():
        for seed in range(draws):
            ParameterTracker(ARX(4, 4)).run(*faint(100 + seed, 1.0))


def test_the_score_of_a_gain_is_that_of_its_definition():
    x, e = np.random.default_rng(32).normal(size=(2, 120))
    s, i = gain.scored(np.zeros((12, 2)), e, x)[-1]
    level = np.median(e)
    limit = 2.0 * 1.4826 * np.median(np.abs(e - level))
    clipped, x = np.clip(e - level, -limit, limit), x - x.mean()
    np.testing.assert_allclose(s, ((clipped - clipped.mean()) * x)[80:].sum() / np.mean(clipped**2))
    np.testing.assert_allclose(i, (x**2)[80:].sum() / np.mean(clipped**2))


def test_scores_that_scatter_more_than_their_information_says_are_judged_by_their_scatter():
    steady = np.column_stack((np.full(12, 10.0), np.full(12, 30.0)))
    assert gain.changed(steady) == pytest.approx(1 / 3)
    assert gain.changed(steady + np.outer((-1.0) ** np.arange(12), [40.0, 0.0])) == 0.0
    assert gain.changed(np.vstack((steady[:5], np.zeros((7, 2))))) == 0.0
    assert gain.changed(steady * [0.1, 1.0]) == 0.0


def test_what_the_inputs_make_in_the_residuals_is_what_another_gain_leaves():
    structure, u = BoxJenkins(nb=2, nc=1, nd=1, nf=2), np.random.default_rng(33).normal(size=(200, 1))
    b, f, c, d = [1.0, 0.5], [-1.5, 0.7], [0.4], [-0.3]
    driven = gain.driven(structure, np.array([*b, *f, *c, *d]), np.zeros(200), u)
    at_rest = u[:, 0] - np.median(u)
    true = lfilter([1.0, *d], [1.0, *c], lfilter([0.0, *b], [1.0, *f], at_rest))
    np.testing.assert_allclose(driven[-100:], true[-100:], rtol=1e-3, atol=1e-4 * np.abs(true).max())


# A level that moves after the first model.


def quiet(seed, length=1600, size=1.0):
    """Return a recording in which nothing changes but, halfway, the size of the noise."""
    rng, u = binary([33, seed], length)
    u = u.repeat((1, 5, 20)[seed % 3])[:length]
    return lfilter(B, A, u), wild(rng, length) * np.where(np.arange(length) < length // 2, 1.0, size), u


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
        with silence(LostTrackerWarning):
            ParameterTracker(structure).run(y + (noise if structure.nf else lfilter([1.0], A, noise)), u)


def test_residuals_off_zero_are_no_chance():
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
    assert "the level of y" not in said(ParameterTracker(OutputError(2, 2), offset=False), y + noise + 0.3, u)


# What a stuck sensor says while a tracker runs counts as missing; sensors that repeat themselves are believed.


LENGTH = 900
STRUCTURES = [ARX(2, 2), OutputError(2, 2), ARMAX(2, 2, 1), BoxJenkins(2, 1, 1, 2)]


def recorded(structure, seed=1, length=LENGTH, size=0.3):
    return recording([41, seed], length, sigma=size, inside=structure.na > 0)


def begun(structure, y, u, at=600):
    """A tracker as it is after so many samples, quickly."""
    with unheard():
        tracker = ParameterTracker(structure, start=200)
        tracker.run(y[:at], u[:at])
    return tracker


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("structure", support.by_night(STRUCTURES, ARX(2, 2), OutputError(2, 2)), ids=str)
@pytest.mark.parametrize("value", ["last", 0.0, 25.0])
def test_a_sensor_that_is_stuck_is_said_once_and_teaches_nothing(structure, value, form):
    y, u = recorded(structure)
    y[600:800] = y[599] if value == "last" else value
    tracker = begun(structure, y, u)
    theta, noise = tracker.theta, tracker.R
    with pytest.warns(Warning) as caught:
        result = tracker.run(y[600:], u[600:])
    assert [each.category for each in caught] == [StuckSensorWarning]
    assert np.isnan(result.residual[10:200]).all() and np.isnan(result.weights[10:200]).all()
    assert not np.isnan(result.residual[200:]).any()
    # The first readings may be near the prediction, and count as any others.
    assert np.abs(result.theta[199] - theta).max() < 0.02 and 0.5 < tracker.R / noise < 2.0


def stuck():
    y, u = recorded(OutputError(2, 2))
    y[600:700] = y[600]
    return y, u


@pytest.mark.parametrize("drawn, cut, warning, start", [
    (broken, 890, LostTrackerWarning, 0), (broken, 933, LostTrackerWarning, 400), (stuck, 650, StuckSensorWarning, 200),
])  # fmt: skip
def test_interrupted_it_goes_on_to_the_last_bit_and_says_the_same(drawn, cut, warning, start):
    y, u = drawn()
    tracker = ParameterTracker(OutputError(2, 2), start=200)
    # What has been said is not in a state, and is said again.
    other = ParameterTracker(OutputError(2, 2), start=start, offset=True, regressor="cleaned")
    with unheard():
        tracker.run(y[:cut], u[:cut])
    other.restore(tracker.state())
    with pytest.warns(warning):
        found = other.run(y[cut:], u[cut:])
    with unheard():
        same(tracker.run(y[cut:], u[cut:]), found)
    same(tracker.state(), other.state())
    with unchanged(other), pytest.raises(ValueError, match="readings"):
        other.restore({**tracker.state(), "readings": np.full(7, -1.0)})


def believed():
    """Recordings of sensors that repeat themselves and are right."""
    y, u = recorded(OutputError(2, 2), 2)
    rng, places = np.random.default_rng(3), np.arange(LENGTH)
    rests = u * (places // 150 % 2)
    at_rest = lfilter(B, A, rests)
    moving = np.abs(at_rest) > 1e-3
    return {
        "coarse": (np.round(y), u),
        "a tenth of its noise": (0.03 * np.round(y / 0.03), u),
        "counts": (rng.poisson(np.maximum(400.0 + 40.0 * y, 0.0)).astype(float), u),
        "each value three times": (y[places // 3 * 3], u),
        "without noise": (lfilter(B, A, u), u),
        "without noise, held": (at_rest, rests),
        "at rest": (np.where(moving, at_rest + 0.3 * rng.normal(size=LENGTH), 0.0), rests),
    }


@pytest.mark.parametrize("name", support.by_night(believed(), "coarse", "counts", "at rest"))
def test_sensors_that_repeat_themselves_are_believed(name):
    y, u = believed()[name]
    with unheard(LostTrackerWarning), silence(StuckSensorWarning):
        result = ParameterTracker(OutputError(2, 2), start=200).run(y, u)
    assert np.isnan(result.residual).sum() <= 2


def test_a_sensor_stuck_in_the_first_samples_is_said_too():
    y, u = recorded(OutputError(2, 2))
    y[:100] = 3.0
    with pytest.warns(StuckSensorWarning, match="of its first samples: y is 3"):
        ParameterTracker(OutputError(2, 2), start=200).run(y[:400], u[:400])


def test_as_in_the_paper_every_output_is_taken_as_it_is():
    y, u = recorded(OutputError(2, 2))
    y[600:700] = y[600]
    tracker = ParameterTracker(OutputError(2, 2), start=0, theta=[-1.5, 0.7, 1.0, 0.5], P=0.01, R=0.09)
    assert not np.isnan(tracker.run(y, u).residual).any()


def test_after_a_long_gap_nothing_is_lost():
    y, u = recorded(OutputError(2, 2), 4, length=2600)
    y[600:2400] = np.nan
    tracker = ParameterTracker(OutputError(2, 2), start=200)
    with silence():
        tracker.run(y, u)
    # What is usual.
    assert tracker.state()["usual"][0] > 0.3


def test_wild_outputs_explain_no_other_wild_one():
    y, u = recorded(ARX(2, 2), 5)
    model = identify(y[:400], u[:400], ARX(2, 2))
    wild = y.copy()
    # The first predicts 1.5e6 for the second: nearer than what the model predicts from outputs that are ordinary.
    size = 1e6 * np.random.default_rng(7).uniform(1.0, 2.0, 12)
    wild[420::40], wild[421::40] = size, 0.9 * size
    clean, spoilt = ParameterTracker(model), ParameterTracker(model)
    clean.run(y[400:], u[400:])
    spoilt.run(wild[400:], u[400:])
    assert np.abs(spoilt.theta - clean.theta).max() < 0.02


def test_a_sensor_that_gets_stuck_as_soon_as_there_is_a_model_is_seen():
    # That moves by a hundred times its noise, so that neighbours tell little of how fine its steps are.
    y, u = recorded(OutputError(2, 2), 6, size=0.03)
    y[210:300] = y[210]
    with pytest.warns(StuckSensorWarning):
        result = ParameterTracker(OutputError(2, 2), start=200).run(y[:400], u[:400])
    assert np.isnan(result.residual[215:300]).all()


@pytest.mark.nightly
@support.draws(3, 12)
def test_coloured_noise_and_an_input_that_hardly_moves_are_no_other_gain(draws):
    for seed in range(draws):
        rng = np.random.default_rng([34, seed])
        u = rng.choice([-1.0, 1.0], 10).repeat(150)
        u[:400] = rng.choice([-1.0, 1.0], 400)
        y = lfilter(B, A, u) + 0.3 * lfilter([1.0], [1.0, -0.95], rng.normal(size=1500))
        assert "its gain" not in said(ParameterTracker(OutputError(2, 2)), y, u)
