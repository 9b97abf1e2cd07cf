"""Plain, robust or adaptive, given R or not: what matters when a radar's echo jumps about the target?

Range and bearing of a target in the plane; in one return out of seven the echo comes from elsewhere on the target or
beside it (glint). The correction is bounded, whatever the measurement function h:
x+ = x + C T' psi(T y), y = z - h(x), T = S^(-1/2), with C and S from a Jacobian or from sigma points. The choice
between these two, extended or unscented, changes no figure below: at a radar's distances the measurement is nearly
linear.
"""

# %% A target that turns slowly, seen from the origin every half second.
import argparse
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.stats import bootstrap

from robust_filterpy import RobustExtendedKalmanFilter
from robust_filterpy.plotting import LOOKS

DT, STEPS, RUNS = 0.5, 200, 10
SIGMA = np.array([10.0, 0.005])  # m, rad
GLINT, GLINT_RATIO = 0.15, 15.0
F = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = 0.5 * np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])


def simulate(rng):
    """Return the true states, the radar's returns and which of them glint."""
    x, truth = np.array([2000.0, -20.0, 1000.0, 15.0]), np.empty((STEPS, 4))
    for k in range(STEPS):
        x = truth[k] = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4)
    glint = rng.random(STEPS) < GLINT
    noise = SIGMA * rng.normal(size=(STEPS, 2)) * np.where(glint, GLINT_RATIO, 1.0)[:, None]
    return truth, np.apply_along_axis(polar, 1, truth) + noise, glint


# %% The measurement function, its Jacobian and a residual that knows about angles: as in any filterpy program.
def polar(x):
    """Return range and bearing."""
    return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])


def polar_jacobian(x):
    """Return the derivative of range and bearing."""
    r2 = x[0] ** 2 + x[2] ** 2
    return np.array([[x[0] / r2**0.5, 0, x[2] / r2**0.5, 0], [-x[2] / r2, 0, x[0] / r2, 0]])


def difference(a, b):
    """Subtract measurements; the bearing's difference is between -pi and pi."""
    y = a - b
    y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
    return y


# %% The robust filters differ by the class name. A glint spoils the whole return, so psi takes it as one: "joint".
def extended(cls, factor=1.0, **choice):
    """Return a step function of an extended filter that is given R times a factor."""
    kf = cls(4, 2, **choice)
    kf.x, kf.P = np.array([2000.0, 0.0, 1000.0, 0.0]), np.diag([100.0, 30.0, 100.0, 30.0]) ** 2 / 10
    kf.F, kf.Q, kf.R = F, Q.copy(), factor * np.diag(SIGMA**2)

    def step(z):
        kf.predict()
        kf.update(z, polar_jacobian, polar, residual=difference)
        return kf

    return step


WRONG = 10.0
FILTERS = {
    "EKF, filterpy": lambda: extended(ExtendedKalmanFilter),
    "EKF, robust": lambda: extended(RobustExtendedKalmanFilter, grouping="joint"),
    "EKF, adaptive": lambda: extended(RobustExtendedKalmanFilter, noise="learnt", grouping="joint"),
    "EKF, robust, R x 10": lambda: extended(RobustExtendedKalmanFilter, WRONG, grouping="joint"),
    "EKF, adaptive, R x 10": lambda: extended(RobustExtendedKalmanFilter, WRONG, noise="learnt", grouping="joint"),
}


def main(argv=None):
    """Track in many runs, draw one, tabulate, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--runs", type=int, default=RUNS)
    options = parser.parse_args(argv)
    rms = {name: [] for name in FILTERS}
    for seed in range(options.runs):
        truth, zs, glint = simulate(np.random.default_rng(seed))
        paths, marked = {}, None
        for name, build in FILTERS.items():
            step = build()
            states = [(step_to.x.copy(), getattr(step_to, "weights", None)) for step_to in map(step, zs)]
            paths[name] = np.array([x for x, _ in states])
            error = (paths[name] - truth)[STEPS // 10 :, [0, 2]]
            rms[name].append(np.sqrt((error**2).sum(axis=1).mean()))
            if name == "EKF, robust":
                marked = np.array([w[0] for _, w in states])
        if seed == 0:
            draw(truth, zs, glint, paths, marked, options.out)
    print(f"{'':24} RMS position error, m (mean of {options.runs} runs, 95 % interval)")
    for name, values in rms.items():
        low, high = bootstrap((values,), np.mean, random_state=0).confidence_interval
        print(f"{name:24} {np.mean(values):6.1f}   ({low:.1f} to {high:.1f})")
    mean = {name: float(np.mean(values)) for name, values in rms.items()}

    def over(one, other):
        return mean[one] / mean[other]

    print(
        f"Conclusion: a bounded correction lowers the error by a factor of {over('EKF, filterpy', 'EKF, robust'):.1f}. "
        f"An R that is {WRONG:.0f} times too large costs the robust filter "
        f"{over('EKF, robust, R x 10', 'EKF, robust') - 1:.0%}, "
        f"the adaptive one, which has {over('EKF, adaptive', 'EKF, robust'):.2f} of the robust one's error, "
        f"{over('EKF, adaptive, R x 10', 'EKF, adaptive') - 1:.0%}."
    )


def draw(truth, zs, glint, paths, weights, out):
    """Draw the track from above, and the weights over time."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    seen = zs[:, :1] * np.column_stack([np.cos(zs[:, 1]), np.sin(zs[:, 1])])
    left.plot(*seen[~glint].T, ".", color="0.6", ms=4, label="radar return")
    left.plot(*seen[glint].T, "x", color="0.3", ms=5, label="glint")
    left.plot(truth[:, 0], truth[:, 2], "k-", lw=3, alpha=0.35, label="target")
    for name, look in (("EKF, filterpy", LOOKS["Kalman"]), ("EKF, robust", LOOKS["Huber"])):
        left.plot(paths[name][:, 0], paths[name][:, 2], lw=1.3, label=name, **look)
    margin = 150
    left.set_xlim(truth[:, 0].min() - margin, truth[:, 0].max() + margin)
    left.set_ylim(truth[:, 2].min() - margin, truth[:, 2].max() + margin)
    left.set(xlabel="east, m", ylabel="north, m", title="Glint pulls the plain filter off the track")
    left.legend(loc="best", fontsize=8)
    time = DT * np.arange(len(zs))
    right.plot(time[~glint], weights[~glint], ".", color="0.5", label="radar return")
    right.plot(time[glint], weights[glint], "kx", label="glint")
    right.set(xlabel="time, s", ylabel=r"weight $\psi(|e|)/|e|$", title="The robust one hardly believes it")
    right.set_ylim(0, 1.2)
    right.legend(loc="upper center", ncols=2, fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "11_radar_glint.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
