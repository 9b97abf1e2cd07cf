"""Time a step of every filter with every option, online, over filterpy's own predict and update; processor time.

Run ``python tests/benchmarks/online_table.py [PART]``: under a minute, or the rows whose name has PART. Each number is
the least of a few turns.
"""

from __future__ import annotations

import sys
import time
import warnings

import numpy as np
from filterpy.kalman import (
    CubatureKalmanFilter,
    EnsembleKalmanFilter,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)

import robust_filterpy as rf
import robust_filterpy.kalman as ours
from robust_filterpy.correction.policies import Contaminated
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.influence.functions import StudentT, TukeyBiweight

GIVEN, JOINT, ADAPTIVE = {"noise": Contaminated(0.1, 10.0)}, {"grouping": "joint"}, {"noise": "learnt"}
LEARNT = {**ADAPTIVE, "process": "given"}
F, ROWS = np.eye(4) + 0.1 * np.eye(4, k=2), np.array([[1.0, 0, 0, 0], [0, 1, 0, 0]])
STEPS, TURNS = 200, 5


class Biweight:
    """Tukey's biweight as somebody else's class has it."""

    def __init__(self, c=4.685):
        """Keep c."""
        self.c = c

    def rho(self, e):
        """Return the loss."""
        return self.c**2 / 6.0 * (1.0 - np.maximum(1.0 - (np.asarray(e) / self.c) ** 2, 0.0) ** 3)

    def psi(self, e):
        """Return the derivative of rho."""
        return np.asarray(e) * self.weights(e)

    def weights(self, e):
        """Return psi(e) / e."""
        return np.maximum(1.0 - (np.asarray(e) / self.c) ** 2, 0.0) ** 2

    def psi_deriv(self, e):
        """Return the derivative of psi."""
        u = np.minimum((np.asarray(e) / self.c) ** 2, 1.0)
        return (1.0 - u) * (1.0 - 5.0 * u)


def linear(cls=rf.RobustKalmanFilter, **options):
    """Return a filter of a point in the plane."""
    kf = cls(4, 2, **options)
    kf.F, kf.H, kf.Q, kf.R, kf.P = F.copy(), ROWS.copy(), 0.01 * np.eye(4), 0.1 * np.eye(2), 10.0 * np.eye(4)
    if np.shape(kf.M) != (4, 2):
        kf.M = np.zeros((4, 2))
    return kf


def measurements(m=2):
    """Return readings of a point that turns; every tenth is far off."""
    rng, t = np.random.default_rng(0), 0.1 * np.arange(STEPS)
    zs = np.stack([5.0 * np.cos(t), 5.0 * np.sin(t)], axis=1)[:, :m] + 0.3 * rng.normal(size=(STEPS, m))
    zs[rng.random((STEPS, m)) < 0.1] += 10.0
    return zs


ZS = measurements()
GAPS = np.where(np.random.default_rng(1).random(ZS.shape) < 0.1, np.nan, ZS)


def plain(kf, zs=ZS, **given):
    """Take the steps."""
    for z in zs:
        kf.predict()
        kf.update(z, **given)


def moved(kf):
    """Take them with F and Q passed."""
    Q = kf.Q.copy()
    for z in ZS:
        kf.predict(F=F, Q=Q)
        kf.update(z)


def correlated(kf):
    """Take them by `update_correlated`."""
    for z in ZS:
        kf.predict()
        kf.update_correlated(z)


def sequential(kf):
    """Take them sensor by sensor."""
    for z in ZS:
        kf.predict()
        kf.update_sequential(0, z[0])
        kf.update_sequential(1, z[1])


def range_of(x):
    """Return distance and bearing."""
    x = np.ravel(x)
    return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])


def jacobian(x):
    """Return their derivatives."""
    a, b = np.ravel(x)[:2].tolist()
    r = np.hypot(a, b)
    return np.array([[a / r, b / r, 0.0, 0.0], [-b / r**2, a / r**2, 0.0, 0.0]])


def move(x, dt):
    """Move the point."""
    return F @ x


POLAR = np.stack([20.0 + ZS[:, 0], 0.6 + 0.01 * ZS[:, 1]], axis=1)


