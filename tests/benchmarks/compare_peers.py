"""Microseconds per step of every Kalman filter in Python, and the ratio to filterpy's in the same run.

    python tests/benchmarks/compare_peers.py [--steps 2000] [--series 1000] [--growth] [--write-readme]

Before anything is timed, the plain Kalman answers are checked to agree. --growth prints how the cost grows with steps,
series and dim_x; --write-readme puts the table between the two markers of README.md.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import Linear, RobustKalmanFilter
from robust_filterpy.bank import FilterBank
from robust_filterpy.series import filter_series

SIZES = [(2, 1), (4, 1), (4, 2), (7, 4), (8, 1), (20, 5)]
MARKERS = "<!-- speed table -->", "<!-- end speed table -->"


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


def ours_bank(p, **options):
    """Return the last states of all series."""
    bank = p.fill(FilterBank(len(p.z), p.n, p.m, **options))
    bank.P = np.tile(p.P, (len(p.z), 1, 1))
    for z in p.z.transpose(1, 0, 2):
        bank.predict()
        bank.update(z)
    return bank.x


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
    """Return the best time per step of one series."""
    out = function(p, **options)
    steps = p.z.shape[1] * (len(p.z) if out.ndim == 2 else 1)
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        function(p, **options)
        best = min(best, time.perf_counter() - start)
    return 1e6 * best / steps


def check(p) -> None:
    """Raise unless every plain Kalman filter comes to the same state."""
    truth = filterpy_loop(p)
    for function in (with_statsmodels, with_simdkalman, with_pykalman):
        np.testing.assert_allclose(np.atleast_2d(function(p))[0], truth, rtol=1e-6, atol=1e-8)
    for function in (ours_online, ours_batch, ours_series, ours_bank):
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


def table(steps: int, series: int, repeats: int) -> str:
    """Return the table, in Markdown."""
    one = [("filterpy", filterpy_loop), ("statsmodels", with_statsmodels), ("pykalman", with_pykalman),
           ("ours, online", ours_online), ("ours, batch", ours_batch)]  # fmt: skip
    many = [("simdkalman", with_simdkalman), ("ours, series", ours_series), ("ours, bank", ours_bank)]
    names = [name for name, _ in one] + [f"{name} ({series})" for name, _ in many]
    lines = ["| dim_x, dim_z | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for n, m in SIZES:
        check(Problem(n, m, 2, 1200))
        alone, together = Problem(n, m, 1, steps), Problem(n, m, series, max(steps // 100, 10))
        cost = [microseconds(function, alone, repeats) for _, function in one]
        cost += [microseconds(function, together, repeats) for _, function in many]
        cells = [f"{c:.3g} ({c / cost[0]:.3f})" for c in cost]
        lines.append(f"| {n}, {m} | " + " | ".join(cells) + " |")
    lines.append(f"\npadasip RLS, ARX(4, 4): {padasip_rls(steps, repeats):.3g} microseconds per sample.")
    return "\n".join(lines)


def growth() -> str:
    """Return how the cost per step of a series changes with each size."""
    lines = []
    for steps in (1000, 10_000, 100_000, 1_000_000):
        lines.append(f"batch (4, 1), {steps} steps: {microseconds(ours_batch, Problem(4, 1, 1, steps), 2):.3g}")
    for series in (1, 100, 10_000, 100_000):
        cost = microseconds(ours_series, Problem(4, 1, series, 20), 2, keep="last")
        lines.append(f"series (4, 1), {series} series: {cost:.3g}")
    for n in (2, 4, 8, 16, 32, 64):
        lines.append(f"batch ({n}, 1): {microseconds(ours_batch, Problem(n, 1, 1, 2000), 2):.3g}")
    return "\n".join(lines)


def main() -> None:
    """Print, and write if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--series", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--growth", action="store_true")
    parser.add_argument("--write-readme", action="store_true")
    args = parser.parse_args()
    if args.growth:
        print("Microseconds per step of a series\n" + growth())
        return
    found = "Microseconds per step (ratio to filterpy in the same run)\n\n" + table(
        args.steps, args.series, args.repeats
    )
    print(found)
    if args.write_readme:
        readme = Path(__file__).parents[2] / "README.md"
        text = readme.read_text(encoding="utf-8")
        if not all(marker in text for marker in MARKERS):
            raise SystemExit(f"README.md: expected the markers {MARKERS[0]} and {MARKERS[1]}")
        head, rest = text.split(MARKERS[0], 1)
        readme.write_text(f"{head}{MARKERS[0]}\n{found}\n{MARKERS[1]}{rest.split(MARKERS[1], 1)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
