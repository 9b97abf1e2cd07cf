"""Recordings that break an assumption of identify: a right model, or a sentence that says what is wrong."""


import numpy as np
import pytest
import recordings
import support
from recordings import RIGHT, A, B, binary, silence, unheard, wild
from scipy.signal import lfilter
from support import by_night

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import (
    ARMAX,
    FIR,
    BoxJenkins,
    LinearRegression,
    LostTrackerWarning,
    StateSpace,
    TrackerBank,
    validate,
)
from robust_filterpy.identification.estimation.disturbances import Break, break_finding, piecewise_level


def recording(seed, length=1000, share=0.1):
    rng = np.random.default_rng([27, seed])
    return rng, *recordings.recording(rng, length, share)


# Fill values.


@pytest.mark.parametrize("structure", support.by_night(
    [OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 2), BoxJenkins(2, 1, 1, 2)], OutputError(2, 2)
), ids=str)  # fmt: skip
def test_fill_values_are_gaps_in_any_structure(structure):
    rng, y, u = recording(1, 300)
    places = rng.random(y.size) < 0.1
    gaps = identify(np.where(places, np.nan, y), u, structure)
    for fill in (9999.0, 9.97e36):
        with pytest.warns(UserWarning, match=f"y has {fill:.6g}".replace("+", r"\+")):
            model = identify(np.where(places, fill, y), u, structure)
        np.testing.assert_array_equal(model.theta, gaps.theta)
        kinds, without = ([finding.kind for finding in one.findings] for one in (model, gaps))
        assert kinds == ["fill value", *without]
        assert f"{fill:.6g}" in repr(model)
        assert f"{fill:.6g}" in model.summary().to_text()


def test_a_tracker_and_a_bank_take_fill_values_for_gaps():
    rng, y, u = recording(2, 500)
    places = rng.random(y.size) < 0.1
    gaps, fills = np.where(places, np.nan, y), np.where(places, 1e8, y)
    one, other = ParameterTracker(OutputError(2, 2)), ParameterTracker(OutputError(2, 2))
    one.run(gaps, u)
    with pytest.warns(UserWarning, match=r"y has 1e\+08"):
        other.run(fills, u)
    np.testing.assert_array_equal(one.theta, other.theta)
    with pytest.warns(UserWarning, match=r"^TrackerBank: y has fill values, by actuator 1: 1e\+08 \(") as said:
        result = TrackerBank(2, FIR(1, nk=0), start=0).run(np.column_stack((y, fills)), u)
    assert len(said) == 1
    for i, column in enumerate((y, gaps)):
        np.testing.assert_array_equal(result.theta[:, i], ParameterTracker(FIR(1, nk=0), start=0).run(column, u).theta)


# Steps and ramps of the level.


def outputs(structure, seed, length=600):
    """Output and input of the plant; two outputs for states, noise inside the loop for ARX."""
    if structure == ARX(2, 2):
        y, u = driven(seed, length)
        return y, u, lfilter(B, A, u)
    rng, y, u = recording(seed, length)
    if not isinstance(structure, StateSpace):
        return y, u, lfilter(B, A, u)
    clean = np.column_stack((lfilter(B, A, u), lfilter([0.0, 0.5, 0.2], A, u)))
    return np.column_stack((y, clean[:, 1] + wild(rng, length))), u, clean


def dynamic_error(model, u, clean):
    """Error of the dynamics as a share of the output that they make."""
    return np.linalg.norm(model.simulate(u) - model.simulate(np.zeros(u.size)) - clean) / np.linalg.norm(clean)


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2), StateSpace(2)], ids=["oe", "arx", "states"])
def test_a_step_of_the_level_is_found_taken_off_and_put_back(structure):
    y, u, clean = outputs(structure, 6)
    size = 15.0 * np.array([1.0, -1.0][: y.ndim])
    size = size if y.ndim > 1 else size[0]
    broken = y + np.multiply.outer(np.arange(600) >= 400, size)
    with pytest.warns(UserWarning, match="the level of y steps by .* at sample 400"):
        model = identify(broken, u, structure)
    assert [(one.kind, one.place) for one in model.findings] == [("step", (400, 600))] * y.ndim
    np.testing.assert_allclose(model.level, size, atol=0.2)
    assert dynamic_error(model, u, clean) < 0.02
    if y.ndim == 1:
        assert model.trend[399] - model.trend[400] == pytest.approx(-size, rel=0.02) and model.trend[-1] == 0.0
    assert validate(model, broken, u).verdict == RIGHT and np.all(model.fit(broken, u) > 80.0)
    for output in (model.predict(broken, u), model.free_run(broken, u)):
        for part in (slice(50, 400), slice(400, None)):
            assert np.abs(np.nanmedian((broken - output)[part], axis=0)).max() < 0.1
    # Another recording has the level at the end, and no step.
    assert np.abs(np.nanmedian(model.residuals(y + size, u), axis=0)).max() < 0.1
    # With a constant nothing is taken off, and what that leaves is said.
    with pytest.warns(UserWarning, match="follow u"):
        bent = identify(broken, u, structure, trend="constant")
    assert dynamic_error(bent, u, clean) > 0.1 and bent.findings
    assert not any("taken off" in one.text for one in bent.findings)


