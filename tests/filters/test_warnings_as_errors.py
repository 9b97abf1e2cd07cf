"""Where a warning is an error, the call that gives it has not happened: made again, it is as it would have been."""

import pickle
import warnings

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    AdaptiveKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustFilterWarning,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    _warning,
)


class Extended(RobustExtendedKalmanFilter):
    def update(self, z):
        super().update(z, first_row, position)


def first_row(x):
    return np.array([[1.0, 0.0]])


def position(x):
    return x[:1]


def move(x, dt):
    return np.array([x[0] + x[1], x[1]])


def unscented(**options):
    return RobustUnscentedKalmanFilter(2, 1, 1.0, position, move, MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0), **options)


MAKERS = {
    "default": lambda: RobustKalmanFilter(2, 1),
    "innovation": lambda: RobustKalmanFilter(2, 1, scaling="innovation"),
    "patience": lambda: RobustKalmanFilter(2, 1, patience=5),
    "learnt": lambda: RobustKalmanFilter(2, 1, noise="learnt"),
    "adaptive": lambda: AdaptiveKalmanFilter(2, 1),
    "extended": lambda: Extended(2, 1),
    "extended learnt": lambda: Extended(2, 1, noise="learnt"),
    "unscented": unscented,
    "unscented learnt": lambda: unscented(noise="learnt"),
}


def recordings(rng):
    stuck, fill, wild = rng.normal(size=(3, 100))
    stuck[60:80], fill[60:63], slope = 50.0, -9999.0, 0.5 * np.arange(100.0) ** 1.5
    return stuck, fill, 100.0 * wild, slope


@pytest.mark.parametrize("name", MAKERS)
def test_a_call_that_a_warning_refuses_has_not_happened(name):
    said = set()
    for zs in recordings(np.random.default_rng(3)):
        plain, strict = MAKERS[name](), MAKERS[name]()
        for kf in (plain, strict):
            kf.F, kf.H, kf.P, kf.Q = (
                np.array([[1.0, 1.0], [0.0, 1.0]]),
                first_row(0),
                10.0 * np.eye(2),
                0.01 * np.eye(2),
            )
        for z in zs[:, None]:
            for call in (lambda kf: kf.predict(), lambda kf, z=z: kf.update(z)):
                before = pickle.dumps(strict.state())
                _warning._said.clear()
                with warnings.catch_warnings():
                    warnings.simplefilter("error", RobustFilterWarning)
                    try:
                        call(strict)
                    except RobustFilterWarning as word:
                        said.add(type(word))
                        assert pickle.dumps(strict.state()) == before
                        warnings.simplefilter("ignore")
                        call(strict)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    call(plain)
        assert pickle.dumps(plain.state()) == pickle.dumps(strict.state())
    assert said or name in ("patience", "unscented")
