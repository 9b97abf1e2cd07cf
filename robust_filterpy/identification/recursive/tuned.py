"""How fast parameters drift: Q or the forgetting factor, by how well each value predicts a recording one step ahead.

Every value is judged by the same density, the mixture that `learnt_noise` learns from the residuals, so that an outlier
costs a bounded amount whichever value it is held against. The samples from which the tracker makes its first model are
left out, and so are those after them in which P still forgets how it began.
"""

from __future__ import annotations

import copy
import itertools
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._brief import tabulated
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.noise import likelihood_of_mixture
from robust_filterpy.identification.models.results import signals_of
from robust_filterpy.identification.models.signals import recorded_input, recorded_output, table
from robust_filterpy.influence.regression import mad_scale

if TYPE_CHECKING:
    from robust_filterpy.identification.recursive.tracker import ParameterTracker

__all__ = ["Tried", "TunedTracker", "tuned"]

# What may be tried, and the value with which theta stands still.
_STANDS_STILL: Final = {"Q": 0.0, "forgetting": 1.0}
# Samples left out after the start, for each parameter, and how many must be left to judge by.
_SETTLING: Final = 20
_LEAST: Final = 50
# A residual this many times as large as y varies is as wild as any.
_WILD: Final = 10.0


class Tried(NamedTuple):
    """One candidate of `TunedTracker`.

    Attributes
    ----------
    values : dict of str
        What was set, by name.
    log_likelihood : float
        Of the prediction errors one step ahead; -inf if the filter could not go through the recording.
    """

    values: dict[str, Any]
    log_likelihood: float


class TunedTracker(NamedTuple):
    """What `ParameterTracker.tuned` chose.

    Attributes
    ----------
    tracker : ParameterTracker
        The tracker as it was before the recording, with the chosen values.
    rows : tuple of Tried
        All candidates, in the order in which they were given.
    samples : int
        How many samples they were judged by.
    warning : str
        What makes the choice doubtful, in words; empty if nothing does.
    """

    tracker: ParameterTracker
    rows: tuple[Tried, ...]
    samples: int
    warning: str

    @property
    def best(self) -> Tried:
        """The candidate with the greatest log-likelihood."""
        return max(self.rows, key=lambda row: row.log_likelihood)

    def to_text(self) -> str:
        """Return the candidates as a table, values within 2 of the best predict as well.

        Returns
        -------
        str
        """
        heads = dict.fromkeys(self.best.values, 16) | {"log-likelihood": 18, "below best": 12}
        rows = []
        for row in self.rows:
            below = self.best.log_likelihood - row.log_likelihood
            numbers = f"{row.log_likelihood:.1f}", f"{below:.1f}", "  chosen" if row is self.best else ""
            rows.append((*map(_short, row.values.values()), *numbers))
        doubt = [f"Doubtful: {self.warning}"] if self.warning else []
        return tabulated(heads, rows, f"predictions one step ahead of {self.samples} samples", *doubt)

    def __str__(self) -> str:
        """Return the table."""
        return self.to_text()

    def to_frame(self) -> Any:
        """Return the candidates as a pandas DataFrame, a row for each.

        Returns
        -------
        pandas.DataFrame
            A column for each name, and log_likelihood.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return table([{**row.values, "log_likelihood": row.log_likelihood} for row in self.rows])


def tuned(tracker: ParameterTracker, y: Any, u: Any, over: Any, leave_out: int | None) -> TunedTracker:
    """Choose Q or the forgetting factor of a tracker."""
    candidates = _candidates(tracker, over)
    _, y, u = signals_of(tracker, y, u)
    output = recorded_output(y)
    signal = recorded_input(tracker.structure, u, output.size)
    if not tracker.enabled:
        raise ValueError("tracker: expected one that learns, got enabled=False, with which no value makes a difference")
    ready, start = copy.deepcopy(tracker), tracker.now.starts.get(0)
    first = 0 if start is None else min(max(start.samples - start.y.size, 0), output.size)
    settling = _SETTLING * tracker.structure.n_theta if leave_out is None else _checks.count("leave_out", leave_out)
    judged = np.flatnonzero(~np.isnan(output[first:]) & (np.arange(output.size - first) >= settling))
    if judged.size < _LEAST:
        raise ValueError(
            f"y: expected at least {_LEAST} measured samples after the first {first + settling}, of which {first} are "
            f"the start and {settling} are left out, got {judged.size}; record more, or take a smaller start or "
            "leave_out"
        )
    wild = _WILD * mad_scale(output[~np.isnan(output)] - np.nanmedian(output)) or np.inf
    rows = []
    with warnings.catch_warnings():
        # A value that is far off loses its way, which its likelihood says.
        warnings.simplefilter("ignore", UserWarning)
        if first:
            # No value changes the model of these samples.
            ready.run(output[:first], signal[:first])
        for values in candidates:
            try:
                e = ready.replaced(**values).run(output[first:], signal[first:]).residual[judged]
                rows.append(Tried(values, likelihood_of_mixture(e[~np.isnan(e)], wild)))
            except (np.linalg.LinAlgError, ValueError):
                rows.append(Tried(values, -np.inf))
    chosen = max(rows, key=lambda row: row.log_likelihood)
    if not np.isfinite(chosen.log_likelihood):
        raise ValueError("over: expected a value with which the filter goes through the recording, got none")
    doubt = _doubt(chosen.values, candidates)
    if doubt:
        warn(f"tuned: {doubt}")
    return TunedTracker(tracker.replaced(**chosen.values), tuple(rows), judged.size, doubt)


def _candidates(tracker: ParameterTracker, over: Any) -> list[dict[str, Any]]:
    """Return every combination of the values, checked."""
    if not isinstance(over, Mapping) or not over or set(over) - set(_STANDS_STILL):
        example = 'of Q or forgetting or both, such as {"Q": [1e-6, 1e-5]}'
        raise ValueError(f"over: expected values to try by name, {example}, got {_checks.shown(over)}")
    for name, values in over.items():
        if np.ndim(values) == 0 or not len(values):
            raise ValueError(f"over[{name!r}]: expected a sequence of values to try, got {_checks.shown(values)}")
    lists = ([one.item() if isinstance(one, np.generic) else one for one in values] for values in over.values())
    candidates = [dict(zip(over, values, strict=True)) for values in itertools.product(*lists)]
    for values in candidates:
        tracker.replaced(**values)
    return candidates


def _doubt(chosen: dict[str, Any], candidates: list[dict[str, Any]]) -> str:
    """Say which value lies at the end of what was tried, where a further one may be better; or nothing."""
    for name, value in chosen.items():
        tried = [values[name] for values in candidates]
        if any(np.ndim(one) for one in tried) or len(set(tried)) < 2 or value == _STANDS_STILL[name]:
            continue
        # Between Q = 0 and the next value are many.
        where = {max(tried): "larger", min(one for one in tried if one > 0.0): "smaller"}.get(value)
        if where:
            return f"the best {name}, {value:g}, is at the end of what was tried; try {where} ones too"
    return ""


def _short(value: Any) -> str:
    """Return a value as a cell of the table."""
    return f"{value:.3g}" if np.ndim(value) == 0 else f"trace {np.trace(np.atleast_2d(value)):.3g}"