def test_a_ramp_and_a_line_are_taken_off():
    _, y, u = recording(7, 400)
    broken = y + 3.0 * np.std(y) * np.arange(y.size) / y.size
    with pytest.warns(UserWarning, match="changes by .* a sample"):
        model = identify(broken, u, OutputError(2, 2))
    assert [one.kind for one in model.findings] == ["ramp"]
    asked = identify(broken, u, OutputError(2, 2), trend="line")
    for each in (model, asked):
        assert dynamic_error(each, u, lfilter(B, A, u)) < 0.02
        assert each.trend[0] == pytest.approx(-3.0 * np.std(y), rel=0.05)
    assert asked.findings == ()
    none, without = identify(y, u, OutputError(2, 2), trend="none"), identify(y, u, OutputError(2, 2), offset=False)
    np.testing.assert_array_equal(none.theta, without.theta)
    assert without.offset == without.offset_std == without.level == 0.0


# Another plant in a part.


@pytest.mark.parametrize("seed", [0, 4])
def test_a_pole_that_moves_in_much_noise_shows_in_two_parts_together(seed):
    rng = np.random.default_rng([27, seed])
    u = rng.choice([-1.0, 1.0], 1500)
    clean = np.where(np.arange(1500) < 750, lfilter(B, A, u), lfilter(B, [1.0, -1.5, 0.6], u))
    with pytest.warns(UserWarning, match="follow u: the plant is another one there"):
        identify(clean + 0.6 * clean.std() * rng.normal(size=1500), u, OutputError(2, 2))


@pytest.mark.parametrize("structure", [OutputError(2, 2), StateSpace(2)], ids=["output error", "states"])
def test_an_angle_that_wraps_is_said(structure):
    rng, u = binary(99, 270)
    u = u.repeat(3)
    y = np.column_stack((lfilter(B, A, u), lfilter([0.0, 0.5, 0.2], A, u))) + 0.3 * rng.normal(size=(810, 2))
    y = y if isinstance(structure, StateSpace) else y[:, 0]
    limit = 0.6 * np.abs(y).max(axis=0)
    with pytest.warns(UserWarning, match="y jumps .* from one end of its range"):
        identify((y + limit) % (2.0 * limit) - limit, u, structure)


def test_a_plant_that_switches_is_no_angle():
    rng, u = binary(99, 800)
    switched = np.concatenate(([0.0], u[:-1])) + 0.05 * rng.normal(size=800)
    with silence():
        identify(switched, u, OutputError(1, 1))
        identify(switched, u, ARX(1, 1))


@support.draws(1, 3)
@pytest.mark.parametrize("also", ["nothing", "gross errors", "another plant"])
def test_outliers_of_the_input_are_said_and_hide_nothing(also, draws):
    for seed in range(draws):
        rng, y, u = recording(20 + seed, share=0.0)
        read = np.where(rng.random(u.size) < 0.03, 10.0 * rng.normal(size=u.size), u)
        if also == "gross errors":
            # Three sizes: noise, what inputs that were not as read leave, and errors far beyond; the mixture has two.
            y = np.where(rng.random(u.size) < 0.01, 1e5 * rng.normal(size=u.size), y)
        elif also == "another plant":
            y = y + lfilter(B, A, u) * (np.arange(y.size) >= 600)
        with pytest.warns(UserWarning, match="u has .* values unlike the others"):
            model = identify(y, read, OutputError(2, 2))
        assert ("another plant" in {one.kind for one in model.findings}) == (also == "another plant")
        if also != "another plant":
            np.testing.assert_allclose(model.theta, recordings.THETA, atol=0.1)


def test_a_tracker_says_that_its_input_has_outliers():
    rng, y, u = recording(25, 500, share=0.0)
    read = np.where(rng.random(u.size) < 0.03, 10.0 * rng.normal(size=u.size), u)
    with pytest.warns(LostTrackerWarning, match="u has .* values unlike the others"):
        ParameterTracker(OutputError(2, 2), start=300).run(y, read)


# Outliers of the output in a model that has it in its regressor, and of the process.


def driven(seed, length=600, share=0.1):
    """An ARX(2, 2) whose noise has outliers that act on."""
    return recordings.recording([29, seed], length, share, 0.1, inside=True)


