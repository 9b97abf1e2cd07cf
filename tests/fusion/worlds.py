"""Recordings of sensors in time, with everything known, for the tests of this room."""

import numpy as np

from robust_filterpy.fusion import Contaminated, Fusion, Scales, Sensor, constant_velocity
from robust_filterpy.influence import Huber, Linear

GPS = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
WHEEL = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
POLICIES = {
    "learnt": {}, "trusting Q": {"process": Scales((1.0,), jump=0.0)}, "given": {"noise": Contaminated(0.1, 10.0)},
    "linear": {"influence": Linear()}, "huber": {"influence": Huber()},
}  # fmt: skip


def sensors():
    return {"gps": Sensor(GPS, R=4.0), "wheel": Sensor(WHEEL, R=0.01)}


def line(names, window=1.0, q=0.1, R=1.0, **options):
    """A fusion of sensors of one place on a line."""
    sensors = {name: Sensor([1.0, 0.0], R=R) for name in names}
    return Fusion(constant_velocity(1, q), sensors, window, P0=100.0 * np.eye(2), **options)


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
    """Readings as columns: value, or v0 and v1 where a sensor has two components."""
    names = ["value"] if np.ndim(readings[0][2]) == 0 else ["v0", "v1"]
    columns = np.array([np.broadcast_to(z, len(names)) for *_, z in readings]).T
    return {
        "time": [t for _, t, _ in readings], "sensor": [who for who, *_ in readings],
        **dict(zip(names, columns.tolist(), strict=True)),
    }  # fmt: skip


def fed(fusion, readings):
    """A fusion that has taken readings."""
    for one in readings:
        fusion.observe(*one)
    return fusion


def followed(fusion, readings, looked):
    """(t, estimate, who is not healthy nor silent) after each reading of which looked(number, sensor) is true."""
    found = []
    for k, (name, t, z) in enumerate(readings, 1):
        fusion.observe(name, t, z)
        if looked(k, name):
            said = {who: v.fault for who, v in fusion.verdicts().items() if v.fault not in ("healthy", "silent")}
            found.append((t, fusion.estimate(), said))
    return found
