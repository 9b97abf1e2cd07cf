"""Figures 2-4: Huber's function, and the state-estimation problem (31)-(34) with its four robust filters.

Problem, filters and study are those of ``examples/state_estimation_study.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from report import Claim, Options, Part, geometric_ratio, judged, markdown_table, ratio_interval, shown

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from state_estimation_study import FILTERS, KALMAN, LABELS, Setting, on_threads, study

from robust_filterpy import Huber
from robust_filterpy.plotting import LOOKS

STEPS = 200
USUAL, UNCERTAIN = Setting("contamination 0.1"), Setting("P0 = 10 I", P0=10.0)
T_EXPECTED, T_REALIZED, UNIT_EXPECTED, UNIT_REALIZED = FILTERS[2:6]
STYLE = {
    KALMAN: {**LOOKS["Kalman"], "linewidth": 1.2, "label": "Kalman, nominal R"},
    LABELS: dict(color="black", linestyle=":", linewidth=1.6, label="Kalman, outliers known"),
    T_EXPECTED: {**LOOKS["Huber"], "linewidth": 1.6, "label": "(37)-(41): T(k), expected psi'"},
    T_REALIZED: {**LOOKS["Huber"], "linewidth": 1.6, "label": "T(k), realized psi'"},
    UNIT_EXPECTED: dict(color="tab:cyan", linestyle="-.", linewidth=1.6, label="(42)-(45): T = 1, expected psi'"),
    UNIT_REALIZED: dict(color="tab:cyan", linestyle="-", linewidth=1.2, label="(47)-(49): T = 1, realized psi'"),
}
COMPARED = {3: (KALMAN, T_EXPECTED, UNIT_EXPECTED, LABELS), 4: (KALMAN, T_EXPECTED, UNIT_REALIZED, LABELS)}


def make(options: Options) -> Part:
    """Draw figures 2-4 and test T = 1 and the realized psi' on the state-estimation problem."""
    part = Part("Figures 2-4: state estimation")
    if options.wants(2):
        caption = "Huber's function and its derivative; k = 1.14 is the threshold for contamination 0.1."
        part.save(influence_figure(), "fig02.png", caption, options)
    if not options.wants(3, 4):
        return part
    errors = study(USUAL, options.runs, STEPS, options.seed, on_threads(options.jobs))
    for number, names in COMPARED.items():
        if options.wants(number):
            caption = f"One run as in the paper, and median with quartile band of {options.runs} runs."
            part.save(error_figure(errors, names), f"fig{number:02d}.png", caption, options)
    x1, total = errors[..., 0] ** 2, np.sum(errors**2, axis=-1)
    part.text.append(table(x1, total, options))
    part.claims += claims(x1, total, options)
    part.claims.append(broken_unit(options))
    return part


def by_name(squared: np.ndarray, name: str, steps: slice = slice(None)) -> np.ndarray:
    """Return the mean over some steps of one filter's squared error, run by run."""
    return squared[:, FILTERS.index(name), steps].mean(axis=1)


def table(x1: np.ndarray, total: np.ndarray, options: Options) -> str:
    """Say what every filter's mean-square error is, beside the filter that knows the outliers."""
    rows = []
    for name in FILTERS:
        ratio = ratio_interval(by_name(x1, name), by_name(x1, LABELS), options.seed)
        rows.append([name, f"{by_name(x1, name).mean():.4f}", shown(ratio), f"{by_name(total, name).mean():.3f}"])
    head = ["filter", "MSE of x1", "relative to outliers known (95 %)", "MSE of all four"]
    return (
        f"{options.runs} runs of {STEPS} steps, P0 = 0.1 I (our choice). x3 and x4 hardly show in y, so that "
        "the error of all four states is much the same for every filter; the claims are tested on it, as the figures "
        "draw it, and on x1 alone.\n\n" + markdown_table(head, rows)
    )


