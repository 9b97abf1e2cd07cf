"""What can a smoother do about outliers that a filter cannot?

A filter judges a measurement once, from the past. filterpy's rts_smoother works on what the filter believed and never
sees the measurements again. `smooth` weighs each measurement by what all the others say of it, before and after, and
learns on the way how many outliers there are and how large: p(e) = (1 - c) N(0, R) + c N(0, r^2 R).
"""

# %% A position that drifts; three in ten measurements are outliers.
import argparse
from pathlib import Path

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter, smooth
from robust_filterpy.plotting import LOOKS

CONTAMINATION, RATIO = 0.3, 15.0


def prepared(kind):
    """Return a filter of the kind with its model set: one of filterpy's, or ours."""
    kf = kind(dim_x=2, dim_z=1)
    kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0.0]])
    kf.Q = Q_discrete_white_noise(2, 1.0, var=0.002)
    kf.P *= 10.0
    return kf


def recording(rng, steps=200):
    """Return the true position (steps,), measurements (steps,) and which of them are outliers."""
    position = np.cumsum(np.cumsum(np.sqrt(0.002) * rng.standard_normal(steps)))
    bad = rng.random(steps) < CONTAMINATION
    return position, position + np.where(bad, RATIO, 1.0) * rng.standard_normal(steps), bad


# %% One call for the robust smoother; for the others a forward and a backward pass.
def estimates(zs, bad):
    """Return positions (steps,) and standard deviations (steps,) of each smoother."""
    found = {}
    for name, kind in (("Kalman filter + RTS", KalmanFilter), ("Huber filter + RTS", RobustKalmanFilter)):
        kf = prepared(kind)
        means, covariances, _, _ = kf.batch_filter(list(zs))
        x, P, _, _ = kf.rts_smoother(means, covariances)
        found[name] = x[:, 0, 0], np.sqrt(P[:, 0, 0])
    robust = smooth(prepared(KalmanFilter), zs)
    found["smooth, by default"] = robust.x[:, 0, 0], np.sqrt(robust.P[:, 0, 0])
    kf = prepared(KalmanFilter)
    means, covariances, _, _ = kf.batch_filter(list(zs), Rs=[RATIO**2 if one else 1.0 for one in bad])
    x, P, _, _ = kf.rts_smoother(means, covariances)
    found["outliers known, RTS"] = x[:, 0, 0], np.sqrt(P[:, 0, 0])
    return found, robust


# %% One recording is drawn; what it says by chance, twenty say surely.
def main(argv=None):
    """Run, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--runs", type=int, default=20)
    options = parser.parse_args(argv)
    squares, learnt = {}, []
    for run in range(options.runs):
        truth, zs, bad = recording(np.random.default_rng(options.seed + run))
        found, robust = estimates(zs, bad)
        learnt.append((robust.contamination[0], robust.scale_ratio[0]))
        for name, (x, _) in found.items():
            squares.setdefault(name, []).append(np.mean((x - truth) ** 2))
        if run == 0:
            draw(truth, zs, bad, found, robust.weights[:, 0], options.out)
    share, ratio = np.median(learnt, axis=0)
    print(
        f"Conclusion: root-mean-square error of the position in {options.runs} recordings: "
        + "; ".join(f"{name} {np.sqrt(np.mean(values)):.2f}" for name, values in squares.items())
        + f". The smoother learnt contaminations around {share:.2f} and ratios around {ratio:.0f}; "
        f"the truth is {CONTAMINATION} and {RATIO:.0f}."
    )


# %% Errors, not tracks: the tracks lie on top of each other.
def draw(truth, zs, bad, found, weights, out):
    """Draw the measurements with their weights, and below the error of each smoother in a panel of its own."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(found) + 1, 1, figsize=(9, 9), sharex=True, layout="constrained", height_ratios=[1.8] + [1] * len(found)
    )
    steps = np.arange(truth.size)
    dots = axes[0].scatter(steps, zs, c=weights, s=14, cmap="viridis", vmin=0, vmax=1, label="measurement")
    axes[0].scatter(steps[bad], zs[bad], s=45, facecolors="none", edgecolors="C3", lw=0.7, label="an outlier in truth")
    axes[0].plot(truth, "k-", lw=1.5, label="truth")
    axes[0].set(ylabel="position [m]", ylim=(truth.min() - 25, truth.max() + 25))
    axes[0].legend(fontsize=8, ncols=3, loc="upper left")
    figure.colorbar(dots, ax=axes[0], label="weight in smooth", pad=0.01)
    axes[0].set_title("Each measurement weighed by all others: the error of a smoother that knows the outliers")
    colours = (LOOKS[name]["color"] for name in ("Kalman", "Huber", "learnt", "ideal"))
    for ax, (name, (x, deviation)), colour in zip(axes[1:], found.items(), colours, strict=True):
        rms = np.sqrt(np.mean((x - truth) ** 2))
        ax.fill_between(steps, -2 * deviation, 2 * deviation, color=colour, alpha=0.2, lw=0, label="± 2 deviations")
        ax.plot(x - truth, color=colour, lw=1.4, label=f"{name}: {rms:.2f} m rms")
        ax.axhline(0.0, color="0.5", lw=0.6)
        limit = 6.5 if rms > 1.0 else 2.0
        ax.set(ylabel="error [m]", ylim=(-limit, limit))
        ax.legend(fontsize=8, ncols=2, loc="upper left")
    axes[-1].set_xlabel("step")
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "06_smoothing.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
