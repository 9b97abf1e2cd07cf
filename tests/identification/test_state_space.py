"""State-space models of several outputs: what they promise of a recording."""

import numpy as np
import pandas as pd
import pytest
import support
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import binom

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import GreyBox, StateSpace, compare, validate
from robust_filterpy.identification.judging.validate import Validation, Validations

A = np.array([[0.8, 0.4, 0.0], [-0.4, 0.8, 0.0], [0.0, 0.0, 0.6]])
B = np.array([[1.0, 0.3], [0.2, -0.6], [0.5, 1.0]])
C = np.array([[1.0, 0.0, 0.7], [0.3, -1.0, 0.4]])
POLES = np.linalg.eigvals(A)


def recorded(seed, samples=500, outliers=0.1, noise=0.2, driven=0.0, gain=1.0):
    """A recording with outliers, from a state that is not at rest."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.choice([-1.0, 1.0], (samples, 2)), rng.normal(size=3), np.empty((samples, 2))
    for k in range(samples):
        y[k] = C @ x
        x = A @ x + gain * B @ u[k] + driven * rng.normal(size=3)
    wrong = rng.random(y.shape) < outliers
    return y + noise * np.where(wrong, 10.0, 1.0) * rng.normal(size=y.shape) + [5.0, -300.0], u


def steps(model, length=25):
    """The step responses, shape (outputs, inputs, length)."""
    return np.array([model.step_response(length, output=j).response for j in range(2)])


def true_steps(length=25):
    found = np.empty((2, 2, length))
    x = np.zeros((3, 2))
    for k in range(length):
        found[:, :, k] = C @ x
        x = A @ x + B
    return found


def test_outputs_tell_the_plant_through_outliers_and_say_how_sure_they_are():
    y, u = recorded(1)
    y[40:60, 1] = np.nan
    model = identify(y, u, StateSpace(3))
    assert np.abs(steps(model) - true_steps()).max() < 0.2
    assert model.poles(0.999).contains(model.poles().values).all()
    regions = model.poles(0.9999)
    order = [np.abs(POLES - value).argmin() for value in regions.values]
    assert regions.contains(POLES[order]).all()
    assert (np.abs(model.level - [5.0, -300.0]) < 5.0 * model.level_std).all()
    assert not model.warning


def test_noise_is_learnt_for_each_output():
    y, u = recorded(2, outliers=0.0)
    y[:, 1] += 2.0 * np.random.default_rng(0).normal(size=len(y))
    R = identify(y, u, StateSpace(3)).R
    assert R[0] == pytest.approx(0.04, rel=0.3)
    assert R[1] == pytest.approx(4.04, rel=0.3)


def test_units_and_levels_change_nothing():
    y, u = recorded(3)
    model, other = identify(y, u, StateSpace(3)), identify(1e4 * y + 7e4, u * [1e-3, 50.0], StateSpace(3))
    assert np.allclose(1e4 * steps(model) / np.array([1e-3, 50.0])[:, None], steps(other), rtol=1e-3, atol=20.0)


def test_the_evidence_finds_the_order():
    model = identify(*recorded(4), StateSpace())
    assert len(model.A) == 3
    assert min(model.orders, key=lambda tried: tried[1])[0] == 3


def test_python_control_and_the_model_simulate_the_same():
    import control

    y, u = recorded(5)
    model = identify(y, u, StateSpace(3))
    run = control.forced_response(model.to_control(), inputs=u.T).outputs.T + model.level
    assert np.allclose(model.simulate(u), run)


@pytest.mark.parametrize("disturbance", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_a_simulation_goes_on_where_a_recording_ended(disturbance):
    y, u = recorded(7, outliers=0.0, noise=1e-3)
    model = identify(y[:400], u[:400], StateSpace(3, disturbance=disturbance))
    for start in ("continued", (y[300:400], u[300:400])):
        assert np.abs(model.simulate(u[400:], start=start) - y[400:]).max() < 0.05
    assert np.abs(model.simulate(u[400:]) - y[400:])[0].max() > 0.05


def test_several_recordings_and_tables():
    y, u = recorded(8)
    model = identify([y[:200], y[200:] + 50.0], [u[:200], u[200:]], StateSpace(3))
    assert np.allclose(model.levels[1] - model.levels[0], 50.0, atol=0.5)
    index = pd.date_range("2024-01-01", periods=len(y), freq="500ms")
    tables = pd.DataFrame(y, index, ["a", "b"]), pd.DataFrame(u, index, ["v", "w"])
    timed = identify(*tables, StateSpace(3))
    assert timed.dt == 0.5
    assert timed.simulate(tables[1]).index.equals(index)
    assert len(timed.poles().to_frame()) == 3


def test_bands_are_those_of_the_same_plant_as_a_polynomial():
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 600)
    y = lfilter([0.0, 1.0], [1.0, -0.7], u) + 0.3 * rng.normal(size=600)
    one, other = (identify(y, u, s).frequency_response([0.1, 0.5, 2.0]) for s in (StateSpace(1), OutputError(1, 1)))
    for name in ("magnitude", "phase"):
        middle, width = getattr(other, name), getattr(other, f"{name}_upper") - getattr(other, f"{name}_lower")
        assert (width > 0.0).all()
        # Their levels and starts are not told apart in the same way.
        for end in ("", "_lower", "_upper"):
            far = getattr(one, name + end) - getattr(other, name + end)
            assert (np.abs(far) < 0.25 * width).all(), (name, end, middle, far / width)


@pytest.mark.parametrize(("change", "says"), [
    (lambda y, u: (y, np.column_stack((u[:, 0], 2.0 * u[:, 0]))), "some that others explain"),
    (lambda y, u: (y, np.column_stack((u[:, 0], np.ones(len(u))))), "input 1 constant"),
    (lambda y, u: (np.column_stack((y[:, 0], np.full(len(y), 3.0))), u), "same value throughout in output 1"),
    # Beside such a level what moves is rounding.
    (lambda y, u: (np.column_stack((y[:, 0], 1e9 + 1e-5 * y[:, 1])), u), "same value throughout in output 1"),
    (lambda y, u: (np.column_stack((y[:, 0], np.full(len(y), np.nan))), u), "of output 1 in recording 0"),
    (lambda y, u: (y[:15], u[:15]), "more samples"),
])  # fmt: skip
def test_what_no_model_can_be_made_of_is_refused(change, says):
    y, u = recorded(10)
    with pytest.raises(ValueError, match=says):
        identify(*change(y, u), StateSpace(3))


def test_an_order_beyond_the_recording_is_said():
    y, u = recorded(11, outliers=0.0, noise=1e-7)
    with pytest.warns(UserWarning, match="order"):
        identify(y, u, StateSpace(5))


def test_arguments_of_other_structures_are_refused():
    y, u = recorded(13)
    with pytest.raises(ValueError, match="R: expected None"):
        identify(y, u, StateSpace(2), R=1.0)
    with pytest.raises(ValueError, match="'auto'"):
        StateSpace("most")


def test_responses_are_drawn_and_tabled():
    import matplotlib

    matplotlib.use("Agg")
    y, u = recorded(14)
    model = identify(y, u, StateSpace(3))
    step = model.step_response(10)
    assert len(step.plot().lines) == 3
    assert list(step.to_frame().columns[:2]) == ["response[0]", "response[1]"]
    assert model.frequency_response([0.1, 1.0]).to_frame().shape == (2, 12)
    assert model.poles().to_frame().shape == (3, 4)


@pytest.mark.parametrize(
    "structure",
    [pytest.param(StateSpace(2), marks=pytest.mark.nightly), StateSpace(2, feedthrough=True, disturbance=True)],
)
def test_a_summary_has_every_entry_with_what_was_found_beside(structure):
    y, u = recorded(5, samples=300)
    y[50:60, 0] = np.nan
    model = identify(y, u, structure)
    summary = model.summary(0.9)
    rows = {row.name: row for row in summary.rows}
    assert len(rows) == model.theta.size + 2
    assert rows["B[1,0]"].estimate == model.B[1, 0] and rows["level[1]"].estimate == model.level[1]
    assert ("K[0,1]" in rows) == ("D[0,1]" in rows) == structure.disturbance
    assert rows["A[0,0]"].std == np.sqrt(model.P[0, 0]) and rows["level[0]"].std == model.level_std[0]
    width = (rows["C[0,0]"].upper - rows["C[0,0]"].lower) / (model.confidence_intervals().upper - model.theta)[8]
    assert width == pytest.approx(2.0 * 1.6449 / 1.96, rel=1e-3)
    assert summary.facts["Samples"] == "590 of 600"
    assert "Noise, output 1" in str(summary) and len(summary.to_frame()) == len(rows)


# validate and compare of state-space and physical models: right ones pass, wrong ones are named by output.


RIGHT = "nothing is left in the residuals"


def judged(seed, outliers=0.1, driven=0.0, gain=1.0):
    return recorded([41, *np.atleast_1d(seed)], 400, outliers, driven=driven, gain=gain)


def lag(x, u, p):
    """A lag of first order."""
    return [p[0] * (p[1] * u[0] - x[0])]


def two_lags(x, u, p):
    """Another one after it."""
    return [p[0] * (p[1] * u[0] - x[0]), p[2] * (x[0] - x[1])]


def cascade(seed, outliers=0.1, gain=2.0, samples=100):
    """Two lags at irregular times, of which the second is measured."""
    rng = np.random.default_rng([43, seed])
    t, u, x = np.cumsum(rng.uniform(0.2, 1.8, samples)), np.repeat(rng.normal(size=samples // 5), 5), np.zeros(2)
    F, y = np.array([[-0.5, 0.0], [0.3, -0.3]]), np.empty(samples)
    for k in range(samples):
        y[k] = x[1]
        rest = np.full(2, gain * u[k])
        x = rest + expm(F * (t[k + 1] - t[k] if k + 1 < samples else 0.0)) @ (x - rest)
    wild = np.where(rng.random(samples) < outliers, 10.0, 1.0)
    return y + 0.05 * wild * rng.normal(size=samples), u, t


def physics(f=two_lags):
    names = ("rate", "gain", "second")[: 3 if f is two_lags else 2]
    guess = dict(zip(names, (0.7, 1.0, 0.4), strict=False))
    return GreyBox(f, guess, x0=np.zeros(2 if f is two_lags else 1), h=lambda x, u, p: x[-1:])


@pytest.fixture(scope="module")
def states():
    return identify(*judged(0), StateSpace(3))


@pytest.fixture(scope="module")
def box():
    y, u, t = cascade(0)
    return identify(y, u, physics(), t=t)


# Right ones.


@support.draws(4, 12)
@pytest.mark.parametrize("outliers", [pytest.param(0.0, marks=pytest.mark.nightly), 0.1])
def test_p_values_of_right_states_are_uniform_on_their_own_and_on_fresh_recordings(outliers, draws):
    same, fresh = [], []
    for seed in range(draws):
        y, u = judged([1, seed], outliers)
        model = identify(y, u, StateSpace(3))
        same += validate(model, y, u)
        fresh += validate(model, *judged([2, seed], outliers))
    assert all(one.same_recording for one in same) and not any(one.same_recording for one in fresh)
    for found in (same, fresh):
        for values in ([one.whiteness.p_value for one in found], [one.independence.p_value for one in found]):
            low, high = binom.interval(0.999, len(values), 0.5)
            assert low <= np.sum(np.array(values) < 0.5) <= high
            assert np.sum(np.array(values) < 0.05) <= binom.ppf(0.9995, len(values), 0.05)
            assert min(values) > 1e-4
    # What the fit has made zero is no evidence.
    assert max(one.independence.degrees for one in same) < 42 == fresh[0].independence.degrees


@pytest.mark.parametrize("outliers", [pytest.param(0.0, marks=pytest.mark.nightly), 0.1])
def test_right_states_driven_by_noise_pass_and_without_it_said_they_do_not(outliers):
    first, second = judged(3, outliers, 0.3), judged(4, outliers, 0.3)
    model = identify(*first, StateSpace(3, disturbance=True))
    assert validate(model, *first).verdict == validate(model, *second).verdict == RIGHT
    assert "residuals follow one another" in validate(identify(*first, StateSpace(3)), *second).verdict


def test_gaps_fill_values_and_wild_samples_raise_no_alarm(states, box):
    rng = np.random.default_rng(0)
    y, u = judged(5)
    found = validate(states, np.where(rng.random(y.shape) < 0.2, 9999.0, y), u)
    assert found.verdict == RIGHT and found[0].samples < 360
    y, u, t = cascade(5)
    y[::7] = np.nan
    y[60] = 1e9
    assert validate(box, y, u, lags=10, t=t).verdict == RIGHT


# Wrong ones.


def test_an_order_too_little_is_named_by_output_and_input(states):
    y, u = judged(6)
    small = identify(*judged(0), StateSpace(2))
    assert "output 0: dynamics are missing: residuals follow input" in validate(small, y, u).verdict
    assert validate(states, y, u).verdict == RIGHT
    assert [row.name for row in compare({"small": small, "right": states}, y, u).rows] == ["right", "small"]


def test_only_the_output_that_is_wrong_is_named(states):
    y, u = judged(7)
    y[:, 1] = 1.5 * (y[:, 1] + 300.0) - 300.0
    verdict = validate(states, y, u).verdict
    assert verdict.startswith("output 1: dynamics are missing") and "output 0" not in verdict
    # Of a model that is far off all residuals are large, and large is not wild.
    one = identify(judged(0)[0][:, 0], judged(0)[1], OutputError(4, (4, 4)))
    assert validate(one, 1.5 * (y[:, 0] - 5.0) + 5.0, u).verdict.startswith("dynamics are missing")


@pytest.mark.nightly
def test_a_gain_that_has_changed_and_equations_that_lack_a_state_are_named(states, box):
    assert "dynamics are missing" in validate(states, *judged(8, gain=1.2)).verdict
    y, u, t = cascade(8, gain=2.4)
    assert validate(box, y, u, lags=10, t=t).verdict != RIGHT
    y, u, t = cascade(0)
    simple = identify(y, u, physics(lag), t=t)
    y, u, t = cascade(9)
    assert validate(simple, y, u, lags=10, t=t).verdict != RIGHT
    assert compare({"lag": simple, "two": box}, y, u, t).rows[0].name == "two"


def test_another_level_is_said_and_is_no_missing_dynamics(states):
    y, u = judged(10)
    found = validate(states, y + [0.0, 40.0], u)
    assert found.verdict.startswith("output 1: the level is +40")
    assert "dynamics" not in found.verdict
    assert found[1].shift == pytest.approx(40.0, abs=0.2)
    one = identify(y[:, 0], u, StateSpace(3))
    assert validate(one, y[:, 0] - 9.0, u)[0].shift == pytest.approx(-9.0, abs=0.2)
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 500)
    y = np.concatenate(([0.0], u[:-1])) + 0.1 * rng.normal(size=500)
    plain = validate(identify(y, u, OutputError(1, 1)), y + 3.0, u)
    assert plain.verdict.startswith("the level is +3") and "dynamics" not in plain.verdict


# What comes back.


def test_each_output_has_a_validation_and_all_of_them_a_text_and_a_table(states):
    y, u = judged(13)
    found = validate(states, y, u, level=0.9801)
    assert isinstance(found, Validations) and all(isinstance(one, Validation) for one in found)
    assert [one.level for one in found] == pytest.approx([0.99, 0.99])
    assert found[1].cross_correlation.shape == (2, 21)
    assert found[0].fits[-1].all == pytest.approx(states.fit(y, u)[0])
    assert "output 1: nothing is left" in str(found)
    assert found.to_frame()["output 1", "autocorrelation"][3] == found[1].autocorrelation[2]


@pytest.mark.nightly
def test_predictions_further_ahead_come_to_the_free_run():
    y, u = judged(14, 0.0, 0.3)
    model = identify(y, u, StateSpace(3, disturbance=True))
    left = [np.abs(y - model.predict(y, u, steps))[5:].mean() for steps in (1, 3, 30)]
    assert left[0] < left[1] < left[2]
    np.testing.assert_allclose(model.predict(y, u), y - model.residuals(y, u))
    # By then nothing is left of the state in which it began, nor of what was measured.
    run = model.simulate(u)
    np.testing.assert_allclose(model.free_run(y, u)[150:], run[150:], atol=1e-6)
    np.testing.assert_allclose(model.predict(y, u, 350)[-40:], run[-40:], atol=1e-6)


def test_physics_begins_where_the_recording_does(box):
    y, u, t = cascade(15, outliers=0.0)
    run = box.free_run(y[60:], u[60:], t[60:])
    assert np.abs(run - y[60:, None]).max() < 0.3
    np.testing.assert_allclose(box.residuals(y[60:], u[60:], t[60:]), y[60:, None] - run)
    assert box.fit(y[60:], u[60:], t[60:])[0] > 85.0


def test_tables_and_transfer_functions_stand_beside_physics_of_equal_steps():
    rng = np.random.default_rng(2)
    u, t = rng.choice([-1.0, 1.0], 100), 0.5 * np.arange(100.0)
    y, share = np.zeros(100), np.exp(-0.25)
    for k in range(99):
        y[k + 1] = share * y[k] + (1.0 - share) * 2.0 * u[k]
    y += 0.05 * rng.normal(size=100)
    models = {"physics": identify(y, u, physics(lag), t=t), "states": identify(y, u, StateSpace(1))}
    models["polynomials"] = identify(y, u, OutputError(1, 1))
    found = compare(models, y, u, t)
    assert found.measured.shape == (100,) and max(row.fit for row in found.rows) - found.rows[-1].fit < 0.5
    index = pd.to_datetime("2024-01-01") + pd.to_timedelta(t, unit="s")
    table = pd.DataFrame({"y": y, "u": u}, index)
    timed = compare(models, table["y"], table["u"])
    assert timed.index.equals(index) and timed.rows[0].fit == pytest.approx(found.rows[0].fit)


@pytest.mark.parametrize(("change", "says"), [
    (lambda y, u, t: ([y, y], [u, u], None), "expected one recording"),
    (lambda y, u, t: (np.column_stack((y, y[:, 0])), u, None), r"expected shape \(N, 2\)"),
    (lambda y, u, t: (y * [1.0, np.nan], u, None), "at least 84 measured samples of output 1"),
    (lambda y, u, t: (y, u, t**2), "t: expected equal steps"),
    (lambda y, u, t: (y, u, t[:-1]), "t: expected 400 times"),
])  # fmt: skip
def test_what_cannot_be_judged_is_refused_in_words(states, change, says):
    y, u, t = change(*judged(16), np.arange(400.0))
    with pytest.raises(ValueError, match=says):
        validate(states, y, u, t=t)


def test_physics_wants_times_and_models_of_the_same_outputs_are_compared(states, box):
    y, u, t = cascade(17)
    with pytest.raises(ValueError, match="t: expected the times"):
        validate(box, y, u)
    with pytest.raises(ValueError, match="u: expected the inputs that f takes"):
        validate(box, y, None, t=t)


def test_models_of_other_outputs_than_y_are_told_apart_by_name(states, box):
    y, u, t = cascade(17)
    one, both = identify(y, u, OutputError(1, 1)), np.column_stack((y, y))
    for models, measured, says in (
        ({"box": box}, both, r"as y has, 2, got models\['box'\] of 1;"),
        ({"states": states}, y, r"as y has, 1, got models\['states'\] of 2;"),
        ({"states": states, "one": one}, both, r"as y has, 2, got models\['states'\] of 2, models\['one'\] of 1;"),
        ({"one": one, "states": states}, y, r"as y has, 1, got models\['one'\] of 1, models\['states'\] of 2;"),
    ):
        with pytest.raises(ValueError, match=says):
            compare(models, measured, np.column_stack((u, u)) if "states" in models else u, t)
    assert len(compare({"one": one, "box": box}, y[:, None], u, np.arange(float(len(y)))).rows) == 2
