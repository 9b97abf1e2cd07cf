"""What a fleet costs on each engine, with `filter_series` in the same run, and what 1e8 devices at 1 Hz would need.

    python tests/benchmarks/fleet.py [--keys 20000] [--steps 100] [--engines dask spark]

Times are the least of three. An engine that is not installed is left out.
"""

import argparse
import io
import os
import shutil
import sys
import tempfile
import time
from typing import NamedTuple

import numpy as np
import pandas as pd
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints
from measuring import least_time as least

from robust_filterpy import (
    ARX,
    AdaptiveKalmanFilter,
    Contaminated,
    OutputError,
    ParameterTracker,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    filter_series,
)
from robust_filterpy.fleet import FilterModel, TrackerModel, filter_table, pack, step, unpack

F, H = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]])
Q, R = 0.01 * np.eye(2), np.eye(1)


def model():
    """Return a model of two states and one sensor."""
    kf = RobustKalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.R = F, H, Q, R
    return FilterModel(kf, time="t", measurements=["z"])


def samples(keys, steps, first=0):
    """Return the samples of some devices, in the order of time."""
    rng = np.random.default_rng(first)
    z = rng.normal(size=keys * steps) * np.where(rng.random(keys * steps) < 0.1, 20.0, 1.0)
    device, t = np.tile(np.arange(first, first + keys), steps), np.repeat(np.arange(float(steps)), keys)
    return pd.DataFrame({"device": device, "t": t, "z": z})


def each(call, count=300):
    """Return the time of one of many calls, in microseconds."""
    return least(lambda: [call() for _ in range(count)]) / count * 1e6


def sizes():
    """Print what a state takes, in memory of its arrays and as bytes."""
    print("| state of | numbers that move | packed for a fleet, bytes | the whole of it, bytes |")
    print("|---|---|---|---|")

    def moved(x, dt):
        return x

    def seen(x):
        return x[:1]

    for n, m in ((2, 1), (4, 2), (6, 3)):
        filters = {
            f"RobustKalmanFilter({n}, {m})": RobustKalmanFilter(n, m),
            f"RobustKalmanFilter({n}, {m}, noise=Contaminated())": RobustKalmanFilter(n, m, noise=Contaminated()),
            f"AdaptiveKalmanFilter({n}, {m})": AdaptiveKalmanFilter(n, m),
        }
        if (n, m) == (2, 1):
            points = MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)
            filters["RobustUnscentedKalmanFilter(2, 1)"] = RobustUnscentedKalmanFilter(2, 1, 1.0, seen, moved, points)
        for name, kf in filters.items():
            described = FilterModel(kf)
            state, _ = step(described, None, np.zeros((1, described.filter.dim_z)))
            row(name, state, kf.state())
    for structure in (ARX(2, 2), OutputError(2, 2), ARX(4, 4)):
        state, _ = step(TrackerModel(structure, {"start": 0}), None, np.zeros((1, 2)))
        row(f"ParameterTracker({structure})", state, ParameterTracker(structure, start=0).state())


def row(name, state, whole):
    """Print a row of the table of sizes."""
    numbers = sum(np.size(value) for key, value in state.items() if key != "format")
    print(f"| {name} | {numbers} | {len(pack(state))} | {len(pack(whole))} |")


def bytes_and_files(state):
    """Print what packing costs, and what numpy's .npz does."""

    def npz():
        file = io.BytesIO()
        np.savez(file, **state)
        return file.getvalue()

    def loaded(data=npz()):
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    data = pack(state)
    packed, unpacked = each(lambda: pack(state)), each(lambda: unpack(data))
    print(f"pack {packed:.0f} us, unpack {unpacked:.0f} us, {len(data)} bytes")
    print(f".npz {each(npz):.0f} us, read {each(loaded):.0f} us, {len(npz())} bytes")
    return packed + unpacked


