"""Figures of the servo study: the recording, models of a few seconds of it, and the tracked gain over time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from servo.experiment import DT, NOMINAL, NONE, ROBUST, Conditions, motion
from servo.linearization import linearized as linear_models
from servo.models import CONSTANT, EVERY, ORDER, Model, frozen_gain, gain_of, sliding_gain
from servo.study import INSTANTS, at

from robust_filterpy.identification import Model as PolynomialModel
from robust_filterpy.plants.servo import PneumaticParameters
from robust_filterpy.plants.servo.position_loop import ServoRecording
from robust_filterpy.plotting import LOOKS

STYLE = {NOMINAL: {**LOOKS["Kalman"], "linewidth": 1.1}, ROBUST: {**LOOKS["Huber"], "linewidth": 1.3}}
BLUE = LOOKS["Huber"]["color"]
FREQUENCIES = np.logspace(np.log10(0.3), np.log10(45), 200)  # Hz
#: Models of the same seconds: of a recording whose sensor makes no error, and of the one with outliers, two ways.
TRUTH_FIT, ROBUST_FIT, LEAST_SQUARES = "sensor without error", "robust", "least squares"
MODEL_STYLE = {
    TRUTH_FIT: dict(color="black", linewidth=2.4, alpha=0.55),
    ROBUST_FIT: dict(color=BLUE, linewidth=1.3, linestyle="--"),
    LEAST_SQUARES: dict(color=LOOKS["Kalman"]["color"], linewidth=1.1),
}


def draw_recording(given: Conditions, recordings: dict[str, ServoRecording], path: Path) -> None:
    """Draw a stretch of the recording, what the outliers do to piston and valve, and the physics that change."""
    figure, axes = plt.subplots(4, 1, figsize=(9, 10), layout="constrained")
    robust, without = recordings[ROBUST], recordings[NONE]
    t, end = robust.t, robust.t.size
    part = slice(max(end - 400, 0), end)
    bad = np.flatnonzero(given.is_outlier[part, 0]) + part.start
    axes[0].plot(t[part], 100 * robust.position_measured[part], ".", color="0.6", markersize=3, label="measured")
    axes[0].plot(t[bad], 100 * robust.position_measured[bad], "x", color="black", markersize=5, label="outlier")
    axes[0].plot(t[part], 100 * robust.position[part], color="black", linewidth=1.3, label="true position")
    axes[0].step(t[part], 100 * given.reference[part], color="tab:green", ls=":", where="post", label="reference")
    axes[0].set(ylabel="position / cm", title="The encoder and the loop on the robust filter (last 4 s)")
    for loop in (NOMINAL, ROBUST):
        recording, style = recordings[loop], STYLE[loop]
        axes[1].plot(t, 1e3 * (recording.position - without.position), label=f"loop on {loop}", **style)
        axes[2].plot(t[part], 100 * recording.valve[part], label=f"loop on {loop}", **style)
    moved = (f"{motion(recordings[loop], without).deviation:.2f} mm on {loop}" for loop in (NOMINAL, ROBUST))
    title = f"Outliers move the piston, root mean square: {', '.join(moved)}"
    axes[1].set(ylabel="moved by outliers / mm", title=title)
    axes[2].plot(t[part], 100 * without.valve[part], color="black", linewidth=0.8, label="loop without outliers")
    axes[2].set(ylabel="valve / % of stroke", title="What the controller does about them (last 4 s)")
    physics = given.physics
    axes[3].plot(t, physics["beta"], color="black", label="beta (discharge, heat, temperature)")
    axes[3].plot(t, physics["alpha"] - 1, color="0.5", linestyle="--", label="alpha - 1 (heat)")
    axes[3].plot(t, physics["load"] / 20, color="tab:blue", linestyle=":", label="load [20 N]")
    axes[3].plot(t, physics["supply"] / 1e6, color="tab:green", linestyle="-.", label="supply [10 bar]")
    axes[3].set(ylabel="in the legend's units", xlabel="time / s", title="Meanwhile the servo changes")
    for axis in axes:
        axis.legend(loc="upper left", ncols=4, fontsize=8)
        axis.margins(x=0.01, y=0.3)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def draw_gain(
    given: Conditions, recording: ServoRecording, models: dict[str, Model], path: Path, say: Callable[[str], None]
) -> None:
    """Draw the static gain from opening to velocity with the physics' own."""
    figure, axis = plt.subplots(figsize=(9, 4.4), layout="constrained")
    ends = np.arange(EVERY - 1, recording.t.size, EVERY)
    t, robust = recording.t[ends], models[ROBUST]
    low, high = robust.gain - 1.96 * robust.gain_std, robust.gain + 1.96 * robust.gain_std
    axis.fill_between(t, low, high, color=BLUE, alpha=0.2, label="robust, 95 % band")
    axis.plot(t, robust.gain, label=ROBUST, **STYLE[ROBUST])
    constant = gain_of(models[CONSTANT].theta[-1], np.eye(2 * ORDER))[0]
    axis.axhline(constant, color="0.6", linestyle="--", linewidth=1, label="one constant model")
    sliding = [sliding_gain(recording, k) for k in ends]
    axis.plot(t, sliding, color="black", linewidth=1.4, label="physics, steady sliding")
    instants = [at(share, recording.t.size) for share in (0.1, *INSTANTS)]
    frozen = []
    for k in instants:
        say(f"the best linear model of the physics at {recording.t[k]:.0f} s")
        frozen.append(frozen_gain(given, k))
    axis.plot(recording.t[instants], frozen, "o", color="black", markerfacecolor="none",
              label="physics, frozen: its best linear model")  # fmt: skip
    axis.set(xlabel="time / s", ylabel="gain / (cm/s per % of opening)", ylim=(2, 9))
    grown = sliding[-1] / sliding[0]
    axis.set_title(f"The servo's gain grows {grown:.1f} times: the tracked model follows, a constant one cannot")
    axis.legend(loc="upper left", ncols=2, fontsize=8)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def linearized(servo: PneumaticParameters, position: float, speed: float, z: np.ndarray, **physics) -> np.ndarray:
    """Return the response of the linearized servo at z, cm/s per percent of opening: the mean of both directions.

    The rod makes the way out slower than the way back, by the ratio of the areas.
    """
    both = (linear_models(servo, DT, position, velocity=v, **physics).valve_to_velocity(z) for v in (-speed, speed))
    # The opening, whose dead band the model does not see, is a little more of the command.
    return (1 - servo.dead_band) * sum(both) / 2


