"""Figures 8-19: measured output, estimates of a_i and b_i, and their error beside the bounds."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from identification import (
    INNOVATION,
    KALMAN,
    KALMAN_TOTAL,
    LABELS,
    LITERAL,
    STEPS,
    TRACKERS,
    Limits,
    Run,
    squared,
    staying,
)

from robust_filterpy.plotting import LOOKS

STYLE = {
    KALMAN: LOOKS["Kalman"],
    KALMAN_TOTAL: {**LOOKS["Kalman"], "linestyle": "-.", "linewidth": 0.9},
    LITERAL: dict(color="tab:cyan", linestyle="-"),
    INNOVATION: LOOKS["Huber"],
    LABELS: dict(color="black", linestyle=":"),
}


def output_figure(run: Run, title: str) -> plt.Figure:
    """Draw the measured output of one run (figures 8, 12, 16)."""
    figure, axis = plt.subplots(figsize=(6.4, 3), layout="constrained")
    axis.plot(run.y[0], color="black", linewidth=0.6, label="measured output y(k)")
    axis.plot(run.y_clean[0], color="tab:orange", linewidth=1.0, label="without noise")
    axis.set(xlabel="sample k", ylabel="output", title=title)
    axis.legend(fontsize=8)
    return figure


def estimates_figure(run: Run, columns: slice, letter: str) -> plt.Figure:
    """Draw the estimates of four parameters in one run (figures 9, 10, 13, 14, 17, 18)."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 5.2), sharex=True, layout="constrained")
    for i, axis in enumerate(axes.flat):
        for name in (LITERAL, KALMAN):
            path = run.estimates[0, TRACKERS.index(name), :, columns][:, i]
            axis.plot(path, label=name, linewidth=1.2, **STYLE[name])
        axis.plot(run.theta[0, :, columns][:, i], color="black", linestyle=":", label="true")
        axis.set(ylabel=f"{letter}{i + 1}")
    for axis in axes[1]:
        axis.set_xlabel("sample k")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def error_figure(studies: list[tuple[str, Run, Limits]]) -> plt.Figure:
    """Draw the log squared error (figures 11, 15, 19): one run of the first study, and every study's medians."""
    figure, axes = plt.subplots(
        1, 1 + len(studies), figsize=(4.6 * (1 + len(studies)), 4.6), sharey=True, layout="constrained"
    )
    _paths(axes[0], "one run, " + studies[0][0], *studies[0][1:], one=True)
    for axis, (title, run, limits) in zip(axes[1:], studies, strict=True):
        _paths(axis, f"median and quartiles of {len(run.y)} runs, {title}", run, limits, one=False)
    axes[0].set_ylabel("ln ||theta_hat - theta||^2")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2 + len(studies), frameon=False
    )
    return figure


def _paths(axis: plt.Axes, title: str, run: Run, limits: Limits, one: bool) -> None:
    """Draw the trackers' errors, that of staying at the prior's mean, and the bounds."""
    logs = np.log(squared(run))
    for name, style in STYLE.items():
        values = logs[:, TRACKERS.index(name)]
        if np.isnan(values).all():
            continue
        low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75], axis=0)
        axis.plot(values[0] if one else middle, label=name, **style)
        if not one and name in (KALMAN, LITERAL, INNOVATION):
            axis.fill_between(np.arange(STEPS), low, high, color=style["color"], alpha=0.12, linewidth=0)
    still = np.log(staying(run))
    axis.plot(still[0] if one else np.median(still, axis=0), color="tab:purple", linewidth=1, label="stay at the start")
    axis.plot(np.log(limits.bayesian), color="tab:red", linewidth=1, label="Bayesian bound (with prior)")
    axis.axhline(
        2 * np.log(limits.without_prior), color="tab:red", linestyle="--", linewidth=1,
        label="Cramer-Rao bound, still theta, no prior",
    )  # fmt: skip
    axis.set(xlabel="sample k", title=title)
    axis.title.set_size(10)
