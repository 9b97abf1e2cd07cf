"""Bytes and text are no measurements, whatever takes them."""

import numpy as np
import pytest

from robust_filterpy import RobustKalmanFilter, diagnose, estimate_noise, smooth

CALLS = {
    "batch_filter": lambda kf, z: kf.batch_filter(z), "update": lambda kf, z: kf.update(z),
    "smooth": smooth, "diagnose": diagnose, "estimate_noise": estimate_noise,
}  # fmt: skip


@pytest.mark.parametrize("z", [b"12", "12", bytearray(b"12"), [b"1", b"2"]])
@pytest.mark.parametrize("call", CALLS)
def test_bytes_are_refused(call, z):
    kf = RobustKalmanFilter(1, 1)
    kf.H = np.eye(1)
    with pytest.raises(TypeError, match="expected"):
        CALLS[call](kf, z)
    assert kf.x[0, 0] == 0.0
