"""Recordings that once passed without a word: each is modelled right, refused in words, or said to be what it is."""


import numpy as np
import pytest
import recordings
import support
from recordings import RIGHT, A, B, binary, silence, unheard
from scipy.signal import lfilter

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import AR, ARMAX, FIR, GreyBox, StateSpace, compare, select_structure, validate
from robust_filterpy.identification.estimation.prediction_error import colour_of
from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.influence.regression import resolution

SECOND = [0.0, 0.5, 0.2]
LAG = np.exp(-0.3)
PHYSICS = GreyBox(lambda x, u, p: [p[0] * (p[1] * u[0] - x[0])], {"rate": 0.4, "gain": 1.5}, x0=[0.0])
STRUCTURES = {"output error": OutputError(2, 2), "ARX": ARX(2, 2), "states": StateSpace(2), "physics": PHYSICS}


def recording(name, seed, samples=240):
    """A recording that the structure can have made, a tenth of it outliers: output, or several, input, gain at rest."""
    rng = np.random.default_rng([94, seed])
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 3 + 1), 3)[:samples]
    noise = 0.1 * np.where(rng.random((samples, 2)) < 0.1, 10.0, 1.0) * rng.normal(size=(samples, 2))
    if name == "physics":
        return rng, lfilter([0.0, 2.0 * (1.0 - LAG)], [1.0, -LAG], u) + noise[:, 0], u, 2.0
    if name == "states":
        return rng, np.column_stack((lfilter(SECOND, A, u), lfilter(B, A, u))) + noise, u, 7.5
    noise = lfilter([1.0], A, noise[:, 0]) if name == "ARX" else noise[:, 0]
    return rng, lfilter(B, A, u) + noise, u, 7.5


def timed(y):
    """When the samples were taken, of one recording or of several."""
    return [np.arange(len(one)) * 1.0 for one in y] if isinstance(y, list) else np.arange(len(y)) * 1.0


def modelled(name, y, u):
    return identify(y, u, STRUCTURES[name], progress=False, **({"t": timed(y)} if name == "physics" else {}))


def gain(name, model):
    """What the last output does in the end after a unit step."""
    if name == "physics":
        return model.p["gain"]
    return float(model.step_response(150, **({"output": 1} if name == "states" else {})).response[-1])


def last(y):
    return y[:, -1] if y.ndim > 1 else y


@pytest.mark.parametrize(("name", "seed", "samples", "first", "end", "near"), [
    *(pytest.param(name, 1, 240, 24, 216, 0.2, marks=[] if name == "output error" else [pytest.mark.nightly])
      for name in STRUCTURES),
    *(pytest.param(name, 9, 700, 300, 366, 0.1, marks=[] if name in ("ARX", "states") else [pytest.mark.nightly])
      for name in STRUCTURES),
])  # fmt: skip
def test_a_sensor_that_is_stuck_is_taken_for_missing(name, seed, samples, first, end, near):
    _, y, u, expected = recording(name, seed, samples)
    last(y)[first:end] = last(y)[first]
    words = f"y is .* in {end - first} of {samples} samples, whatever u does, .*: the sensor is stuck"
    with pytest.warns(UserWarning, match=words):
        model = modelled(name, y, u)
    # Of few samples with a tenth of outliers.
    assert gain(name, model) == pytest.approx(expected, rel=near)
    assert [(one.kind, one.place) for one in model.findings] == [("stuck", (first, end))] and "stuck" in repr(model)
    # Methods that get the recording know it too.
    times = {"t": timed(y)} if name == "physics" else {}
    left = model.residuals(y, u, **times)
    assert np.isnan(last(left)[first:end]).all() and np.isnan(left).sum() == end - first + np.isnan(left[:first]).sum()
    if samples > 500:
        assert validate(model, y, u, **times).verdict == RIGHT


