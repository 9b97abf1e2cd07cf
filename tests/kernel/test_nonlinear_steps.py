"""Steps of nonlinear filters refuse what the definition refuses; steps by parts show the same whenever looked at."""

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints
from hostile import spoilt

from robust_filterpy import RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, kernel

support.needs_kernel()

EXTENSION = kernel.extension()
F = np.array([[1.0, 0.1, 0.0], [0.0, 0.95, 0.1], [0.0, 0.0, 0.9]])
REFUSED = (TypeError, ValueError, OverflowError, np.linalg.LinAlgError)


def seen(x):
    x = np.ravel(x)
    return np.array([np.hypot(x[0] + 5.0, x[1]), x[1] + 0.1 * x[2] ** 2])


def slope(x):
    x = np.ravel(x)
    r = np.hypot(x[0] + 5.0, x[1])
    return np.array([[(x[0] + 5.0) / r, x[1] / r, 0.0], [0.0, 1.0, 0.2 * x[2]]])


def made(kind):
    if kind == "extended":
        kf = RobustExtendedKalmanFilter(3, 2)
        kf.F = F
    else:
        points = MerweScaledSigmaPoints(3, 0.3, 2.0, 0.0)
        kf = RobustUnscentedKalmanFilter(3, 2, 1.0, seen, lambda x, dt: F @ x, points)
    kf.x, kf.Q, kf.R = np.zeros(3), 0.1 * np.eye(3), np.diag([0.5, 0.2])
    return kf


def stepped(kf, z, extension, monkeypatch, **passed):
    """Step by an extension, or by the definition alone; what it raises, None if nothing."""
    with monkeypatch.context() as patch, np.errstate(all="ignore"):
        support.served_by(patch, extension)
        try:
            kf.predict()
            linearized = isinstance(kf, RobustExtendedKalmanFilter)
            extra = (passed.pop("H", slope), passed.pop("Hx", seen)) if linearized else ()
            kf.update(z, *extra, **passed)
        except REFUSED as error:
            return type(error)
    return None


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_what_is_passed_spoilt_is_refused_or_taken_as_by_the_definition(kind, monkeypatch):
    g, served = np.random.default_rng(4), 0
    for seed in range(150):
        one, two = made(kind), made(kind)
        for kf in (one, two):
            assert stepped(kf, np.array([5.0, 0.1]), None, monkeypatch) is None
        place = ("z", "R", "H", "Hx")[seed % (4 if kind == "extended" else 2)]
        given = {"z": np.array([5.2, 0.3]), "R": np.diag([0.4, 0.3]), "H": slope(one.x), "Hx": seen(one.x)}
        given[place] = spoilt(given[place], g, [])
        passed = {"R": given["R"]}
        if kind == "extended":
            passed |= {"H": lambda x, H=given["H"]: H, "Hx": lambda x, at=given["Hx"]: at}
        before = {name: np.array(getattr(one, name)) for name in ("x", "P", "z")}
        raised = [stepped(kf, given["z"], e, monkeypatch, **passed) for kf, e in ((one, EXTENSION), (two, None))]
        assert (raised[0] is None) == (raised[1] is None), (seed, place, given[place], raised)
        served += raised[0] is None
        if raised[0] is None and max(np.abs(two.x).max(), np.abs(two.P).max()) < 1e9 and given["z"] is not None:
            np.testing.assert_allclose(one.x, two.x, rtol=1e-6, atol=1e-6, err_msg=str(seed))
            np.testing.assert_allclose(one.P, two.P, rtol=1e-6, atol=1e-6, err_msg=str(seed))
        if raised[0] is not None:
            # The prediction has happened, the correction has not.
            np.testing.assert_array_equal(one.x, one.x_prior)
            np.testing.assert_array_equal(one.z, before["z"])
    assert served > 20
