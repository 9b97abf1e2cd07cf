"""Microseconds per step of every Kalman filter in Python, and the ratio to filterpy's in the same run.

    python tests/benchmarks/compare_peers.py [--steps 2000] [--series 1000] [--growth]

Before anything is timed, the plain Kalman answers are checked to agree. After the table, each target says whether it
is met. --growth prints how the cost grows with steps, series and dim_x. Each number is the least of many turns, so that
other work on the machine matters little.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.filters.series import filter_series
from robust_filterpy.influence import Linear

SIZES = [(2, 1), (4, 1), (4, 2), (7, 4), (8, 1), (20, 5)]
#: Ours, whose it is compared with, sizes, and the greatest ratio.
TARGETS = [
    ("ours, batch", "filterpy", [(4, 1)], 0.02),
    ("ours, batch", "filterpy", [(4, 2)], 0.03),
    ("ours, batch", "filterpy", [(8, 1)], 0.05),
    ("ours, batch", "statsmodels", [(2, 1), (4, 1), (4, 2)], 0.15),
    ("ours, batch", "statsmodels", [(20, 5)], 1.0),
    ("ours, series", "simdkalman", [(2, 1), (4, 1), (4, 2)], 0.2),
    ("ours, series", "simdkalman", [(7, 4), (8, 1), (20, 5)], 0.5),
]
LINEAR, SECONDS, BYTES = 1.5, 1.0, 2e9


class Problem:
    """A stable plant and its measurements, with an outlier now and then."""

    def __init__(self, n: int, m: int, series: int, steps: int) -> None:
        rng = np.random.default_rng(0)
        F = rng.normal(size=(n, n))
        self.n, self.m = n, m
        self.F, self.H = 0.95 * F / np.abs(np.linalg.eigvals(F)).max(), rng.normal(size=(m, n))
        self.Q, self.R, self.x, self.P = 0.01 * np.eye(n), 0.7 * np.eye(m), np.zeros(n), np.eye(n)
        self.z = rng.normal(size=(series, steps, m))
        self.z[rng.random(self.z.shape) < 0.05] += 20.0

    def fill(self, kf):
        """Give a filter of filterpy's kind the matrices."""
        kf.F, kf.H, kf.Q, kf.R, kf.P = (getattr(self, name).copy() for name in "FHQRP")
        return kf


def filterpy_loop(p, cls=KalmanFilter, **options):
    """Return the last state of the first series."""
    kf = p.fill(cls(p.n, p.m, **options))
    for z in p.z[0][:, :, None]:
        kf.predict()
        kf.update(z)
    return kf.x.ravel()


def ours_online(p, **options):
    """Return the last state of the first series."""
    return filterpy_loop(p, RobustKalmanFilter, **options)


def ours_batch(p, **options):
    """Return the last state of the first series."""
    return p.fill(RobustKalmanFilter(p.n, p.m, **options)).batch_filter(p.z[0][:, :, None])[0][-1].ravel()


def ours_series(p, **options):
    """Return the last states of all series, filtered on one thread."""
    return filter_series(p.z, p.F, p.H, p.Q, p.R, p.x, p.P, n_threads=1, **options).x[:, -1]


def with_statsmodels(p):
    """Return the last state of the first series."""
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as Compiled

    kf = Compiled(k_endog=p.m, k_states=p.n, tolerance=0)
    kf.bind(p.z[0].copy())
    for name, value in {
        "design": p.H, "transition": p.F, "selection": np.eye(p.n), "state_cov": p.Q, "obs_cov": p.R
    }.items():  # fmt: skip
        kf[name] = value
    # Its x is that before the first measurement, ours before the first prediction.
    kf.initialize_known(p.x, p.F @ p.P @ p.F.T + p.Q)
    return kf.filter().filtered_state[:, -1]


def with_simdkalman(p):
    """Return the last states of all series."""
    import simdkalman

    kf = simdkalman.KalmanFilter(p.F, p.Q, p.H, p.R)
    first = p.F @ p.P @ p.F.T + p.Q
    result = kf.compute(p.z, 0, initial_value=p.x, initial_covariance=first, smoothed=False, filtered=True)
    return result.filtered.states.mean[:, -1]


def with_pykalman(p):
    """Return the last state of the first series."""
    import pykalman

    first = p.F @ p.P @ p.F.T + p.Q
    return pykalman.KalmanFilter(p.F, p.H, p.Q, p.R, initial_state_mean=p.x, initial_state_covariance=first).filter(
        p.z[0]
    )[0][-1]


def microseconds(function, p, repeats, **options) -> float:
    """Return the best time per step of one series, of so many turns or a quarter of a second, whichever is more."""
    out = function(p, **options)
    steps = p.z.shape[1] * (len(p.z) if out.ndim == 2 else 1)
    durations = []
    while len(durations) < repeats or sum(durations) < 0.25:
        start = time.perf_counter()
        function(p, **options)
        durations.append(time.perf_counter() - start)
    return 1e6 * min(durations) / steps


def check(p) -> None:
    """Raise unless every plain Kalman filter comes to the same state."""
    truth = filterpy_loop(p)
    for function in (with_statsmodels, with_simdkalman, with_pykalman):
        np.testing.assert_allclose(np.atleast_2d(function(p))[0], truth, rtol=1e-6, atol=1e-8)
    for function in (ours_online, ours_batch, ours_series):
        found = np.atleast_2d(function(p, influence=Linear()))[0]
        np.testing.assert_allclose(found, truth, rtol=1e-8, atol=1e-10)


