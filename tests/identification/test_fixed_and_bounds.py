"""Parameters that are told, as numbers or between bounds; noise that is summed up."""


import numpy as np
import pytest
import recordings
from recordings import THETA, A, B, unheard
from scipy.signal import lfilter
from support import by_night

from robust_filterpy.identification import (
    AR,
    ARMAX,
    ARX,
    FIR,
    GreyBox,
    OutputError,
    StateSpace,
    identify,
    validate,
)
from robust_filterpy.identification.models.structures import Structure


def recording(seed=0, length=400, filtered=False):
    return recordings.recording([31, seed], length, sigma=0.1, inside=filtered)


@pytest.mark.parametrize("structure", by_night([OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 1)], ARX(2, 2)), ids=str)
def test_a_fixed_parameter_stays_has_no_variance_and_helps_the_others(structure):
    y, u = recording(filtered=structure.na > 0)
    free, told = identify(y, u, structure), identify(y, u, structure, fixed={"a1": -1.5})
    assert told.theta[0] == -1.5
    assert told.std[0] == 0.0
    assert (told.std[1:4] < 1.05 * free.std[1:4]).all()
    assert told.std[1] < 0.9 * free.std[1]
    assert np.abs((told.theta - free.theta)[:4]).max() < 4.0 * free.std[:4].max()


def test_a_fixed_parameter_is_one_of_the_recording_as_it_was_measured():
    y, u = recording()
    model = identify(1e3 * y + 7.0, 1e-2 * u + 50.0, OutputError(2, 2), fixed={"b2": 5e4})
    assert model.theta[3] == 5e4
    np.testing.assert_allclose(model.theta / [1.0, 1.0, 1e5, 1e5], THETA, atol=0.02)


def test_a_bound_that_does_not_bind_changes_nothing():
    y, u = recording()
    free, bounded = identify(y, u, OutputError(2, 2)), identify(y, u, OutputError(2, 2), bounds={"b2": (0.0, None)})
    np.testing.assert_allclose(bounded.theta, free.theta, rtol=1e-6)
    np.testing.assert_allclose(bounded.std, free.std, rtol=1e-5)


def test_a_bound_that_binds_is_kept_and_named():
    y, u = recording()
    with pytest.warns(UserWarning, match="b2 ended at a bound"):
        model = identify(y, u, OutputError(2, 2), bounds={"b2": (None, 0.4)})
    assert model.theta[3] == 0.4
    assert model.std[3] == 0.0
    with unheard():
        fixed = identify(y, u, OutputError(2, 2), fixed={"b2": 0.4})
    np.testing.assert_allclose(model.theta, fixed.theta, atol=1e-6)
    np.testing.assert_allclose(model.std, fixed.std, rtol=1e-3)


def test_matrices_and_physics_have_no_such_names():
    y, u = recording(length=100)
    box = GreyBox(lambda x, u, p: [u[0] - p[0] * x[0]], [1.0], x0=[0.0])
    for structure in (StateSpace(1), box):
        with pytest.raises(ValueError, match="fixed: expected None"):
            identify(y, u, structure, fixed={"a1": 1.0})


# Noise that is summed up.


def wandering(seed=0, length=500):
    rng = np.random.default_rng([37, seed])
    u = rng.choice([-1.0, 1.0], length)
    steps = 0.1 * np.where(rng.random(length) < 0.05, 20.0, 1.0) * rng.normal(size=length)
    return 40.0 + lfilter(B, A, u) + np.cumsum(steps), u


def test_beside_a_level_that_wanders_and_jumps_the_dynamics_are_found_from_differences():
    y, u = wandering()
    y[[100, 101, 300]] += [9.0, -7.0, 5.0]
    model = identify(y, u, OutputError(2, 2, integrated=True))
    np.testing.assert_allclose(model.theta, [*THETA, -1.0], atol=0.03)
    assert not model.findings
    assert model.std[4] == 0.0
    # The level is nobody's.
    assert np.isinf(model.offset_std)
    left = y - model.predict(y, u)
    assert np.nanmedian(np.abs(left[5:60])) < 0.15
    assert validate(model, y, u).verdict == "nothing is left in the residuals"


def test_a_structure_of_differences_is_its_orders():
    structure = ARX(2, 1, integrated=True)
    assert structure == eval(repr(structure))
    assert Structure(**structure.get_params()) == structure
    assert structure.names == ("a1", "a2", "b1", "d1")
    assert structure.integrated
    assert not any(one.integrated for one in (ARX(2, 1), Structure(2, 1, nd=1)))
    assert all(one.nd == 1 for one in (FIR(2, integrated=True), AR(1, integrated=True)))
    with pytest.raises(TypeError, match="integrated: expected True or False"):
        ARX(2, 2, 1, 3)
    with pytest.raises(ValueError, match="which has it at -1"):
        identify(*recording(), structure, fixed={"d1": -0.5})
