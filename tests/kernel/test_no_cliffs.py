"""No option, and no matrix that is passed for one call, asks the definition: all of them are steps of the kernel."""

import os
import sys

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints

import robust_filterpy
from robust_filterpy import RobustExtendedKalmanFilter, RobustKalmanFilter, RobustUnscentedKalmanFilter
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.influence.functions import TukeyBiweight

TOLD, ADAPTIVE = {"noise": Contaminated(0.1, 8.0)}, {"noise": "learnt", "process": "scales"}
OPTIONS = {
    "default": {},
    "learnt, joint": {"noise": "learnt", "grouping": "joint"},
    "adaptive": ADAPTIVE,
    "adaptive, joint": {**ADAPTIVE, "grouping": "joint"},
    "adaptive, groups": {**ADAPTIVE, "grouping": ((0, 1),)},
    "told": TOLD,
    "told, joint": {**TOLD, "grouping": "joint"},
    "told, process told": {**TOLD, "process": Contaminated(0.05, 10.0)},
}
WAYS = {
    "H": {"H": np.array([[1.0, 0.1], [0.3, 1.0]])}, "a row of H": {"H": np.array([[1.0, 0.2]]), "R": 0.3},
    "R": {"R": np.array([[0.4, 0.1], [0.1, 0.3]])}, "M": {}, "F and Q": {}, "part by part": {},
}  # fmt: skip


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("way", WAYS)
def test_a_step_of_any_option_is_the_kernels_and_the_definitions(way, options, by_kernel_alone, monkeypatch):
    found = []
    for kernel in (True, False):
        if not kernel:
            monkeypatch.undo()
            support.without_kernel(monkeypatch)
        kf = RobustKalmanFilter(2, 2, **options)
        kf.F, kf.H, kf.Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(2), 0.01 * np.eye(2)
        kf.M, rows = np.array([[0.02, 0.01], [0.0, 0.03]]), []
        for k, z in enumerate(np.random.default_rng(2).normal(size=(30, 2))):
            z[k % 2] += 15.0 * (k % 7 == 6)
            z = np.where(np.arange(2) == (k % 5 == 4), np.nan, z) if k % 5 == 4 else z
            kf.predict(F=kf.F.T, Q=2.0 * kf.Q) if way == "F and Q" else kf.predict()
            given = WAYS[way]
            if way == "M":
                kf.update_correlated(z)
            elif way == "part by part":
                kf.update(z) if k % 3 == 2 else [kf.update_sequential(i, z[i]) for i in (0, 1) if z[i] == z[i]]
            elif way == "a row of H" and k % 2:
                kf.update(z[0] if z[0] == z[0] else 1.0, **given)
            else:
                kf.update(z, **({} if way == "a row of H" else given))
            lags = np.nansum(getattr(kf._last, "lags", 0.0))
            shown = [*np.ravel(kf.y), *np.ravel(kf.S), *np.ravel(kf.SI), *np.ravel(kf.K), *np.ravel(kf.weights)]
            shown += [float(z) for z in np.ravel(kf.z)]
            rows.append([*np.ravel(kf.x), *np.ravel(kf.P), kf.log_likelihood, kf.outlier_probability, lags])
            if way == "part by part":
                rows[-1] += shown
        found.append((np.array(rows), kf._memory, *kf._other_sensors.values()))
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11)


FAR = {**OPTIONS, "innovation": {"scaling": "innovation"}, "Tukey": {"influence": TukeyBiweight()}}


@pytest.mark.parametrize("options", FAR.values(), ids=FAR)
@pytest.mark.parametrize("rows", [[[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.3]]], ids=["apart", "alike"])
def test_a_reading_beyond_all_measure_is_the_kernels_and_the_definitions(rows, options, by_kernel_alone, monkeypatch):
    found = []
    for kernel in (True, False):
        if not kernel:
            monkeypatch.undo()
            support.without_kernel(monkeypatch)
        kf, shown = RobustKalmanFilter(2, 2, **options), []
        kf.F, kf.H, kf.Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array(rows), 0.01 * np.eye(2)
        for k, z in enumerate(np.random.default_rng(3).normal(size=(60, 2))):
            far = k > 15 and k % 4 == 0
            z[0] = (-1.0) ** (k // 4) * 1e151 * 10.0 ** (2.5 * k) if far else z[0]
            z[1] = z[0] / 7.0 if far and k % 12 == 0 else z[1]
            kf.predict()
            kf.update(z)
            shown.append([*np.ravel(kf.x), *np.ravel(kf.P), *np.ravel(kf.weights), kf.log_likelihood])
        found.append((np.array(shown), kf._memory))
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-10)
    assert np.abs(found[0][0][:, :2]).max() < 10.0