def padasip_rls(steps: int, repeats: int) -> float:
    """Return microseconds per sample of padasip's recursive least squares, ARX(4, 4)."""
    import padasip

    rng = np.random.default_rng(0)
    y, X = rng.normal(size=steps), rng.normal(size=(steps, 8))
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        padasip.filters.FilterRLS(n=8, mu=0.999).run(y, X)
        best = min(best, time.perf_counter() - start)
    return 1e6 * best / steps


def measured(steps: int, series: int, repeats: int) -> dict[tuple[int, int], dict[str, float]]:
    """Return microseconds per step by size and name."""
    one = [("filterpy", filterpy_loop), ("statsmodels", with_statsmodels), ("pykalman", with_pykalman),
           ("ours, online", ours_online), ("ours, batch", ours_batch)]  # fmt: skip
    many = [("simdkalman", with_simdkalman), ("ours, series", ours_series)]
    found = {}
    for n, m in SIZES:
        check(Problem(n, m, 2, 1200))
        alone, together = Problem(n, m, 1, steps), Problem(n, m, series, max(steps // 100, 10))
        cost = {name: microseconds(function, alone, repeats) for name, function in one}
        found[n, m] = cost | {name: microseconds(function, together, repeats) for name, function in many}
    return found


def table(found: dict[tuple[int, int], dict[str, float]], steps: int, series: int, repeats: int) -> str:
    """Return the table, in Markdown."""
    names = list(next(iter(found.values())))
    heads = [f"{name} ({series})" if name in ("simdkalman", "ours, series") else name for name in names]
    lines = ["| dim_x, dim_z | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for (n, m), cost in found.items():
        cells = [f"{c:.3g} ({c / cost['filterpy']:.3f})" for c in cost.values()]
        lines.append(f"| {n}, {m} | " + " | ".join(cells) + " |")
    lines.append(f"\npadasip RLS, ARX(4, 4): {padasip_rls(steps, repeats):.3g} microseconds per sample.")
    return "\n".join(lines)


def verdict(what: str, number: float, target: float, unit: str = "") -> str:
    """Return a line that says whether a target is met."""
    return f"{what}: {number:.4g}{unit} (target {target:g}{unit}) {'met' if number <= target else 'NOT MET'}"


def verdicts(found: dict[tuple[int, int], dict[str, float]]) -> str:
    """Return what has become of each target."""
    lines = [
        verdict(f"{ours} / {theirs} at {size}", found[size][ours] / found[size][theirs], target)
        for ours, theirs, sizes, target in TARGETS
        for size in sizes
    ]
    return "\n".join([*lines, verdict("first long batch of a second process", first_batch(), SECONDS, " s")])


def in_a_process(code: str) -> float:
    """Return the number that a new interpreter prints."""
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def first_batch() -> float:
    """Return seconds from after the import of a warm process to the result of its first long batch."""
    return min(
        in_a_process(
            "import time, numpy as np; from robust_filterpy import RobustKalmanFilter\n"
            "kf, start = RobustKalmanFilter(4, 1), time.perf_counter()\n"
            "kf.H[:] = 1.0; kf.batch_filter(np.zeros(1000)); print(time.perf_counter() - start)"
        )
        for _ in range(5)
    )


def peak_memory() -> float:
    """Return bytes that 1e5 series of 100 steps with 4 states take at most, all covariances and Python included."""
    return 1024 * in_a_process(
        "import resource, numpy as np; from robust_filterpy import filter_series\n"
        "zs = np.random.default_rng(0).standard_normal((100_000, 100, 1))\n"
        "eye = np.eye(4); filter_series(zs, 0.9 * eye, np.ones((1, 4)), 0.1 * eye, np.eye(1), np.zeros(4), eye)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )


def growth() -> str:
    """Return how the cost per step of a series changes with each size."""
    lines = []
    for steps in (1000, 10_000, 100_000, 1_000_000):
        lines.append(f"batch (4, 1), {steps} steps: {microseconds(ours_batch, Problem(4, 1, 1, steps), 2):.3g}")
    costs = {series: microseconds(ours_series, Problem(4, 1, series, 20), 2) for series in (1, 100, 10_000, 100_000)}
    lines += [f"series (4, 1), {series} series: {cost:.3g}" for series, cost in costs.items()]
    for n in (2, 4, 8, 16, 32, 64):
        lines.append(f"batch ({n}, 1): {microseconds(ours_batch, Problem(n, 1, 1, 2000), 2):.3g}")
    lines.append(verdict("\n1e5 series to 100, per series-step", costs[100_000] / costs[100], LINEAR))
    lines.append(verdict("peak of 1e5 series x 100 steps", peak_memory() / 1e9, BYTES / 1e9, " GB"))
    return "\n".join(lines)


def main() -> None:
    """Print, and write if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--series", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--growth", action="store_true")
    args = parser.parse_args()
    if args.growth:
        print("Microseconds per step of a series\n" + growth())
        return
    costs = measured(args.steps, args.series, args.repeats)
    found = "Microseconds per step (ratio to filterpy in the same run)\n\n" + table(
        costs, args.steps, args.series, args.repeats
    )
    print(found + "\n\n" + verdicts(costs))


if __name__ == "__main__":
    main()