def one_process(keys, steps):
    """Print microseconds a sample on one core, and return what a plan needs."""
    described, table, count = model(), samples(keys, steps), keys * steps
    zs = table["z"].to_numpy().reshape(steps, keys).T[:, :, None].copy()
    series = least(lambda: filter_series(zs, F, H, Q, R, np.zeros(2), np.eye(2), covariance="diagonal", n_threads=1))
    whole = least(lambda: filter_table(described, table))
    shuffled = table.sample(frac=1.0, random_state=0)
    sorting = least(lambda: filter_table(described, shuffled, sort=True))
    print(f"filter_series                        {series / count * 1e6:8.3f} us a sample")
    print(f"filter_table                         {whole / count * 1e6:8.3f}, {count / whole:,.0f} rows a second")
    print(f"filter_table of a shuffled table     {sorting / count * 1e6:8.3f}")
    loop = least(lambda: plain(table[table["device"] < 100]), 2) / (100 * steps)
    print(f"filterpy, a loop over groupby        {loop * 1e6:8.3f}, {1.0 / loop:,.0f} rows a second")
    state, _ = step(described, None, np.zeros((1, 2)))
    now = np.array([[1.0, 0.5]])
    online = each(lambda: step(described, state, now))
    print(f"step, one sample at a time           {online:8.3f}")
    tracked = TrackerModel(ARX(2, 2), {"start": 0}, time="t", measurements=["z"], inputs=["u"])
    some = samples(min(keys, 1000), steps).assign(u=1.0)
    tracking = least(lambda: filter_table(tracked, some), 2) / len(some) * 1e6
    print(f"filter_table of a ParameterTracker   {tracking:8.3f}")
    states, _ = step(described, None, table[: 2 * keys], key="device")
    another = table[2 * keys : 3 * keys]
    batch = least(lambda: step(described, states, another, key="device")) / keys
    print(f"step, a sample of each device        {batch * 1e6:8.3f} us a device")
    columns = states.to_arrow()
    there = least(states.to_arrow) / keys
    back = least(lambda: step(described, columns, another, key="device")) / keys
    print(f"states to an Arrow table and back    {(there + back - batch) * 1e6:8.3f} us a device")
    packing = bytes_and_files(state)
    return Costs(series / count, whole / count, online + packing, batch * 1e6 + packing, len(pack(state)))


def plain(table):
    """Filter each device by filterpy, as a first program does."""
    for _, one in table.groupby("device"):
        kf = KalmanFilter(2, 1)
        kf.F, kf.H, kf.Q, kf.R = F, H, Q, R
        for z in one["z"].to_numpy():
            kf.predict()
            kf.update(z)


class Costs(NamedTuple):
    """What was measured in one process, in seconds or microseconds."""

    series: float
    """Seconds a sample in filter_series."""
    table: float
    """Seconds a sample in filter_table."""
    alone: float
    """Microseconds of a batch of one key, with its packing."""
    batch: float
    """Microseconds of a batch and key among many, with its packing."""
    state: int
    """Bytes of a packed state."""


def part(first, keys, steps):
    """Make and filter the samples of some devices, and return little."""
    began = time.process_time()
    table = samples(keys, steps, first)
    start = time.perf_counter()
    found = filter_table(model(), table)
    return found["x0"].sum(), time.perf_counter() - start, time.process_time() - began