@pytest.mark.parametrize("options", [{}, ADAPTIVE], ids=["default", "adaptive"])
def test_a_measurement_visits_six_functions_at_most(options, by_kernel_alone):
    kf = RobustKalmanFilter(2, 2, **options)
    kf.H, home = np.eye(2), os.path.dirname(robust_filterpy.__file__)
    visited = set()

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


class Biweight:
    """Tukey's biweight as somebody else's class has it."""

    def rho(self, e):
        return TukeyBiweight().rho(e)

    def psi(self, e):
        return TukeyBiweight().psi(e)

    def psi_deriv(self, e):
        return TukeyBiweight().psi_deriv(e)

    def weights(self, e):
        return TukeyBiweight().weights(e)


@pytest.mark.parametrize("scaling", ["learnt", "innovation", "bounded"])
@pytest.mark.parametrize("patience", [None, 4])
def test_a_psi_of_the_users_is_called_by_the_kernel(scaling, patience, by_kernel_alone):
    if patience and scaling == "learnt":
        pytest.skip("patience is not for it")
    found = []
    for influence in (Biweight(), TukeyBiweight()):
        kf = RobustKalmanFilter(2, 2, influence=influence, scaling=scaling, patience=patience)
        kf.F, kf.H, kf.Q = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(2), 0.01 * np.eye(2)
        for z in np.random.default_rng(2).normal(size=(60, 2)) + np.repeat([[0.0], [25.0]], 30, axis=0):
            kf.predict()
            kf.update(z)
        found.append([*kf.x.ravel(), *kf.P.ravel(), *kf.weights.ravel(), kf.recoveries, *kf.spread])
    np.testing.assert_allclose(*found, rtol=1e-12)
    assert (found[0][8] > 0) == (patience is not None)


def test_what_a_psi_of_the_users_raises_is_passed_on_and_nothing_has_changed():
    class Spoilt(Biweight):
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


@pytest.mark.parametrize("residual", [np.subtract, angle], ids=["plain", "angle"])
@pytest.mark.parametrize(
    "options",
    [{"noise": "learnt"}, {"noise": "learnt", "grouping": "joint"}, TOLD, {"patience": 3}],
    ids=["learnt", "learnt, joint", "told", "patience"],
)
@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_a_step_of_a_nonlinear_filter_is_the_kernels_and_the_definitions(
    kind, options, residual, by_kernel_alone, monkeypatch
):
    points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)

    def h(x):
        return np.array([np.arctan2(x[1], x[0]), np.arctan2(x[1] - 1.0, x[0] + 1.0)])

    def jacobian(x):
        rows = [(x[0], x[1]), (x[0] + 1.0, x[1] - 1.0)]
        return np.array([[-b, a] / (a**2 + b**2) for a, b in rows])

    found = []
    for kernel in (True, False):
        if not kernel:
            monkeypatch.undo()
            support.without_kernel(monkeypatch)
        rng = np.random.default_rng(3)
        if kind == "extended":
            kf = RobustExtendedKalmanFilter(2, 2, **options)
        else:
            kf = RobustUnscentedKalmanFilter(2, 2, 1.0, h, lambda x, dt: x, points, residual_z=residual, **options)
        kf.x, kf.P, kf.Q, kf.R = np.array([5.0, 3.0]), 0.1 * np.eye(2), 1e-3 * np.eye(2), 1e-3 * np.eye(2)
        rows = []
        for k in range(40):
            z = h([5.0, 3.0]) + 0.03 * rng.normal(size=2) + [0.0, 0.5 * (k % 7 == 3 or k > 30)]
            kf.predict()
            kf.update(z, jacobian, h, residual=residual) if kind == "extended" else kf.update(z)
            rows.append([*kf.x, *kf.P.ravel(), kf.log_likelihood, kf.outlier_probability, kf.recoveries])
        found.append(np.array(rows))
    np.testing.assert_allclose(*found, rtol=1e-7, atol=1e-9)