def nonlinear(kf, given=()):
    """Return a filter of distance and bearing, set up."""
    kf.x, kf.P = np.array([16.0, 11.0, 0.0, 0.0]), np.eye(4)
    kf.Q, kf.R = 0.01 * np.eye(4), np.diag([0.1, 1e-4])
    return kf


def extended(cls, **options):
    """Return an extended one."""
    kf = nonlinear(cls(4, 2, **options))
    kf.F = F
    return kf


def sigma(cls, **options):
    """Return an unscented one."""
    return nonlinear(cls(4, 2, 0.1, range_of, move, MerweScaledSigmaPoints(4, 0.5, 2.0, -1.0), **options))


def cubature(cls, **options):
    """Return a cubature one."""
    kf = nonlinear(cls(4, 2, 0.1, range_of, move, **options))
    kf.x = kf.x[:, None] if cls is CubatureKalmanFilter else kf.x
    return kf


def ensemble(cls, **options):
    """Return an ensemble of 50."""
    kf = cls(np.array([16.0, 11.0, 0.0, 0.0]), np.eye(4), 2, 0.1, 50, range_of, move, **options)
    kf.Q, kf.R = 0.01 * np.eye(4), np.diag([0.1, 1e-4])
    return kf


def lagged(cls):
    """Return a smoother."""
    s = cls(4, 2, N=10)
    s.F, s.H, s.Q, s.R, s.P = F, ROWS, 0.01 * np.eye(4), 0.1 * np.eye(2), 10.0 * np.eye(4)
    return s


def polar(kf):
    """Take the steps of a nonlinear filter."""
    for z in POLAR:
        kf.predict()
        kf.update(z)


def by_jacobian(kf):
    """Take them with a Jacobian."""
    for z in POLAR:
        kf.predict()
        kf.update(z, jacobian, range_of)


def smoothed(s):
    """Smooth with a lag."""
    for z in ZS:
        s.smooth(z)


def table():
    """Yield rows: name, filter, its walk, filterpy's, its walk, the ratio asked for."""
    peer = (lambda: linear(KalmanFilter), plain)
    H, R = np.array([[1.0, 0.1, 0, 0], [0, 1, 0, 0.1]]), 0.2 * np.eye(2)
    for name, options, target in (
        ("default", {}, 0.2), ("innovation", {"scaling": "innovation"}, 0.3), ("bounded", {"scaling": "bounded"}, 0.3),
        ("joint", JOINT, 0.3), ("Tukey", {"influence": TukeyBiweight()}, 0.3),
        ("StudentT", {"influence": StudentT(4)}, 0.3),
        ("patience", {"patience": 8}, 0.3), ("psi in Python", {"influence": Biweight()}, 3),
        ("learnt", LEARNT, 0.8), ("learnt joint", {**LEARNT, **JOINT}, 1), ("adaptive", ADAPTIVE, 0.8),
        ("adaptive joint", {**ADAPTIVE, **JOINT}, 1), ("given", GIVEN, 1), ("given joint", {**GIVEN, **JOINT}, 1),
        ("given groups", {**GIVEN, "grouping": ((0, 1),)}, 1),
        ("adaptive groups", {**ADAPTIVE, "grouping": ((0, 1),)}, 1),
        ("given, process given", {**GIVEN, "process": Contaminated(0.05, 10.0)}, 1),
        ("given, process scales", {**GIVEN, "process": "scales"}, 1),
    ):  # fmt: skip
        yield name, lambda o=options: linear(**o), plain, *peer, target
    for name, options, targets in (("default", {}, (0.4, 0.4, 0.4, 1, 0.3, 0.3)), ("adaptive", ADAPTIVE, (1,) * 6)):
        for way, walk, target in (
            ("H=", lambda kf: plain(kf, H=H), targets[0]), ("H= the same", lambda kf: plain(kf, H=ROWS), targets[0]),
            ("F=, Q=", moved, targets[1]), ("correlated", correlated, targets[2]),
            ("sequential", sequential, targets[3]),
            ("R=", lambda kf: plain(kf, R=R), targets[4]), ("NaN", lambda kf: plain(kf, GAPS), targets[5]),
        ):  # fmt: skip
            yield f"{name}, {way}", lambda o=options: linear(**o), walk, *peer, target
    for name, made, walk, theirs, cls in (
        ("extended", extended, by_jacobian, ExtendedKalmanFilter, rf.RobustExtendedKalmanFilter),
        ("unscented", sigma, polar, UnscentedKalmanFilter, rf.RobustUnscentedKalmanFilter),
        ("cubature", cubature, polar, CubatureKalmanFilter, rf.filters.RobustCubatureKalmanFilter),
    ):
        other = (lambda m=made, c=theirs: m(c)), walk if theirs is not CubatureKalmanFilter else column
        for kind, options in (("default", {}), ("learnt", LEARNT), ("given", GIVEN), ("adaptive", ADAPTIVE)):
            yield f"{name}, {kind}", lambda m=made, c=cls, o=options: m(c, **o), walk, *other, 1
    yield (
        "ensemble", lambda: ensemble(RobustEnsembleKalmanFilter), polar, lambda: ensemble(EnsembleKalmanFilter), polar,
        1.5,
    )  # fmt: skip
    yield "fixed lag", lambda: lagged(ours.FixedLagSmoother), smoothed, lambda: lagged(FixedLagSmoother), smoothed, 2


