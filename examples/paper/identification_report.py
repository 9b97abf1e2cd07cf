"""Figures 8-19 with their claims: section 4 of the paper, with both readings of its lost W, and a plant to learn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from identification import (
    INNOVATION,
    KALMAN,
    KALMAN_TOTAL,
    LABELS,
    LITERAL,
    SECTION4,
    UNIT_EXPECTED,
    WELL,
    Run,
    bounds,
    squared,
)
from identification_figures import error_figure, estimates_figure, output_figure
from identification_tables import (
    LATE,
    READINGS,
    STAY,
    Found,
    about_w,
    errors_of,
    ratio_of,
    sensitivity,
    study,
    table,
)
from report import Claim, Options, Part, geometric_ratio, judged, shown, together
from studies import Interval

FIRST_FIGURE = {0.05: 8, 0.1: 12, 0.15: 16}
LEVELS = (0.0, *FIRST_FIGURE)
EARLY = slice(0, 100)
MAIN = "W = 1e-4 I"

BETTER = "The robust filter is better than the Kalman filter (given the ordinary noise)."
ALSO_BETTER = "It is also better than a Kalman filter that is given the variance of all the noise."
NO_WORSE = "Under Gaussian noise it is no worse than the Kalman filter."
CONTRARY = "The runs say the contrary of the paper's, and of all runs before: look for a mistake here first."


def make(options: Options) -> Part:
    """Draw figures 8-19 and test what section 4 says of them."""
    part = Part("Figures 8-19: the output-error model of section 4")
    levels = [level for level, first in FIRST_FIGURE.items() if options.wants(*range(first, first + 4))]
    if options.only is None:
        levels = list(LEVELS)
    found: dict[str, Found] = {reading: {} for reading in READINGS}
    for level in levels:
        for reading, plant in READINGS.items():
            found[reading][level] = study(replace(plant, contamination=level), options.runs, options)
        if level:
            _figures(part, {reading: runs[level] for reading, runs in found.items()}, level, options)
    if options.only is not None:
        return part
    part.text.append(about_w(found))
    well = {level: study(replace(WELL, contamination=level), options.runs, options) for level in LEVELS}
    limits = bounds(well[0.1].information, WELL)
    part.save(error_figure([("contamination 0.1", well[0.1], limits)]), "well_conditioned.png",
              "The plant where theta can be identified, contamination 0.1.", options)  # fmt: skip
    for level in LEVELS:
        part.text.append(table(level, found, well[level]))
    white = study(replace(SECTION4, white=True), options.runs, options, (LITERAL, LABELS))
    part.claims += [*_claims(found, options), _input_claim(found[MAIN][0.1], white, options)]
    part.claims += _well_claims(well, options)
    part.text.append(sensitivity(options))
    return part


def _figures(part: Part, runs: dict[str, Run], level: float, options: Options) -> None:
    """Save output, a_i, b_i and error at one contamination."""
    first, run, title = FIRST_FIGURE[level], runs[MAIN], f"contamination {level:g}, {MAIN}"
    if options.wants(first):
        part.save(output_figure(run, title), f"fig{first:02d}.png", f"Measured output, {title}.", options)
    for offset, columns, letter in ((1, slice(0, 4), "a"), (2, slice(4, 8), "b")):
        if options.wants(first + offset):
            figure, caption = estimates_figure(run, columns, letter), f"Estimates of {letter}_i, one run, {title}."
            part.save(figure, f"fig{first + offset:02d}.png", caption, options)
    if options.wants(first + 3):
        studies = [
            (reading, runs[reading], bounds(runs[reading].information, replace(plant, contamination=level)))
            for reading, plant in READINGS.items()
        ]
        caption = (
            f"ln ||theta_hat - theta||^2, contamination {level:g}, with both readings of W, beside an estimate that "
            "stays at theta-bar, the Bayesian bound (with the prior) and the Cramer-Rao bound (theta still, no prior)."
        )
        part.save(error_figure(studies), f"fig{first + 3:02d}.png", caption, options)


def _claims(found: dict[str, Found], options: Options) -> list[Claim]:
    """Test what section 4 says, with the main reading of W; the other's numbers stand beside."""
    seed = options.seed

    def claim(figures: str, text: str, criterion: str, ratios: Callable[[Found], dict], high: float, why: str) -> Claim:
        main = ratios(found[MAIN])
        holds = together(judged(interval, high=high) for interval in main.values())
        beside = (f"with {name}: {_listed(ratios(runs))}" for name, runs in found.items() if name != MAIN)
        return Claim(figures, text, f"squared error, {criterion}", "; ".join((_listed(main), *beside)), holds, why)

    def each(denominator: str) -> Callable[[Found], dict]:
        return lambda runs: {f"at {c:g}": ratio_of(runs[c], LITERAL, denominator, seed) for c in FIRST_FIGURE}

    def at(level: float, denominator: str, steps: slice = LATE) -> Callable[[Found], dict]:
        return lambda runs: {"": ratio_of(runs[level], LITERAL, denominator, seed, steps)}

    every = "below 1 at every contamination"
    grown = {name: [ratio_of(runs[c], KALMAN, LITERAL, seed) for c in (0.05, 0.15)] for name, runs in found.items()}
    beside = "".join(f"; with {name}: {_pair(steps)}" for name, steps in grown.items() if name != MAIN)
    slower = (
        "With T = 1 the gain is P phi where the Kalman filter has P phi / S, and S is .1 to .2: the filter moves less."
    )
    return [
        claim("9-10, 13-14, 17-18", "The estimates follow the parameters.",
              f"{LITERAL} over staying at theta-bar, {every}", each(STAY), 1.0, "The prior tells more than the data."),
        claim("11, 15, 19", BETTER, f"{LITERAL} over {KALMAN}, {every}", each(KALMAN), 1.0, CONTRARY),
        claim("11, 15, 19", ALSO_BETTER, f"{LITERAL} over {KALMAN_TOTAL}, {every}", each(KALMAN_TOTAL), 1.0, CONTRARY),
        _growth("11, 15, 19", grown[MAIN], beside),
        claim("Remark 3", NO_WORSE, f"{LITERAL} over {KALMAN} without outliers, at most 1.1", at(0.0, KALMAN), 1.1,
              slower),
        claim("15", "T(k) = 1 loses nothing.", f"{LITERAL} over {INNOVATION}, at most 1.1", at(0.1, INNOVATION), 1.1,
              slower),
        claim("15", "The realized psi' raises the initial rate of convergence, from the prior of section 4.",
              f"samples 1-100, {LITERAL} over {UNIT_EXPECTED}, below 1", at(0.1, UNIT_EXPECTED, EARLY), 1.0,
              "Outliers alone meet (51): the prior's mean is wrong by less than the threshold, 1.14 in the unit of y."),
    ]  # fmt: skip


