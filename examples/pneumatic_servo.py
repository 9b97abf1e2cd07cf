"""Can a linear model of a pneumatic servo be followed while its physics change and its sensor lies?

Question. The nonlinear servo (air springs, friction, valve) runs in a position loop, driven by a designed binary
reference, while supply temperature, discharge coefficient and load change. One position sample in ten is an outlier.
Output-error and ARX models from reference to position are tracked by the robust and by the Kalman tracker. What is
left of the fit to the position that no sensor saw?

One equation (paper Table 1)::

    theta+ = theta + P phi T psi(T (y - phi' theta))

Run ``python examples/pneumatic_servo.py`` (seconds); ``--seeds 20`` repeats it with other noise, reference and
physics, and prints how much fit the outliers cost. ``--help`` lists --seed, --steps, --contamination, --jobs, --out.
"""

# %%
from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy.excitation import bandlimited_pink_autocovariance, receding_horizon_binary
from robust_filterpy.experiments import bootstrap_interval, fit_percent, monte_carlo
from robust_filterpy.identification import ARX, OutputError, ParameterTracker, TrackingResult
from robust_filterpy.noise import EpsilonContaminated
from robust_filterpy.plants import beta_coefficient, linearize_servo, random_alpha, simulate_servo

DT, HOLD, ORDER = 0.01, 10, 4
AMPLITUDE = 0.01  # m
SENSOR, FACTOR = 0.05, 10.0  # cm; an outlier is ten times as wide
DRIFT = 1e-6  # variance of a step of theta: our choice
CLEAN, ROBUST, KALMAN = "robust, no outliers", "robust", "Kalman"
STRUCTURES = {"OE": OutputError(ORDER, ORDER), "ARX": ARX(ORDER, ORDER)}


class Data(NamedTuple):
    """One experiment; positions in cm."""

    recording: object
    u: np.ndarray
    truth: np.ndarray
    y: np.ndarray
    y_without: np.ndarray  # the same noise, every outlier shrunk to an ordinary error
    is_outlier: np.ndarray


