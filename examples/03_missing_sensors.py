"""What becomes of missing and partly missing measurements, and of one sensor in three that fails?

Three thermometers watch one slowly changing temperature. NaN in z is a component that is missing: the rest of z
corrects the state, and weights is NaN where nothing was measured. What was used of an innovation y is y_bounded. The
weight psi(e)/e tells how unusual y was for its sensor: once a sensor has lied for long, 8 degrees are usual for it.
"""

# %% Three sensors, one level.
import argparse
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.plotting import LOOKS

SIGMA = np.array([0.2, 0.3, 0.5])


def thermometer(kind):
    """Return a random-walk level seen by three sensors."""
    kf = kind(dim_x=1, dim_z=3)
    kf.x = np.array([20.0])
    kf.H = np.ones((3, 1))
    kf.R = np.diag(SIGMA**2)
    kf.Q *= 0.02**2
    return kf


# %% Sensor B drops out for a while, then everything does, then sensor A, the best one, reads 8 degrees too much.
def recording(rng, steps=400):
    """Return the true level (steps,) and the measurements (steps, 3) with NaN."""
    level = 20.0 + np.cumsum(0.02 * rng.standard_normal(steps))
    zs = level[:, None] + SIGMA * rng.standard_normal((steps, 3))
    zs[50:120, 1] = np.nan
    zs[150:180] = np.nan
    zs[250:350, 0] += 8.0
    return level, zs


# %% filterpy has no NaN: its users pass the rows that are complete and skip the others.
def main(argv=None):
    """Run, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=3)
    options = parser.parse_args(argv)
    level, zs = recording(np.random.default_rng(options.seed))
    plain = thermometer(KalmanFilter).batch_filter([None if np.isnan(z).any() else z for z in zs])[0][:, 0]
    kf, robust, used = thermometer(RobustKalmanFilter), [], []
    for z in zs:
        kf.predict()
        kf.update(z)
        robust.append(kf.x[0])
        used.append(np.where(np.isnan(kf.weights), np.nan, np.abs(kf.y_bounded)))
    robust, used = np.array(robust), np.array(used)
    draw(level, zs, plain, robust, used, options.out)
    broken = slice(250, 350)
    print(
        f"Conclusion: while sensor A reads 8 degrees too much, the level is off by at most "
        f"{np.abs(plain - level)[broken].max():.2f} degrees with KalmanFilter and "
        f"{np.abs(robust - level)[broken].max():.2f} with RobustKalmanFilter, which uses "
        f"{np.median(used[broken, 0]):.2f} of A's innovations of 8 degrees."
    )


def draw(level, zs, plain, robust, used, out):
    """Draw the level and what was used of each sensor."""
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 5.5), sharex=True, layout="constrained")
    for column, (name, marker) in enumerate(zip("ABC", "xo+", strict=True)):
        shade, style = str(0.2 + 0.25 * column), ("-", "--", ":")[column]
        top.plot(zs[:, column], marker, color=shade, ms=3, label=f"sensor {name}")
        smooth = np.convolve(used[:, column], np.ones(15) / 15, mode="same")
        bottom.plot(np.arange(7, smooth.size - 7), smooth[7:-7], style, color=shade, label=f"sensor {name}")
    top.plot(level, "k-", lw=2.5, label="truth")
    top.plot(plain, label="KalmanFilter", **LOOKS["Kalman"])
    top.plot(robust, label="RobustKalmanFilter", **LOOKS["Huber"])
    for span, text in (((50, 120), "B missing"), ((150, 180), "all missing"), ((250, 350), "A reads 8 too much")):
        for ax in (top, bottom):
            ax.axvspan(*span, color="0.92", zorder=0)
        top.text(np.mean(span), 18.2, text, ha="center", fontsize=8)
    top.set(ylabel="temperature [°C]", ylim=(17.5, 30.5), title="A sensor that fails carries the Kalman filter away")
    bottom.set(xlabel="step", ylabel="|y_bounded| [°C]", ylim=(0, None))
    bottom.set_title(
        "Of the 8 degrees next to nothing is used, of the other sensors what is there (means of 15 samples)"
    )
    top.legend(fontsize=8, ncols=2, loc="upper left")
    bottom.legend(fontsize=8, loc="center left")
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "03_missing_sensors.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
