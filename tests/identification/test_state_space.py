"""State-space models of several outputs: what they promise of a recording."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import StateSpace

A = np.array([[0.8, 0.4, 0.0], [-0.4, 0.8, 0.0], [0.0, 0.0, 0.6]])
B = np.array([[1.0, 0.3], [0.2, -0.6], [0.5, 1.0]])
C = np.array([[1.0, 0.0, 0.7], [0.3, -1.0, 0.4]])
POLES = np.linalg.eigvals(A)


def recorded(seed, samples=500, outliers=0.1, noise=0.2, driven=0.0):
    """A recording with outliers, from a state that is not at rest."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.choice([-1.0, 1.0], (samples, 2)), rng.normal(size=3), np.empty((samples, 2))
    for k in range(samples):
        y[k] = C @ x
        x = A @ x + B @ u[k] + driven * rng.normal(size=3)
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


@pytest.mark.nightly
def test_a_disturbance_of_the_states_is_predicted():
    y, u = recorded(6, 400, outliers=0.05, noise=0.1, driven=0.3)
    plain, driven = identify(y, u, StateSpace(3)), identify(y, u, StateSpace(3, disturbance=True))
    assert np.nanmedian(np.abs(driven.residuals(y, u))) < 0.8 * np.nanmedian(np.abs(plain.residuals(y, u)))
    assert np.abs(steps(driven) - true_steps()).max() < 0.6


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


def test_one_output_and_one_input_without_a_second_axis():
    y, u = recorded(9)
    model = identify(y[:, 0], u[:, 0], StateSpace(2))
    assert model.C.shape == (1, 2)
    assert model.frequency_response([0.1]).response.shape == (1,)


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
    (lambda y, u: (y, u[:-1]), "500 samples like y, got 499"),
    (lambda y, u: (y, None), "got None"),
    (lambda y, u: (np.where(np.arange(len(y))[:, None] == 7, np.inf, y), u), "inf in sample 7"),
])  # fmt: skip
def test_what_no_model_can_be_made_of_is_refused(change, says):
    y, u = recorded(10)
    with pytest.raises(ValueError, match=says):
        identify(*change(y, u), StateSpace(3))


def test_an_order_beyond_the_recording_is_said():
    y, u = recorded(11, outliers=0.0, noise=1e-7)
    with pytest.warns(UserWarning, match="order"):
        identify(y, u, StateSpace(5))


def test_fill_values_are_gaps():
    y, u = recorded(12, outliers=0.0)
    filled = y.copy()
    filled[::25, 0] = 9999.0
    with pytest.warns(UserWarning, match="9999"):
        model = identify(filled, u, StateSpace(3))
    assert np.abs(steps(model) - true_steps()).max() < 0.2


def test_arguments_of_other_structures_are_refused():
    y, u = recorded(13)
    with pytest.raises(ValueError, match="R: expected None"):
        identify(y, u, StateSpace(2), R=1.0)
    with pytest.raises(ValueError, match="'auto'"):
        StateSpace("most")


def test_responses_are_drawn_and_tabled_and_the_model_reduced():
    import matplotlib

    matplotlib.use("Agg")
    y, u = recorded(14)
    model = identify(y, u, StateSpace(3))
    step = model.step_response(10)
    assert len(step.plot().lines) == 3
    assert list(step.to_frame().columns[:2]) == ["response[0]", "response[1]"]
    assert model.frequency_response([0.1, 1.0]).to_frame().shape == (2, 12)
    assert model.poles().to_frame().shape == (3, 4)
    assert model.reduced(2).nstates == 2
    with pytest.raises(ValueError, match="1 to 3 states"):
        model.reduced(4)


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
