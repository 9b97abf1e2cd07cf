"""Ten thousand devices on a cluster whose machines die: does the answer depend on it?

Every device is the same filter, x+ = x + C T' psi(T y), and a partition of the table goes through it as a pure
function: what a lost worker had done is done again elsewhere, with the same result to the last bit. Needs
``pip install "robust_filterpy[dask]"``.
"""

# %% The model that all devices share: a level that drifts, read by a sensor that sometimes lies.
import argparse
import logging
import os
import signal
import time
from pathlib import Path

import numpy as np
import pandas as pd

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.fleet import FilterModel, filter_table


def model():
    """Return the filter of every device."""
    kf = RobustKalmanFilter(1, 1)
    kf.H, kf.Q, kf.R, kf.P = np.eye(1), 0.01 * np.eye(1), np.eye(1), 100.0 * np.eye(1)
    return FilterModel(kf, time="t", dt=1.0, measurements=["z"])


# %% The samples, in no order at all; one device in a hundred has a sensor that lies every second time.
def samples(devices, steps):
    """Return a table, and which devices are worn."""
    rng = np.random.default_rng(0)
    worn = rng.random(devices) < 0.01
    level = np.cumsum(0.1 * rng.normal(size=(devices, steps)), axis=1) + rng.normal(size=(devices, 1)) * 5.0
    lies = rng.random(level.shape) < np.where(worn, 0.5, 0.02)[:, None]
    z = level + np.where(lies, 15.0, 1.0) * rng.normal(size=level.shape)
    table = {"device": np.repeat(np.arange(devices), steps), "t": np.tile(np.arange(float(steps)), devices)}
    table = pd.DataFrame({**table, "z": z.ravel()})
    return table.sample(frac=1.0, random_state=1, ignore_index=True), worn


# %% The whole program on Dask: one call. And one that kills a worker on the way.
def on_dask(table):
    """Filter on two worker processes, and kill one of them."""
    import dask.dataframe as dd
    from distributed import Client, LocalCluster

    from robust_filterpy.fleet.dask import filter_frame

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": logging.ERROR}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        victim = next(iter(client.run(os.getpid).values()))
        future = client.compute(filter_frame(dd.from_pandas(table, npartitions=16), model()))
        time.sleep(0.3)
        os.kill(victim, getattr(signal, "SIGKILL", signal.SIGTERM))  # Windows has but the latter, which kills
        return future.result()


def main(argv=None):
    """Filter on a dying cluster and in one process, compare, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--devices", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=50)
    options = parser.parse_args(argv)
    table, worn = samples(options.devices, options.steps)
    found = on_dask(table).sort_values(["device", "t"], ignore_index=True)
    alone = filter_table(model(), table, sort=True).sort_values(["device", "t"], ignore_index=True)
    same = np.array_equal(found["x0"], alone["x0"]) and np.array_equal(found["std0"], alone["std0"])
    # How many of its readings a device's filter believed only in part.
    doubted = (found["weight0"] < 1.0).groupby(found["device"]).mean().to_numpy()
    suspects = doubted > 0.35
    draw(doubted, worn, options.out)
    print(
        f"Conclusion: {options.devices} devices, {len(table)} samples, a worker killed on the way: the result is that "
        f"of one process {'to the last bit' if same else 'NOT exactly'}. Of {worn.sum()} devices with a worn sensor "
        f"{(suspects & worn).sum()} are found, {(suspects & ~worn).sum()} others are suspected."
    )


def draw(doubted, worn, out):
    """Draw how many readings were doubted, device by device."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
    bins = np.linspace(0.0, 0.8, 41)
    ax.hist(100.0 * doubted[~worn], 100.0 * bins, label="sound sensor", color="0.6")
    ax.hist(100.0 * doubted[worn], 100.0 * bins, label="worn sensor", color="C3")
    ax.axvline(35.0, color="k", linestyle=":", label="suspected from here")
    ax.set(xlabel="readings that the filter doubts, %", ylabel="devices", yscale="log")
    ax.set_title("A sensor that lies is doubted more often")
    ax.legend()
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "15_a_fleet_on_dask.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