def dask(keys, steps, series):
    """Print what Dask makes of it, with one worker process and with two."""
    import dask.dataframe as dd
    from distributed import Client, LocalCluster

    from robust_filterpy.fleet.dask import filter_frame

    rates, cores = [], []
    for workers in (1, 2):
        options = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None, "memory_limit": "6GB"}
        with LocalCluster(**options) as cluster, Client(cluster) as client:
            client.run(part, 0, 100, 10)
            firsts = list(range(0, keys, keys // 16))
            start = time.perf_counter()
            done = client.gather(client.map(part, firsts, keys=keys // 16, steps=steps, pure=False))
            spent = time.perf_counter() - start
            inside = sum(one[1] for one in done)
            rates.append(keys * steps / spent)
            cores.append(sum(one[2] for one in done))
            print(
                f"Dask, {workers} worker(s), partitions made where they are filtered: {spent / keys / steps * 1e6:.3f} "
                f"us a sample, {rates[-1] / workers:,.0f} samples a second and core; {inside / spent / workers:.0%} of "
                f"it filter_table"
            )
            if workers == 2:
                frame = dd.from_map(samples, [keys // 16] * len(firsts), [steps] * len(firsts), firsts)
                # What is read is in the order of time, so that every key is in every partition.
                mixed = frame.repartition(npartitions=16)
                start = time.perf_counter()
                float(filter_frame(mixed, model())["x0"].sum().compute())
                moved = time.perf_counter() - start
                print(
                    f"Dask, 2 workers, shuffled by key first: {moved / keys / steps * 1e6:.3f} us a sample, "
                    f"{moved / spent:.1f} times as long: the shuffle and its serialisation"
                )
    print(f"two workers over one: {rates[1] / rates[0]:.2f} (target 1.7), with {load()}")
    print(f"processor time of the same work, one worker over two: {cores[0] / cores[1]:.2f}")
    print(f"over filter_series on one core: {1.0 / series / rates[1] * 2.0:.1f} times the core seconds")


def load():
    """Say how busy the machine is, which is no fault of an engine."""
    return f"a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores in the last minute"


def spark(keys, steps, series):
    """Print what Spark makes of it, with one core and with two."""
    from pyspark.sql import SparkSession

    from robust_filterpy.fleet.spark import filter_frame

    os.environ["PYSPARK_PYTHON"] = sys.executable
    spent = {}
    with tempfile.TemporaryDirectory() as folder:
        samples(keys, steps).to_parquet(f"{folder}/samples.parquet")
        for cores in (1, 2):
            session = (
                SparkSession.builder.master(f"local[{cores}]")
                .config("spark.ui.enabled", "false")
                .config("spark.driver.host", "127.0.0.1")
                .config("spark.driver.bindAddress", "127.0.0.1")
                .config("spark.sql.shuffle.partitions", "8")
                .getOrCreate()
            )
            session.sparkContext.setLogLevel("ERROR")
            frame = session.read.parquet(f"{folder}/samples.parquet").repartition(16)
            query = filter_frame(frame, model(), groups=16)
            query.limit(1).collect()
            spent[cores] = least(lambda query=query: query.agg({"x0": "sum"}).collect(), 2)
            # The same way there and back with nothing done.
            idle = frame.groupBy((frame["device"] % 16).alias("part")).applyInPandas(lambda one: one, frame.schema)
            nothing = least(lambda idle=idle: idle.agg({"z": "sum"}).collect(), 2)
            session.stop()
            print(
                f"Spark, {cores} core(s): {spent[cores] / keys / steps * 1e6:.3f} us a sample, "
                f"{keys * steps / spent[cores] / cores:,.0f} samples a second and core; {nothing / spent[cores]:.0%} "
                f"of it reading, shuffle and serialisation"
            )
    print(f"two cores over one: {spent[1] / spent[2]:.2f} (target 1.7), with {load()}")
    print(f"over filter_series on one core: {2.0 * spent[2] / keys / steps / series:.1f} times the core seconds")


def plan(costs, devices=1e8, rate=1.0, batch=60, message=24, checkpoint=600.0, busy=0.6):
    """Print what a fleet needs: cores, memory, store and network, from what was measured here."""
    state, batched = costs.state, costs.table + costs.batch * 1e-6 / (batch * rate)
    ways = {
        "each sample as it comes": costs.alone * 1e-6,
        "all devices' samples of a second together": costs.table + costs.batch * 1e-6,
        f"in batches of {batch} s": batched,
    }
    for name, cost in ways.items():
        print(f"{devices:.0e} devices at {rate:g} Hz, {name}: {devices * rate * cost / busy:,.0f} cores")
    print(
        f"memory and store: {devices * state / 1e9:,.0f} GB of states, three copies {3 * devices * state / 1e9:,.0f} GB"
    )
    print(f"network: {devices * rate * message / 1e9:,.1f} GB/s of samples in")
    print(f"         {devices * state / checkpoint / 1e9:,.2f} GB/s of states, each written every {checkpoint:g} s")


def main():
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keys", type=int, default=20_000)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--engines", nargs="*", default=["dask", "spark"], choices=["dask", "spark"])
    arguments = parser.parse_args()
    sizes()
    print()
    costs = one_process(arguments.keys, arguments.steps)
    for name in arguments.engines:
        print()
        if name == "spark" and shutil.which("java") is None:
            print("Spark: no Java")
            continue
        try:
            {"dask": dask, "spark": spark}[name](arguments.keys, arguments.steps, costs.series)
        except ImportError as error:
            print(f"{name}: {error}")
    print()
    plan(costs)


if __name__ == "__main__":
    main()
