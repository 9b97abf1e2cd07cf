"""Figures 8-19 with their claims: section 4 of the paper, and the same on a plant where theta can be told."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from identification import (
    BOUNDED,
    INNOVATION,
    KALMAN,
    KALMAN_TOTAL,
    LABELS,
    LITERAL,
    SECTION4,
    STEPS,
    TRACKERS,
    UNIT_EXPECTED,
    WELL,
    Limits,
    Plant,
    Run,
    bounds,
    trial,
)
from report import Claim, Options, Part, geometric_ratio, judged, markdown_table, shown

from robust_filterpy.experiments import monte_carlo

FIRST_FIGURE = {0.05: 8, 0.1: 12, 0.15: 16}
EARLY, LATE = slice(0, 100), slice(500, None)
STYLE = {
    KALMAN: dict(color="0.55", linestyle="-."),
    KALMAN_TOTAL: dict(color="tab:orange", linestyle="--"),
    LITERAL: dict(color="navy", linestyle="-"),
    INNOVATION: dict(color="tab:green", linestyle=(0, (5, 1))),
    LABELS: dict(color="black", linestyle=":"),
}
STUDIED = (KALMAN, LITERAL, BOUNDED, INNOVATION)


def study(plant: Plant, runs: int, options: Options, trackers: tuple[str, ...] = TRACKERS) -> Run:
    """Run a plant many times; every field gets a first axis of runs."""
    results = monte_carlo(partial(trial, plant=plant, trackers=trackers), runs, options.seed, options.jobs).results
    return Run(*(np.array(column) for column in zip(*results, strict=True)))


def squared(run: Run) -> np.ndarray:
    """Return ||theta_hat - theta||^2, shape (runs, trackers, steps)."""
    return np.sum((run.estimates - run.theta[:, None]) ** 2, axis=-1)


def make(options: Options) -> Part:
    """Draw figures 8-19 and test what section 4 says of them."""
    part = Part("Figures 8-19: the output-error model of section 4")
    found = {}
    for contamination, first in FIRST_FIGURE.items():
        if options.wants(*range(first, first + 4)):
            plant = replace(SECTION4, contamination=contamination)
            found[contamination] = run = study(plant, options.runs, options)
            limits = bounds(run.information, plant)
            _figures(part, run, plant, limits, first, options)
            part.text.append(_table(run, plant, limits))
    if options.only is None:
        plant = replace(SECTION4, contamination=0.0)
        found[0.0] = study(plant, options.runs, options)
        part.text.append(_table(found[0.0], plant, bounds(found[0.0].information, plant)))
        part.claims += _claims(found, SECTION4, options)
        well = {}
        for contamination in (0.0, 0.05, 0.1, 0.15):
            plant = replace(WELL, contamination=contamination)
            well[contamination] = run = study(plant, options.runs, options)
            limits = bounds(run.information, plant)
            part.text.append(_table(run, plant, limits))
            if contamination == WELL.contamination:
                caption = "The plant where theta can be told."
                part.save(_error_figure(run, limits), "well_conditioned.png", caption, options)
        part.claims += _claims(well, WELL, options, INNOVATION)
        part.text.append(_sensitivity(options))
    return part


def _figures(part: Part, run: Run, plant: Plant, limits: Limits, first: int, options: Options) -> None:
    """Save output, a_i, b_i and error of one contamination."""
    level = f"contamination {plant.contamination:g}"
    if options.wants(first):
        figure, axis = plt.subplots(figsize=(6.4, 3), layout="constrained")
        axis.plot(run.y[0], color="black", linewidth=0.6, label="measured output")
        axis.set(xlabel="sample k", ylabel="y(k)", title=level)
        axis.legend()
        part.save(figure, f"fig{first:02d}.png", f"Measured output, {level}.", options)
    for offset, columns, letter in ((1, slice(0, 4), "a"), (2, slice(4, 8), "b")):
        if options.wants(first + offset):
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
            part.save(figure, f"fig{first + offset:02d}.png", f"Estimates of {letter}_i, one run, {level}.", options)
    if options.wants(first + 3):
        caption = f"ln ||theta_hat - theta||^2, {level}, with the Bayesian bound (prior) and the Cramer-Rao bound."
        part.save(_error_figure(run, limits), f"fig{first + 3:02d}.png", caption, options)


def _error_figure(run: Run, limits: Limits) -> plt.Figure:
    """Draw the log squared error of one run and of all, beside the bounds."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.6), sharey=True, layout="constrained")
    logs = np.log(squared(run))
    bound, without_prior = limits
    for column, axis in enumerate(axes):
        for name, style in STYLE.items():
            values = logs[:, TRACKERS.index(name)]
            if np.isnan(values).all():
                continue
            low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75], axis=0)
            axis.plot(values[0] if column == 0 else middle, label=name, **style)
            if column == 1 and name in (KALMAN, LITERAL, INNOVATION):
                axis.fill_between(np.arange(STEPS), low, high, color=style["color"], alpha=0.15, linewidth=0)
        axis.plot(np.log(bound), color="tab:red", linewidth=1, label="Bayesian bound (with prior)")
        axis.axhline(2 * np.log(without_prior), color="tab:red", linestyle="--", linewidth=1,
                     label="Cramer-Rao bound, 1000 samples, no prior")  # fmt: skip
        axis.set(xlabel="sample k", title="one run" if column == 0 else f"median and quartiles of {len(logs)} runs")
    axes[0].set_ylabel("ln ||theta_hat - theta||^2")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _table(run: Run, plant: Plant, limits: Limits) -> str:
    """Say what every tracker did at one contamination."""
    error = np.sqrt(squared(run)[:, :, LATE].mean(axis=2))
    bound, without_prior = limits
    rows = []
    for i, name in enumerate(TRACKERS):
        refused = int(np.isnan(error[:, i]).sum())
        if refused == len(error):
            rows.append([name, "-", "-", "-", f"{refused} of {len(error)}"])
            continue
        middle = [np.nanmedian(values[:, i]) for values in (error, run.output_fit, run.response_error)]
        rows.append([name, f"{middle[0]:.3f}", f"{middle[1]:.1f} %", f"{middle[2]:.3f}", f"{refused} of {len(error)}"])
    head = ["tracker", "||theta_hat - theta||", "fit to noise-free output", "frequency response", "P indefinite"]
    return (
        f"**{plant.name}, contamination {plant.contamination:g}**: medians of {len(error)} runs over samples 500-1000. "
        f"Cramer-Rao bound of ||theta_hat - theta|| without a prior (median): {without_prior:.3f}; Bayesian "
        f"bound with the prior: {bound[-1] ** 0.5:.3f}. An error far below the first comes from the "
        f"prior, not from the data.\n\n{markdown_table(head, rows)}"
    )


