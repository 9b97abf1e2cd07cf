"""Nobody knows R: what does a filter lose that learns it, and how large the outliers are, while it runs?

The data sheet of a sensor is wrong by a factor of ten, either way; a tenth of the samples are outliers; and halfway
the sensor wears out: its ordinary noise triples. `AdaptiveKalmanFilter` learns the variance of ordinary noise, and how
often and how far it is exceeded, from its own innovations. `estimate_noise` fits these numbers to a recording
beforehand.
"""

# %% A point that moves with a nearly constant velocity; its position is measured.
import argparse
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, RobustKalmanFilter, estimate_noise
from robust_filterpy.plotting import LOOKS

STEPS, WORN = 1600, 800
F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
G = 0.1 * np.array([[0.5], [1.0]])
FACTORS = (0.1, 1.0, 10.0)  # R that the filter is given, over the true one at the start


def simulate(rng):
    """Return the true positions, the measurements, and the standard deviation of each one's noise."""
    x, truth = np.zeros((2, 1)), np.empty(STEPS)
    for k in range(STEPS):
        x = F @ x + G * rng.standard_normal()
        truth[k] = x[0, 0]
    sigma = np.where(np.arange(STEPS) < WORN, 1.0, 3.0)
    sigma_each = sigma * np.where(rng.random(STEPS) < 0.1, 10.0, 1.0)
    return truth, truth + sigma_each * rng.standard_normal(STEPS), sigma_each


def moving(kf, R):
    """Give a filter the model and an R."""
    kf.F, kf.H, kf.Q, kf.R, kf.P = F, H, G @ G.T, np.array([[R]]), 10.0 * np.eye(2)
    return kf


def rms(path, truth):
    """Return the root mean square error of the position after the first fifty steps."""
    return float(np.sqrt(np.mean((path[:, 0, 0] - truth)[50:] ** 2)))


# %% Every filter with every R; the one that is given the size of each sample's noise says what is possible.
def main(argv=None):
    """Run, draw, tabulate, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    truth, zs, sigma = simulate(np.random.default_rng(options.seed))
    given = moving(KalmanFilter(2, 1), 1.0).batch_filter(zs, Rs=[np.array([[s**2]]) for s in sigma])[0]
    possible = rms(given, truth)

    _, practice, _ = simulate(np.random.default_rng(options.seed + 1))
    kf = moving(RobustKalmanFilter(2, 1, noise=Contaminated()), 10.0)
    fitted = estimate_noise(kf, practice[:WORN])
    makes = {
        "KalmanFilter": lambda R: moving(KalmanFilter(2, 1), R),
        "RobustKalmanFilter (Huber)": lambda R: moving(RobustKalmanFilter(2, 1), R),
        "AdaptiveKalmanFilter": lambda R: moving(AdaptiveKalmanFilter(2, 1), R),
    }
    loss = {name: [rms(make(R).batch_filter(zs)[0], truth) / possible for R in FACTORS] for name, make in makes.items()}
    print(f"{'error over the informed filter':32}" + "".join(f"   R given x {factor:<4g}" for factor in FACTORS))
    for name, values in loss.items():
        print(f"{name:32}" + "".join(f"{value:15.2f}" for value in values))
    worn = rms(fitted.apply(kf).batch_filter(zs)[0], truth) / possible
    print(
        f"estimate_noise, given R x 10, says from a recording of the new sensor that it is "
        f"{fitted.R_scale[0]:.3f} of that; a filter with that noise does not learn on when the sensor wears: {worn:.2f}"
    )

    learnt, errors = follow(makes["AdaptiveKalmanFilter"], zs)
    draw(learnt, errors, loss, options.out)
    worst = {name: max(values) for name, values in loss.items()}
    print(
        f"Conclusion: with R known to a factor of ten the Kalman filter's error is up to {worst['KalmanFilter']:.1f} "
        f"times that of one informed of each sample's noise, Huber's up to "
        f"{worst['RobustKalmanFilter (Huber)']:.2f} times, that of the filter that learns its noise up to "
        f"{worst['AdaptiveKalmanFilter']:.2f} times."
    )


def follow(make, zs):
    """Return R as learnt after each step with its standard error, for each R that was given."""
    learnt, errors = {}, {}
    for factor in FACTORS:
        kf = make(factor)
        path, error = [], []
        for z in zs:
            kf.predict()
            kf.update(z)
            path.append(kf.R_learnt[0, 0])
            error.append(factor * kf.noise_learnt.r_std[0])
        learnt[factor], errors[factor] = np.array(path), np.array(error)
    return learnt, errors


def draw(learnt, errors, loss, out):
    """Draw R as learnt, and what each filter loses."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), width_ratios=(3, 2), layout="constrained")
    k = np.arange(STEPS)
    left.step(k, np.where(k < WORN, 1.0, 9.0), "k--", lw=1.5, label="true R of ordinary samples")
    colour = LOOKS["learnt"]["color"]
    for style, (factor, path) in zip(("--", "-", ":"), learnt.items(), strict=True):
        left.plot(k, path, style, color=colour, lw=1.8, label=f"learnt, given {factor:g}")
    low, high = learnt[1.0] - errors[1.0], learnt[1.0] + errors[1.0]
    left.fill_between(k, np.maximum(low, 0.05), high, color=colour, alpha=0.25, lw=0, label="± standard error")
    left.set(
        yscale="log",
        ylim=(0.05, 40),
        xlabel="step",
        ylabel="variance R",
        title="R is learnt, whatever was given, while a tenth are outliers",
    )
    left.legend(fontsize=8, loc="lower right")
    width, colours = 0.26, [LOOKS[name]["color"] for name in ("Kalman", "Huber", "learnt")]
    for j, (name, values) in enumerate(loss.items()):
        bars = right.bar(np.arange(len(FACTORS)) + (j - 1) * width, values, width, label=name, color=colours[j])
        right.bar_label(bars, [f"{value:.2f}" for value in values], fontsize=7)
    right.axhline(1.0, color="k", lw=0.8)
    right.set(
        xticks=np.arange(len(FACTORS)), xticklabels=[f"{factor:g}" for factor in FACTORS],
        xlabel="R given, over the true one at the start", ylabel="error over the informed filter's",
        title="What a wrong R costs",
    )  # fmt: skip
    right.legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "14_noise_unknown.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
