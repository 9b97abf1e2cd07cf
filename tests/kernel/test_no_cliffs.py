"""No option, and no matrix that is passed for one call, asks the definition: all of them are steps of the kernel."""

import os
import sys

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints
from hostile import spoilt
from statsmodels.robust import norms
from support import assert_alike, shown

import robust_filterpy
from robust_filterpy import RobustExtendedKalmanFilter, RobustKalmanFilter, RobustUnscentedKalmanFilter, kernel
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.influence import Hampel, Linear, StudentT, TukeyBiweight

GIVEN, ADAPTIVE = {"noise": Contaminated(0.1, 8.0)}, {"noise": "learnt", "process": "scales"}
OPTIONS = {
    "default": {}, "adaptive": ADAPTIVE, "adaptive, groups": {**ADAPTIVE, "grouping": ((0, 1),)}, "given": GIVEN,
    "given, process given": {**GIVEN, "process": Contaminated(0.05, 10.0)},
    **{f"{name}, joint": {**options, "grouping": "joint"} for name, options in (
        ("learnt", {"noise": "learnt", "process": "given"}), ("adaptive", ADAPTIVE), ("given", GIVEN),
    )},
}  # fmt: skip
WAYS = {
    "H": {"H": np.array([[1.0, 0.1], [0.3, 1.0]])}, "a row of H": {"H": np.array([[1.0, 0.2]]), "R": 0.3},
    "R": {"R": np.array([[0.4, 0.1], [0.1, 0.3]])}, "M": {}, "F and Q": {}, "part by part": {},
    "parts with H": {}, "by name": {},
}  # fmt: skip


def moving(H=((1.0, 0.0), (0.0, 1.0)), **options):
    kf = RobustKalmanFilter(2, 2, **options)
    kf.F, kf.H, kf.Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array(H), 0.01 * np.eye(2)
    return kf


@pytest.mark.parametrize("options", [{}, ADAPTIVE], ids=["default", "adaptive"])
def test_a_measurement_visits_six_functions_at_most(options):
    kf, home, visited = moving(**options), os.path.dirname(robust_filterpy.__file__), set()

    def note(frame, event, argument):
        if event == "call" and frame.f_code.co_filename.startswith(home):
            visited.add((frame.f_code.co_filename, frame.f_code.co_name))

    kf.update([0.5, -0.2])
    kf.predict()
    sys.setprofile(note)
    try:
        kf.update([0.1, 0.3])
    finally:
        sys.setprofile(None)
    assert 0 < len(visited) <= 6, visited


def take(kf, k, z, way):
    """Predict, and take a measurement in one of the ways."""
    kf.predict(F=kf.F.T, Q=2.0 * kf.Q) if way == "F and Q" else kf.predict()
    if way == "M":
        kf.update_correlated(z)
    elif way in ("part by part", "parts with H") and k % 3 != 2:
        for i in np.flatnonzero(z == z).tolist():
            kf.update_sequential(i, z[i], H_i=np.array([[0.2, 1.0]]) if way == "parts with H" else None)
    elif way == "by name":
        kf.update(z, sensor="ab"[k % 2])
    elif way == "a row of H" and k % 2 == 0:
        kf.update(z)
    else:
        z = z if way != "a row of H" else z[0] if z[0] == z[0] else 1.0
        kf.update(z, **WAYS[way])


@pytest.mark.usefixtures("by_kernel_alone")
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("way", WAYS)
def test_a_step_of_any_option_is_the_kernels_and_the_definitions(way, options, both):
    def steps():
        kf, rows = moving(**options), []
        kf.M = np.array([[0.02, 0.01], [0.0, 0.03]])
        for k, z in enumerate(np.random.default_rng(2).normal(size=(30, 2))):
            # Outliers, gaps, and at the end a jump under noise that is correlated with the state.
            z[k % 2] += 15.0 * (k % 7 == 6)
            z = z + 60.0 * (way == "M" and k > 15)
            z = np.where(np.arange(2) == (k % 5 == 4), np.nan, z) if k % 5 == 4 else z
            take(kf, k, z, way)
            lags = np.nansum(getattr(kf._record(), "lags", 0.0))
            rows.append(shown(kf, "outlier_probability") | {"lags": lags})
        return rows, [kf._memory, *kf._other_sensors.values(), *kf._named_sensors.values()]

    (ours, memories), (theirs, expected) = both(steps)
    assert_alike(ours, theirs, 1e-9)
    for mine, other in zip(memories, expected, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("scaling, patience", [("learnt", None), ("learnt", 6), ("innovation", None)])
def test_a_psi_of_the_users_is_called_by_the_kernel(scaling, patience, by_kernel_alone):
    found = []
    # Somebody else's function of the same formulas.
    for influence in (norms.TukeyBiweight(4.685), TukeyBiweight(4.685)):
        kf = RobustKalmanFilter(2, 2, influence=influence, scaling=scaling, patience=patience)
        kf.F, kf.H, kf.Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(2), 0.01 * np.eye(2)
        for z in np.random.default_rng(2).normal(size=(60, 2)) + np.repeat([[0.0], [25.0]], 30, axis=0):
            kf.predict()
            kf.update(z)
        found.append([*kf.x.ravel(), *kf.P.ravel(), *kf.weights.ravel(), *kf.spread])
    np.testing.assert_allclose(*found, rtol=1e-12)


def test_what_a_psi_of_the_users_raises_is_passed_on_and_nothing_has_changed():
    class Spoilt(norms.TukeyBiweight):
        def psi_deriv(self, e):
            kf.x[0] = 7.0
            raise OSError("no")

    kf = RobustKalmanFilter(2, 1, influence=Spoilt())
    kf.H[0, 0] = 1.0
    before = kf.state()
    with pytest.raises(OSError, match="no"):
        kf.update(1.0)
    for name, value in kf.state().items():
        np.testing.assert_array_equal(value, before[name])


def angle(a, b):
    """Differ by an angle, as a bearing does."""
    return (a - b + np.pi) % (2.0 * np.pi) - np.pi


def bearings(x):
    x = np.ravel(x)
    return np.array([np.arctan2(x[1], x[0]), np.arctan2(x[1] - 1.0, x[0] + 1.0)])


def slopes(x):
    x = np.ravel(x)
    rows = [(x[0], x[1]), (x[0] + 1.0, x[1] - 1.0)]
    return np.array([[-b, a] / (a**2 + b**2) for a, b in rows])


def bent(x, dt=1.0):
    """Move a state along a bend."""
    return np.ravel(x) + 0.02 * dt * np.sin(np.ravel(x)[::-1])


def nonlinear(kind, residual=np.subtract, **options):
    """A filter of two bearings of a point in the plane."""
    points = [MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)] if kind is RobustUnscentedKalmanFilter else []
    functions = () if kind is RobustExtendedKalmanFilter else (1.0, bearings, bent, *points, residual)
    kf = kind(2, 2, *functions, **options)
    kf.x = np.reshape([5.0, 3.0], (2, 1) if kind is RobustCubatureKalmanFilter else 2)
    kf.P, kf.Q, kf.R = 0.1 * np.eye(2), 1e-3 * np.eye(2), 1e-3 * np.eye(2)
    return kf