def claims(x1: np.ndarray, total: np.ndarray, options: Options) -> list[Claim]:
    """Test what section 3.1 says of the two heuristics."""

    def claim(figures: str, text: str, squared: np.ndarray, pair: tuple[str, str], what: str, high: float) -> Claim:
        interval = ratio_interval(*(by_name(squared, name) for name in pair), options.seed)
        limit = "below 1" if high == 1.0 else f"at most {high:g}"
        why = (
            "Without T(k) the gain is P H' where it should be P H'/S with S near .12, and psi clips at 1.14 in the "
            "unit of y, which is 3.6 deviations of the ordinary noise."
        )
        return Claim(figures, text, f"{what}, {limit}", shown(interval), judged(interval, high=high), why)

    return [
        claim("3", "T(k) = 1 loses nothing.", total, (UNIT_EXPECTED, T_EXPECTED),
              "MSE of all four states, as the figure draws it, (42)-(45) over (37)-(41)", 1.1),
        claim("3", "T(k) = 1 loses nothing for the state that y shows, either.", x1, (UNIT_EXPECTED, T_EXPECTED),
              "MSE of x1, (42)-(45) over (37)-(41)", 1.1),
        claim("4", "T(k) = 1 with the realized psi' loses nothing.", total, (UNIT_REALIZED, T_EXPECTED),
              "MSE of all four states, as the figure draws it, (47)-(49) over (37)-(41)", 1.1),
        claim("4", "It loses nothing for the state that y shows, either.", x1, (UNIT_REALIZED, T_EXPECTED),
              "MSE of x1, (47)-(49) over (37)-(41)", 1.1),
        claim("3, 4", "The robust filter beats the Kalman filter at contamination 0.1.", x1, (UNIT_REALIZED, KALMAN),
              "MSE of x1, (47)-(49) over Kalman with nominal R", 1.0),
    ]  # fmt: skip


def broken_unit(options: Options) -> Claim:
    """Count the runs in which T = 1 would make P indefinite from an uncertain start."""
    errors = study(UNCERTAIN, options.runs, STEPS, options.seed, on_threads(options.jobs))
    x1 = errors[..., 0] ** 2
    refused = int(np.isnan(by_name(x1, UNIT_REALIZED)).sum())
    ratio = geometric_ratio(by_name(x1, T_REALIZED), by_name(x1, LABELS), options.seed)
    return Claim(
        "3, 4, 15", "T(k) = 1 can take the place of T(k) from any start.",
        "P stays positive definite in every run from P0 = 10 I",
        f"P turns indefinite in {refused} of {options.runs} runs; with T(k) it never does, and the MSE of x1 is "
        f"{shown(ratio)} times that with the outliers known",
        refused == 0,
        "(49) takes P H'H P away without dividing by S: what is left is no covariance once H P H' exceeds 1. The same "
        "happens to the tracker on the plant where theta can be identified, from P0 = I (tables below).",
    )  # fmt: skip


def influence_figure() -> plt.Figure:
    """Draw figure 2."""
    huber = Huber.from_contamination(0.1)
    k = huber.threshold
    e = np.linspace(-3, 3, 1201)
    figure, axes = plt.subplots(1, 2, figsize=(7.6, 3.2), layout="constrained")
    axes[0].plot(e, huber.psi(e), color="black", label="Huber's psi")
    axes[0].plot(e, e, color="0.6", linestyle="--", label="Kalman filter")
    # A line drawn across the jump would be a slope that psi' does not have.
    derivative = np.where(np.abs(np.abs(e) - k) < 3e-3, np.nan, huber.psi_deriv(e))
    axes[1].plot(e, derivative, color="black", label="Huber's psi'")
    axes[0].set(title="(a) psi", ylabel="psi(e)")
    axes[1].set(title="(b) derivative of psi", ylabel="psi'(e)", ylim=(-0.1, 1.3))
    for axis in axes:
        axis.set(xlabel="standardized innovation e")
        axis.axvline(-k, color="0.75", linewidth=0.8)
        axis.axvline(k, color="0.75", linewidth=0.8, label=f"+-k = {k:.2f}")
        axis.legend(fontsize=8)
    return figure


def error_figure(errors: np.ndarray, names: tuple[str, ...]) -> plt.Figure:
    """Draw ln ||error||^2 of the observed state and of all four, for one run and over all runs."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.2), sharex=True, layout="constrained")
    k = np.arange(1, STEPS + 1)
    for column, what in enumerate(("one run", f"median and quartiles of {len(errors)} runs")):
        for row, components in enumerate((slice(0, 4), slice(0, 1))):
            axis = axes[row, column]
            for name in names:
                i = FILTERS.index(name)
                if column == 0:
                    axis.plot(k, np.log(np.sum(errors[0, i, :, components] ** 2, axis=-1)), **STYLE[name])
                    continue
                logs = np.log(np.sum(errors[:, i, :, components] ** 2, axis=-1))
                low, middle, high = np.nanquantile(logs, [0.25, 0.5, 0.75], axis=0)
                axis.plot(k, middle, **STYLE[name])
                if name in (KALMAN, names[2]):
                    axis.fill_between(k, low, high, color=STYLE[name]["color"], alpha=0.15, linewidth=0)
            axis.set_ylabel("ln squared error, " + ("all states" if row == 0 else "x1"))
            if row == 0:
                axis.set_title(what)
            else:
                axis.set_xlabel("step k")
    # The logarithm of one error dips without end where the error passes through zero.
    for row in axes:
        for axis in row:
            axis.set_ylim(bottom=max(axis.get_ylim()[0], -9))
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure
