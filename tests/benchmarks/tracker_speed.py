"""Time `ParameterTracker.run` on ARX(4,4) against padasip's recursive least squares, in one run.

Run ``python tests/benchmarks/tracker_speed.py``; the target is a ratio of at most 1 without numba.
"""

from __future__ import annotations

import time

import numpy as np
from padasip.filters import FilterRLS

from robust_filterpy.identification import ARX, ParameterTracker
from robust_filterpy.plants import simulate_arx

SAMPLES, ROUNDS = 10_000, 9


def duration(function, *arguments):
    """Return how long a call takes, in s."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def main():
    """Print the median over rounds of the ratio of durations, the two timed in turn."""
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], SAMPLES)
    theta = [-1.5, 0.7, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0]
    y = simulate_arx(theta, u, na=4, nb=4, noise=0.1 * rng.standard_normal(SAMPLES)).y
    phi = ARX(4, 4).regressors(u, y)
    rounds = []
    for _ in range(ROUNDS):
        ours = duration(ParameterTracker(ARX(4, 4), R=0.01, forgetting=0.999).run, y, u)
        drifting = duration(ParameterTracker(ARX(4, 4), R=0.01, Q=1e-6).run, y, u)
        theirs = duration(FilterRLS(8, mu=0.999, w="zeros").run, y, phi)
        rounds.append((ours, drifting, theirs))
    ours, drifting, theirs = np.transpose(rounds)
    for name, own in (("forgetting", ours), ("Q", drifting)):
        print(f"run with {name} / padasip RLS, ARX(4,4), {SAMPLES} samples: {np.median(own / theirs):.2f}")
    print(f"per sample: {ours.min() / SAMPLES * 1e6:.1f} and {theirs.min() / SAMPLES * 1e6:.1f} microseconds at best")


if __name__ == "__main__":
    main()
