"""What does a recording tell of a servo's friction and volumes, and what does it not tell?

A pneumatic servo follows a reference; its position and pressures are recorded, one reading in ten ten times as bad as
the others. The equations of the plant are known, x' = f(x, u, p), four of their parameters are not. `GreyBox` finds
them through the outliers, says how sure each is, and names those that this recording cannot tell.
"""

# %% The equations: the servo's own, with the parameters that are to be found.
import argparse
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from robust_filterpy import identify
from robust_filterpy.identification import GreyBox
from robust_filterpy.plants.servo import PneumaticParameters, simulate_servo
from robust_filterpy.plants.servo.equations import servo_derivatives

TRUTH = PneumaticParameters(static_friction=5.7, friction_smoothing=1e-2)
ALPHA, BETA, PERIOD = 1.2, 0.25, 0.01


@lru_cache(maxsize=64)
def equations(viscous, coulomb, dead, stop):
    """Return the right-hand side for one set of parameters, in N s/m, N, mm and MN/m."""
    changed = {"viscous_friction": viscous, "coulomb_friction": coulomb, "static_friction": coulomb}
    return servo_derivatives(replace(TRUTH, **changed, dead_length=1e-3 * dead, stop_stiffness=1e6 * stop))


def f(x, u, p):
    """Return the derivatives of position (m), velocity (m/s) and the two pressures (Pa)."""
    return equations(*map(float, p))(*x, u[0], 0.0, ALPHA, BETA)


def measured(x, u, p):
    """Return what is measured: position and pressures."""
    return x[[0, 2, 3]]


def record(steps, seed=1):
    """Simulate the experiment and its sensors."""
    rng = np.random.default_rng(seed)
    reference = 0.02 * np.repeat(rng.choice([-1.0, -0.5, 0.5, 1.0], steps // 30 + 1), 30)[:steps]
    sizes = np.array([1e-4, 500.0, 500.0])
    noise = sizes * np.where(rng.random((steps, 3)) < 0.1, 10.0, 1.0) * rng.normal(size=(steps, 3))
    run = simulate_servo(reference, PERIOD, TRUTH, alpha=ALPHA, beta=BETA, noise=noise)
    x0 = [run.position[0], run.velocity[0], run.P_a[0], run.P_b[0]]
    return np.column_stack((run.position_measured, run.P_a_measured, run.P_b_measured)), run.valve, run.t, x0


def main(argv=None):
    """Record, find, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--steps", type=int, default=160)
    options = parser.parse_args(argv)

    # %% First guesses far off; the servo begins at rest, so its first state is known.
    y, valve, t, x0 = record(options.steps)
    guess = {"viscous N s/m": 10.0, "Coulomb N": 2.0, "dead length mm": 10.0, "end stop MN/m": 1.0}
    bounds = {name: (0.0, None) for name in guess}
    box = GreyBox(f, guess, x0, measured, bounds=bounds, start="fixed")
    with warnings.catch_warnings():
        # What the recording cannot tell is said below.
        warnings.simplefilter("ignore", UserWarning)
        model = identify(y, valve, box, t=t)
    print(model)  # model.summary() has the table

    # %% Beside the truth, which only a simulation knows.
    truth = [TRUTH.viscous_friction, TRUTH.coulomb_friction, 1e3 * TRUTH.dead_length, 1e-6 * TRUTH.stop_stiffness]
    draw(model, truth, options.out)
    unidentifiable = " and ".join(name for names in model.unidentifiable for name in names) or "nothing"
    print(
        "Conclusion, +- a standard deviation: "
        f"viscous friction {model.theta[0]:.2f} +- {model.std[0]:.2f} N s/m (the plant: {truth[0]:.2f}), "
        f"Coulomb friction {model.theta[1]:.2f} +- {model.std[1]:.2f} N ({truth[1]:.2f}), dead length "
        f"{model.theta[2]:.2f} +- {model.std[2]:.2f} mm ({truth[2]:.2f}). "
        f"What this recording cannot tell: {unidentifiable}."
    )


def draw(model, truth, out):
    """Draw each parameter over its true value."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(8, 3.4), layout="constrained")
    places = np.arange(len(truth))[::-1]
    guess = list(model.structure.p0.values())
    width = np.minimum(1.96 * model.std / truth, 10.0)
    ax.errorbar(model.theta / truth, places, xerr=width, fmt="o", capsize=4, label="found, 95 %")
    ax.plot(np.divide(guess, truth), places, "x", color="0.5", label="first guess")
    ax.axvline(1.0, color="0.3", lw=1)
    ax.set(yticks=places, yticklabels=model.structure.free_names, xlabel="over the true value", xlim=(0, 4))
    ax.set_title("One recording with outliers tells friction and volumes; the end stops it never met")
    ax.legend()
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "21_physics_from_a_recording.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
