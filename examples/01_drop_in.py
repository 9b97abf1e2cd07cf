"""Existing filterpy tracking code, one line changed: what do outliers do before and after?

A target moves in the plane; one radar reading in ten is nonsense. The correction x+ = x + P H' T' psi(T y) bounds
what such a reading can do, and that is all that changes.
"""

# %% Existing code: constant velocity in the plane. Only the class is an argument.
import argparse
import timeit
from pathlib import Path

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.plotting import LOOKS

DT, SIGMA = 1.0, 1.0


def tracker(kind):
    """Return the filter as filterpy's users write it, of the given class."""
    kf = kind(dim_x=4, dim_z=2)
    kf.x = np.array([0.0, 1.0, 0.0, 0.5])
    kf.F = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    kf.R *= SIGMA**2
    kf.Q = block_diag(*[Q_discrete_white_noise(2, DT, var=0.001)] * 2)
    kf.P *= 10.0
    return kf


# %% A target and its measurements: 10 % of them are off by about 30 standard deviations.
def recording(rng, steps=200, contamination=0.1):
    """Return true positions (steps, 2), measurements (steps, 2) and which of them are outliers."""
    path = np.cumsum([1.0, 0.5] + np.cumsum(0.03 * rng.standard_normal((steps, 2)), axis=0), axis=0)
    outlier = rng.random(steps) < contamination
    scale = np.where(outlier, 30.0, 1.0)[:, None] * SIGMA
    return path, path + scale * rng.standard_normal((steps, 2)), outlier


def track(kind, zs):
    """Return the estimated positions (steps, 2)."""
    kf, positions = tracker(kind), []
    for z in zs:
        kf.predict()
        kf.update(z)
        positions.append(kf.x[[0, 2]])
    return np.array(positions)


def cost(kind, zs):
    """Return the microseconds of a predict and an update: the least of five passes."""
    return 1e6 * min(timeit.repeat(lambda: track(kind, zs), number=1, repeat=5)) / len(zs)


# %% The same data through both classes.
def main(argv=None):
    """Run, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    path, zs, outlier = recording(np.random.default_rng(options.seed))
    kinds = {"KalmanFilter": KalmanFilter, "RobustKalmanFilter": RobustKalmanFilter}
    estimates = {name: track(kind, zs) for name, kind in kinds.items()}
    errors = {name: np.linalg.norm(xy - path, axis=1) for name, xy in estimates.items()}
    rms = {name: float(np.sqrt(np.mean(error**2))) for name, error in errors.items()}
    draw(path, zs, outlier, estimates, errors, rms, options.out)
    plain, robust = (cost(kind, zs) for kind in kinds.values())
    print(f"predict and update: {plain:.0f} microseconds with KalmanFilter, {robust:.0f} with RobustKalmanFilter")
    print(
        f"Conclusion: with {outlier.mean():.0%} outliers the root-mean-square position error is "
        f"{rms['KalmanFilter']:.2f} m with KalmanFilter and {rms['RobustKalmanFilter']:.2f} m with RobustKalmanFilter; "
        f"a step of it takes {robust / plain:.1f} times as long."
    )


def draw(path, zs, outlier, estimates, errors, rms, out):
    """Draw the tracks and the errors."""
    import matplotlib.pyplot as plt

    figure, (plane, time) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    plane.plot(*zs[~outlier].T, ".", color="0.7", ms=3, label="measurement")
    plane.plot(*zs[outlier].T, "x", color="0.4", ms=5, label="outlier")
    plane.plot(*path.T, "k-", lw=2.5, label="truth")
    for (name, xy), look in zip(estimates.items(), (LOOKS["Kalman"], LOOKS["Huber"]), strict=True):
        plane.plot(*xy.T, lw=1.2, label=name, **look)
        time.plot(errors[name], lw=1.2, label=f"{name}, {rms[name]:.2f} m rms", **look)
    margin = 20.0
    plane.set(xlabel="x [m]", ylabel="y [m]", title="Wrong readings pull the Kalman filter off the track")
    plane.set_xlim(path[:, 0].min() - margin, path[:, 0].max() + margin)
    plane.set_ylim(path[:, 1].min() - margin, path[:, 1].max() + margin)
    time.set(
        xlabel="step",
        ylabel="position error [m]",
        title="The same code with the other class stays on it",
        yscale="log",
        ylim=(1e-2, None),
    )
    plane.legend(fontsize=8)
    time.legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "01_drop_in.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