def test_wild_outputs_next_to_each_other_and_in_the_first_samples_are_found():
    y, u = driven(0, 400)
    right = identify(y, u, ARX(2, 2))
    y[[1, 60, 61, 62, 200, 202]] = 1e7 * np.array([1.0, -2.0, 0.7, 0.4, 1.0, -1.0])
    model = identify(y, u, ARX(2, 2))
    np.testing.assert_allclose(model.theta, right.theta, atol=0.02)


def test_a_shock_of_the_process_is_not_taken_for_wild_outputs():
    y, u = driven(1)
    shock = np.zeros(y.size)
    shock[[150, 420]] = [1e5, -3e6]
    model = identify(y + lfilter([1.0], A, shock), u, ARX(2, 2))
    # Such a shock tells A better than all the rest, and does not if what follows it is left out.
    np.testing.assert_allclose(model.theta[:2], A[1:], atol=1e-4)


@pytest.mark.parametrize("rest, says", [(4.5, False), (-4.5, False), (5.5, True), (-5.5, True)])
def test_an_input_stays_far_from_zero_beyond_five_of_its_deviations(rest, says):
    u = rest + np.random.default_rng(0).normal(size=(20001, 1))
    finding = break_finding(Break("ramp", 10, 0.1, 9.0), None, 9.0, len(u), u)
    assert ("or a gain does" in finding.text) == says


# A recording from a closed loop is recognised, one from an open loop is not taken for one.


def closed(seed, gain=0.5, outliers=0.0, samples=800):
    """A plant with coloured noise, under proportional control of its measured output."""
    rng, levels = binary(seed, samples // 10)
    reference, v = np.repeat(levels, 10), lfilter([1.0], [1.0, -0.8], rng.normal(size=samples))
    far = np.where(rng.random(samples) < outliers, 5.0, 0.0) * rng.normal(size=samples)
    u, w, y = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    for k in range(1, samples):
        w[k] = 0.8 * w[k - 1] + 0.5 * u[k - 1]
        y[k] = w[k] + 0.3 * v[k] + far[k]
        u[k] = gain * (reference[k] - y[k])
    return y, u


def kinds(y, u, structure):
    """What was found."""
    with unheard(UserWarning):
        return [(finding.kind, finding.text) for finding in identify(y, u, structure).findings]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize(("structure", "says"), [
    (OutputError(1, 1), "is biased by that"),
    (BoxJenkins(1, 0, 1, 1), "as far as its noise model"),
    (ARX(2, 2), "right"),
    (StateSpace(1), "comes from a closed loop"),
], ids=str)  # fmt: skip
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_feedback_is_found_and_what_it_means_is_said(structure, says, outliers):
    assert says in dict(kinds(*closed(1, outliers=outliers), structure))["closed loop"]


@pytest.mark.pairwise(1)
@support.draws(1, 5)
@pytest.mark.parametrize("hold", [1, 4, 30])
@pytest.mark.parametrize("structure", [OutputError(1, 1), ARX(1, 1)], ids=str)
def test_an_open_loop_is_none(hold, structure, draws):
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, 1.0], 800 // hold + 1), hold)[:800]
        v = lfilter([1.0], [1.0, -0.9], rng.normal(size=800)) + np.where(rng.random(800) < 0.1, 5.0, 0.0)
        assert "closed loop" not in dict(kinds(lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.3 * v, u, structure))


def test_a_model_whose_pole_keeps_what_was_in_motion_begins_at_rest():
    rng, u = binary(1, 300)
    clean = lfilter([0.0, 0.3], [1.0, -1.0], u)
    with pytest.warns(UserWarning, match="would keep what was in motion when y began .*: the model begins at rest"):
        model = identify(clean + 0.3 * rng.normal(size=300), u, OutputError(1, 1), trend="constant")
    assert [finding.kind for finding in model.findings] == ["slow start"]
    assert np.abs(model.simulate(u) - clean).max() < 0.2


# What is left of a model has a colour of its own: trends, standard deviations and inputs are judged with it.


def quiet(y, u, structure, **options):
    """Return the model, nothing written."""
    with unheard():
        return identify(y, u, structure, progress=False, **options)


@pytest.mark.parametrize("trend", by_night([None, "line"], None))
def test_a_trend_leaves_a_slow_input_what_it_explains(trend):
    rng, t = np.random.default_rng([9, 0]), np.arange(1000)
    binary = rng.choice([-1.0, 1.0], 1000).repeat(10)[:1000]
    slow = 25.0 * np.sin(2.0 * np.pi * t / 900) + 0.05 * t + lfilter([1.0], [1.0, -0.99], rng.normal(size=1000))
    y = lfilter([0.0, 0.05], [1.0, -0.95], binary) + lfilter([0.0, 0.03], [1.0, -0.95], slow) - 0.02 * t
    model = quiet(
        y + 0.15 * rng.normal(size=1000), np.column_stack((binary, slow)), OutputError(1, (1, 1)), trend=trend
    )
    assert abs(model.theta[2] - 0.03) < 3.0 * model.std[2]
    assert model.R < 0.027