@pytest.mark.pairwise
@pytest.mark.usefixtures("by_kernel_alone")
@pytest.mark.parametrize("residual", [np.subtract, angle], ids=["plain", "angle"])
@pytest.mark.parametrize("options", [
    {"noise": "learnt", "process": "given"}, {**ADAPTIVE, "grouping": "joint"}, GIVEN, {"patience": 3}, {}, ADAPTIVE,
    {**GIVEN, "process": Contaminated(0.05, 10.0)},
    {"grouping": "joint"}, {"influence": Linear()}, {"influence": TukeyBiweight(), "grouping": "joint"},
    {"influence": Hampel(), "scaling": "bounded"}, {"influence": StudentT(), "scaling": "innovation"},
], ids=str)  # fmt: skip
@pytest.mark.parametrize("kind", [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter])
def test_a_step_of_a_nonlinear_filter_is_the_kernels_and_the_definitions(kind, options, residual, both):
    # How far P grows after a jump, the typical innovation tells by a Jacobian: without one that is the definition's.
    jumps = kind is RobustExtendedKalmanFilter or "noise" in options

    def steps():
        rng, kf, at, rows = np.random.default_rng(3), nonlinear(kind, residual, **options), np.array([5.0, 3.0]), []
        kf.predict_x = lambda u=0: setattr(kf, "x", bent(kf.x))
        for k in range(40):
            at = bent(at)
            z = bearings(at) + 0.03 * rng.normal(size=2) + [0.0, 0.5 * (k % 7 == 3 or (k > 30 and jumps))]
            z[k % 2] = np.nan if k % 5 == 4 else z[k % 2]
            R = None if k % 3 else np.diag(rng.uniform(1e-3, 2e-3, 2))
            if kind is RobustExtendedKalmanFilter:
                kf.F = np.eye(2) + 0.02 * np.diag(np.cos(kf.x[::-1]))[::-1]
            kf.predict()
            if kind is RobustExtendedKalmanFilter:
                kf.update(z, slopes, bearings, R=R, residual=residual)
            else:
                kf.update(z, R=R)
            rows.append(shown(kf, "outlier_probability", "_memory"))
        return rows

    assert_alike(*both(steps), 1e-7)


# What is passed spoilt is refused as by the definition.


def stepped(kf, z, extension, monkeypatch, passed=(), R=None):
    """Step by an extension, or by the definition alone; what it raises, None if nothing."""
    with monkeypatch.context() as patch, np.errstate(all="ignore"):
        support.served_by(patch, extension)
        try:
            kf.predict()
            functions = (slopes, bearings) if isinstance(kf, RobustExtendedKalmanFilter) else ()
            kf.update(z, *(passed or functions), R=R)
        except (TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
            return type(error)
    return None


@pytest.mark.parametrize("kind", [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter])
def test_what_is_passed_spoilt_is_refused_or_taken_as_by_the_definition(kind, monkeypatch):
    support.needs_kernel()
    g, served, extended = np.random.default_rng(4), 0, kind is RobustExtendedKalmanFilter
    for seed in range(150):
        one, two = nonlinear(kind), nonlinear(kind)
        for kf in (one, two):
            assert stepped(kf, np.array([0.54, 0.32]), None, monkeypatch) is None
        place = ("z", "R", "H", "Hx")[seed % (4 if extended else 2)]
        given = {"z": np.array([0.5, 0.3]), "R": np.diag([4e-3, 3e-3]), "H": slopes(one.x), "Hx": bearings(one.x)}
        given[place] = spoilt(given[place], g, [])
        passed = (lambda x, H=given["H"]: H, lambda x, at=given["Hx"]: at) if extended else ()
        before = np.array(one.z)
        raised = [
            stepped(kf, given["z"], extension, monkeypatch, passed, given["R"])
            for kf, extension in ((one, kernel.extension()), (two, None))
        ]
        assert (raised[0] is None) == (raised[1] is None), (seed, place, given[place], raised)
        served += raised[0] is None
        if raised[0] is None and max(np.abs(two.x).max(), np.abs(two.P).max()) < 1e9 and given["z"] is not None:
            np.testing.assert_allclose(one.x, two.x, rtol=1e-6, atol=1e-6, err_msg=str(seed))
            np.testing.assert_allclose(one.P, two.P, rtol=1e-6, atol=1e-6, err_msg=str(seed))
        if raised[0] is not None:
            # The prediction has happened, the correction has not.
            np.testing.assert_array_equal(one.x, one.x_prior)
            np.testing.assert_array_equal(one.z, before)
    assert served > 20
