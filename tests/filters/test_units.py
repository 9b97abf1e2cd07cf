"""Units cannot matter: sensors in other units give the same states and covariances, to rounding, on every path."""

import numpy as np
import pytest
import support
from filterpy.common import kinematic_kf

from robust_filterpy import RobustKalmanFilter

STEPS = 40
SIZES = [(2, 1), (3, 2), (4, 3), (5, 5)]


def recording(seed, dims):
    """Return a problem, a recording with outliers and gaps, and the same two in other units of the sensors."""
    problem = support.random_problem(seed, *dims)
    zs, _ = support.simulate(problem, STEPS, seed, contamination=0.2, size=30.0)
    rng = np.random.default_rng(seed)
    zs[rng.random(zs.shape) < 0.05] = np.nan
    # Extremes side by side, and what is no power of two: products with it are rounded.
    units = 10.0 ** rng.uniform(-8, 8, dims[1])
    units[0] = 1e-8
    units[-1] = 1e8
    changed = support.with_(
        problem, H=problem.H * units[:, None], R=problem.R * np.outer(units, units), M=problem.M * units
    )
    return problem, zs, changed, zs * units


def same(found, expected, what):
    """Compare states and covariances; rounding grows with the correlation of the sensors."""
    for name, ours, theirs in zip(("x", "P"), found, expected, strict=True):
        support.assert_close(ours, theirs, 1e-9, f"{what}: {name}")


@pytest.mark.pairwise
@pytest.mark.parametrize("dims", SIZES)
@pytest.mark.parametrize("method", ["update_correlated", "update_steadystate", "update_sequential"])
def test_no_other_update_does(path, method, dims):
    problem, zs, changed, others = recording(8, dims)

    def run(problem, zs):
        kf = support.make(RobustKalmanFilter, problem)
        kf.update(np.nan_to_num(zs[0]))
        for z in zs[1:]:
            if method == "update_sequential":
                kf.predict()
                for i, number in enumerate(z):
                    kf.update_sequential(i, number)
            elif method == "update_steadystate":
                kf.predict_steadystate()
                kf.update_steadystate(z)
            else:
                kf.predict()
                kf.update_correlated(z)
        return kf.x, kf.P

    same(run(changed, others), run(problem, zs), method)


@pytest.mark.parametrize("dim, order", [(7, 5), (3, 4)])
def test_many_kinematic_states_stay_positive_definite(path, dim, order):
    plain = kinematic_kf(dim=dim, order=order, dt=0.1)
    kf = RobustKalmanFilter(plain.dim_x, plain.dim_z)
    kf.F, kf.H, kf.Q, kf.R, kf.P = (getattr(plain, name) for name in ("F", "H", "Q", "R", "P"))
    assert plain.dim_x == dim * (order + 1)
    rng = np.random.default_rng(0)
    for _ in range(400):
        kf.predict()
        kf.update(rng.normal(size=plain.dim_z))
        np.testing.assert_array_equal(kf.P, kf.P.T)
        # Relative to the units of the states, of which the highest derivatives have no like.
        unit = np.sqrt(np.diag(kf.P))
        assert np.linalg.eigvalsh(kf.P / np.outer(unit, unit))[0] > -1e-12
    support.assert_all_finite(kf)