# %% The experiment
def experiment(steps: int, contamination: float, rng: np.random.Generator) -> Data:
    """Drive the servo while its physics change, and measure it."""
    shape = bandlimited_pink_autocovariance(0.2, 3.0, 40)
    reference = AMPLITUDE * np.repeat(receding_horizon_binary(shape, -(-steps // HOLD), rng=rng), HOLD)[:steps]
    t = DT * np.arange(steps)
    end = t[-1]
    alpha = random_alpha(t, low=1.05, high=1.35, rng=rng)
    discharge = np.interp(t, [0, end], [0.20, 0.32])
    temperature = 1 + 0.1 * np.sin(2 * np.pi * t / end)
    load = np.interp(t, [0, 0.5 * end, 0.53 * end], [0.0, 0.0, 5.0])
    beta = beta_coefficient(alpha, discharge, temperature)
    recording = simulate_servo(reference, DT, alpha=alpha, beta=beta, load=load)
    v, is_outlier = EpsilonContaminated(contamination, SENSOR, FACTOR * SENSOR).rvs_labelled(steps, rng)
    truth = 100 * recording.position
    return Data(recording, 100 * reference, truth, truth + v, truth + np.where(is_outlier, v / FACTOR, v), is_outlier)


# %% The trackers: the same one around three filters and recordings
def track(data: Data, contamination: float) -> dict[tuple[str, str], TrackingResult]:
    """Track both structures; the Kalman filter is told the variance of all the noise."""
    all_noise = SENSOR**2 * (1 - contamination + contamination * FACTOR**2)
    results = {}
    for name, structure in STRUCTURES.items():
        common = dict(theta=0.0, P=10.0, Q=DRIFT)
        kalman = ParameterTracker(structure, filter=KalmanFilter, R=all_noise, **common)
        results[name, CLEAN] = ParameterTracker(structure, R=SENSOR**2, **common).run(data.y_without, data.u)
        results[name, ROBUST] = ParameterTracker(structure, R=SENSOR**2, **common).run(data.y, data.u)
        results[name, KALMAN] = kalman.run(data.y, data.u)
    return results


def free_run(theta: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Simulate the tracked models from the input alone, each sample with that sample's parameters."""
    y, past = np.zeros(u.size + ORDER), np.concatenate((np.zeros(ORDER), u))
    for k in range(u.size):
        recent = slice(k, k + ORDER)
        # A model that is unstable for a moment must not end the simulation.
        new = theta[k, ORDER:] @ past[recent][::-1] - theta[k, :ORDER] @ y[recent][::-1]
        y[k + ORDER] = np.clip(new, -1e6, 1e6)
    return y[ORDER:]


def fits(data: Data, results: dict[tuple[str, str], TrackingResult]) -> dict[tuple[str, str], tuple[float, float]]:
    """Return one-step and free-run fit on the noise-free position, percent, after the first third."""
    late = slice(data.u.size // 3, None)
    return {
        key: (
            fit_percent(data.truth[late], result.prediction[late]),
            fit_percent(data.truth[late], free_run(result.theta, data.u)[late]),
        )
        for key, result in results.items()
    }


def trial(rng: np.random.Generator, steps: int, contamination: float) -> np.ndarray:
    """Return the free-run fits, one row a structure: without outliers, robust, Kalman."""
    data = experiment(steps, contamination, rng)
    found = fits(data, track(data, contamination))
    return np.array([[found[name, which][1] for which in (CLEAN, ROBUST, KALMAN)] for name in STRUCTURES])


# %% Figures
def draw_recording(data: Data, results: dict, path: Path) -> None:
    """Draw a stretch of the recording, the free runs, the weights and the physics that change."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(4, 1, figsize=(9, 9.5), layout="constrained")
    t = data.recording.t
    end = data.u.size
    part = slice(max(end - 400, 0), end)
    bad = np.flatnonzero(data.is_outlier[part]) + part.start
    axes[0].plot(t[part], data.y[part], ".", color="0.6", markersize=3, label="measured")
    axes[0].plot(t[bad], data.y[bad], "x", color="tab:red", markersize=5, label="outlier")
    axes[0].plot(t[part], data.truth[part], color="black", linewidth=1.3, label="true position")
    axes[0].step(t[part], data.u[part], color="tab:blue", linestyle=":", where="post", label="reference")
    axes[0].set(ylabel="position / cm", title="recording (last 4 s)")
    axes[1].plot(t[part], data.truth[part], color="black", linewidth=1.8, label="true position")
    for which, style in ((ROBUST, dict(color="tab:blue", ls="--")), (KALMAN, dict(color="tab:red", ls="-."))):
        y = free_run(results["OE", which].theta, data.u)
        axes[1].plot(t[part], y[part], linewidth=1.2, label=f"free run, {which}", **style)
    axes[1].set(ylabel="position / cm", title="output-error models, from the reference alone")
    weight = results["OE", ROBUST].weights
    axes[2].vlines(t[part], weight[part], 1, color="0.6", linewidth=0.8)
    axes[2].plot(t[part], weight[part], ".", color="black", markersize=3, label="ordinary sample")
    axes[2].plot(t[bad], weight[bad], "x", color="tab:red", label="outlier")
    axes[2].set(ylabel="weight psi(e)/e", ylim=(-0.05, 1.1), title="how far the robust tracker believed each sample")
    axes[3].plot(t, data.recording.alpha, color="black", label="alpha, heat coefficient")
    axes[3].plot(t, data.recording.beta, color="0.4", linestyle="--", label="beta, discharge and temperature")
    axes[3].plot(t, data.recording.load / 10, color="tab:blue", linestyle=":", label="load / 10 N")
    axes[3].set(ylabel="1", xlabel="time / s", title="what changes in the servo")
    for axis in axes:
        axis.legend(loc="upper left", ncols=4, fontsize=8)
        axis.margins(y=0.3)
    axes[2].set_ylim(-0.05, 1.5)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def draw_parameters(data: Data, results: dict, path: Path) -> None:
    """Draw the parameter paths with 95 percent bands, beside those without outliers."""
    import matplotlib.pyplot as plt

    names = STRUCTURES["OE"].names
    figure, axes = plt.subplots(2, 4, figsize=(12, 5.4), sharex=True, layout="constrained")
    t = data.recording.t
    for i, axis in enumerate(axes.flat):
        robust, kalman = results["OE", ROBUST], results["OE", KALMAN]
        lower, upper = robust.confidence_intervals()
        axis.fill_between(t, lower[:, i], upper[:, i], color="tab:blue", alpha=0.25, label="robust, 95 % band")
        axis.plot(t, robust.theta[:, i], color="tab:blue", label="robust")
        axis.plot(t, kalman.theta[:, i], color="tab:red", linestyle="-.", linewidth=1, label="Kalman")
        axis.plot(t, results["OE", CLEAN].theta[:, i], color="black", linestyle=":", label="robust, no outliers")
        late = np.concatenate([r.theta[t.size // 5 :, i] for r in (robust, kalman, results["OE", CLEAN])])
        margin = 0.3 * np.ptp(late) + 1e-3
        axis.set(title=names[i], ylim=(late.min() - margin, late.max() + margin))
    for axis in axes[1]:
        axis.set_xlabel("time / s")
    for axis in axes[:, 0]:
        axis.set_ylabel("coefficient (a: 1, b: cm/cm)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def draw_bode(data: Data, results: dict, path: Path) -> None:
    """Draw the output-error models at three moments against the linearized servo of that moment."""
    import control
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(12, 6), sharex=True, sharey="row", layout="constrained")
    w = 2 * np.pi * np.logspace(np.log10(0.2), np.log10(0.95 * 0.5 / DT), 300)
    recording = data.recording
    speed = float(np.sqrt(np.mean(recording.velocity**2)))
    for column, share in enumerate((0.4, 0.7, 0.99)):
        k = int(share * data.u.size)
        lines = [("linearized servo", dict(color="black", lw=2), _linearized(recording, k, speed))]
        for which, style in ((ROBUST, dict(color="tab:blue", ls="--")), (KALMAN, dict(color="tab:red", ls="-."))):
            theta = results["OE", which].theta[k]
            model = control.tf(theta[ORDER:], np.concatenate(([1.0], theta[:ORDER])), DT)
            lines.append((f"OE model, {which}", style, model))
        for label, style, model in lines:
            response = np.array([model(np.exp(1j * x * DT)) for x in w])
            axes[0, column].plot(w / 2 / np.pi, 20 * np.log10(np.abs(response)), label=label, **style)
            axes[1, column].plot(w / 2 / np.pi, np.degrees(np.unwrap(np.angle(response))), **style)
        axes[0, column].set_title(f"t = {recording.t[k]:.1f} s, beta = {recording.beta[k]:.2f}")
        axes[1, column].set(xlabel="frequency / Hz", xscale="log")
    axes[0, 0].set_ylabel("gain / dB")
    axes[1, 0].set_ylabel("phase / degrees")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _linearized(recording, k: int, speed: float):
    """Linearize the closed loop at the physics of sample k, sliding at the recording's typical speed."""
    point = dict(load=recording.load[k], alpha=recording.alpha[k], beta=recording.beta[k])
    return linearize_servo(
        position=recording.position[k], dt=DT, velocity=speed, friction="viscous", **point
    ).reference_to_position


# %% Tables
def table(found: dict) -> str:
    """Format the fits of one recording."""
    lines = ["Fit on the noise-free position / %", f"  {'model':6}{'tracker':22}{'one step':>9}{'free run':>10}"]
    lines += [f"  {name:6}{which:22}{one:9.1f}{free:10.1f}" for (name, which), (one, free) in found.items()]
    return "\n".join(lines)


def losses(study: np.ndarray, seed: int) -> str:
    """Say what the outliers cost over many seeds, in points of free-run fit."""
    lines = [f"Points of free-run fit that the outliers cost, {len(study)} seeds: mean (95 % interval), worst"]
    for i, name in enumerate(STRUCTURES):
        for column, which in ((1, ROBUST), (2, KALMAN)):
            loss = study[:, i, 0] - study[:, i, column]
            mean = bootstrap_interval(loss, "mean", rng=seed, n_resamples=1999, method="percentile")
            text = f"{mean.estimate:6.2f} ({mean.low:.2f} .. {mean.high:.2f}), {loss.max():.2f}"
            lines.append(f"  {name:4} {which:8}{text}")
    worst = (study[:, 0, 0] - study[:, 0, 1]).mean()
    lines.append(f"Target (OE, robust, mean loss at most 3 points): {'met' if worst <= 3 else 'missed'}")
    return "\n".join(lines)


# %%
def main(argv: list[str] | None = None) -> dict:
    """Run one experiment with figures, then as many seeds as asked for; return the fits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=0, help="repeat with so many seeds, at least 2 (default: do not)")
    parser.add_argument("--steps", type=int, default=3000, help="samples of 10 ms, at least 300 (default %(default)s)")
    parser.add_argument("--contamination", type=float, default=0.1)
    parser.add_argument("--jobs", type=int, default=-1, help="processes, -1 for one per processor (the default)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    args = parser.parse_args(argv)
    if args.steps < 300 or args.seeds < 0 or args.seeds == 1:
        parser.error("--steps must be at least 300, --seeds at least 2")
    args.out.mkdir(parents=True, exist_ok=True)
    data = experiment(args.steps, args.contamination, np.random.default_rng(args.seed))
    results = track(data, args.contamination)
    draw_recording(data, results, args.out / "servo_recording.png")
    draw_parameters(data, results, args.out / "servo_parameters.png")
    draw_bode(data, results, args.out / "servo_bode.png")
    if args.seeds:
        one = partial(trial, steps=args.steps, contamination=args.contamination)
        print(losses(monte_carlo(one, args.seeds, args.seed, args.jobs).stacked(), args.seed))
    found = fits(data, results)
    print("Figures: servo_recording.png, servo_parameters.png, servo_bode.png")
    print(table(found))
    clean, robust, kalman = (found["OE", which][1] for which in (CLEAN, ROBUST, KALMAN))
    print(
        f"Conclusion: of the output-error model's free-run fit the outliers cost {clean - robust:.1f} points with the "
        f"robust tracker,\n{clean - kalman:.1f} with the Kalman filter."
    )
    return found


if __name__ == "__main__":
    main([] if "ipykernel" in sys.modules else None)
