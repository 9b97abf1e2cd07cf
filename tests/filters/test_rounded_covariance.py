"""States that no sensor sees grow until what a sensor sees of P drowns in rounding: filterpy goes on there."""


import numpy as np
import pytest
from filterpy.common import kinematic_kf
from recordings import unheard
from support import Extended, predict_and_update, through

from robust_filterpy import AdaptiveKalmanFilter, RobustFilterWarning, RobustKalmanFilter
from robust_filterpy.influence import Linear

MAKERS = {
    "linear": lambda n, m: RobustKalmanFilter(n, m, influence=Linear()),
    "default": RobustKalmanFilter,
    "innovation": lambda n, m: RobustKalmanFilter(n, m, scaling="innovation"),
    "adaptive": AdaptiveKalmanFilter,
    "extended": Extended,
}


@pytest.mark.parametrize("dim, order, dt", [(7, 5, 1.0), (5, 5, 2.0), (3, 6, 1.5), (9, 4, 4.0)])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_sum_of_chains_is_followed_with_a_warning(make, dim, order, dt):
    """A ramp, of which filterpy's own `test_steadystate` asks that nothing be raised."""
    kf = make(dim * (order + 1), 1)
    if not hasattr(kf, "H"):
        kf.H = np.zeros((1, kf.dim_x))
    kinematic_kf(dim=dim, order=order, dt=dt, kf=kf)
    with unheard(RobustFilterWarning):
        for k in range(150):
            predict_and_update(kf, np.array([float(k)]))
            assert np.isfinite(kf.x).all()
        assert kf.H @ kf.x == pytest.approx(k, abs=5.0)
        for z in range(100) if make is MAKERS["linear"] and dim == 7 else ():
            kf.predict_steadystate()
            kf.update_steadystate([z])
            assert kf.mahalanobis == pytest.approx(abs(kf.y.item()) / kf.S.item() ** 0.5)


def test_it_is_said_once(recwarn):
    class Mine(RobustKalmanFilter):
        pass

    for _ in range(2):
        kf = kinematic_kf(dim=7, order=5, kf=Mine(42, 1, influence=Linear()))
        through(kf, range(120))
    assert [str(w.message)[:40] for w in recwarn] == ["Mine: H P H' is negative by rounding, si"]
