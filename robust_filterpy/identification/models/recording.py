"""From what was recorded to arrays, once, at the door: one recording or several, at equal steps or any times.

Several recordings come as lists, or as one table with a column that groups its rows. A gap of more than `LONG_GAP`
samples in the inputs or in the time axis makes two recordings of one: what happened in it is not known, so what comes
after it has a start of its own. In shorter gaps an input is held at the value before, which is said. Equations of
physics hold it as long as it takes.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
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
from robust_filterpy.identification.models.unmeasured import measurements

# Of samples that may come at any time.
ANY_TIMES: Final = Signals(0, 0, takes_phi=True)
# Gaps of more samples make two recordings of one.
LONG_GAP: Final = 10
_FEWEST: Final = 2


class Recording(NamedTuple):
    """Recordings of one plant, one after the other, checked.

    Attributes
    ----------
    y : ndarray, shape (N, n_outputs)
        Outputs, NaN where one is missing, has a fill value or is stuck.
    u : ndarray, shape (N, n_inputs)
        Inputs, without gaps.
    spans : tuple of slice
        Samples of each recording.
    axis : TimeAxis
        Of a single one; of several only the sampling period.
    times : ndarray, shape (N,) or (0,)
        Of samples that may come at any times, in s from the first of each recording on.
    findings : tuple of Finding
        Fill values, stuck sensors, copies, gaps.
    """

    y: Array
    u: Array
    spans: tuple[slice, ...]
    axis: TimeAxis
    times: Array
    findings: tuple[Finding, ...]


def recorded(structure: Structure | Signals, y: Any, u: Any, groups: Any = None, t: Any = None) -> Recording:
    """Return what was recorded, checked; `ANY_TIMES` in the place of a structure for equations of physics."""
    recordings = _grouped(y, u, groups) if groups is not None else _listed(y, u, t)
    if len(recordings) == 1 and not are_several(y, u):
        recordings = _split_in_time(structure, *recordings[0])
    axes: list[TimeAxis] = []
    parts, findings, times = [], [], [np.zeros(0)]
    for i, (one, other, when) in enumerate(recordings):
        axis, one, other = recording(structure, y=one, u=other)
        if axes:
            axis.require_period(axes[0].dt)
        axes.append(axis)
        if structure is ANY_TIMES:
            pieces, gaps = _held(one, other, i)
            times.append(_times(axis.index, when, len(pieces[0][0])))
        else:
            width = structure.n_outputs if isinstance(structure, Signals) else None
            output = measured_output(one)[:, None] if width is None else measured_outputs(one, width)
            require_squares(output)
            signal = _inputs(structure, other, len(output))
            pieces, gaps = _without_gaps(structure, output, signal, "" if len(recordings) == 1 else f"recording {i}: ")
        parts += pieces
        findings += gaps
    if not parts:
        raise ValueError("u: expected some samples with an input, got none")
    for name, widths in zip("yu", zip(*((y.shape[1], u.shape[1]) for y, u in parts), strict=True), strict=True):
        if len(set(widths)) > 1:
            raise ValueError(f"{name}: expected recordings of equally many columns, got {[*widths]}")
    measured, signal = (np.concatenate(each) for each in zip(*parts, strict=True))
    measured, lies = measurements(measured, signal)
    if len(recordings) < len(parts):
        text = f"gaps of more than {LONG_GAP} samples in u: {len(parts)} recordings, each with a level and a start"
        findings.append(Finding("gap", text, float("nan"), (0, len(measured))))
    elif len(recordings) > 1 and groups is None and not are_several(y, u):
        text = f"{len(recordings) - 1} jumps of the time axis: {len(parts)} recordings, each with a level and a start"
        findings.append(Finding("gap", text, float("nan"), (0, len(measured))))
    ends = np.cumsum([0, *(len(one) for one, _ in parts)]).tolist()
    spans = tuple(slice(a, b) for a, b in pairwise(ends))
    axis = axes[0] if len(recordings) == len(parts) == 1 else TimeAxis(None, axes[0].dt)
    return Recording(measured, signal, spans, axis, np.concatenate(times), (*lies, *findings))


def _listed(y: Any, u: Any, t: Any) -> list[tuple[Any, Any, Any]]:
    """Return the recordings that came as lists, or the one that it is."""
    if not are_several(y, u):
        return [(y, u, t)]
    columns = [y]
    for name, each in (("u", u), ("t", t)):
        if each is not None and (not isinstance(each, (list, tuple)) or len(each) != len(y)):
            got = len(each) if isinstance(each, (list, tuple)) else type(each).__name__
            raise ValueError(f"{name}: expected a list of {len(y)} recordings like y, got {got}")
        columns.append([None] * len(y) if each is None else each)
    return list(zip(*columns, strict=True))


def _grouped(y: Any, u: Any, groups: Any) -> list[tuple[Any, Any, Any]]:
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
    return [(_rows(y, where), None if u is None else _rows(u, where), None) for where in rows.values()]


def _rows(signal: Any, where: Any) -> Any:
    """Return some rows of an array or a table."""
    return signal.iloc[where] if hasattr(signal, "iloc") else np.asarray(signal)[where]


def _split_in_time(structure: Structure | Signals, y: Any, u: Any, t: Any) -> list[tuple[Any, Any, Any]]:
    """Return the recordings between long jumps of a time axis."""
    pd = sys.modules.get("pandas")
    index = getattr(y, "index", None)
    if pd is None or not isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)) or structure.takes_phi:
        return [(y, u, t)]
    if (
        len(index) < 2 * _FEWEST
        or index.hasnans
        or (u is not None and not (hasattr(u, "index") and index.equals(u.index)))
    ):
        return [(y, u, t)]
    steps = np.diff(index.asi8).astype(float)
    usual = float(np.median(steps))
    cuts = np.flatnonzero(steps > (LONG_GAP + 0.5) * usual) + 1
    if usual <= 0.0 or not cuts.size or (np.diff([0, *cuts, len(index)]) < _FEWEST).any():
        return [(y, u, t)]
    spans = [slice(a, b) for a, b in zip([0, *cuts], [*cuts, len(index)], strict=True)]
    return [(y.iloc[part], None if u is None else u.iloc[part], None) for part in spans]


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
        finding = Finding("gap", text, float("nan"), (int(gaps.argmax()), int(gaps.size - gaps[::-1].argmax())))
        return [(np.where(gaps[:, None], np.nan, y), np.nan_to_num(u))], [finding]
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
    spans = [slice(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a >= _FEWEST]
    return [(y[part], u[part]) for part in spans], findings


def _held(y: Any, u: Any, i: int) -> tuple[list[tuple[Array, Array]], list[Finding]]:
    """Return a recording for equations of physics, its inputs held in gaps, and what is to be said."""
    output = _columns("y", y)
    require_squares(output)
    if np.isinf(output).any():
        raise ValueError("y: expected finite numbers or NaN (missing), got inf")
    for j, column in enumerate(output.T):
        if np.isnan(column).all():
            raise ValueError(f"y: expected some measured samples of output {j} in recording {i}, got none")
    signal = np.zeros((len(output), 0)) if u is None else _columns("u", u)
    if len(signal) != len(output):
        raise ValueError(f"u: expected {len(output)} samples like y, got {len(signal)}")
    if np.isinf(signal).any() or np.isnan(signal[:1]).any():
        raise ValueError("u: expected finite numbers, the first of them measured")
    gaps = np.isnan(signal)
    if not gaps.any():
        return [(output, signal)], []
    last = np.maximum.accumulate(np.where(gaps, 0, np.arange(len(signal))[:, None]), axis=0)
    text = f"u is missing in {int(gaps.any(axis=1).sum())} samples of recording {i}: held at the value before"
    finding = Finding("gap", text, float("nan"), (0, len(signal)))
    return [(output, np.take_along_axis(signal, last, axis=0))], [finding]


def _columns(name: str, signal: Any) -> Array:
    """Return a signal as columns or raise."""
    columns = _checks.numbers(name, signal)
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or not len(columns):
        raise ValueError(f"{name}: expected shape (N,) or (N, n), N >= 1, got {np.shape(signal)}")
    return columns


def _times(index: Any, t: Any, length: int) -> Array:
    """Return the times of a recording in s, from 0 on, or raise."""
    if t is None:
        pd = sys.modules.get("pandas")
        if pd is None or index is None:
            raise ValueError("t: expected the times of the samples in s, or a pandas index that has them, got None")
        is_time = isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))
        t = (index - index[0]).total_seconds() if is_time else index
    times = _checks.numbers("t", np.asarray(t))
    if times.shape != (length,) or not np.isfinite(times).all():
        raise ValueError(f"t: expected {length} finite times like y, got shape {times.shape}")
    if (np.diff(times) <= 0.0).any():
        k = int(np.argmax(np.diff(times) <= 0.0))
        raise ValueError(
            f"t: expected times that increase, got {times[k]:.6g} and {times[k + 1]:.6g} in sample {k + 1}"
        )
    return times - times[0]
