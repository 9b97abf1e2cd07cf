"""Does `estimate_noise` find the greatest likelihood, wherever R and Q begin? Random models, with and without outliers.

Run ``python tests/benchmarks/noise_fit_study.py [--models N] [--seed S] [--steps N] [--jobs J] [--als N]
[--intervals N]``. A model has up to 4 states and 3 sensors; R and Q are told wrongly by factors between 1e-4 and 1e4.
The gap is what the worse of two such estimates lacks, in nats, of the best of seven, one of them told the truth. The
second table is the setting of ALS-IRLS (arXiv 2603.08158): 1500 samples with outliers to fit to, 500 clean ones to
filter; root mean square error of the states over that of the filter that knows both noises. The third: over N models,
how often an interval of level .95 holds the truth.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from scipy.stats import ortho_group

from robust_filterpy import estimate_noise

SHARES = (0.0, 0.1, 0.3)


def random_model(g: np.random.Generator) -> Any:
    """Return F, H and the diagonals of Q and R of a stable model whose states all show."""
    n, m = int(g.integers(1, 5)), int(g.integers(1, 4))
    root = ortho_group.rvs(n, random_state=g) if n > 1 else np.eye(1)
    F = root @ np.diag(g.uniform(-0.2, 0.97, n)) @ root.T
    return F, g.normal(size=(m, n)), np.exp(g.normal(size=n)), np.exp(g.normal(size=m))


def recording(g: np.random.Generator, model: Any, steps: int, share: float, size: float = 10.0) -> Any:
    """Return states and measurements, of which some are outliers."""
    F, H, q, r = model
    x, path = np.zeros(len(F)), np.empty((steps, len(F)))
    for k in range(steps):
        x = path[k] = F @ x + np.sqrt(q) * g.standard_normal(len(q))
    scale = np.where(g.random(steps) < share, size, 1.0)[:, None]
    return path, path @ H.T + scale * np.sqrt(r) * g.standard_normal((steps, len(r)))


def told(model: Any, q: float = 1.0, r: float = 1.0) -> KalmanFilter:
    """Return a filter that is told a multiple of Q and of R."""
    F, H, Q, R = model
    kf = KalmanFilter(len(F), len(H))
    kf.F, kf.H, kf.Q, kf.R, kf.P = F, H, q * np.diag(Q), r * np.diag(R), 10.0 * np.eye(len(F))
    return kf


def gap(seed: int, steps: int, share: float) -> float:
    """Return how many nats the estimate is below the best that any of many beginnings leads to."""
    g = np.random.default_rng(seed)
    model = random_model(g)
    zs = recording(g, model, steps, share)[1]
    wrong = 10.0 ** g.uniform(-4, 4, (6, 2))
    found = [estimate_noise(told(model, *factors), zs) for factors in wrong[:2]]
    # A grid moves with what is told, so that other beginnings are other grids.
    others = [estimate_noise(told(model, *factors), zs) for factors in [*wrong[2:], (1.0, 1.0)]]
    return max(one.log_likelihood for one in [*found, *others]) - min(one.log_likelihood for one in found)


def held(seed: int, steps: int, share: float) -> list[bool]:
    """Return for the factor of R and that of Q whether the interval of level .95 holds the truth."""
    g = np.random.default_rng(seed)
    model = random_model(g)
    ends = estimate_noise(told(model), recording(g, model, steps, share)[1]).intervals(0.95)
    return [bool(low <= 1.0 <= high) for low, high in (ends.R_scale[0], ends.Q_scale[0])]


def als(seed: int) -> float:
    """Return the error of the filter with the fitted noise over that of the one that knows it."""
    g = np.random.default_rng(seed)
    F, G, H = np.diag([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]), np.array([[0.1, 0.2, 0.0]])
    F[0, 2] = 0.1

    def drawn(steps: int, share: float) -> Any:
        x, path = np.zeros(3), np.empty((steps, 3))
        for k in range(steps):
            x = path[k] = F @ x + G * (np.sqrt(5.0) * g.standard_normal())
        bad = np.where(g.random(steps) < share, 8.0, 1.0)
        return path, path @ H.T + (bad * np.sqrt(3.0) * g.standard_normal(steps))[:, None]

    def filtered(Q: Any, R: Any, zs: Any) -> Any:
        kf = KalmanFilter(3, 1)
        kf.F, kf.H, kf.Q, kf.R, kf.P = F, H, Q, R, 10.0 * np.eye(3)
        return kf.batch_filter(list(zs))[0].reshape(-1, 3)

    kf = KalmanFilter(3, 1)
    kf.F, kf.H, kf.Q, kf.R, kf.P = F, H, np.outer(G, G), np.eye(1), 10.0 * np.eye(3)
    fit = estimate_noise(kf, drawn(1500, 0.15)[1])
    truth, zs = drawn(500, 0.0)
    errors = [
        np.sqrt(np.mean((filtered(Q, R, zs) - truth) ** 2))
        for Q, R in ((fit.Q, fit.R), (5.0 * np.outer(G, G), 3.0 * np.eye(1)))
    ]
    return float(errors[0] / errors[1])


def main(argv: list[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=int, default=100)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--als", type=int, default=20, help="recordings of the second table")
    parser.add_argument("--intervals", type=int, default=0, help="models of the third table")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args(argv)
    seeds = range(args.seed, args.seed + args.models)
    if args.models:
        print("| outliers | within .1 nat of the best | largest gap, nats |\n|---|---|---|")
    for share in SHARES if args.models else ():
        gaps = np.array(Parallel(n_jobs=args.jobs)(delayed(gap)(seed, args.steps, share) for seed in seeds))
        print(f"| {share:g} | {(gaps < 0.1).sum()} of {len(gaps)} | {gaps.max():.2f} |", flush=True)
    if args.intervals:
        print("\n| outliers | intervals of R, of Q that hold the truth |\n|---|---|")
    for share in SHARES if args.intervals else ():
        numbers = range(args.seed, args.seed + args.intervals)
        right = Parallel(n_jobs=args.jobs)(delayed(held)(seed, args.steps, share) for seed in numbers)
        print(f"| {share:g} | {', '.join(f'{one:.3f}' for one in np.mean(right, axis=0))} |", flush=True)
    if not args.als:
        return
    ratios = Parallel(n_jobs=args.jobs)(delayed(als)(seed) for seed in range(args.seed, args.seed + args.als))
    print(f"\nALS-IRLS's setting: {np.mean(ratios):.3f} (target 1.03), from {min(ratios):.3f} to {max(ratios):.3f}")


if __name__ == "__main__":
    main()
