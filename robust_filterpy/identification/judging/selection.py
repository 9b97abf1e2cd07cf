"""Selection: the structures that were tried on a recording, and the best of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._pictures import Pictured
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.time_axis import table

__all__ = ["Candidate", "ImpulseResponse", "Selection"]

# What lies so many times outside the band is no accident.
_SURE: Final = 2.0


class Candidate(NamedTuple):
    """One structure of the table.

    Structures whose first b is worth its price come before those whose first b is 0 within the noise.

    Attributes
    ----------
    structure : Structure
        The structure.
    criterion : float
        Its information criterion; the least is the best.
    fit : float
        Fit of the output from inputs alone, or without input of the prediction one step ahead, on ordinary samples.
    log_likelihood : float
        Of the prediction errors on the samples that all structures share.
    shows_delay : bool
        Whether the first b is as many standard deviations from 0 as the criterion asks of a further parameter. Without
        it the delay of the structure is shorter than the recording shows.
    held_out_fit : float
        Fit on the ordinary samples of the part that was held out, by the model of the part before; NaN where that was
        not tried. Without ``held_out=`` it is of the best structure of each size, and no better than the fit of the two
        models, that of the part and that of the whole recording, to each other.
    """

    structure: Structure
    criterion: float
    fit: float
    log_likelihood: float
    shows_delay: bool
    held_out_fit: float = math.nan

    @property
    def rank(self) -> tuple[bool, float]:
        """By which the table is sorted."""
        return not self.shows_delay, self.criterion


class ImpulseResponse(NamedTuple):
    """What the output does after a unit impulse of the input, by robust regression.

    Attributes
    ----------
    lags : ndarray of int, shape (n,)
        Samples after the impulse.
    values : ndarray, shape (n,)
        Response, in units of y over u.
    band : ndarray, shape (n,)
        Where the response is 0, the values of all lags lie within -+ band with a probability of 95 %.
    """

    lags: Any
    values: Array
    band: Array

    @property
    def delay(self) -> int | None:
        """The first lag outside the band, None if there is none."""
        return self._first_outside(1.0)

    @property
    def sure_delay(self) -> int | None:
        """The first lag far outside the band, None if there is none."""
        return self._first_outside(_SURE)

    def _first_outside(self, bands: float) -> int | None:
        """Return the first lag outside so many bands."""
        outside = np.abs(self.values) > bands * self.band
        return int(self.lags[outside.argmax()]) if outside.any() else None


@dataclass(frozen=True)
class Selection(Pictured):
    """Structures of a recording, the best first.

    Attributes
    ----------
    rows : tuple of Candidate
        The structures that were tried: the one that was taken, then all others sorted by their criterion.
    best : Model
        The model of the first, identified from the whole recording.
    criterion : str
        "bic" or "aic".
    samples : int
        How many samples the structures were compared on.
    impulse_responses : tuple of ImpulseResponse
        What the search for the delay of each input began with; empty without input, or where it excites too little.
    """

    picture = "workbench.plot_structure_selection"

    rows: tuple[Candidate, ...]
    best: Model
    criterion: str
    samples: int
    impulse_responses: tuple[ImpulseResponse, ...]

    @property
    def impulse_response(self) -> ImpulseResponse | None:
        """That of the first input, None if there is none."""
        return self.impulse_responses[0] if self.impulse_responses else None

    def to_frame(self) -> Any:
        """Return the whole table as a pandas DataFrame, the best first.

        Returns
        -------
        pandas.DataFrame
            A row for each structure: criterion, above_best, fit, log_likelihood, shows_delay, held_out_fit, parameters.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        fields = ("criterion", "fit", "log_likelihood", "shows_delay", "held_out_fit")
        columns: dict[str, Any] = {name: [getattr(row, name) for row in self.rows] for name in fields}
        columns["above_best"] = [row.criterion - self.rows[0].criterion for row in self.rows]
        columns["parameters"] = [row.structure.n_theta for row in self.rows]
        return table(columns, [str(row.structure) for row in self.rows], "structure")

    def to_text(self, rows: int = 10) -> str:
        """Return the first rows as a table.

        Parameters
        ----------
        rows : int, default 10
            How many.

        Returns
        -------
        str
        """
        held_out = any(not math.isnan(row.held_out_fit) for row in self.rows)
        lines = [f"{'structure':<38}{self.criterion:>12}{'above best':>12}{'fit, %':>9}{'log-likelihood':>16}"]
        lines[0] += f"{'held out, %':>13}" if held_out else ""
        for row in self.rows[: _checks.count("rows", rows, 1)]:
            above = row.criterion - self.rows[0].criterion
            values = f"{row.criterion:>12.1f}{above:>12.1f}{row.fit:>9.2f}{row.log_likelihood:>16.1f}"
            late = "-" if math.isnan(row.held_out_fit) else f"{row.held_out_fit:.2f}"
            values += f"{late:>13}" if held_out else ""
            lines.append(f"{row.structure!s:<38}{values}{'' if row.shows_delay else '  first b is 0'}")
        return "\n".join(lines)

    def __str__(self) -> str:
        """Return the table."""
        return self.to_text()