def _listed(ratios: dict[str, Interval]) -> str:
    """Write intervals with what they belong to."""
    return ", ".join(f"{what} {shown(interval)}".strip() for what, interval in ratios.items())


def _pair(steps: list[Interval]) -> str:
    """Write the advantage at the least and at the largest contamination."""
    return f"{shown(steps[0])} at .05, {shown(steps[1])} at .15"


def _growth(figures: str, steps: list[Interval], beside: str = "") -> Claim:
    """Test whether the advantage grows with the contamination."""
    apart = True if steps[1].low > steps[0].high else False if steps[1].high < steps[0].low else None
    criterion = "squared error, Kalman of the ordinary noise over robust: interval at .15 above that at .05"
    text = "The superiority is greater at higher contamination."
    return Claim(figures, text, criterion, _pair(steps) + beside, apart, CONTRARY)


def _input_claim(pink: Run, white: Run, options: Options) -> Claim:
    """Test whether the designed input makes the estimates converge faster than a white binary one."""
    found = {}
    for i, name in enumerate((LITERAL, LABELS)):
        pair = np.array([errors_of(pink, name), squared(white)[:, i, LATE].mean(axis=1)])
        found[name] = geometric_ratio(*pair[:, np.isfinite(pair).all(axis=0)], options.seed)
    return Claim(
        "7",
        "The designed input raises the rate of convergence.",
        f"squared error, contamination 0.1, 1/f input over white +-1 input, below 1 with {LITERAL}",
        _listed({f"{name}:": interval for name, interval in found.items()}),
        judged(found[LITERAL], high=1.0),
        "The band from .5 to 2.5 rad/sample leaves out the plant's slow poles, at .16 rad/sample, where it responds "
        "most: the output is smaller, and tells less.",
    )


def _well_claims(well: Found, options: Options) -> list[Claim]:
    """Test the same on the plant where theta can be identified; T = 1 is no filter there, and is counted elsewhere."""

    def claim(text: str, denominator: str, levels: tuple[float, ...], high: float) -> Claim:
        ratios = {f"at {c:g}": ratio_of(well[c], INNOVATION, denominator, options.seed) for c in levels}
        holds = together(judged(interval, high=high) for interval in ratios.values())
        limit = "below 1" if high == 1.0 else f"at most {high:g}"
        criterion = f"squared error, {INNOVATION} over {denominator}, {limit}"
        return Claim(WELL.name, text, criterion, _listed(ratios), holds, CONTRARY)

    levels = tuple(FIRST_FIGURE)
    return [
        claim(BETTER, KALMAN, levels, 1.0),
        claim(ALSO_BETTER, KALMAN_TOTAL, levels, 1.0),
        _growth(WELL.name, [ratio_of(well[c], KALMAN, INNOVATION, options.seed) for c in (0.05, 0.15)]),
        claim(NO_WORSE, KALMAN, (0.0,), 1.1),
    ]
