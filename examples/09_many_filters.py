"""A thousand sensors, or a thousand runs: what replaces the loop over filters?

`filter_series` is a function of arrays, (series, time, dim_z) in and estimates out: of whole recordings, or of one step
of all filters, from the state that the step before returned; a study repeats an experiment, each run with a seed of its
own. Every one of them computes x+ = x + C T' psi(T y), the same numbers as a loop over
RobustKalmanFilter.
"""

# %% A fleet: the same model, different noise, outliers everywhere.
import argparse
import time
from pathlib import Path

import numpy as np
from scipy.stats import bootstrap

from robust_filterpy import RobustKalmanFilter, filter_series

F = np.array([[1.0, 1.0], [0.0, 0.95]])
H, Q, R = np.array([[1.0, 0.0]]), np.diag([0.0, 0.02]), np.array([[1.0]])
X0, P0 = np.zeros(2), 10.0 * np.eye(2)


def fleet(rng, series, steps):
    """Return true positions (series, steps) and measurements (series, steps, 1)."""
    x, path = np.zeros((series, 2)), np.zeros((series, steps))
    for k in range(steps):
        x = x @ F.T + rng.standard_normal((series, 2)) * np.sqrt(np.diag(Q))
        path[:, k] = x[:, 0]
    scale = np.where(rng.random(path.shape) < 0.1, 20.0, 1.0)
    return path, (path + scale * rng.standard_normal(path.shape))[:, :, None]


# %% Three ways to the same numbers.
def by_loop(zs):
    """Filter each series with a filter of its own."""
    positions = []
    for series in zs:
        kf = RobustKalmanFilter(2, 1)
        kf.x, kf.P, kf.F, kf.H, kf.Q, kf.R = X0.copy(), P0.copy(), F, H, Q, R
        for z in series:
            kf.predict()
            kf.update(z)
        positions.append(kf.x[0])
    return np.array(positions)


def by_steps(zs):
    """Advance all filters together, step by step, as measurements come in."""
    result = filter_series(zs[:, :1], F, H, Q, R, X0, P0)
    for k in range(1, zs.shape[1]):
        result = filter_series(zs[:, k : k + 1], F, H, Q, R, state=result.state)
    return result.x[:, 0, 0]


def by_series(zs):
    """Filter whole recordings at once, keeping only the last state."""
    return filter_series(zs, F, H, Q, R, X0, P0, keep="last").x.reshape(len(zs), 2)[:, 0]


def by_dask(zs):
    """Filter more than one machine holds: blocks of series, here on a local cluster of two workers."""
    import dask.array as da
    from dask.distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1) as cluster, Client(cluster):
        blocks = da.from_array(zs, chunks=(max(len(zs) // 4, 1), -1, -1))
        return blocks.map_blocks(by_series, drop_axis=(1, 2), dtype=float).compute()


# %% A study: the same experiment many times, with an interval.
def trial(rng):
    """Return the root-mean-square error of one run of 100 samples."""
    path, zs = fleet(rng, 20, 100)
    return float(np.sqrt(np.mean((by_series(zs) - path[:, -1]) ** 2)))


def main(argv=None):
    """Time, compare, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--dask", action="store_true", help="also on a local cluster")
    options = parser.parse_args(argv)
    ways = {"loop": by_loop, "all, step by step": by_steps, "whole series": by_series}
    if options.dask:
        ways["Dask, 2 workers"] = by_dask
    sizes = (1, 10, 100, 1000)
    cost = {name: [] for name in ways}
    worst = 0.0
    # The first call of each loads what is compiled.
    for way in ways.values():
        way(fleet(np.random.default_rng(1), 2, 20)[1])
    for series in sizes:
        _, zs = fleet(np.random.default_rng(0), series, options.steps)
        answers = {}
        for name, way in ways.items():
            subset = zs[:30] if name == "loop" else zs
            seconds = []
            for _ in range(3):
                began = time.perf_counter()
                answers[name] = way(subset)
                seconds.append(time.perf_counter() - began)
            cost[name].append(min(seconds) / len(subset) / options.steps)
        worst = max(worst, *(np.abs(a[:30] - answers["loop"]).max() for a in answers.values()))
    study = np.array([trial(np.random.default_rng(seed)) for seed in np.random.SeedSequence(0).spawn(20)])
    low, high = bootstrap((study,), np.mean, n_resamples=999, random_state=0).confidence_interval
    draw(sizes, cost, options.out)
    per_step = {name: values[-1] / cost["loop"][-1] for name, values in cost.items()}
    print(
        f"Conclusion: the same numbers to {worst:.0e}; with 1000 series a step of one filter costs "
        f"{per_step['all, step by step']:.3f} of the loop's where all go on step by step and "
        f"{per_step['whole series']:.3f} where series are whole. "
        f"The study's error is {study.mean():.2f} ({low:.2f} to {high:.2f})."
    )


def draw(sizes, cost, out):
    """Draw the cost of a step against the number of series."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
    for (name, values), marker in zip(cost.items(), "os^x", strict=False):
        ax.loglog(sizes, np.array(values) / min(cost["loop"]), marker=marker, label=name)
    ax.set(xlabel="number of series", ylabel="time of one step of one filter, loop = 1")
    ax.set_title("Together, a step of one filter costs a small part of the loop's")
    ax.legend()
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "09_many_filters.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
