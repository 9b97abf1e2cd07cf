"""Time `RobustKalmanFilter` against filterpy's `KalmanFilter`: predict + update, the two in turn in one run.

Run ``python tests/benchmarks/filter_speed.py``, and again with ROBUST_FILTERPY_KERNEL=off in the environment for the
definition; with ``--check`` the exit code is 1 if a target is not met. Each number is the least of many short turns, so
that other work on the machine does not matter. ``--learning`` compares the filter that learns the noise with the
robust one, online and over recordings and series, ``--nonlinear`` extended and unscented filters with filterpy's.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from functools import partial

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from robust_filterpy import (
    AdaptiveKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    filter_series,
    kernel,
)
from robust_filterpy.correction import Scales
from robust_filterpy.influence import Linear

SIZES = ((2, 1), (4, 1), (8, 1), (4, 2), (7, 4), (20, 5))
#: Greatest ratio of the robust filter, by the kernel and by the definition.
KERNEL = {(2, 1): 0.15, (4, 1): 0.15, (4, 2): 0.15, (8, 1): 0.15, (7, 4): 0.2, (20, 5): 0.35}
DEFINITION: dict = {}
VARIANTS = {"robust": {}, "Linear()": {"influence": Linear()}, "joint": {"grouping": "joint"}}
ADAPTIVE = "adaptive"
# A turn is shorter than the slice of time that a busy machine gives a process.
STEPS, TURNS = 30, 500


def built(cls, dim_x, dim_z, **choices):
    """Return a filter with all its matrices filled."""
    rng = np.random.default_rng(0)
    kf = cls(dim_x, dim_z, **choices)
    kf.F = 0.95 * np.eye(dim_x) + 0.02 * rng.standard_normal((dim_x, dim_x))
    kf.H = rng.standard_normal((dim_z, dim_x))
    kf.R = 0.5 * np.eye(dim_z) + 0.1
    kf.Q = 0.1 * np.eye(dim_x)
    return kf


def recording(dim_z):
    """Return measurements of which every tenth is an outlier."""
    zs = 3.0 * np.random.default_rng(1).standard_normal((STEPS, dim_z))
    zs[::10] *= 20.0
    return list(zs) if dim_z > 1 else zs.ravel().tolist()


def duration(kf, zs):
    """Return the seconds that a step takes on average."""
    start = time.perf_counter()
    for z in zs:
        kf.predict()
        kf.update(z)
    return (time.perf_counter() - start) / len(zs)


def measured(dim_x, dim_z):
    """Return the least duration of a step in s: filterpy's, then each variant's."""
    zs = recording(dim_z)
    filters = {"filterpy": built(KalmanFilter, dim_x, dim_z)}
    filters |= {name: built(RobustKalmanFilter, dim_x, dim_z, **choices) for name, choices in VARIANTS.items()}
    # Sensors whose noises have nothing to do with each other, which its kernel is for.
    filters[ADAPTIVE] = built(AdaptiveKalmanFilter, dim_x, dim_z)
    filters[ADAPTIVE].R = np.diag(filters[ADAPTIVE].R.diagonal())
    least = dict.fromkeys(filters, np.inf)
    gc.disable()
    for _ in range(TURNS):
        for name, kf in filters.items():
            least[name] = min(least[name], duration(kf, zs))
    gc.enable()
    return least


def learning():
    """Print how long a step of the filter that learns the noise takes, of the robust filter's time."""
    variants = {"5 process scales": {}, "1": {"process": Scales((1.0,))}}
    ways = ("predict + update", "batch_filter", "series")
    print("a step that learns the noise, of a robust one: " + ", ".join(ways))
    for n, m in ((2, 1), (4, 1), (4, 2)):
        zs = np.resize(np.array(recording(m)).reshape(STEPS, m), (2000, m))
        zs += np.random.default_rng(2).standard_normal(zs.shape)

        def calls(kf, series, zs=zs):
            kf.R = np.diag(kf.R.diagonal())
            model = (kf.F, kf.H, kf.Q, kf.R, np.zeros(len(kf.F)), np.eye(len(kf.F)))
            few = list(zs[:STEPS]) if zs.shape[1] > 1 else zs[:STEPS, 0].tolist()
            return (
                lambda: duration(kf, few) * len(few),
                lambda: kf.batch_filter(zs),
                lambda: series(zs[None], *model, n_threads=1),
            )

        filters = {"robust": calls(built(RobustKalmanFilter, n, m), filter_series)}
        for name, options in variants.items():
            kf = built(AdaptiveKalmanFilter, n, m, **options)
            filters[name] = calls(kf, partial(filter_series, noise="learnt", process=kf.process))
        least = {name: np.full(len(ways), np.inf) for name in filters}
        for _ in range(TURNS // 5):
            for name, each in filters.items():
                for i, call in enumerate(each):
                    start = time.perf_counter()
                    call()
                    steps = STEPS if i == 0 else len(zs)
                    least[name][i] = min(least[name][i], (time.perf_counter() - start) / steps)
        for name in variants:
            pairs = zip(least[name], least["robust"], strict=True)
            print(
                f"{(n, m)!s:>8} {name:>17}: "
                + ", ".join(
                    f"{ours * 1e6:.2f} us / {theirs * 1e6:.2f} us = {ours / theirs:.1f}" for ours, theirs in pairs
                )
            )


def nonlinear() -> None:
    """Print a step of extended and unscented filters, and what is left of it without the user's own functions."""
    F, x0 = np.eye(4) + 0.1 * np.eye(4, k=2), np.array([7.0, 7.0, 0.0, 0.0])
    zs = 10.0 + np.random.default_rng(0).normal(size=STEPS)
    points = MerweScaledSigmaPoints(4, 0.1, 2.0, -1.0)

    def h(x):
        return np.hypot(x[:1], x[1:2])

    def jacobian(x):
        return np.array([[x[0, 0], x[1, 0], 0.0, 0.0]]) / np.hypot(x[0, 0], x[1, 0])

    def move(x, dt):
        return F @ x

    def extended(cls):
        kf = cls(4, 1)
        kf.F, kf.Q, kf.x = F, 0.01 * np.eye(4), x0[:, None]
        for z in zs:
            kf.predict()
            kf.update(np.array([[z]]), jacobian, h)

    def unscented(cls):
        kf = cls(4, 1, 0.1, h, move, points)
        kf.Q, kf.x = 0.01 * np.eye(4), x0
        for z in zs:
            kf.predict()
            kf.update(z)

    def own_extended(_):
        for _ in zs:
            jacobian(x0[:, None]), h(x0[:, None])

    def own_unscented(_):
        for _ in range(9 * len(zs)):
            move(x0, 0.1), h(x0)

    print(f"\n{'':>10}{'filterpy':>12}{'ours':>10}{'without the functions':>24}")
    for name, run, own, theirs, ours in (
        ("extended", extended, own_extended, ExtendedKalmanFilter, RobustExtendedKalmanFilter),
        ("unscented", unscented, own_unscented, UnscentedKalmanFilter, RobustUnscentedKalmanFilter),
    ):
        best = [np.inf] * 3
        for _ in range(TURNS // 5):
            for k, (call, cls) in enumerate(((run, theirs), (run, ours), (own, None))):
                begin = time.perf_counter()
                call(cls)
                best[k] = min(best[k], (time.perf_counter() - begin) / STEPS)
        ratio, rest = best[1] / best[0], (best[1] - best[2]) / (best[0] - best[2])
        print(f"{name:>10}{1e6 * best[0]:9.1f} us{ratio:10.2f}{rest:24.2f}")


def main():
    """Print the ratios to filterpy, and say whether the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 if a target is not met")
    parser.add_argument("--learning", action="store_true", help="compare the filter that learns with the robust one")
    parser.add_argument("--nonlinear", action="store_true", help="compare extended and unscented filters")
    arguments = parser.parse_args()
    if arguments.learning or arguments.nonlinear:
        (learning if arguments.learning else nonlinear)()
        return
    serves, targets = ("the kernel", KERNEL) if kernel.available() else ("the definition", DEFINITION)
    missed = False
    names = "".join(f"{name:>10}" for name in (*VARIANTS, ADAPTIVE))
    print(f"predict + update by {serves}\n{'dim_x, dim_z':>12} {'filterpy':>12}{names}    target of robust")
    for size in SIZES:
        least = measured(*size)
        ratios = {name: least[name] / least["filterpy"] for name in (*VARIANTS, ADAPTIVE)}
        target = targets.get(size, np.inf)
        missed |= ratios["robust"] > target
        verdict = f"{target:.2f} {'met' if ratios['robust'] <= target else 'NOT MET'}" if size in targets else "-"
        print(
            f"{size!s:>12} {least['filterpy'] * 1e6:9.1f} us"
            + "".join(f"{ratio:10.2f}" for ratio in ratios.values())
            + f"    {verdict}"
        )
    sys.exit(int(arguments.check and missed))


if __name__ == "__main__":
    main()