def test_a_dead_time_is_not_stuck_and_a_sensor_that_becomes_slow_is_said_once():
    rng, u = binary([94, 12], 1000)
    y = lfilter(B, A, u) + 0.1 * rng.normal(size=1000)
    late = lfilter([0.0] * 31 + [0.3], [1.0, -0.7], u)  # without noise: exactly 0 for 31 samples
    with silence():
        identify(late, u, OutputError(1, 1, 31))
    for begin in range(500, 1000, 25):
        y[begin : begin + 25] = y[begin]
    with pytest.warns(UserWarning, match="y is .* or one of .* more numbers in .* of 1000 samples, whatever u does"):
        model = modelled("output error", y, u)
    assert [one.kind for one in model.findings] == ["stuck"]
    np.testing.assert_allclose(model.theta, [*A[1:], *B[1:]], atol=0.05)


def test_a_sensor_that_is_stuck_here_and_there_or_without_an_input_is_said_too():
    rng, y, u, expected = recording("states", 2)
    y[rng.random(240) < 0.7, 1] = 0.123
    with pytest.warns(UserWarning, match="output 1: y is 0.123 in"):
        assert gain("states", modelled("states", y, u)) == pytest.approx(expected, rel=0.05)
    alone = lfilter([1.0], A, rng.normal(size=400))
    alone[100:350] = alone[100]
    with pytest.warns(UserWarning, match="in 250 of 400 samples and hardly"):
        model = identify(alone, None, AR(2))
    np.testing.assert_allclose(model.theta, A[1:], atol=4.0 * model.std.max())
    with pytest.warns(UserWarning, match="select_structure: y is 0.123 in"):
        assert select_structure(y[:, 1], u, OutputError, na=[2], nb=[2]).best.findings[0].kind == "stuck"


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_sensor_that_is_always_stuck_is_refused(name):
    _, y, u, _ = recording(name, 3)
    last(y)[5:] = last(y)[5]
    with pytest.raises(ValueError, match=r"y: expected an output that varies, got .* in 235 of 240 samples"):
        modelled(name, y, u)


def ordinary(seed):
    """Outputs that rest, are rounded, switched or small: nothing of that is a sensor that is stuck."""
    rng = np.random.default_rng([95, seed])
    u = np.repeat((rng.random(80) < 0.2) * 1.0, 3)
    y = lfilter([0.0, 0.3], [1.0, -0.7], u)
    noise = 0.05 * rng.normal(size=240)
    flow = np.concatenate(([0.0], u[:-1])) * (1.0 + noise)  # exactly 0 where the valve was closed
    yield from ((y, u), (y + noise, u), (np.round(y + noise, 1), u), (np.round(3.0 * y) / 3.0, u), (flow, u))
    yield (y > 0.5) * 1.0 + 0.01 * np.round(20.0 * noise), u


@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2)], ids=str)
def test_a_sensor_that_is_read_less_often_or_ends_at_its_limit_is_said(structure):
    rng, u = recordings.binary(96, 600)
    noise = 0.1 * rng.normal(size=600)
    y = lfilter(B, A, u) + (noise if structure.nf else lfilter([1.0], A, noise))
    stored, limit = y.copy(), np.quantile(y, 0.95)
    for k in np.flatnonzero(rng.random(600) < 0.05):
        stored[k : k + 4] = stored[k]
    for kind, one in (
        ("held", np.repeat(y[::2], 2)), ("held", np.repeat(np.round(y[::2], 2), 2)), ("held", stored),
        ("stuck", np.minimum(y, limit)), ("none", y), ("none", np.round(y, 2)), ("none", np.round(y)),
    ):  # fmt: skip
        with unheard():
            kinds = {finding.kind for finding in identify(one, u, structure).findings}
        assert kinds & {"held", "stuck"} == {kind} - {"none"}, kind


@support.draws(1, 4)
def test_outputs_that_rest_or_are_rounded_are_not_stuck(draws):
    for seed in range(draws):
        for y, u in ordinary(seed):
            with unheard():
                assert not {"stuck", "held", "copy"} & {one.kind for one in identify(y, u, FIR(3)).findings}


