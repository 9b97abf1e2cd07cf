"""Time `RobustKalmanFilter` against filterpy's `KalmanFilter`: predict + update, the two in turn in one run.

Run ``python tests/benchmarks/filter_speed.py``; with ``--check`` the exit code is 1 if a target is missed. Each number
is the least of many short turns, so that other work on the machine does not matter.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import Linear, RobustKalmanFilter

SIZES = ((1, 1), (4, 1), (4, 2), (7, 4), (20, 5))
TARGETS = {(4, 1): 0.75, (4, 2): 1.0, (7, 4): 1.2}
VARIANTS = {"robust": {}, "Linear()": {"influence": Linear()}, "joint": {"grouping": "joint"}}
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
    least = dict.fromkeys(filters, np.inf)
    gc.disable()
    for _ in range(TURNS):
        for name, kf in filters.items():
            least[name] = min(least[name], duration(kf, zs))
    gc.enable()
    return least


def main():
    """Print the ratios to filterpy, and say whether the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 if a target is missed")
    check = parser.parse_args().check
    missed = False
    names = "".join(f"{name:>10}" for name in VARIANTS)
    print(f"{'dim_x, dim_z':>12} {'filterpy':>12}{names}    target of robust")
    for size in SIZES:
        least = measured(*size)
        ratios = {name: least[name] / least["filterpy"] for name in VARIANTS}
        target = TARGETS.get(size, np.inf)
        missed |= ratios["robust"] > target
        verdict = f"{target:.2f} {'met' if ratios['robust'] <= target else 'MISSED'}" if size in TARGETS else "-"
        print(
            f"{size!s:>12} {least['filterpy'] * 1e6:9.1f} us"
            + "".join(f"{ratio:10.2f}" for ratio in ratios.values())
            + f"    {verdict}"
        )
    sys.exit(int(check and missed))


if __name__ == "__main__":
    main()
