"""An IMM on a manoeuvring target with outliers: which filter keeps its model probabilities?

IMMEstimator weighs its models by their likelihoods. A Gaussian likelihood falls like exp(-e^2/2), so one outlier
decides for whichever model has the larger S, or underflows in both. Huber's falls like exp(-k |e|), Tukey's stays at
exp(-c^2/6): an outlier then says next to nothing about the model. And the states have not been carried away.
"""

# %% Two models of one coordinate: nearly constant velocity, and strong acceleration.
import argparse
from functools import partial
from pathlib import Path

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter

from robust_filterpy import RobustKalmanFilter, TukeyBiweight
from robust_filterpy.plotting import LOOKS

SIGMA = 1.0
KINDS = {
    "KalmanFilter": KalmanFilter,
    "RobustKalmanFilter, Huber": RobustKalmanFilter,
    "RobustKalmanFilter, Tukey": partial(RobustKalmanFilter, influence=TukeyBiweight()),
}


def imm(kind):
    """Return an IMM of a calm and an agile filter of the calm_share class."""
    filters = []
    for variance in (1e-4, 0.5):
        kf = kind(dim_x=2, dim_z=1)
        kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
        kf.H = np.array([[1.0, 0.0]])
        kf.R *= SIGMA**2
        kf.Q = Q_discrete_white_noise(2, 1.0, var=variance)
        kf.P *= 10.0
        filters.append(kf)
    return IMMEstimator(filters, mu=[0.5, 0.5], M=np.array([[0.97, 0.03], [0.03, 0.97]]))


# %% The target flies straight, manoeuvres from 80 to 120, flies straight again; 10 % of the readings are wild.
def recording(rng, steps=200):
    """Return true positions (steps,), measurements (steps,), whether it manoeuvres (steps,)."""
    agile = (np.arange(steps) >= 80) & (np.arange(steps) < 120)
    velocity = 1.0 + np.cumsum(np.where(agile, rng.normal(0.0, 1.0, steps), 0.0))
    position = np.cumsum(velocity)
    scale = np.where(rng.random(steps) < 0.1, 50.0, 1.0) * SIGMA
    return position, position + scale * rng.standard_normal(steps), agile


def run(kind, zs):
    """Return positions (steps,) and the probability of the agile model (steps,)."""
    bank, positions, agile = imm(kind), [], []
    for z in zs:
        bank.predict()
        bank.update(np.array([[z]]))
        positions.append(bank.x[0, 0])
        agile.append(bank.mu[1])
    return np.array(positions), np.array(agile)


# %% The same target seen through both.
def main(argv=None):
    """Run, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=4)
    options = parser.parse_args(argv)
    truth, zs, agile = recording(np.random.default_rng(options.seed))
    results = {name: run(kind, zs) for name, kind in KINDS.items()}
    draw(truth, agile, results, options.out)
    calm = ~agile & (np.arange(zs.size) > 20)
    calm_share = {name: float(np.mean(mu[calm] < 0.5)) for name, (_, mu) in results.items()}
    rms = {name: float(np.sqrt(np.mean((x - truth)[20:] ** 2))) for name, (x, _) in results.items()}
    print(f"{'IMM of':28} calm model the likelier one    position error (rms)")
    for name in KINDS:
        print(f"{name:28} {calm_share[name]:>20.0%} {rms[name]:>22.1f} m")
    huber, tukey = list(KINDS)[1:]
    print(
        f"Conclusion: in straight flight the calm model is the likelier one in {calm_share['KalmanFilter']:.0%} "
        f"of the samples with KalmanFilter, {calm_share[huber]:.0%} with Huber's psi and {calm_share[tukey]:.0%} with "
        f"Tukey's; the position errors are {rms['KalmanFilter']:.1f}, {rms[huber]:.1f} and {rms[tukey]:.1f} m. Where "
        f"model probabilities matter, take a bounded rho."
    )


def draw(truth, agile, results, out):
    """Draw model probabilities and errors."""
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9, 5.5), sharex=True, layout="constrained")
    looks = (LOOKS[name] for name in ("Kalman", "Huber", "Tukey"))
    for (name, (x, mu)), look in zip(results.items(), looks, strict=True):
        top.plot(mu, lw=1.3, label=f"IMM of {name}", **look)
        bottom.plot(np.abs(x - truth), lw=1.3, label=f"IMM of {name}", **look)
    for ax in (top, bottom):
        ax.axvspan(*np.flatnonzero(agile)[[0, -1]], color="0.9", zorder=0, label="manoeuvre")
    top.set(ylabel="probability of the agile model", ylim=(-0.02, 1.02))
    bottom.set(xlabel="step", ylabel="position error [m]", yscale="log", ylim=(1e-2, None))
    figure.suptitle("Outliers look like manoeuvres, unless psi returns to zero")
    top.legend(fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "05_imm.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
