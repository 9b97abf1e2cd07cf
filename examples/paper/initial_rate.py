"""The remark around (50)-(52): after a large innovation the realized psi' keeps the gain up; where does that help?

The package has the gain (50) already, as ``K`` of a `RobustKalmanFilter` with ``scaling="unit"``: P(k|k-1) H'. Here it
stands once more as the paper writes it, from one step to the next, and a test holds the two against each other.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from report import Claim, Options, Part, judged, markdown_table, ratio_interval, shown, together

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from state_estimation_study import FILTERS, VARIANCE, F, H, Setting, W, drawn, on_threads, simulate, study
from studies import Interval, monte_carlo, stacked

from robust_filterpy import Huber, RobustKalmanFilter

STEPS, OFFSETS, LARGE = 20, (0, 1, 2, 3, 5, 10), 2
START = Setting("x1 off", P0=0.5)
REALIZED, EXPECTED = "(47)-(49): psi' realized", "(42)-(45): psi' expected"


def gain(
    P: np.ndarray, psi_deriv: float, H_before: np.ndarray, F: np.ndarray, H: np.ndarray, W: np.ndarray
) -> np.ndarray:
    """Return K(k) of eq (50), shape (n, 1), from P(k-1|k-2) and psi' of the innovation of sample k-1.

    In print H(k) stands for H(k-1) within the bracket, and nu(k) for nu(k-1): K(k) is what multiplies psi(nu(k)).
    """
    corrected = P - P @ H_before.T @ H_before @ P * psi_deriv
    return F @ corrected @ F.T @ H.T + W @ H.T


def is_large(nu: np.ndarray | float, threshold: float) -> np.ndarray | bool:
    """Tell whether |nu| > k_eps, eq (51), where psi' = 0."""
    return np.abs(nu) > threshold


