"""State-space models of several outputs: what they promise of a recording."""

import control
import numpy as np
import pandas as pd
import pytest
from recordings import INPUTS, OUTPUTS, STATES, of_states, recording

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import StateSpace

POLES = np.linalg.eigvals(STATES)


def steps(model, length=25):
    """The step responses, shape (outputs, inputs, length)."""
    return np.array([model.step_response(length, output=j).response for j in range(2)])


def true_steps(length=25):
    found = np.empty((2, 2, length))
    x = np.zeros((3, 2))
    for k in range(length):
        found[:, :, k] = OUTPUTS @ x
        x = STATES @ x + INPUTS
    return found


def test_outputs_tell_the_plant_through_outliers_and_say_how_sure_they_are():
    y, u = of_states(1)
    y[40:60, 1] = np.nan
    model = identify(y, u, StateSpace(3))
    assert np.abs(steps(model) - true_steps()).max() < 0.2
    assert model.poles(0.999).contains(model.poles().values).all()
    regions = model.poles(0.9999)
    order = [np.abs(POLES - value).argmin() for value in regions.values]
    assert regions.contains(POLES[order]).all()
    assert (np.abs(model.level - [5.0, -300.0]) < 5.0 * model.level_std).all()
    assert not model.warning


def test_noise_is_learned_for_each_output():
    y, u = of_states(2, outliers=0.0)
    y[:, 1] += 2.0 * np.random.default_rng(0).normal(size=len(y))
    assert identify(y, u, StateSpace(3)).R == pytest.approx([0.04, 4.04], rel=0.3)


def test_units_and_levels_change_nothing():
    y, u = of_states(3)
    model, other = identify(y, u, StateSpace(3)), identify(1e4 * y + 7e4, u * [1e-3, 50.0], StateSpace(3))
    assert np.allclose(1e4 * steps(model) / np.array([1e-3, 50.0])[:, None], steps(other), rtol=1e-3, atol=20.0)


def test_the_evidence_finds_the_order():
    model = identify(*of_states(4), StateSpace())
    assert len(model.A) == 3 == min(model.orders, key=lambda tried: tried[1])[0]


def test_several_recordings_and_tables_and_a_simulation_is_python_controls():
    y, u = of_states(8)
    model = identify([y[:200], y[200:] + 50.0], [u[:200], u[200:]], StateSpace(3))
    assert np.allclose(model.levels[1] - model.levels[0], 50.0, atol=0.5)
    run = control.forced_response(model.to_control(), inputs=u.T).outputs.T + model.level
    assert np.allclose(model.simulate(u), run)
    index = pd.date_range("2024-01-01", periods=len(y), freq="500ms")
    tables = pd.DataFrame(y, index, ["a", "b"]), pd.DataFrame(u, index, ["v", "w"])
    timed = identify(*tables, StateSpace(3))
    assert timed.dt == 0.5
    assert timed.simulate(tables[1]).index.equals(index)
    assert len(timed.poles().to_frame()) == 3


def test_bands_are_those_of_the_same_plant_as_a_polynomial():
    y, u = recording(1, 600, share=0.0, a=[1.0, -0.7], b=[0.0, 1.0])
    one, other = (identify(y, u, s).frequency_response([0.1, 0.5, 2.0]) for s in (StateSpace(1), OutputError(1, 1)))
    for name in ("magnitude", "phase"):
        middle, width = getattr(other, name), getattr(other, f"{name}_upper") - getattr(other, f"{name}_lower")
        assert (width > 0.0).all()
        # Their levels and starts are not distinguished in the same way.
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
    with pytest.raises(ValueError, match=says):
        identify(*change(*of_states(10)), StateSpace(3))
    with pytest.raises(ValueError, match="'auto'"):
        StateSpace("most")


def test_an_order_beyond_the_recording_is_said():
    with pytest.warns(UserWarning, match="order"):
        identify(*of_states(11, outliers=0.0, noise=1e-7), StateSpace(5))


def test_a_summary_has_every_entry():
    y, u = of_states(5, samples=300)
    y[50:60, 0] = np.nan
    model = identify(y, u, StateSpace(2, feedthrough=True, disturbance=True))
    summary = model.summary(0.9)
    rows = {row.name: row for row in summary.rows}
    assert len(rows) == model.theta.size + 2
    assert rows["B[1,0]"].estimate == model.B[1, 0] and rows["level[1]"].estimate == model.level[1]
    assert {"K[0,1]", "D[0,1]"} <= rows.keys()
    assert rows["A[0,0]"].std == np.sqrt(model.P[0, 0]) and rows["level[0]"].std == model.level_std[0]
    assert summary.facts["Samples"] == "590 of 600"
    assert "Noise, output 1" in str(summary) and len(summary.to_frame()) == len(rows)


@pytest.mark.nightly
def test_predictions_further_ahead_come_to_the_free_run():
    y, u = of_states([41, 14], 400, 0.0, driven=0.3)
    model = identify(y, u, StateSpace(3, disturbance=True))
    left = [np.abs(y - model.predict(y, u, steps))[5:].mean() for steps in (1, 3, 30)]
    assert left[0] < left[1] < left[2]
    np.testing.assert_allclose(model.predict(y, u), y - model.residuals(y, u))
    # By then nothing is left of the state in which it began, nor of what was measured.
    run = model.simulate(u)
    np.testing.assert_allclose(model.free_run(y, u)[150:], run[150:], atol=1e-6)
    np.testing.assert_allclose(model.predict(y, u, 350)[-40:], run[-40:], atol=1e-6)
