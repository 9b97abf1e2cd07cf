"""Does smoothing undo what an outlier did, or must the forward pass already be robust?

filterpy's rts_smoother works on the output of batch_filter: x_s(k) = x(k) + K(k) (x_s(k+1) - F x(k)). It never sees
the measurements again, so what the forward pass believed, the smoother keeps.
"""

# %% A position that drifts, forward and backward.
import argparse
from pathlib import Path

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter


def smoothed(kind, zs):
    """Return filtered and smoothed positions and the smoothed standard deviations, each (steps,)."""
    kf = kind(dim_x=2, dim_z=1)
    kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0.0]])
    kf.Q = Q_discrete_white_noise(2, 1.0, var=0.002)
    kf.P *= 10.0
    means, covariances, _, _ = kf.batch_filter(zs)
    x, P, _, _ = kf.rts_smoother(means, covariances)
    return means[:, 0, 0], x[:, 0, 0], np.sqrt(P[:, 0, 0])


def recording(rng, steps=200):
    """Return the true position (steps,) and measurements (steps,), 15 % of them outliers."""
    position = np.cumsum(np.cumsum(np.sqrt(0.002) * rng.standard_normal(steps)))
    return position, position + np.where(rng.random(steps) < 0.15, 15.0, 1.0) * rng.standard_normal(steps)


# %% Four curves from the same data.
def main(argv=None):
    """Run, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args(argv)
    truth, zs = recording(np.random.default_rng(options.seed))
    results = {kind.__name__: smoothed(kind, list(zs)) for kind in (KalmanFilter, RobustKalmanFilter)}
    draw(truth, zs, results, options.out)
    rms = {
        (name, which): float(np.sqrt(np.mean((result[column] - truth) ** 2)))
        for name, result in results.items()
        for column, which in enumerate(("filtered", "smoothed"))
    }
    print(
        "Conclusion: root-mean-square error, filtered -> smoothed: "
        + "; ".join(f"{name} {rms[name, 'filtered']:.2f} -> {rms[name, 'smoothed']:.2f}" for name in results)
        + ". Smoothing helps both, and only the robust forward pass removes the outliers."
    )


def draw(truth, zs, results, out):
    """Draw the smoothed tracks with a band."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(9, 4.2), layout="constrained")
    steps = np.arange(truth.size)
    ax.plot(zs, ".", color="0.65", ms=3, label="measurement")
    ax.plot(truth, "k-", lw=2.5, label="truth")
    _, x, _ = results["KalmanFilter"]
    ax.plot(x, "C1--", lw=1.3, label="smoothed, KalmanFilter")
    _, x, deviation = results["RobustKalmanFilter"]
    ax.plot(x, "C0-", lw=1.3, label="smoothed, RobustKalmanFilter")
    ax.fill_between(steps, x - 2 * deviation, x + 2 * deviation, color="C0", alpha=0.2, label="± 2 standard deviations")
    ax.set(xlabel="step", ylabel="position [m]", ylim=(truth.min() - 8, truth.max() + 8))
    ax.legend(fontsize=8, ncols=2)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "06_smoothing.png", dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
