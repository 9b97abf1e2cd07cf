"""Time `ParameterTracker.run` against padasip's recursive least squares, and against `update` in a loop.

Run ``python tests/benchmarks/tracker_speed.py``; and again with
ROBUST_FILTERPY_KERNEL=off in the environment for the definition. Targets: ARX(4,4), 10k samples, at most the time of
padasip's RLS by the definition and .03 of it by the kernel; OE(4,4), 1e6 samples, at most .05 of the online
loop by the kernel.
"""

from __future__ import annotations

import time

import numpy as np
from padasip.filters import FilterRLS

from robust_filterpy import kernel
from robust_filterpy.identification import ARX, OutputError, ParameterTracker
from robust_filterpy.plants import simulate_arx, simulate_output_error

SAMPLES, LONG, ROUNDS = 10_000, 1_000_000, 9
KERNEL = kernel.available()
THETA = [-1.5, 0.7, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0]


def duration(function, *arguments):
    """Return how long a call takes, in s."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def against_least_squares(rng):
    """Print the median over rounds of the ratio of durations, all timed in turn."""
    u = rng.choice([-1.0, 1.0], SAMPLES)
    y = simulate_arx(THETA, u, na=4, nb=4, noise=0.1 * rng.standard_normal(SAMPLES)).y
    phi = ARX(4, 4).regressors(u, y)
    names = ("forgetting", "Q")
    # From nothing, as padasip; a tracker that is told no start looks for one in the whole recording first.
    start = {"theta": 0.0, "P": 1.0, "R": 0.01}
    settings = {"forgetting": {"forgetting": 0.999, **start}, "Q": {"Q": 1e-6, **start}}
    serves, target = ("the kernel", 0.03) if KERNEL else ("the definition", 1.0)
    rounds = []
    for _ in range(ROUNDS):
        row = [duration(FilterRLS(8, mu=0.999, w="zeros").run, y, phi)]
        row += [duration(ParameterTracker(ARX(4, 4), **settings[name]).run, y, u) for name in names]
        rounds.append(row)
    theirs, *ours = np.transpose(rounds)
    for own, name in zip(ours, names, strict=True):
        ratio = np.median(own / theirs)
        verdict = "met" if ratio <= target else "NOT MET"
        print(
            f"ARX(4,4), {SAMPLES} samples, {name}, by {serves} / padasip RLS: {ratio:.3f} (target {target}) {verdict}; "
            f"{1e6 * own.min() / SAMPLES:.2f} against {1e6 * theirs.min() / SAMPLES:.2f} microseconds a sample at best"
        )


def against_the_online_loop(rng):
    """Print the ratio for a long recording; the loop is timed over its first samples."""
    u = rng.choice([-1.0, 1.0], LONG)
    noise = 0.1 * rng.standard_normal(LONG) * np.where(rng.random(LONG) < 0.1, 10.0, 1.0)
    y = simulate_output_error(THETA, u, noise=noise, na=4, nb=4).y
    make = {"theta": 0.0, "P": 1.0, "Q": 1e-6, "R": 0.01}

    def loop(tracker):
        for k in range(SAMPLES):
            tracker.update(y[k], u[k])

    run = duration(ParameterTracker(OutputError(4, 4), **make).run, y, u)
    online = duration(loop, ParameterTracker(OutputError(4, 4), **make)) * LONG / SAMPLES
    verdict = "met" if run <= 0.05 * online else "NOT MET"
    print(f"OE(4,4), {LONG} samples, run / online loop: {run / online:.4f} (target 0.05) {verdict}; {run:.2f} s")


def main():
    """Load, then measure."""
    rng = np.random.default_rng(0)
    warm = rng.standard_normal(100)
    ParameterTracker(ARX(4, 4)).run(warm, warm)
    against_least_squares(rng)
    if KERNEL:
        against_the_online_loop(rng)


if __name__ == "__main__":
    main()