def model_response(theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return B/A at z."""
    delays = z ** -np.arange(1.0, ORDER + 1)[:, None]
    return (theta[ORDER:] @ delays) / (1 + theta[:ORDER] @ delays)


def decibel(response: np.ndarray) -> np.ndarray:
    """Return 20 log10 of the size."""
    return 20 * np.log10(np.abs(response))


class Identified(NamedTuple):
    """A model of a few seconds of the recording, and its free run's fit to the true velocity there, in percent."""

    model: PolynomialModel
    fit: float


def draw_model(models: dict[str, Identified], path: Path) -> None:
    """Draw the step and frequency responses of models that were fitted to the same seconds."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for name, (model, fit) in models.items():
        look = dict(MODEL_STYLE[name], label=f"{name} (fit {fit:.0f} %)")
        step, bode = model.step_response(60, dt=DT), model.frequency_response(2 * np.pi * FREQUENCIES, dt=DT)
        left.plot(step.time, step.response, **look)
        right.plot(FREQUENCIES, decibel(bode.magnitude), **look)
        if name == ROBUST_FIT:
            left.fill_between(step.time, step.lower, step.upper, color=BLUE, alpha=0.2, label="its 95 % band")
            ends = (decibel(end) for end in (bode.magnitude_lower, bode.magnitude_upper))
            right.fill_between(FREQUENCIES, *ends, color=BLUE, alpha=0.2)
    left.set(xlabel="time / s", ylabel="velocity / (cm/s)", title="The valve opens by 1 %")
    truth = models[TRUTH_FIT].model.step_response(60, dt=DT).response
    left.set_ylim(-0.5 * truth.max(), 1.4 * truth.max())
    right.set(xlabel="frequency / Hz", ylabel="gain / dB (cm/s per %)", xscale="log", ylim=(-25, 35))
    right.set_title("Frequency response from valve to velocity")
    left.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=80)
    plt.close(figure)
