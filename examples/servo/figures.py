"""Figures of the servo study: the recording, the gain over time, and the frequency response at several instants."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from servo.experiment import DT, NOMINAL, NONE, ROBUST, SERVO, Conditions, motion
from servo.models import CONSTANT, EVERY, ORDER, Model, frozen_gain, gain_of, sliding_gain
from servo.study import INSTANTS, at

from robust_filterpy.plants.servo import PneumaticParameters, ServoRecording, linearize_servo
from robust_filterpy.plotting import LOOKS

STYLE = {NOMINAL: {**LOOKS["Kalman"], "linewidth": 1.1}, ROBUST: {**LOOKS["Huber"], "linewidth": 1.3}}
BLUE = LOOKS["Huber"]["color"]
FREQUENCIES = np.logspace(np.log10(0.3), np.log10(45), 200)  # Hz
POSITIONS = (-0.025, 0.0, 0.025)  # m
DRAWS = 200


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


def draw_gain(given: Conditions, recording: ServoRecording, models: dict[str, Model], path: Path) -> None:
    """Draw the static gain from opening to velocity beside the physics' own."""
    figure, axis = plt.subplots(figsize=(9, 4.4), layout="constrained")
    ends = np.arange(EVERY - 1, recording.t.size, EVERY)
    t, robust = recording.t[ends], models[ROBUST]
    low, high = robust.gain - 1.96 * robust.gain_std, robust.gain + 1.96 * robust.gain_std
    axis.fill_between(t, low, high, color=BLUE, alpha=0.2, label="robust, 95 % band")
    axis.plot(t, models[NOMINAL].gain, label=NOMINAL, **STYLE[NOMINAL])
    axis.plot(t, robust.gain, label=ROBUST, **STYLE[ROBUST])
    constant = gain_of(models[CONSTANT].theta[-1], np.eye(2 * ORDER))[0]
    axis.axhline(constant, color="0.6", linestyle="--", linewidth=1, label="one constant model")
    sliding = [sliding_gain(recording, k) for k in ends]
    axis.plot(t, sliding, color="black", linewidth=1.4, label="physics, steady sliding")
    instants = [at(share, recording.t.size) for share in (0.1, *INSTANTS)]
    frozen = [frozen_gain(given, k) for k in instants]
    axis.plot(recording.t[instants], frozen, "o", color="black", markerfacecolor="none",
              label="physics, frozen: its best linear model")  # fmt: skip
    axis.set(xlabel="time / s", ylabel="gain / (cm/s per % of opening)", ylim=(2, 9))
    grown = sliding[-1] / sliding[0]
    axis.set_title(f"The gain grows {grown:.1f} times: the tracked models follow, a constant one cannot")
    axis.legend(loc="upper left", ncols=2, fontsize=8)
    figure.savefig(path, dpi=80)
    plt.close(figure)


class Response(NamedTuple):
    """Frequency responses at one instant, over FREQUENCIES; cm/s per percent of opening."""

    linearized: np.ndarray  # (positions, F) complex, at each of POSITIONS
    model: np.ndarray  # (F,) complex
    gain: np.ndarray  # (2, F) ends of the 95 % band of the model's gain, dB
    phase: np.ndarray  # (2, F) of its phase, degrees


def linearized(servo: PneumaticParameters, position: float, speed: float, z: np.ndarray, **physics) -> np.ndarray:
    """Return the response of the linearized servo at z, cm/s per percent of opening: the mean of both directions.

    The rod makes the way out slower than the way back, by the ratio of the areas.
    """
    both = (
        linearize_servo(servo, position, dt=DT, velocity=v, friction="viscous", **physics).valve_to_velocity(z)
        for v in (-speed, speed)
    )
    # The opening, whose dead band the model does not see, is a little more of the command.
    return (1 - servo.dead_band) * sum(both) / 2


def responses(recording: ServoRecording, model: Model) -> list[Response]:
    """Compare the model with the linearized physics at each instant."""
    speed, rng = float(np.sqrt(np.mean(recording.velocity**2))), np.random.default_rng(0)
    found = []
    for share in INSTANTS:
        k = at(share, recording.t.size)
        physics = dict(load=recording.load[k], alpha=recording.alpha[k], beta=recording.beta[k])
        z = np.exp(2j * np.pi * FREQUENCIES * DT)
        curves = np.array([linearized(SERVO, y, speed, z, **physics) for y in POSITIONS])
        draws = rng.multivariate_normal(model.theta[k], model.covariance[(k + 1) // EVERY - 1], DRAWS)
        centre, spread = model_response(model.theta[k], z), np.array([model_response(theta, z) for theta in draws])
        turn = np.degrees(np.unwrap(np.angle(centre)) + np.angle(spread / centre))
        bands = (np.quantile(x, [0.025, 0.975], axis=0) for x in (decibel(spread), turn))
        found.append(Response(curves, centre, *bands))
    return found


def model_response(theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return B/A at z."""
    delays = z ** -np.arange(1.0, ORDER + 1)[:, None]
    return (theta[ORDER:] @ delays) / (1 + theta[:ORDER] @ delays)


def decibel(response: np.ndarray) -> np.ndarray:
    """Return 20 log10 of the size."""
    return 20 * np.log10(np.abs(response))


def draw_bode(recording: ServoRecording, found: list[Response], path: Path) -> None:
    """Draw the model with its band against the linearized servo at three instants."""
    figure, axes = plt.subplots(2, 3, figsize=(12, 6), sharex=True, sharey="row", layout="constrained")
    for column, (share, response) in enumerate(zip(INSTANTS, found, strict=True)):
        top, bottom = axes[:, column]
        for y, linear in zip(POSITIONS, response.linearized, strict=True):
            style = dict(color="black", lw=1.8) if y == 0 else dict(color="0.6", lw=0.9)
            label = "linearized servo, mid-stroke" if y == 0 else "linearized servo, 2.5 cm off" if y > 0 else None
            top.plot(FREQUENCIES, decibel(linear), label=label, **style)
            bottom.plot(FREQUENCIES, np.degrees(np.unwrap(np.angle(linear))), **style)
        top.fill_between(FREQUENCIES, *response.gain, color=BLUE, alpha=0.2, label="robust model, 95 % band")
        bottom.fill_between(FREQUENCIES, *response.phase, color=BLUE, alpha=0.2)
        top.plot(FREQUENCIES, decibel(response.model), color=BLUE, ls="--", label="robust model")
        bottom.plot(FREQUENCIES, np.degrees(np.unwrap(np.angle(response.model))), color=BLUE, ls="--")
        k = at(share, recording.t.size)
        top.set_title(f"t = {recording.t[k]:.1f} s, beta = {recording.beta[k]:.2f}")
        bottom.set(xlabel="frequency / Hz", xscale="log")
    axes[0, 0].set(ylabel="gain / dB (cm/s per % of opening)", ylim=(-25, 42))
    axes[1, 0].set(ylabel="phase / degrees", ylim=(-420, 40))
    figure.suptitle("The robust model, and the physics linearized about sliding without dry friction")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=80)
    plt.close(figure)
