"""From what was recorded to arrays: one recording or several, gaps in the inputs, times that jump.

Several recordings come as lists, or as one table with a column that groups its rows. A gap of more than `LONG_GAP`
samples in the inputs or in the time axis makes two recordings of one: what happened in it is not known, so what comes
after it has a start of its own. In shorter gaps an input is held at the value before, which is said.
"""

from __future__ import annotations

import sys
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.identification.models.signals import (
    are_several,
    measured_output,
    measured_outputs,
    recorded_input,
    require_squares,
)
from robust_filterpy.identification.models.state_space import Signals
from robust_filterpy.identification.models.structures import Structure, input_columns
from robust_filterpy.identification.models.time_axis import TimeAxis, recording
from robust_filterpy.identification.models.unmeasured import measurements, require_motion

__all__ = ["LONG_GAP", "Recordings", "recordings"]

#: Gaps of more samples make two recordings of one.
LONG_GAP: Final = 10
_FEWEST: Final = 2


class Recordings(NamedTuple):
    """Recordings of one plant, one after the other.

    Attributes
    ----------
    y : ndarray, shape (N,) or (N, n_outputs)
        Output, NaN where it is missing, has a fill value or is stuck.
    u : ndarray, shape (N, n_inputs)
        Input, without gaps.
    begins : tuple of int
        First sample of each recording.
    axis : TimeAxis
        Of a single one; of several only the sampling period.
    findings : tuple of Finding
        Fill values, stuck sensors, copies, gaps.
    """

    y: Array
    u: Array
    begins: tuple[int, ...]
    axis: TimeAxis
    findings: tuple[Finding, ...]


def recordings(structure: Structure | Signals, y: Any, u: Any, groups: Any = None) -> Recordings:
    """Return what was recorded, checked."""
    told = _grouped(y, u, groups) if groups is not None else _listed(y, u)
    if told is None:
        told = _split_in_time(structure, y, u)
    axes: list[TimeAxis] = []
    parts, findings = [], []
    for i, (one, other) in enumerate(told):
        axis, one, other = recording(structure, y=one, u=other)
        if axes:
            axis.require_period(axes[0].dt)
        axes.append(axis)
        output = measured_outputs(one, structure.n_outputs) if isinstance(structure, Signals) else measured_output(one)
        require_squares(output)
        signal = _inputs(structure, other, len(output))
        kept, found = _without_gaps(structure, output, signal, "" if len(told) == 1 else f"recording {i}: ")
        parts += kept
        findings += found
    if not parts:
        raise ValueError("u: expected some samples with an input, got none")
    signal = np.concatenate([one for _, one in parts])
    measured = np.concatenate([one for one, _ in parts])
    require_motion(measured, signal)
    measured, lies = measurements(measured, signal)
    if len(told) < len(parts):
        text = f"gaps of more than {LONG_GAP} samples in u: {len(parts)} recordings, each with a level and a start"
        findings.append(Finding("gap", text, float("nan"), (0, len(measured))))
    elif len(told) > 1 and groups is None and not are_several(y, u):
        text = f"{len(told) - 1} jumps of the time axis: {len(parts)} recordings, each with a level and a start"
        findings.append(Finding("gap", text, float("nan"), (0, len(measured))))
    ends = np.cumsum([len(one) for one, _ in parts])
    axis = axes[0] if len(told) == len(parts) == 1 else TimeAxis(None, axes[0].dt)
    return Recordings(measured, signal, (0, *(int(e) for e in ends[:-1])), axis, (*lies, *findings))


def _listed(y: Any, u: Any) -> list[tuple[Any, Any]] | None:
    """Return several recordings that came as lists, None if it is one."""
    if not are_several(y, u):
        return None
    if u is None:
        return [(one, None) for one in y]
    if not isinstance(u, (list, tuple)) or len(u) != len(y):
        got = f"{len(u)}" if isinstance(u, (list, tuple)) else type(u).__name__
        raise ValueError(f"u: expected a list of {len(y)} recordings like y, got {got}")
    return list(zip(y, u, strict=True))


def _grouped(y: Any, u: Any, groups: Any) -> list[tuple[Any, Any]]:
    """Return the recordings that a column tells apart, in the order in which they begin."""
    labels = np.asarray(groups, dtype=object).ravel()
    if labels.size != len(y) or (u is not None and len(u) != len(y)):
        raise ValueError(f"groups: expected a label for each of the {len(y)} samples of y and u, got {labels.size}")
    if any(label is None or label != label for label in labels):
        k = next(k for k, label in enumerate(labels) if label is None or label != label)
        raise ValueError(f"groups: expected a label for each sample, got {labels[k]} in sample {k}")
    rows: dict[Any, list[int]] = {}
    for k, label in enumerate(labels):
        rows.setdefault(label, []).append(k)
    return [(_rows(y, where), None if u is None else _rows(u, where)) for where in rows.values()]


def _rows(signal: Any, where: Any) -> Any:
    """Return some rows of an array or a table."""
    return signal.iloc[where] if hasattr(signal, "iloc") else np.asarray(signal)[where]


def _split_in_time(structure: Structure | Signals, y: Any, u: Any) -> list[tuple[Any, Any]]:
    """Return the recordings between long jumps of a time axis."""
    pd = sys.modules.get("pandas")
    index = getattr(y, "index", None)
    if pd is None or not isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)) or structure.takes_phi:
        return [(y, u)]
    if (
        len(index) < 2 * _FEWEST
        or index.hasnans
        or (u is not None and not (hasattr(u, "index") and index.equals(u.index)))
    ):
        return [(y, u)]
    steps = np.diff(index.asi8).astype(float)
    usual = float(np.median(steps))
    cuts = np.flatnonzero(steps > (LONG_GAP + 0.5) * usual) + 1
    if usual <= 0.0 or not cuts.size or (np.diff([0, *cuts, len(index)]) < _FEWEST).any():
        return [(y, u)]
    spans = [slice(a, b) for a, b in zip([0, *cuts], [*cuts, len(index)], strict=True)]
    return [(y.iloc[part], None if u is None else u.iloc[part]) for part in spans]


def _inputs(structure: Structure | Signals, u: Any, length: int) -> Array:
    """Return inputs that may have gaps, shape (N, n_inputs), or raise."""
    if u is None or not structure.n_inputs:
        return recorded_input(structure, u, length)
    signal = input_columns("u", u, structure.n_inputs)
    recorded_input(structure, np.where(np.isnan(signal), 0.0, signal), length)
    return signal


def _without_gaps(
    structure: Structure | Signals, y: Array, u: Array, where: str
) -> tuple[list[tuple[Array, Array]], list[Finding]]:
    """Return the recordings between long gaps in the inputs, with short ones filled, and what is to be said."""
    gaps: Any = np.isnan(u).any(axis=1)
    if not gaps.any():
        return [(y, u)], []
    if structure.takes_phi:
        # A row without its regressor tells nothing.
        text = f"{where}u is missing in {int(gaps.sum())} samples, which do not count"
        found = Finding("gap", text, float("nan"), (int(gaps.argmax()), int(gaps.size - gaps[::-1].argmax())))
        return [(np.where(gaps, np.nan, y), np.nan_to_num(u))], [found]
    edges = np.flatnonzero(np.diff(np.concatenate(([False], gaps, [False])).astype(int)))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    long = [(a, b) for a, b in runs if b - a > LONG_GAP or a == 0 or b == gaps.size]
    short = [run for run in runs if run not in long]
    u = u.copy()
    for a, b in short:
        u[a:b] = np.where(np.isnan(u[a:b]), u[a - 1], u[a:b])
    findings = []
    if short:
        count = sum(b - a for a, b in short)
        text = (
            f"{where}u is missing in {count} samples, never in more than {LONG_GAP} in a row: held at the value before "
            "each; fill u with what acted if that is known"
        )
        findings.append(Finding("gap", text, float("nan"), (short[0][0], short[-1][1])))
    bounds = [0, *(edge for run in long for edge in run), gaps.size]
    kept = [slice(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a >= _FEWEST]
    return [(y[part], u[part]) for part in kept], findings