def gain_after_large(P: np.ndarray, F: np.ndarray, H: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return K(k) of eq (52): eq (50) where (51) holds for sample k-1."""
    return F @ P @ F.T @ H.T + W @ H.T


class Starts(NamedTuple):
    """Runs from starts with x1 so far off: squared errors of x1, gains, and whether (51) held."""

    squared: np.ndarray  # (2, runs, STEPS): realized, expected
    K: np.ndarray  # (2, runs, STEPS), first entry
    large: np.ndarray  # (runs, STEPS), with the realized psi'


def starts(offset: float, runs: int, seed: int) -> Starts:
    """Run both filters, which start at 0, on states that start with x1 = offset."""
    draws = stacked(monte_carlo(partial(drawn, setting=START, steps=STEPS), runs, seed))
    x0 = np.zeros_like(draws.x0)
    x0[:, 0] = offset
    states, z = simulate(draws._replace(x0=x0))
    influence = Huber.from_contamination(START.contamination)
    estimates, K, large = np.empty((2, *z.shape)), np.empty((2, *z.shape)), np.empty(z.shape, dtype=bool)
    for i, information in enumerate(("realized", "expected")):
        for run in range(runs):
            kf = RobustKalmanFilter(4, 1, influence=influence, scaling="unit", information=information)
            kf.x, kf.P, kf.F, kf.H, kf.Q, kf.R = np.zeros(4), START.P0 * np.eye(4), F, H, W, VARIANCE * np.eye(1)
            for k in range(STEPS):
                kf.predict()
                kf.update(z[run, k])
                estimates[i, run, k], K[i, run, k] = kf.x[0], kf.K[0, 0]
                if i == 0:
                    large[run, k] = is_large(kf.y.item(), influence.threshold)
    return Starts((estimates - states[..., 0]) ** 2, K, large)


def make(options: Options) -> Part:
    """Draw the gains and test where the realized psi' makes the first steps faster."""
    part = Part("Equations (50)-(52): the initial rate of convergence")
    found = {offset: starts(offset, options.runs, options.seed) for offset in OFFSETS}
    ratios = {offset: ratio_interval(*runs.squared.mean(axis=2), options.seed) for offset, runs in found.items()}
    rows = [
        [
            f"{offset}",
            f"{runs.large[:, :5].mean():.0%}",
            f"{(runs.K[0] / runs.K[1])[:, 1:].mean():.2f}",
            shown(ratios[offset]),
        ]
        for offset, runs in found.items()
    ]
    head = ["x1 off by", "(51) in steps 1-5", "K, realized over expected, steps 2-20", "MSE of x1, steps 1-20"]
    part.text.append(
        f"By (50) and (52) the gain of sample k is the larger, the fewer of the innovations before have been believed. "
        f"{options.runs} runs of eqs (31)-(34), contamination {START.contamination:g}, the filter at 0 with P0 = "
        f"{START.P0:g} I, the state's x1 off by so much; MSE as (47)-(49) over (42)-(45):\n\n"
        + markdown_table(head, rows)
    )
    part.save(figure(found, ratios), "initial_rate.png",
              "Gain (50) and first errors after starts with x1 off.", options)  # fmt: skip
    large = [offset for offset in OFFSETS if offset >= LARGE]
    criterion = f"MSE of x1 over the first {STEPS} steps, (47)-(49) over (42)-(45), below 1"
    part.claims.append(
        Claim(
            "(50)-(52)",
            "The realized psi' raises the initial rate of convergence where |nu| > k_eps (51).",
            f"{criterion} for every start with x1 {LARGE} or more off",
            ", ".join(f"{offset} off: {shown(ratios[offset])}" for offset in large),
            together(judged(ratios[offset], high=1.0) for offset in large),
            "The filter with the expected psi' was nearer from a start that it had to come back from.",
        )
    )
    usual = (
        study(Setting("as figures 3 and 4"), options.runs, STEPS, options.seed, on_threads(options.jobs))[..., 0] ** 2
    )
    pair = (usual[:, FILTERS.index(name)].mean(axis=1) for name in ("T=1,  realized", "T=1,  expected"))
    ratio = ratio_interval(*pair, options.seed)
    part.claims.append(
        Claim(
            "4",
            "It raises the initial rate of convergence from the start of figure 4, too.",
            f"{criterion}, x(0) ~ N(0, 0.1 I)",
            shown(ratio),
            judged(ratio, high=1.0),
            "Few innovations meet (51) there; one below the threshold has psi' = 1, above E[psi'], and makes the next "
            "gain smaller.",
        )
    )
    return part


def figure(found: dict[int, Starts], ratios: dict[int, Interval]) -> plt.Figure:
    """Draw the mean gain over the first steps, and the ratio of errors by how far the start is off."""
    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    steps = np.arange(1, STEPS + 1)
    for offset, color in ((0, "0.6"), (3, "tab:blue"), (10, "navy")):
        left.plot(steps, found[offset].K[0].mean(axis=0), color=color, label=f"{REALIZED}, x1 {offset} off")
    left.plot(steps, found[0].K[1].mean(axis=0), color="black", linestyle=":", label=f"{EXPECTED}, any start")
    left.set(
        xlabel="step k", ylabel="gain K(k) of x1", title="mean gain, eq (50)", ylim=(0, 0.85), xticks=range(0, 21, 5)
    )
    left.set_xticks(range(0, STEPS + 1, 5))
    left.legend(fontsize=8, loc="upper right")
    middle = np.array([interval.estimate for interval in ratios.values()])
    ends = np.array([[x.estimate - x.low, x.high - x.estimate] for x in ratios.values()]).T
    right.errorbar(
        list(ratios), middle, ends, color="black", marker="o", markersize=4, capsize=3, label="95 % interval"
    )
    right.axhline(1.0, color="0.7", linewidth=0.8)
    right.set(xlabel="x1 off by", ylabel="MSE, realized over expected", title=f"first {STEPS} steps", ylim=(0, 1.3))
    right.legend(fontsize=8)
    return fig