def fused(turning, **options):
    """Return the processor time of each of 1000 steps of a fusion of two sensors: observe, and estimate."""
    rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
    places = np.stack([5.0 * np.cos(t), 5.0 * np.sin(t)] if turning else [0.5 * t, 0.2 * t], axis=1)
    sensors = {name: Sensor([[1.0, 0, 0, 0], [0, 0, 1.0, 0]], R=0.09) for name in ("gps", "lidar")}
    fusion, times = Fusion(constant_velocity(2, 0.02), sensors, 2.0, P0=100.0 * np.eye(4), **options), []
    for k, place in enumerate(places):
        z = place + 0.3 * rng.normal(size=2) + 10.0 * (rng.random() < 0.1)
        begin = time.process_time()
        fusion.observe("gps" if k % 2 else "lidar", float(t[k]), z)
        fusion.estimate()
        times.append(time.process_time() - begin)
    return np.array(times)


def fusions(part):
    """Print the rows of fusions: mean over filterpy's step, and the longest step."""
    for name, turning, options, target in (
        ("fusion", False, {}, 4), ("fusion, watch straight", False, {"watch": True}, 10),
        ("fusion, watch turning", True, {"watch": True}, 20),
    ):  # fmt: skip
        if part in name:
            theirs, times = least(lambda: linear(KalmanFilter), plain), fused(turning, **options)
            ratio, longest = times.mean() / theirs, times.max() / theirs
            missed = "" if ratio <= target else "  NOT MET"
            print(
                f"{name:28}{1e6 * theirs:12.1f}{1e6 * times.mean():10.1f}{ratio:8.2f}{target:8.1f}{missed}"
                f"  longest step {longest:.0f}",
                flush=True,
            )


def column(kf):
    """Take the steps of filterpy's cubature filter, which wants columns."""
    for z in POLAR:
        kf.predict()
        kf.update(z[:, None])


def least(made, walk):
    """Return the least processor time of a step in s."""
    best = np.inf
    for _ in range(TURNS):
        kf = made()
        begin = time.process_time()
        walk(kf)
        best = min(best, (time.process_time() - begin) / STEPS)
        if best > 5e-4:
            break
    return best


def main():
    """Print the table."""
    part, theirs = sys.argv[1] if len(sys.argv) > 1 else "", {}
    print(f"{'':28}{'filterpy us':>12}{'ours us':>10}{'ratio':>8}{'target':>8}")
    for name, made, walk, peer, peer_walk, target in table():
        if part not in name:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind = name.partition(",")[0]
            key = kind if kind in ("extended", "unscented", "cubature") else peer_walk
            if key not in theirs:
                theirs[key] = least(peer, peer_walk)
            own = least(made, walk)
        ratio = own / theirs[key]
        missed = "" if ratio <= target else "  NOT MET"
        print(f"{name:28}{1e6 * theirs[key]:12.1f}{1e6 * own:10.1f}{ratio:8.2f}{target:8.1f}{missed}", flush=True)
    fusions(part)


if __name__ == "__main__":
    main()
