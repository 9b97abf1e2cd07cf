"""What every part of the reproduction hands over, and the report that is made of it."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from studies import Interval, bootstrap_interval, ratio

RESAMPLES = 1999


@dataclass(frozen=True)
class Options:
    """What the command line asked for."""

    runs: int
    seed: int
    jobs: int
    out: Path
    only: frozenset[int] | None = None

    def wants(self, *numbers: int) -> bool:
        """Tell whether any of these figures is wanted."""
        return self.only is None or not self.only.isdisjoint(numbers)


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper put to the test."""

    figures: str
    claim: str
    criterion: str
    measured: str
    holds: bool | None  # None: the runs do not decide
    reason: str = ""  # why it does not hold, if it does not

    @property
    def verdict(self) -> str:
        """Say what the numbers say."""
        return {True: "holds", False: "does not hold", None: "undecided"}[self.holds]

    def row(self) -> list[str]:
        """Return the line of the table; a claim that does not hold says why."""
        why = f": {self.reason}" if self.holds is False else ""
        return [self.figures, self.claim, self.criterion, self.measured, f"**{self.verdict}**{why}"]


@dataclass
class Part:
    """Figures, claims and further text of one part of the report."""

    title: str
    text: list[str] = field(default_factory=list)
    figures: list[tuple[str, str]] = field(default_factory=list)  # (file name, caption)
    claims: list[Claim] = field(default_factory=list)

    def save(self, figure: Any, name: str, caption: str, options: Options) -> None:
        """Write a figure as PNG and remember its caption."""
        import matplotlib.pyplot as plt
        from PIL import Image

        whole = io.BytesIO()
        figure.savefig(whole, dpi=80)
        plt.close(figure)
        # A palette makes a third of the file: the repository keeps these figures.
        Image.open(whole).convert("RGB").quantize(kmeans=8).save(options.out / name, optimize=True)
        self.figures.append((name, caption))


def ratio_interval(numerator: Any, denominator: Any, seed: int) -> Interval:
    """Return the ratio of the means over the same runs, with its 95 percent interval."""
    pair = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    return bootstrap_interval(pair, ratio, seed, RESAMPLES, "percentile")


def geometric_ratio(numerator: Any, denominator: Any, seed: int) -> Interval:
    """Return exp(mean log ratio) over the same runs: no run that went astray decides alone."""
    logs = np.log(np.asarray(numerator, dtype=float)) - np.log(np.asarray(denominator, dtype=float))
    found = bootstrap_interval(logs, np.mean, seed, RESAMPLES, "percentile")
    middle, low, high = np.exp(found[:3])
    return Interval(middle, low, high, middle * found.standard_error)


def shown(interval: Interval, digits: int = 2) -> str:
    """Write an interval as 'estimate (low .. high)'."""
    return f"{interval.estimate:.{digits}f} ({interval.low:.{digits}f} .. {interval.high:.{digits}f})"


def judged(interval: Interval, low: float = -np.inf, high: float = np.inf) -> bool | None:
    """Tell whether the whole interval is inside (low, high): True, outside: False, across an end: None."""
    if low <= interval.low and interval.high <= high:
        return True
    return False if interval.high < low or interval.low > high else None


def together(verdicts: Iterable[bool | None]) -> bool | None:
    """Join verdicts: False if one is, else undecided if one is, else True."""
    found = list(verdicts)
    return False if False in found else None if None in found else True


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def write_report(parts: Sequence[Part], choices: str, options: Options, command: str) -> Path:
    """Write report.md: the claims first, then what was chosen, then the parts."""
    claims = [claim for part in parts for claim in part.claims]
    head = ["figure", "claim", "criterion", "measured (95 % interval)", "verdict"]
    table = markdown_table(head, (claim.row() for claim in claims))
    text = [
        "# Robust identification of pneumatic servo actuators in the real situations: the figures and claims, repeated",
        f"Written by `{command}`. The same seed gives the same report, whatever the number of jobs.",
        "## What the text leaves open, and what was chosen",
        choices,
        "## Claims",
        table if claims else "(none for the figures asked for)",
    ]
    for part in parts:
        text += [f"## {part.title}", *part.text]
        text += [f"![{name}]({name})\n\n*{caption}*" for name, caption in part.figures]
    path = options.out / "report.md"
    path.write_text("\n\n".join(text) + "\n", encoding="utf-8")
    return path
