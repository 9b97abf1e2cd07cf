"""Recordings of sensors in time, with everything known, for the tests of this room."""

import numpy as np

from robust_filterpy.fusion import Contaminated, Scales, Sensor, constant_velocity
from robust_filterpy.influence import Huber, Linear

GPS = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
WHEEL = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
POLICIES = {
    "learnt": {}, "trusting Q": {"process": Scales((1.0,), jump=0.0)}, "told": {"noise": Contaminated(0.1, 10.0)},
    "linear": {"influence": Linear()}, "huber": {"influence": Huber()},
}  # fmt: skip


def sensors():
    return {"gps": Sensor(GPS, R=4.0), "wheel": Sensor(WHEEL, R=0.01)}


def plane(stamps, seed=0, q=0.5, outliers=0.0):
    """A point in the plane: (sensor, stamp, z) of each reading, the wheel at every stamp, gps at every third."""
    rng = np.random.default_rng(seed)
    motion, x, before = constant_velocity(2, q), np.zeros(4), float(stamps[0])
    readings, truth = [], []
    for k, t in enumerate(map(float, stamps)):
        F, Q, _ = motion.matrices(t - before)
        x, before = F @ x + np.linalg.cholesky(Q + 1e-12 * np.eye(4)) @ rng.normal(size=4), t
        size = 10.0 if rng.random() < outliers else 1.0
        readings.append(("wheel", t, x[[1, 3]] + size * 0.1 * rng.normal(size=2)))
        if k % 3 == 0:
            readings.append(("gps", t, x[[0, 2]] + size * 2.0 * rng.normal(size=2)))
        truth.append(x)
    return readings, np.array(truth)


def table(readings):
    return {
        "time": [t for _, t, _ in readings], "sensor": [who for who, _, _ in readings],
        "v0": [z[0] for *_, z in readings], "v1": [z[1] for *_, z in readings],
    }  # fmt: skip