@pytest.mark.parametrize("name", support.by_night(STRUCTURES, "states", "ARX"))
def test_a_copy_of_another_signal_is_said(name):
    rng, y, u, _ = recording(name, 4, 60)
    if name == "states":
        wild = np.where(rng.random(60) < 0.03, 3.0, 0.0)
        with pytest.warns(UserWarning, match="output 1 moves exactly as 1.8 times output 0 does: one is a copy"):
            modelled(name, np.column_stack((y[:, 0], 1.8 * y[:, 0] + 32.0 + wild)), u)
        y[:, 1] = u
    else:
        y = u.copy()
    with pytest.warns(UserWarning, match="moves exactly as u does: one is a copy of the other"):
        assert "copy" in {one.kind for one in modelled(name, y, u).findings}


@pytest.mark.parametrize("name", support.by_night(STRUCTURES, "physics"))
def test_a_short_recording_of_another_plant_in_a_list_is_said(name):
    parts = [recording(name, 5 + i, 120)[1:3] for i in range(3)]
    same = [y for y, _ in parts]
    # The gain is twice as large in the second.
    other = [y * (2.0 if i == 1 else 1.0) for i, y in enumerate(same)]
    inputs = [u for _, u in parts]
    with pytest.warns(UserWarning, match=r"recording [0-2]: .*follow u: the plant is another one there"):
        modelled(name, other, inputs)
    with silence():
        assert modelled(name, same, inputs).findings == ()


@pytest.mark.parametrize("name", support.by_night([*STRUCTURES, "states with a disturbance"], "output error", "states"))
def test_a_gain_that_changes_in_much_noise_is_said_of_every_structure(name):
    structure = StateSpace(2, disturbance=True) if name not in STRUCTURES else STRUCTURES[name]
    rng, y, u, _ = recording("states" if name not in STRUCTURES else name, 10, 900)
    noise = rng.normal(size=y.shape)
    if name == "ARX":
        noise = lfilter([1.0], A, noise)
    # Two outputs tell more.
    y += (1.0 if y.ndim > 1 else 0.5) * y.std() / noise.std() * noise
    changed = np.where(np.arange(900) < 500, 1.0, 0.7).reshape(-1, *[1] * (y.ndim - 1)) * y
    times = {"t": timed(y)} if name == "physics" else {}
    with pytest.warns(UserWarning, match="from about sample .* on the gain from u to y is .* times the model's"):
        model = identify(changed, u, structure, progress=False, **times)
    assert {one.kind for one in model.findings} == {"another plant"}
    with silence():
        identify(y, u, structure, progress=False, **times)


@pytest.mark.parametrize("name", support.by_night(STRUCTURES, "output error", "states"))
def test_a_few_wild_inputs_are_held_back_and_not_taken_for_another_plant_or_a_step(name):
    rng, y, u, expected = recording(name, 8, 150)
    read = u.copy()
    read[[40, 100, 101]] = [60.0, -45.0, 20.0]
    with pytest.warns(UserWarning, match="u has 3 values unlike the others"):
        model = modelled(name, y, read)
    assert [one.kind for one in model.findings] == ["input outliers"]
    assert gain(name, model) == pytest.approx(expected, rel=0.05)
    if name == "physics":
        return
    # A pulse that acted is no outlier.
    noise = 0.1 * rng.normal(size=(150, 2))
    acted = lfilter(B, A, read) + (lfilter([1.0], A, noise[:, 0]) if name == "ARX" else noise[:, 0])
    if name == "states":
        acted = np.column_stack((lfilter(SECOND, A, read) + noise[:, 1], acted))
    with silence():
        assert gain(name, modelled(name, acted, read)) == pytest.approx(expected, rel=0.05)


# Recordings that mostly rest, are rounded by their sensor, or have no noise: step tests, pulses, simulations.


FRESH = np.random.default_rng(0).choice([-1.0, 1.0], 300)


