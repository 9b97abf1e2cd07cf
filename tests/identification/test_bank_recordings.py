"""What a user may give to a bank: the same as as many trackers make of it, or one sentence that says what it is."""

import warnings

import numpy as np
from numpy.testing import assert_array_equal

from robust_filterpy.identification import FIR, ParameterTracker, TrackerBank


def test_fill_values_are_missing_for_a_bank_as_for_trackers():
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], (300, 3))
    y = 2.0 * u + 0.1 * rng.normal(size=u.shape)
    y[rng.random(300) < 0.05, 1] = 9999.0
    bank = TrackerBank(3, FIR(1, nk=0), start=0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = bank.run(y, u)
    (only,) = said
    assert "TrackerBank: y has fill values, by actuator 1: 9999 (" in str(only.message)
    assert np.isnan(result.residual[y == 9999.0]).all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for i in range(3):
            alone = ParameterTracker(FIR(1, nk=0), start=0).run(y[:, i], u[:, i])
            assert_array_equal(result.theta[:, i], alone.theta)
