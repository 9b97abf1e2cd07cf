"""validate and compare take transfer functions of python-control: those of a model give the model's numbers."""

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import compare, validate

A, B = [1.0, -1.5, 0.7], [0.0, 0.0, 1.0, 0.5]


def recorded(offset=40.0, seed=10005, size=1500):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], size)
    noise = 0.3 * rng.normal(size=size) * np.where(rng.random(size) < 0.1, 10.0, 1.0)
    return offset + lfilter(B, A, u) + noise, u


def test_that_of_a_model_is_judged_as_the_model():
    model = identify(*recorded(), OutputError(2, 2, nk=2))
    y, u = recorded(seed=10006)
    found = compare({"model": model, "transfer function": model.transfer_function(0.1)}, y, u)
    ours, theirs = sorted(found.rows)
    np.testing.assert_allclose(ours[1:], theirs[1:], atol=0.05)
    one, other = validate(model, y, u), validate(model.transfer_function(0.1), y, u)
    assert one.verdict == other.verdict == "nothing is left in the residuals"


def test_the_true_one_passes_and_a_wrong_one_is_named():
    y, u = recorded()
    y[100:110] = np.nan
    # python-control writes polynomials in z.
    right = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0], True)
    late = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0, 0.0], True)
    assert validate(right, y, u).verdict == "nothing is left in the residuals"
    assert validate(late, y, u).verdict.startswith("dynamics are missing")
    assert [row.name for row in compare({"late": late, "right": right}, y, u).rows] == ["right", "late"]


@pytest.mark.parametrize("system, error, message", [
    (control.TransferFunction([1.0], [1.0, 1.0]), ValueError, "discrete time"),
    (control.TransferFunction([[[1.0], [1.0]]], [[[1.0, 0.5], [1.0, 0.5]]], True), ValueError, "one input"),
    (control.TransferFunction([1.0, 0.0, 0.0], [1.0, 0.5], True), ValueError, "proper"),
    (3.0, TypeError, "StateSpaceModel or GreyBoxModel that identify found, or a control.TransferFunction"),
])  # fmt: skip
def test_what_cannot_be_judged_is_refused(system, error, message):
    y, u = recorded(size=200)
    with pytest.raises(error, match=message):
        validate(system, y, u)
    with pytest.raises(error, match=r"models\['it'\].*" + message):
        compare({"it": system}, y, u)


def test_another_period_than_that_of_the_recording_is_refused():
    pd = pytest.importorskip("pandas")
    y, u = recorded(size=300)
    index = pd.date_range("2026-01-01", periods=300, freq="100ms")
    system = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0], 0.2)
    with pytest.raises(ValueError, match=r"0\.2"):
        validate(system, pd.Series(y, index), pd.Series(u, index))