def driven(kind, digits=None, steps=600):
    k = np.arange(steps)
    u = {"step": k >= 50, "pulse": (k >= 50) & (k < 70), "square": k // 100 % 2}[kind] * 1.0
    y = lfilter(B, A, u)
    return (y if digits is None else y.round(digits)), u


def fresh_fit(model):
    response = model.simulate(FRESH) - model.simulate(np.zeros(FRESH.size))
    return fit_percent(lfilter(B, A, FRESH), np.ravel(response))


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2), StateSpace(2)], ids=["arx", "oe", "states"])
@pytest.mark.parametrize("kind", ["step", "pulse", "square"])
@pytest.mark.parametrize("digits, least", [(None, 99.999), (2, 99.8), (1, 98.5)])
def test_what_moves_for_a_while_is_no_outlier(structure, kind, digits, least):
    y, u = driven(kind, digits)
    with silence():
        model = identify(y, u, structure, progress=False)
    assert not model.findings
    assert fresh_fit(model) > least


def test_steps_of_a_sensor_bound_its_noise():
    y, u = driven("step", 1)
    model = identify(y, u, OutputError(2, 2))
    assert 0.1**2 / 12.0 <= model.noise.R < 0.1**2 / 6.0
    assert model.noise.is_rounding
    # The truth within the interval that this noise makes.
    assert (np.abs(model.theta - [-1.5, 0.7, 1.0, 0.5]) < 3.0 * model.std).all()


def test_a_recording_without_noise_leaves_nothing_to_be_judged():
    y, u = recordings.recording(1, 600, sigma=0.0)
    models = {str(s): identify(y, u, s) for s in (ARX(2, 2), OutputError(2, 2))}
    for model in models.values():
        assert not model.findings and not model.warning
        np.testing.assert_allclose(model.theta, [-1.5, 0.7, 1.0, 0.5], rtol=1e-12)
        assert validate(model, y, u).verdict == RIGHT
        assert all(len(line) <= 78 for line in str(model.summary()).splitlines())
    assert min(row.fit for row in compare(models, y, u).rows) > 99.999
    # A wrong model of it leaves much.
    wrong = identify(y, u, OutputError(1, 1), trend="constant")
    assert validate(wrong, y, u).verdict != RIGHT


def test_of_few_values_that_are_explained_the_steps_are_no_noise():
    u = binary(2, 400)[1]
    model = identify(lfilter([0.0, 2.0], [1.0], u), u, OutputError(0, 1))
    assert model.noise.R < 1e-20


def test_parameters_that_no_noise_tells_apart_are_named():
    y, u = recordings.recording(1, 600, sigma=0.0)
    with pytest.warns(UserWarning, match=r"a1, a2, a3, .*not determined by a recording without noise"):
        identify(y, u, ARX(3, 3))
    with pytest.warns(UserWarning, match="no noise but rounding: the coefficients of C and D"):
        identify(y, u, ARMAX(2, 2, 1))


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-3])
def test_resolution_is_the_step_of_a_sensor(step):
    rng = np.random.default_rng(0)
    signal = step * np.round(20.0 * rng.normal(size=3000))
    signal[::97] = 5.0 * step * rng.normal(size=signal[::97].size)
    assert resolution(signal) == pytest.approx(step)
    assert resolution(rng.normal(size=100)) == 0.0 and resolution(np.ones(9)) == 0.0


@pytest.mark.parametrize("kind", ["step", "pulse"])
def test_a_tracker_at_rest_is_not_lost(kind):
    y, u = driven(kind, 2)
    tracker = ParameterTracker(OutputError(2, 2))
    with silence():
        tracker.run(y, u)
    np.testing.assert_allclose(tracker.theta[:4], [-1.5, 0.7, 1.0, 0.5], atol=0.02)


def test_after_a_rest_in_coarse_steps_what_moves_is_no_outlier():
    u = np.zeros(1500)
    u[60:110] = 1.0
    u[1200:] = -2.0
    y = lfilter(B, A, u).round(1)
    tracker = ParameterTracker(OutputError(2, 2))
    with silence():
        result = tracker.run(y, u)
    assert result.weights[1200:1230].min() > 0.5
    assert tracker.R >= 0.1**2 / 12.0 * (1.0 - 1e-12)