def _claims(found: dict[float, Run], plant: Plant, options: Options, robust: str = LITERAL) -> list[Claim]:
    """Compare the squared error of the trackers, run by run."""

    def ratio(contamination: float, numerator: str, denominator: str, steps: slice = LATE) -> object:
        error = squared(found[contamination])[:, :, steps].mean(axis=2)
        pair = error[:, TRACKERS.index(numerator)], error[:, TRACKERS.index(denominator)]
        done = np.isfinite(pair[0]) & np.isfinite(pair[1])
        return geometric_ratio(pair[0][done], pair[1][done], options.seed) if done.sum() > 1 else None

    claims = []

    def claim(figures: str, text: str, criterion: str, interval: object, **limits: float) -> None:
        measured = "refused (P indefinite)" if interval is None else shown(interval)
        holds = False if interval is None else judged(interval, **limits)
        place = figures if plant.name == SECTION4.name else plant.name
        claims.append(Claim(place, f"{text} ({plant.name})", f"squared error, {criterion}", measured, holds))

    for contamination in (0.05, 0.1, 0.15):
        for baseline in (KALMAN, KALMAN_TOTAL):
            claim(str(FIRST_FIGURE[contamination] + 3), f"Robust is better at contamination {contamination:g}.",
                  f"{robust} over {baseline}, below 1", ratio(contamination, robust, baseline), high=1.0)  # fmt: skip
    steps = [ratio(c, KALMAN, robust) for c in (0.05, 0.15)]
    if None not in steps:
        apart = True if steps[1].low > steps[0].high else False if steps[1].high < steps[0].low else None
        claims.append(Claim("11, 15, 19", f"The superiority is greater at higher contamination. ({plant.name})",
                            "squared error, Kalman over robust: interval at .15 above that at .05",
                            f"{shown(steps[0])} at .05, {shown(steps[1])} at .15", apart))  # fmt: skip
    claim("Remark 3", "Similar to the Kalman filter under Gaussian noise.", f"{robust} over {KALMAN}, .9 to 1.1",
          ratio(0.0, robust, KALMAN), low=0.9, high=1.1)  # fmt: skip
    claim("15", "T(k) = 1 loses nothing.", f"{LITERAL} over {INNOVATION}, at most 1.05",
          ratio(0.1, LITERAL, INNOVATION), high=1.05)  # fmt: skip
    claim("15", "The realized psi' raises the initial rate of convergence.",
          f"samples 1-100, {LITERAL} over {UNIT_EXPECTED}, below 1",
          ratio(0.1, LITERAL, UNIT_EXPECTED, EARLY), high=1.0)  # fmt: skip
    return claims


def _sensitivity(options: Options) -> str:
    """Show what W and P0, lost or open in the text, do."""
    rows, runs = [], max(2, options.runs // 3)
    for Q in (1e-7, 1e-6, 1e-5):
        for P0 in (0.01, 0.1, 1.0):
            plant = replace(SECTION4, Q=Q, P0=P0)
            error = np.sqrt(squared(study(plant, runs, options, STUDIED))[:, :, LATE].mean(axis=2))
            cells = []
            for i in range(len(STUDIED)):
                refused = int(np.isnan(error[:, i]).sum())
                value = "-" if refused == runs else f"{np.nanmedian(error[:, i]):.3f}"
                cells.append(value + (f" (P indefinite in {refused} of {runs})" if refused else ""))
            rows.append([f"{Q:g}", f"{P0:g}", *cells])
    return (
        f"**Sensitivity to W and P0**, section 4, contamination 0.1, {runs} runs, median ||theta_hat - theta|| over "
        "samples 500-1000. P0 is the prior of theta(0) as well as P(0). Where the literal form breaks, the bounded and "
        f"the T(k) form stand beside it.\n\n{markdown_table(['W / I', 'P0 / I', *STUDIED], rows)}"
    )
