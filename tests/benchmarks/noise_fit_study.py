"""Does `estimate_noise` find the greatest likelihood, wherever R and Q begin? Random models, with and without outliers.

Run ``python tests/benchmarks/noise_fit_study.py [--models N] [--seed S] [--steps N] [--shares ..] [--jobs J] [--als N]
[--intervals N [--level]] [--statsmodels]``. A model has up to 4 states and 3 sensors; R and Q are given wrongly by
factors between 1e-4 and 1e4. The gap is what the worst of three such estimates lacks, in nats, of the best that they or
a dense search find: that looks at 5292 places over all four numbers, and goes downhill from the 30 lowest that are
lower than their neighbours. Over N random models, or recordings of one level with R = 1 and Q = .25: how often an
interval of level .95 holds the truth, and how often where it has two ends. Data and models of statsmodels, without
outliers: its likelihood at its own estimate and at ours. The setting of ALS-IRLS (arXiv 2603.08158): 1500 samples with
outliers to fit to, 500 clean ones to filter; root mean square error of the states over that of the filter that knows
both noises.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from scipy.stats import ortho_group

from robust_filterpy import estimate_noise
from robust_filterpy.filters.problem import Problem
from robust_filterpy.noise._problem import NoiseFit, descend, of_filter, valleys
from robust_filterpy.noise.estimation import NoiseEstimate

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


def given(model: Any, q: float = 1.0, r: float = 1.0) -> KalmanFilter:
    """Return a filter that is given a multiple of Q and of R."""
    F, H, Q, R = model
    kf = KalmanFilter(len(F), len(H))
    kf.F, kf.H, kf.Q, kf.R, kf.P = F, H, q * np.diag(Q), r * np.diag(R), 10.0 * np.eye(len(F))
    return kf


def gap(seed: int, steps: int, share: float) -> float:
    """Return how many nats the worst of three estimates is below the best that they or a dense search find."""
    g = np.random.default_rng(seed)
    model = random_model(g)
    zs = recording(g, model, steps, share)[1]
    found = [estimate_noise(given(model, *factors), zs) for factors in 10.0 ** g.uniform(-4, 4, (3, 2))]
    # What a filter that is given the truth would make small: one cost for all.
    data = of_filter(given(model), zs, *[None] * 5)
    n, m = data.H.shape[:0:-1]
    problem = NoiseFit(data, np.zeros(m, dtype=int), np.zeros(n, dtype=int), (None, None))
    points = np.array([_point(one, data) for one in found])
    costs = problem.cost(points)
    return float(costs.max() - min(costs.min(), densely(problem)))


def _point(found: NoiseEstimate, data: Problem) -> list[float]:
    """Return an estimate as a point of the problem of the filter that is given the truth."""
    factors = found.R[0, 0] / data.R[0, 0, 0], found.Q[0, 0] / data.Q[0, 0, 0]
    return [*np.log(factors), np.log(found.contamination / (1.0 - found.contamination)), np.log(found.scale_ratio)]


def densely(problem: NoiseFit) -> float:
    """Return the least cost that a dense search finds, half a decade or a factor of 3 apart."""
    decades = np.log(10.0) * np.linspace(-5.0, 5.0, 21)
    axes = decades, decades, np.array([-7.0, -3.0, -1.8, -0.6]), np.log([4.0, 12.0, 40.0])
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = problem.cost(grid.reshape(-1, 4)).reshape(grid.shape[:-1])
    starts = np.array([grid[at] for at in valleys(values, 30)])
    return float(descend(problem.cost, starts, *problem.limits, "the dense search").costs.min())


def held(seed: int, steps: int, share: float, level: bool) -> list[float]:
    """Return for the factors of R and of Q whether the interval of level .95 holds the truth; NaN for no two ends."""
    g = np.random.default_rng(seed)
    model = (np.eye(1), np.eye(1), np.array([0.25]), np.ones(1)) if level else random_model(g)
    ends = estimate_noise(given(model), recording(g, model, steps, share)[1]).intervals(0.95)
    both = [
        (float(low <= 1.0 <= high), low > 0.0 and high < np.inf) for low, high in (ends.R_scale[0], ends.Q_scale[0])
    ]
    return [right for right, _ in both] + [right if whole else np.nan for right, whole in both]


def structural() -> dict[str, tuple[Any, dict[str, Any]]]:
    """Return data that come with statsmodels, and what of a structural model each is fitted by."""
    from statsmodels import datasets

    frames = {name: getattr(datasets, name).load_pandas().data for name in ("nile", "co2", "macrodata", "elnino")}
    macro, monthly = frames["macrodata"], frames["co2"]["co2"].resample("MS").mean().to_numpy()
    sea = frames["elnino"].iloc[:, 1:].to_numpy(dtype=float).ravel()
    return {
        "nile": (frames["nile"]["volume"].to_numpy(), {"level": "llevel"}),
        "nile, trend": (frames["nile"]["volume"].to_numpy(), {"level": "lltrend"}),
        "co2, monthly": (monthly, {"level": "lltrend", "seasonal": 12}),
        "co2, monthly, smooth": (monthly, {"level": "strend", "seasonal": 12}),
        "macrodata, inflation": (macro["infl"].to_numpy(), {"level": "llevel"}),
        "macrodata, log of GDP": (np.log(macro["realgdp"].to_numpy()), {"level": "lltrend"}),
        "macrodata, unemployment": (macro["unemp"].to_numpy(), {"level": "strend", "seasonal": 4}),
        "elnino": (sea, {"level": "llevel", "seasonal": 12}),
    }


def beside_statsmodels(y: np.ndarray, model: dict[str, Any]) -> tuple[float, float]:
    """Return the likelihood that statsmodels gives to its own estimate, and to ours, of a model of its own."""
    from statsmodels.tsa.statespace.structural import UnobservedComponents

    theirs = UnobservedComponents(y, **model, use_exact_diffuse=True)
    best = theirs.fit(disp=False)
    drives, size = theirs["selection"], float(np.nanvar(np.diff(y)))
    kf = KalmanFilter(len(drives), 1)
    kf.F, kf.H, kf.Q, kf.R = theirs["transition"], theirs["design"], size * drives @ drives.T, size * np.eye(1)
    kf.P = 1e6 * float(np.nanmean(y**2)) * np.eye(len(drives))
    fit = estimate_noise(kf, y, Q="each", contamination=0.0)
    return best.llf, theirs.loglike([fit.R[0, 0], *(drives.T @ fit.Q @ drives).diagonal()])


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
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=int, default=100)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--als", type=int, default=20, help="recordings of the second table")
    parser.add_argument("--intervals", type=int, default=0, help="models of the third table")
    parser.add_argument("--level", action="store_true", help="intervals of one level in place of random models")
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES, help="of outliers")
    parser.add_argument("--statsmodels", action="store_true", help="only the table with statsmodels")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args(argv)
    if args.statsmodels:
        print("| data | model | log-likelihood, statsmodels | at ours | ours over theirs |\n|---|---|---|---|---|")
        for name, (y, model) in structural().items():
            theirs, ours = beside_statsmodels(y, model)
            parts = ", ".join(f"{key} {value}" for key, value in model.items())
            print(f"| {name} | {parts} | {theirs:.3f} | {ours:.3f} | {ours - theirs:+.3f} |", flush=True)
        return
    seeds = range(args.seed, args.seed + args.models)
    if args.models:
        print("| outliers | within .1 nat of the best | largest gap, nats |\n|---|---|---|")
    for share in args.shares if args.models else ():
        gaps = np.array(Parallel(n_jobs=args.jobs)(delayed(gap)(seed, args.steps, share) for seed in seeds))
        print(f"| {share:g} | {(gaps < 0.1).sum()} of {len(gaps)} | {gaps.max():.2f} |", flush=True)
    if args.intervals:
        print("\n| outliers | intervals of R, of Q that hold the truth | of those with two ends | with two ends |")
        print("|---|---|---|---|")
    for share in args.shares if args.intervals else ():
        numbers = range(args.seed, args.seed + args.intervals)
        right = np.array(
            Parallel(n_jobs=args.jobs)(delayed(held)(seed, args.steps, share, args.level) for seed in numbers)
        )
        whole = np.mean(~np.isnan(right[:, 2:]), axis=0)
        cells = [f"{a:.3f}, {b:.3f}" for a, b in (*np.nanmean(right, axis=0).reshape(2, 2), whole)]
        print(f"| {share:g} | {' | '.join(cells)} |", flush=True)
    if not args.als:
        return
    ratios = Parallel(n_jobs=args.jobs)(delayed(als)(seed) for seed in range(args.seed, args.seed + args.als))
    print(f"\nALS-IRLS's setting: {np.mean(ratios):.3f} (target 1.03), from {min(ratios):.3f} to {max(ratios):.3f}")


if __name__ == "__main__":
    main()