@pytest.mark.parametrize("by_kernel", [True, False])
@pytest.mark.parametrize("first", [0, 200])
@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2)], ids=str)
def test_while_input_and_output_rest_no_noise_is_learned(structure, first, by_kernel, monkeypatch):
    if not by_kernel:
        support.without_kernel(monkeypatch)
    rng = np.random.default_rng(5)
    rests = slice(first, 3000 if by_kernel else 600)
    u = rng.choice([-1.0, 1.0], rests.stop + 400)
    u[rests] = 0.0
    y = lfilter(B, A, u) + 0.2 * rng.normal(size=u.size)
    y[first + 50 * bool(first) : rests.stop] = 0.0
    tracker = ParameterTracker(structure, start=0)
    tracker.run(y[: rests.stop], u[: rests.stop])
    assert 1e-4 < tracker.R <= 1.0
    tracker.run(y[rests.stop :], u[rests.stop :])
    np.testing.assert_allclose(tracker.theta, [-1.5, 0.7, 1.0, 0.5], atol=0.15)
    assert 0.02 < tracker.R < 0.5


def test_a_delay_far_beyond_the_structure_is_said_and_the_right_one_is_not():
    rng, u = binary(50, 600)
    y = np.concatenate((np.zeros(50), lfilter(B, A, u)[:-50])) + 0.2 * rng.normal(size=600)
    with pytest.warns(UserWarning, match="delay nk is longer"):
        assert "another delay" in {one.kind for one in identify(y, u, OutputError(2, 2)).findings}
    with silence():
        identify(y, u, OutputError(2, 2, 51))


@pytest.mark.parametrize("sigma", [0.1, 0.5])
def test_what_one_pulse_does_is_no_outlier(sigma):
    rng, u = np.random.default_rng(0), np.ones(400)
    u[100] = 5.0
    y = 10.0 + lfilter(B, A, u - 1.0) + sigma * rng.normal(size=400)
    with pytest.warns(UserWarning, match="takes for outliers is to"):
        found = identify(y, u, ARX(2, 2))
    assert "there is OutputError(na=2, nb=2, nk=1)" in found.findings[0].text
    y = 10.0 + lfilter(B, A, u - 1.0) + lfilter([1.0], A, sigma * rng.normal(size=400))
    y[200:212] += 15.0
    with silence():
        identify(y, u, ARX(2, 2))


def test_what_is_at_rest_after_its_first_sample_has_no_color():
    with np.errstate(all="raise"):
        assert colour_of(np.eye(1, 200).ravel()).polynomial.size == 1


GAINS = {
    "even": lambda x, k: np.abs(x),
    "alternating": lambda x, k: np.where(k // 20 % 2, x, -x),
    "square": lambda x, k: x * x / x.std(),
}


def _said_of_gain(gain, structure, u, seed):
    """What is said of a plant whose output is some function of a linear one's, and the sample."""
    rng, x = np.random.default_rng(seed), lfilter(B, A, u)
    y = gain(x, np.arange(x.size)) + 0.1 * x.std() * rng.normal(size=x.size)
    with unheard(UserWarning):
        return [one.kind for one in identify(y, u, structure, progress=False).findings]


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2)], ids=str)
@pytest.mark.parametrize("gain", support.by_night([*GAINS], "even", "alternating"))
def test_a_gain_that_no_linear_plant_has_is_said(gain, structure):
    for seed, u in enumerate((np.random.default_rng(1).normal(size=1000), binary(2, 1000)[1])):
        assert "nonlinear" in _said_of_gain(GAINS[gain], structure, u, seed)


@pytest.mark.parametrize("pole", support.by_night([0.0, 0.9, 0.95], 0.95))
def test_noise_of_its_own_color_is_no_gain(pole):
    for seed in range(4):
        rng = np.random.default_rng([seed, 95])
        u = rng.normal(size=800) if seed % 2 else np.repeat(rng.uniform(-1.0, 1.0, 40), 20)
        left = lfilter([1.0], [1.0, -pole], np.where(rng.random(800) < 0.1, 5.0, 1.0) * rng.normal(size=800))
        with unheard(UserWarning):
            model = identify(lfilter(B, A, u) + 0.3 * left, u, OutputError(2, 2), progress=False)
        assert "nonlinear" not in [one.kind for one in model.findings]
