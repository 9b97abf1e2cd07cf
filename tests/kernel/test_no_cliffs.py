"""No option, and no matrix that is passed for one call, asks the definition: all of them are steps of the kernel."""

import numpy as np
import pytest
import support

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.filters import _bounded, _mixture

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
    "H": {"H": np.array([[1.0, 0.1], [0.3, 1.0]])},
    "a row of H": {"H": np.array([[1.0, 0.2]]), "R": 0.3},
    "R": {"R": np.array([[0.4, 0.1], [0.1, 0.3]])},
    "M": {},
    "F and Q": {},
}


@pytest.fixture
def by_kernel_alone(monkeypatch):
    """Let no filter ask the definition."""
    support.needs_kernel()

    def not_asked(*args, **kwargs):
        raise AssertionError("the definition was asked")

    for name in ("predicted", "corrected", "corrected_by_moments"):
        for policy in (_bounded.Bounded, _mixture.Mixture):
            monkeypatch.setattr(policy, name, not_asked)


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
            elif way == "a row of H" and k % 2:
                kf.update(z[0] if z[0] == z[0] else 1.0, **given)
            else:
                kf.update(z, **({} if way == "a row of H" else given))
            rows.append([*np.ravel(kf.x), *np.ravel(kf.P), kf.log_likelihood, kf.outlier_probability])
        found.append((np.array(rows), kf._memory, *kf._other_sensors.values()))
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11)
