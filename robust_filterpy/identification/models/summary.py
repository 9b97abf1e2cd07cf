"""The parameters of a model with their uncertainty, as a table to read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.results import intervals
from robust_filterpy.identification.models.time_axis import table

__all__ = ["Estimate", "Summary", "coloured", "facts_of_outputs", "summarized"]

_WIDTH: Final = 78


class Estimate(NamedTuple):
    """One parameter.

    Attributes
    ----------
    name : str
        Its name.
    estimate : float
        Its value.
    std : float
        Its standard deviation.
    z : float
        Estimate over standard deviation: how far from 0 it is; NaN where the estimate is held, and has none.
    lower, upper : float
        Ends of its interval.
    """

    name: str
    estimate: float
    std: float
    z: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Summary:
    """Parameters with their uncertainty, and what was found beside them.

    Attributes
    ----------
    title : str
        The structure.
    facts : dict of str to str
        What was found beside the parameters.
    rows : tuple of Estimate
        The parameters.
    level : float
        Probability of each interval.
    warning : str
        What makes the estimates doubtful; empty if nothing does.
    found : str
        What the recording has beside the model and its noise; empty if nothing.
    """

    title: str
    facts: dict[str, str]
    rows: tuple[Estimate, ...]
    level: float
    warning: str
    found: str = ""

    def to_text(self) -> str:
        """Return the table.

        Returns
        -------
        str
        """
        half = _WIDTH // 2 - 1
        cells = [f"{name + ':':<18}{value:>{half - max(len(name) + 1, 18)}}" for name, value in self.facts.items()]
        pairs = zip(cells[::2], [*cells[1::2], ""][: len(cells[::2])], strict=True)
        lower, upper = (f"{100 * edge:.4g} %" for edge in (0.5 - 0.5 * self.level, 0.5 + 0.5 * self.level))
        lines = [self.title.center(_WIDTH).rstrip(), "=" * _WIDTH, *(f"{a}  {b}".rstrip() for a, b in pairs)]
        lines += ["-" * _WIDTH, f"{'':<12}{'estimate':>14}{'std':>13}{'z':>11}{lower:>14}{upper:>14}", "-" * _WIDTH]
        for name, estimate, std, z, low, high in self.rows:
            # A parameter that is told, or stands at a bound, or was not estimated, has nothing to be doubted.
            short = f"{z:.1f}" if abs(z) < 1e6 else f"{z:.1e}"
            sure = f"{'held':>13}" if std == 0.0 else f"{std:>13.3g}{short:>11}{low:>14.5g}{high:>14.5g}"
            lines.append(f"{name:<12}{estimate:>14.5g}{sure}")
        words = {"Found": self.found, "Doubtful": self.warning}
        return "\n".join([*lines, "=" * _WIDTH, *(f"{name}: {text}" for name, text in words.items() if text)])

    def to_frame(self) -> Any:
        """Return the parameters as a pandas DataFrame, a row for each.

        Returns
        -------
        pandas.DataFrame
            estimate, std, z, lower, upper.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        columns = {field: [getattr(row, field) for row in self.rows] for field in Estimate._fields[1:]}
        return table(columns, [row.name for row in self.rows], "parameter")

    def __str__(self) -> str:
        """Return the table."""
        return self.to_text()

    def __repr__(self) -> str:
        """Return the table, which is what a prompt is to show."""
        return self.to_text()


def facts_of_outputs(weights: Array, log_likelihood: float, noise: tuple[Noise, ...], colour: float) -> dict[str, str]:
    """Return what a summary says of a model whose outputs have each a noise."""
    known = int((~np.isnan(weights)).sum())
    facts = {"Samples": f"{known} of {weights.size}", "Log-likelihood": f"{log_likelihood:.1f}"}
    for j, one in enumerate(noise):
        share = getattr(one.influence, "contamination", None)
        beside = "" if share is None else f", {100 * share:.1f} % wild"
        facts[f"Noise, output {j}"] = f"{np.sqrt(one.R):.4g}{beside}"
    return facts | coloured(colour)


def coloured(colour: float) -> dict[str, str]:
    """Return what a summary says of residuals that are not white."""
    return {} if colour == 1.0 else {"Colored residuals": f"std times {colour:.2g}"}


def summarized(
    title: str,
    facts: dict[str, str],
    names: tuple[str, ...],
    theta: Array,
    std: Array,
    level: float,
    warning: str,
    found: str = "",
) -> Summary:
    """Return the summary of parameters."""
    lower, upper = intervals(theta, std, level)
    z = np.divide(theta, std, out=np.full(np.shape(theta), np.nan), where=std != 0.0)
    columns = (column.tolist() for column in (theta, std, z, lower, upper))
    rows = tuple(Estimate(*row) for row in zip(names, *columns, strict=True))
    return Summary(title, facts, rows, float(level), warning, found)
