"""Time `ParameterTracker.run` against padasip's recursive least squares, and against `update` in a loop.

Run ``python tests/benchmarks/tracker_speed.py``; and again with
ROBUST_FILTERPY_KERNEL=off in the environment for the definition. Targets: ARX(4,4), 10k samples, at most the time of
padasip's RLS by the definition and .03 of it by the kernel; OE(4,4), 1e6 samples, at most .05 of the online
loop by the kernel; `update`, online, at most the time of a step (predict and update) of filterpy's KalmanFilter.
"""

from __future__ import annotations

import time

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import kernel
from robust_filterpy.identification import ARX, OutputError, ParameterTracker, TrackerBank
from robust_filterpy.plants import simulate_arx, simulate_output_error

SAMPLES, LONG, ROUNDS, ONLINE = 10_000, 1_000_000, 9, 1000
KERNEL = kernel.available()
THETA = [-1.5, 0.7, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0]


def duration(function, *arguments):
    """Return how long a call takes, in s."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def against_least_squares(rng):
    """Print the median over rounds of the ratio of durations, all timed in turn."""
    from padasip.filters import FilterRLS

    u = rng.choice([-1.0, 1.0], SAMPLES)
    y = simulate_arx(THETA, u, na=4, nb=4, noise=0.1 * rng.standard_normal(SAMPLES)).y
    phi = ARX(4, 4).regressors(u, y)
    names = ("forgetting", "Q")
    # From nothing, as padasip; a tracker that is given no start looks for one in the whole recording first.
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


def one_by_one(update, y, u):
    """Give samples one by one."""
    for k in range(len(y)):
        update(y[k], u[k])


def against_filterpy(rng):
    """Print what a sample costs online, in steps of filterpy's KalmanFilter of as many states."""
    u = rng.choice([-1.0, 1.0], 6 * ONLINE)
    y = simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, noise=0.1 * rng.standard_normal(len(u)), na=2, nb=2).y
    kf = KalmanFilter(4, 1)
    kf.H = np.ones((1, 4))
    given = {"theta": 0.0, "P": 1.0, "R": 0.01, "Q": 1e-6}
    made = {"filterpy": lambda a, b: (kf.predict(), kf.update(a))}
    for structure in (OutputError(2, 2), ARX(2, 2)):
        made[f"{structure}, theta and R given"] = ParameterTracker(structure, **given).update
        made[f"{structure}, watched"] = ParameterTracker(structure).update
    bank = TrackerBank(1, OutputError(2, 2), **given)
    made["TrackerBank(1), theta and R given"] = lambda a, b: bank.update([a], [b])
    rounds = {name: [] for name in made}
    for part in np.split(np.arange(len(u)), 6):
        for name, update in made.items():
            rounds[name].append(duration(one_by_one, update, y[part], u[part]) / ONLINE)
    # The first part is that of the start.
    theirs = np.array(rounds.pop("filterpy")[1:])
    for name, times in rounds.items():
        ratio = float(np.median(times[1:] / theirs))
        verdict = "met" if ratio <= 1.0 else "NOT MET"
        print(f"update, {name}: {ratio:.2f} of filterpy's step (target 1) {verdict}; {1e6 * min(times[1:]):.0f} us")


def main():
    """Load, then measure."""
    rng = np.random.default_rng(0)
    warm = rng.standard_normal(100)
    ParameterTracker(ARX(4, 4)).run(warm, warm)
    against_least_squares(rng)
    if KERNEL:
        against_the_online_loop(rng)
        against_filterpy(rng)


if __name__ == "__main__":
    main()
