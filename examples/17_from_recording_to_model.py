"""From a logger's file to a model that one may trust: what does it take?

The file has dates, gaps, spikes, an output in degrees with an offset and an input in percent. `select_structure` finds
orders, delay and parameters of y = B(q)/A(q) u + offset + noise without being given any of that. The second half of the
file says whether the model is good. A tracker goes on from it, is saved, and resumes as if nothing had happened.
"""

# %% A recording as a logger writes it; replace the file with yours.
import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from robust_filterpy import ParameterTracker
from robust_filterpy.identification import compare, select_structure, validate

STEPS, SECONDS = 1600, 10


def write_recording(path, seed=4):
    """Write the temperature of an oven and its heating power, one row in a hundred lost, one in fifty a spike."""
    rng = np.random.default_rng(seed)
    power = 50.0 + 30.0 * np.repeat(rng.choice([-1.0, 1.0], STEPS // 8), 8)
    above = np.zeros(STEPS)
    for k in range(5, STEPS):
        heating = 0.03 * (power[k - 4] - 50.0) + 0.02 * (power[k - 5] - 50.0)
        above[k] = 1.62 * above[k - 1] - 0.66 * above[k - 2] + heating
    spike = rng.random(STEPS) < 0.02
    temperature = 180.0 + above + np.where(spike, 40.0, 0.8) * rng.normal(size=STEPS)
    times = pd.date_range("2024-03-01 06:00", periods=STEPS, freq=f"{SECONDS}s", name="time")
    table = pd.DataFrame({"power": power, "temperature": temperature}, times)
    path.parent.mkdir(parents=True, exist_ok=True)
    table[rng.random(STEPS) > 0.01].round(3).to_csv(path)


def main(argv=None):
    """Read, identify, validate, save, go on, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args(argv)
    csv = options.csv or options.out / "oven.csv"
    if not csv.exists():
        write_recording(csv)

    # %% Rows that the logger lost become rows without an output; the input held its value.
    table = pd.read_csv(csv, index_col="time", parse_dates=True).resample(f"{SECONDS}s").mean()
    table["power"] = table["power"].ffill()
    first, second = table.iloc[: len(table) // 2], table.iloc[len(table) // 2 :]

    # %% Orders, delay, parameters; then the half of the file that the model has not seen.
    model = select_structure(first["temperature"], first["power"], na=range(1, 4)).best
    checked = validate(model, second["temperature"], second["power"])
    print(model)  # model.summary() and print(checked) have tables

    # %% Go on sample by sample, save in between, and go on from the file.
    quarter = len(second) // 2
    tracker = ParameterTracker(model, Q=1e-8)
    tracker.run(second["temperature"].iloc[:quarter], second["power"].iloc[:quarter])
    np.savez(options.out / "oven_tracker.npz", **tracker.state())
    resumed = ParameterTracker(model, Q=1e-8)
    resumed.restore(np.load(options.out / "oven_tracker.npz"))
    rest = second["temperature"].iloc[quarter:], second["power"].iloc[quarter:]
    same = resumed.run(*rest).to_frame().equals(tracker.run(*rest).to_frame())

    draw(compare({str(model.structure): model}, second["temperature"], second["power"]), options.out)
    gain = float(model.transfer_function().dcgain())
    print(
        f"Conclusion: order {model.structure.nf}, {gain:.2f} degrees per percent of power (the oven: 1.25), dead time "
        f"{SECONDS * (model.structure.nk - 1)} s. On the other half of the file {checked.verdict}, and the free run "
        f"fits ordinary samples to {checked.fits[-1].ordinary:.1f} %. A tracker that goes on from a file gives "
        f"{'to the last bit' if same else 'NOT'} what one gives that was never stopped."
    )


def draw(compared, out):
    """Draw the half that the model has not seen."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(9, 3.8), layout="constrained")
    compared.plot(unit="degrees C", ax=ax)
    fit = max(row.fit for row in compared.rows)
    ax.set_title(f"From the input alone, the half that the model has not seen is met to {fit:.0f} %")
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "17_from_recording_to_model.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
