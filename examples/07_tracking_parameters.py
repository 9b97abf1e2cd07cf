"""Which model structure, and which filter, for parameters that drift in a recording with outliers?

An actuator's gain and damping drift while one reading in ten is wrong. The tracker is a filter whose state is theta:
theta(k+1) = theta(k) + w(k), y(k) = phi(k)' theta(k) + v(k). ARX feeds measured outputs back into phi, outliers
included; an output-error model feeds its own. Replace examples/data/actuator.csv (columns u, y) with your recording.
"""

# %% A recording as a user has it: a CSV file. The one here comes from a plant with drifting parameters.
import argparse
import warnings
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import ARX, Contaminated, OutputError, ParameterTracker
from robust_filterpy.identification import LostTrackerWarning
from robust_filterpy.plants import simulate_output_error
from robust_filterpy.plants.linear import random_walk, stable
from robust_filterpy.plotting import LOOKS
from robust_filterpy.testing import fit_percent

HERE = Path(__file__).parent
SIGMA, CONTAMINATION = 0.5, 0.1


def write_recording(path, steps=2000, seed=3):
    """Write u, y and, since this plant is simulated, the output without noise and b1."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], steps)
    theta = random_walk([-1.5, 0.7, 1.0, 0.5], np.diag([2e-6, 2e-6, 2e-4, 2e-4]), steps, rng, accept=stable(2, 0.97))
    noise = Contaminated(CONTAMINATION, 10.0, SIGMA)
    plant = simulate_output_error(theta, u, noise=noise, rng=rng, na=2, nb=2, nk=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack([plant.u, plant.y, plant.y_clean, theta[:, 2]])
    np.savetxt(path, table, delimiter=",", header="u,y,y_clean,b1", comments="", fmt="%.5f")


# %% The candidates differ by one argument each.
CANDIDATES = {
    "ARX, robust": dict(structure=ARX(2, 2)),
    "OE, Kalman": dict(structure=OutputError(2, 2), filter=KalmanFilter),
    "OE, robust": dict(structure=OutputError(2, 2)),
}
# How fast the parameters may drift; the start, the noise and the level are found from the recording.
WALK = dict(Q=np.diag([2e-6, 2e-6, 2e-4, 2e-4]))


def tracked(y, u, choice):
    """Return the result of a candidate and what it says if it loses the plant: a poor structure is noticed."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", LostTrackerWarning)
        return ParameterTracker(**WALK, **choice).run(y, u), said


def main(argv=None):
    """Track, draw, tabulate, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--csv", type=Path, default=HERE / "data" / "actuator.csv")
    options = parser.parse_args(argv)
    if not options.csv.exists():
        write_recording(options.csv)
    columns = np.genfromtxt(options.csv, delimiter=",", names=True)
    u, y = columns["u"], columns["y"]
    reference = columns["y_clean"] if "y_clean" in columns.dtype.names else y
    runs = {name: tracked(y, u, choice) for name, choice in CANDIDATES.items()}
    results = {name: result for name, (result, _) in runs.items()}
    late = slice(u.size // 4, None)
    fits = {name: fit_percent(reference[late], result.prediction[late]) for name, result in results.items()}
    print(f"{'':28} fit of the one-step prediction to the output without noise")
    for name, fit in fits.items():
        print(f"{name:28} {fit:6.1f} %{', and it warns that it lost the plant' if runs[name][1] else ''}")
    draw(u, y, results, columns["b1"] if "b1" in columns.dtype.names else None, options.out)
    best = max(fits, key=fits.get)
    print(
        f"Conclusion: {best} predicts best ({fits[best]:.1f} %). The same output-error model around filterpy's "
        f"KalmanFilter reaches {fits['OE, Kalman']:.1f} %, a robust ARX model {fits['ARX, robust']:.1f} %: it "
        f"takes the noise of the sensor for one that drives the plant."
    )


def draw(u, y, results, truth, out):
    """Draw the recording and the gain b1 with its band, and its true value where that is known."""
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 5.5), layout="constrained")
    robust, shown = results["OE, robust"], slice(y.size // 2, y.size // 2 + 150)
    k = np.arange(y.size)
    doubted = np.where(robust.weights < 0.3, y, np.nan)
    top.plot(k[shown], y[shown], ".", color="0.5", ms=4, label="measured")
    top.plot(k[shown], doubted[shown], "kx", ms=6, label="weight below 0.3")
    top.plot(k[shown], robust.prediction[shown], lw=1.2, label="prediction, OE, robust", **LOOKS["Huber"])
    top.set(xlabel="sample", ylabel="output y", title="One reading in ten is wrong, and is not believed (a part)")
    for name, look in (("OE, Kalman", LOOKS["Kalman"]), ("OE, robust", LOOKS["Huber"])):
        deviation = results[name].std[:, 2]
        # Until the tracker has a model it claims nothing.
        gain = np.where(np.isfinite(deviation), results[name].theta[:, 2], np.nan)
        bottom.plot(gain, label=f"b1, {name}", **look)
        low, high = gain - 2 * deviation, gain + 2 * deviation
        bottom.fill_between(k, low, high, color=look["color"], alpha=0.15, lw=0)
    if truth is not None:
        bottom.plot(truth, color="k", ls=(0, (1, 1.5)), lw=1.8, label="b1, truth")
    bottom.set(xlabel="sample", ylabel="b1 [output per input]", ylim=(0, 2))
    bottom.set_title("Outliers shake the Kalman filter's gain, not the robust one's (bands: ± 2 std)")
    top.legend(fontsize=8, ncols=3)
    bottom.legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "07_tracking_parameters.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
