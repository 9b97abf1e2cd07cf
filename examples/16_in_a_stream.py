"""A stream of ten thousand devices: samples late, doubled and missing, and the process dies. What is lost?

Nothing, if what a filter knows is a value like any other: (state, batch) -> (state, output) is a pure function, x and P
of a device are a few hundred bytes, and these are written together with how far the stream has been read.
"""

# %% The model that all devices share: a position with a speed, one sample a second; late samples are dropped.
import argparse
import sqlite3
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.fleet import FilterModel, filter_table, pack, step, unpack
from robust_filterpy.plotting import LOOKS

kf = RobustKalmanFilter(2, 1)
kf.F, kf.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
kf.Q, kf.R, kf.P = np.diag([0.0, 1e-3]), np.eye(1), np.diag([100.0, 1.0])
MODEL = FilterModel(kf, time="t", dt=1.0, late="drop", measurements=["z"])


# %% The stream: messages in the order in which they arrive, in batches.
def stream(devices, steps, batches):
    """Return batches of samples; one in ten an outlier, one in twenty lost, one in fifty sent twice or late."""
    rng = np.random.default_rng(0)
    speed = rng.normal(size=(devices, 1))
    path = speed * np.arange(steps)
    z = path + np.where(rng.random(path.shape) < 0.1, 20.0, 1.0) * rng.normal(size=path.shape)
    table = {"device": np.tile(np.arange(devices), steps), "t": np.repeat(np.arange(float(steps)), devices)}
    table = pd.DataFrame({**table, "z": z.T.ravel()})
    table = table[rng.random(len(table)) > 0.05]
    again = table[rng.random(len(table)) < 0.02]
    arrival = np.concatenate((table["t"], again["t"] + rng.integers(0, 4, len(again)) + 0.5))
    table = pd.concat((table, again)).iloc[np.argsort(arrival, kind="stable")].reset_index(drop=True)
    return [table.iloc[part] for part in np.array_split(np.arange(len(table)), batches)]


# %% The consumer: states and place in the stream are one transaction, so that a crash undoes both or neither.
def consume(store, batches, dies_at=None):
    """Read on from where the store is; die within a batch, after its work and before its transaction, if so asked."""
    store.execute("CREATE TABLE IF NOT EXISTS states (device INTEGER PRIMARY KEY, state BLOB)")
    store.execute("CREATE TABLE IF NOT EXISTS place (batch INTEGER)")
    (first,) = store.execute("SELECT COALESCE(MAX(batch) + 1, 0) FROM place").fetchone()
    outputs = {}
    for k in range(first, len(batches)):
        states = {device: unpack(state) for device, state in store.execute("SELECT device, state FROM states")}
        states, output = step(MODEL, states, batches[k], key="device")
        if k == dies_at:
            raise SystemExit
        with store:
            rows = ((device, pack(state)) for device, state in states.items())
            store.executemany("INSERT OR REPLACE INTO states VALUES (?, ?)", rows)
            store.execute("INSERT INTO place VALUES (?)", (k,))
        outputs[k] = output
    return outputs


def main(argv=None):
    """Consume, die, go on, compare with one process that saw everything, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--devices", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=40)
    options = parser.parse_args(argv)
    batches = stream(options.devices, options.steps, 6)
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/states.sqlite"
        with sqlite3.connect(path) as store:
            try:
                consume(store, batches, dies_at=3)
            except SystemExit:
                pass
        store.close()
        store = sqlite3.connect(path)
        second = consume(store, batches)
        (size,) = store.execute("SELECT AVG(LENGTH(state)) FROM states").fetchone()
        store.close()
    table = pd.concat(batches)
    whole = filter_table(MODEL, table)
    later = pd.concat(second.values())
    same = later.equals(whole.loc[later.index])
    draw(table, whole, len(table) // 2, options.out)
    lost = len(table) - len(whole)
    print(
        f"Conclusion: {options.devices} devices, {len(table)} messages, {lost} of them late or doubled; killed in the "
        f"fourth of six batches and started again, it gives "
        f"{'to the last bit' if same else 'NOT'} what a process gives that never died. A state is {size:.0f} bytes."
    )


def draw(table, whole, crash, out):
    """Draw one device: its messages, its estimate, and when the process died."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
    mine, found = table[table["device"] == 7], whole[whole["device"] == 7]
    ax.plot(mine["t"], mine["z"], ".", color="0.6", label="messages")
    ax.plot(found["t"], found["x0"], label="estimate", **LOOKS["Huber"])
    low, high = found["x0"] - 2 * found["std0"], found["x0"] + 2 * found["std0"]
    blue = LOOKS["Huber"]["color"]
    ax.fill_between(found["t"], low, high, color=blue, alpha=0.2, lw=0, label="± 2 standard deviations")
    ax.axvline(table["t"].iloc[crash], color="k", linestyle="--", label="the process dies")
    ax.set(xlabel="time, s", ylabel="position of device 7, m", title="The process dies, the estimate goes on")
    ax.legend()
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "16_in_a_stream.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