def test_standard_deviations_count_that_residuals_follow_one_another():
    inside = []
    for seed in range(6):
        rng, u = binary([10, seed], 500)
        u = u.repeat(3)
        y = lfilter(B, A, u) + lfilter([0.3], A, rng.normal(size=1500))
        model = quiet(y, u, OutputError(2, 2), trend="constant")
        inside.append(np.abs(model.theta - recordings.THETA) < 2.0 * model.std)
        assert "another plant" not in {one.kind for one in model.findings}
    assert np.mean(inside) >= 0.8
    assert model.colour > 1.3 and "Colored residuals" in str(model.summary())


def test_slow_noise_and_the_steps_of_a_sensor_are_no_breaks_of_the_level():
    rng, none, k = np.random.default_rng(2), np.zeros((600, 0)), np.arange(600)
    slow = lfilter([0.3], [1.0, -0.98], rng.normal(size=600))
    assert not piecewise_level(slow, none).breaks
    rounded = 50.0 * np.round((60.0 * (k >= 300) + rng.normal(size=600)) / 100.0 + 0.2)
    assert not piecewise_level(rounded, none).breaks
    (one,) = piecewise_level(slow + 10.0 * (k >= 300), none).breaks
    assert (one.kind, abs(one.time - 300) < 3, abs(one.size - 10.0) < 1.0) == ("step", True, True)


@pytest.mark.parametrize(("at", "found"), [(28, 29), (29, 29), (289, 289), (290, 289)])
def test_a_step_is_looked_for_up_to_ten_samples_from_the_ends(at, found):
    r = 0.1 * np.random.default_rng(1).normal(size=300)
    r[at:] += 1.0
    (one,) = piecewise_level(r, np.zeros((300, 0))).breaks
    assert (one.kind, one.time) == ("step", found)


def test_rows_far_outside_that_y_does_not_follow_do_not_count_and_others_do():
    rng = np.random.default_rng(3)
    phi = rng.normal(size=(800, 2))
    phi[::100] *= 50.0
    y = phi @ [0.25, -0.1] + 0.05 * rng.normal(size=800)
    whole = quiet(y, phi, LinearRegression(2))
    assert not whole.findings
    spoilt = phi.copy()
    spoilt[rng.random(800) < 0.03, 0] = 1e3
    model = quiet(y, spoilt, LinearRegression(2))
    np.testing.assert_allclose(model.theta, [0.25, -0.1], atol=0.01)
    assert [one.kind for one in model.findings] == ["input outliers"]


@pytest.mark.parametrize("value", [1e9, -1e100, 1e300])
def test_one_impossible_reading_is_a_missing_one_and_a_shock_that_acts_on_is_not(value):
    y, u = recordings.recording(4, 600, 0.0, 0.1, inside=True)
    y[300] = np.nan
    missing = quiet(y, u, ARX(2, 2))
    y[300] = value
    model = quiet(y, u, ARX(2, 2))
    np.testing.assert_array_equal(model.theta, missing.theta)
    assert [one.kind for one in model.findings] == ["wild"]


@pytest.mark.parametrize("noise", ["of the equation", "of the output", "slow"])
def test_an_arx_that_coloured_noise_biases_is_said(noise):
    rng, u = binary([519, 4], 800)
    white, slow = wild(rng, 800, 0.2, 0.05), 0.9 * lfilter([0.3], [1.0, -0.95], rng.normal(size=800))
    added = {"of the equation": lfilter([1.0], A, white), "of the output": 2.0 * white, "slow": slow + white}[noise]
    y = lfilter(B, A, u) + added
    model = identify(y, u, ARX(2, 2), trend="constant")
    kinds = [one.kind for one in model.findings]
    assert kinds == [] if noise == "of the equation" else "noise that follows itself" in kinds
    if noise == "of the output":
        assert np.abs(model.theta[:2] - A[1:]).max() > 5.0 * model.std[:2].min()
        # What the finding names is the cure.
        assert "there is OutputError(na=2, nb=2, nk=1)" in model.findings[0].text
        cured = quiet(y, u, OutputError(2, 2))
        assert np.all(np.abs(cured.theta - recordings.THETA) < 3.0 * cured.std) and not cured.findings


def test_a_colour_that_tells_less_than_its_price_is_not_said():
    y, u = recordings.recording([29, 1], 300, 0.0, 0.1, inside=True)
    assert not quiet(y + 0.04 * np.random.default_rng(0).normal(size=300), u, ARX(2, 2)).findings
