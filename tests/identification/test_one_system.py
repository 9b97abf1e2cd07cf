"""A model, states and a tracker are systems: what one of them tells the others tell."""

from __future__ import annotations

import numpy as np
import pytest

from robust_filterpy.identification import ARX, OutputError, ParameterTracker, StateSpace, identify

RNG = np.random.default_rng(5)
U = RNG.choice([-1.0, 1.0], 200)
Y = np.zeros(200)
for k in range(1, 200):
    Y[k] = 0.5 * Y[k - 1] + 2.0 * U[k - 1]
Y += 0.05 * RNG.normal(size=200)


def test_a_tracker_has_its_system_in_continuous_time_and_with_fewer_states():
    tracker = ParameterTracker(ARX(2, 2), theta=[-0.5, 0.0, 2.0, 0.0], P=1e-6)
    assert ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0], P=1e-6).to_continuous(0.1).poles.values == pytest.approx(
        np.log(0.5) / 0.1
    )
    assert float(np.squeeze(tracker.reduced(1).dcgain())) == pytest.approx(4.0)


@pytest.mark.parametrize("structure", [OutputError(1, 1), StateSpace(1)], ids=["polynomials", "states"])
def test_equal_steps_of_time_change_nothing_and_others_are_refused(structure):
    model, t = identify(Y, U, structure), 0.1 * np.arange(200)
    np.testing.assert_array_equal(model.predict(Y, U, t=t), model.predict(Y, U))
    np.testing.assert_array_equal(model.fit(Y, U, t), model.fit(Y, U))
    with pytest.raises(ValueError, match="t: expected equal steps"):
        model.free_run(Y, U, t**2)


@pytest.mark.parametrize("structure", [OutputError(1, 1), StateSpace(1)], ids=["polynomials", "states"])
def test_a_level_in_the_place_of_an_output_is_refused_and_an_output_that_is_not_there(structure):
    model = identify(Y, U, structure)
    with pytest.raises(TypeError, match=r"output: .* level= goes by its name"):
        model.frequency_response([0.1], 0.9)
    for call in (model.step_response, model.noise_spectrum):
        with pytest.raises(ValueError, match="output: expected 0 to 0, got 1"):
            call([0.1] if call == model.noise_spectrum else 5, output=1)
