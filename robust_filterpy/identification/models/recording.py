"""From what was recorded to arrays, once, at the door: one recording or several, at equal steps or any times.

Several recordings come as lists. A gap of more than `LONG_GAP` samples in the inputs or in the time axis makes two
recordings of one: what happened in it is unknown, so what comes after it has a start of its own. In shorter gaps an
input is held at the value before, which is said. Equations of physics hold it as long as it takes.

A measured output has noise, and hardly ever the same number twice. A number that many samples have, or a stretch of
them, while the others are all different, is no rounding; and if inputs moved as much then as at other times, it is no
rest of the plant. A robust estimate takes the majority for the plant, so such samples are taken for missing. Readings
that repeat the one before are said.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy.identification.models import signals
from robust_filterpy.identification.models.results import Finding, of_fill_values
from robust_filterpy.identification.models.signals import Signals, TimeAxis, are_equal, are_several, held
from robust_filterpy.identification.models.structures import Structure, input_columns

# A number that so many samples have, and such a share of them or in a row, is often; the others differ if this share of
# them does.
_OFTEN: Final = 20
_OFTEN_SHARE: Final = 0.1
_DIFFERENT: Final = 0.9
_NAMED: Final = 3
# Fewer others tell no dynamics.
_LEAST_OTHERS: Final = 12
# An input that moves by less than this share of its usual motion, so many samples before or less, may hold the output.
_MOVES: Final = 0.25
_LAGS: Final = 16
# A copy moves with its original in this share of the samples in which one of the two moves.
_COPIED: Final = 0.9
# Motion in fewer samples tells nothing of stuck sensors and copies.
_FEWEST: Final = 8
_EQUAL: Final = 1e-9
# A reading that is so many widths of four fifths of the others away, between some that are within so many, is none.
_BEYOND: Final = 1e6
_BESIDE: Final = 10.0


def measurements(y: Array, u: Array) -> tuple[Array, tuple[Finding, ...]]:
    """Return outputs with NaN where they are no measurement, and what was found."""
    columns, findings = [], []
    several = y.ndim > 1 and y.shape[1] > 1
    for j, column in enumerate(y.reshape(len(y), -1).T):
        fills = fill_values(column)
        signal, wild = _without_wild(fills.signal)
        signal, stuck = _without_held(signal, u)
        columns.append(signal)
        own = (*of_fill_values(fills), *wild, *stuck, *_repeated(signal, u))
        findings += [one._replace(text=f"output {j}: " * several + one.text) for one in own]
    for j, column in enumerate(columns):
        others = [*((f"output {i}", one) for i, one in enumerate(columns[:j])), *_named(u)]
        this = f"output {j}" if several else "y"
        findings += [one for name, other in others for one in _copied(this, column, name, other)]
    return np.column_stack(columns).reshape(y.shape), tuple(findings)


def require_motion(y: Array, u: Array) -> None:
    """Raise if a sensor is stuck in nearly all samples, so that the others tell no dynamics."""
    columns = y.reshape(len(y), -1).T
    for j, column in enumerate(columns):
        signal = fill_values(column).signal
        values, others = _held(signal, u)
        if values.size and others < _LEAST_OTHERS:
            many = f"{values[0]:.6g} in {(signal == values[0]).sum()} of {(~np.isnan(signal)).sum()} samples"
            got = (many if others else "the same value throughout") + f" in output {j}" * (len(columns) > 1)
            raise ValueError(f"y: expected an output that varies, got {got}: the sensor is stuck, or at its limit")


def _without_wild(y: Array) -> tuple[Array, list[Finding]]:
    """Return an output with NaN where it leaves all others by orders of magnitude and is back at once, and that."""
    places = np.flatnonzero(~np.isnan(y))
    low, middle, high = np.quantile(y[places], [0.1, 0.5, 0.9]) if places.size else np.zeros(3)
    away = np.abs(y[places] - middle)
    wild = away > _BEYOND * (high - low)
    if not (wild.any() and high > low):
        return y, []
    # A shock of the process acts on, and so does a plant that is not stable.
    edges = np.flatnonzero(np.diff(wild.astype(int), prepend=0, append=0)).reshape(-1, 2)
    alone = [(a, b) for a, b in edges if a and b < wild.size and max(away[a - 1], away[b]) < _BESIDE * (high - low)]
    if not alone:
        return y, []
    at, signal = np.concatenate([places[a:b] for a, b in alone]), y.copy()
    signal[at] = np.nan
    text = (
        f"y is up to {np.abs(y[at]).max():.3g} in {at.size} samples and at once back among the others, of which four "
    )
    text += f"in five are between {low:.6g} and {high:.6g}: taken for missing"
    return signal, [Finding("wild", text, float("nan"), (int(at[0]), int(at[-1]) + 1))]


def _without_held(y: Array, u: Array) -> tuple[Array, list[Finding]]:
    """Return an output with NaN where its sensor is stuck, and that in words."""
    values, others = _held(y, u)
    if others < _LEAST_OTHERS:
        return y, []
    findings, signal, count = [], y.copy(), int((~np.isnan(y)).sum())
    always = ", whatever u does," if u.shape[1] else ""
    # Of many numbers one sentence.
    for stuck in [values] if values.size > _NAMED else values[:, None]:
        places = np.flatnonzero(np.isin(y, stuck))
        more = f" or one of {stuck.size - 1} more numbers" if stuck.size > 1 else ""
        text = (
            f"y is {stuck[0]:.6g}{more} in {places.size} of {count} samples{always} and hardly any other number twice: "
            "the sensor is stuck, at its limit or in a dead band; taken for missing"
        )
        findings.append(Finding("stuck", text, float("nan"), (int(places[0]), int(places[-1]) + 1)))
        signal[places] = np.nan
    return signal, findings


def _held(y: Array, u: Array) -> tuple[Array, int]:
    """Return the numbers at which an output is stuck, and how many samples have no number that is as often."""
    seen = ~np.isnan(y)
    values, which, counts = np.unique(y[seen], return_inverse=True, return_counts=True)
    often = counts >= max(_OFTEN, _OFTEN_SHARE * seen.sum())
    begins = np.flatnonzero(np.diff(which, prepend=-1))
    # Not from the first sample on: until its dead time is over, a plant without noise has not moved yet.
    often[which[begins[1:][np.diff(begins[1:], append=which.size) >= _OFTEN]]] = True
    # At its limits a sensor is for a few samples at a time; there too not from the first sample on.
    ends, later = np.append(values[:1], values[-1:]), which[begins[1] :] if begins.size > 1 else which[:0]
    often |= np.isin(values, ends) & (np.bincount(later, minlength=values.size) >= _FEWEST)
    others = int(seen.sum() - counts[often].sum())
    # Of a few numbers that are all often nobody can say that they are no rounding.
    if (~often).sum() < _DIFFERENT * others or (others < _LEAST_OTHERS and often.sum() > 1):
        return values[:0], others

    def moves(held: Any, value: float) -> bool:
        acts = not u.shape[1] or (held[1:] & (np.diff(u, axis=0) != 0.0).any(axis=1)).sum() >= _FEWEST
        return acts and not (_is_given(u, held) if value in ends else _is_quiet(u, held))

    return np.array([value for value in values[often] if moves(y == value, value)]), others


def _repeated(y: Array, u: Array) -> list[Finding]:
    """Return the finding that an output often repeats itself though inputs move, and that this is no rounding."""
    step, values = np.diff(y, prepend=np.nan), np.unique(y[~np.isnan(y)])
    gaps, moves = np.diff(values), np.abs(step) > 0.0
    # Not from the first sample on, as above.
    again = (step == 0.0) & np.logical_or.accumulate(moves)
    if values.size < _LEAST_OTHERS or min(again[_LAGS:].sum(), moves[_LAGS:].sum()) < _FEWEST:
        return []
    nearby = moves & (np.abs(step) < 1.5 * gaps[gaps > _EQUAL * np.ptp(values)].min())
    # Of rounded readings the next step is as frequent as none.
    if again.sum() < nearby.sum() / (1.0 - _DIFFERENT) or _is_quiet(u, again) or _rests(u, moves, again):
        return []
    always = ", whatever u does," if u.shape[1] else ""
    text = (
        f"y repeats the reading before in {again.sum()} of {y.size - np.isnan(y).sum()} samples{always} and hardly "
        "ever comes as near otherwise: the sensor was read, or its readings stored, less often; make NaN of the "
        "others, and take an OutputError, which needs none in a row"
    )
    places = np.flatnonzero(again)
    return [Finding("held", text, float("nan"), (int(places[0]), int(places[-1]) + 1))]


def _rests(u: Array, moves: Any, held: Any) -> bool:
    """Tell whether an output moves soon after inputs have, and is held when they have not for longer."""
    k = np.arange(held.size)
    changes = np.append(False, (np.diff(u, axis=0) != 0.0).any(axis=1))
    since = k - np.maximum.accumulate(np.where(changes, k, -k.size))
    apart = [(since[: k.size - lag], moves[lag:], held[lag:]) for lag in range(_LAGS + 1)]
    late = [np.quantile(own[after], 1.0 - _MOVES) < np.quantile(own[rest], _MOVES) for own, after, rest in apart]
    return bool(changes.any() and any(late))


def _is_quiet(u: Array, held: Any) -> bool:
    """Tell whether an input moves less than usual at some distance before the samples in which an output is held."""
    before = [(u[: held.size - lag], held[lag:]) for lag in range(_LAGS + 1)]
    least = np.min([_motion(acted[rows]) for acted, rows in before if rows.any()], axis=0)
    return bool((least < _MOVES * _motion(u)).any())


def _is_given(u: Array, held: Any) -> bool:
    """Tell whether an input has some value whenever an output is held, and more often then than otherwise."""
    for lag in range(_LAGS + 1):
        acted, rows = u[: held.size - lag], held[lag:]
        near = np.abs(acted - np.median(acted[rows], axis=0)) <= _MOVES * _motion(u)
        if (near[rows].all(axis=0) & (rows @ near > 0.5 * near.sum(axis=0))).any():
            return True
    return False


def _motion(u: Array) -> Array:
    """Return how far samples of each input are from their median in the mean."""
    return np.abs(u - np.median(u, axis=0)).mean(axis=0)


def _named(u: Array) -> list[tuple[str, Array]]:
    """Return inputs by their names."""
    return [(f"input {i}" if u.shape[1] > 1 else "u", column) for i, column in enumerate(u.T)]


def _copied(name: str, y: Array, original: str, other: Array) -> list[Finding]:
    """Return the finding that an output moves exactly as another signal does, or none."""
    step, other_step = np.diff(y), np.diff(other)
    moved = ~np.isnan(step + other_step) & ((step != 0.0) | (other_step != 0.0))
    both = moved & (step != 0.0) & (other_step != 0.0)
    if both.sum() < max(_FEWEST, _COPIED * moved.sum()):
        return []
    factor = float(np.median(step[both] / other_step[both]))
    same = both & (np.abs(step - factor * other_step) <= _EQUAL * np.maximum(np.abs(y[1:]), np.abs(y[:-1])))
    if same.sum() < _COPIED * moved.sum():
        return []
    what = original if factor == 1.0 else f"{factor:.6g} times {original}"
    text = (
        f"{name} moves exactly as {what} does: one is a copy of the other and tells nothing of its own, standard "
        "deviations are too small; leave it out, or record what it should be"
    )
    return [Finding("copy", text, float("nan"), (0, y.size))]


# Of samples that may come at any time.
ANY_TIMES: Final = Signals(0, 0, takes_phi=True)
# As many outputs and inputs as were recorded.
ANY_COLUMNS: Final = Signals(0, 0)
# Gaps of more samples make two recordings of one.
LONG_GAP: Final = 10
_LEAST: Final = 2


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

    @property
    def is_sampled(self) -> bool:
        """Whether the times of samples are equally far apart."""
        return all(are_equal(np.diff(self.times[part])) for part in self.spans)


def recorded(structure: Structure | Signals, y: Any, u: Any, t: Any = None) -> Recording:
    """Return what was recorded, checked; `ANY_COLUMNS` is the structure of states, `ANY_TIMES` that of physics."""
    recordings = _listed(y, u, t)
    if len(recordings) == 1 and not are_several(y, u):
        recordings = _split_in_time(structure, *recordings[0])
    axes: list[TimeAxis] = []
    parts, findings, times = [], [], [np.zeros(0)]
    for i, (one, other, when) in enumerate(recordings):
        axis, one, other = signals.recording(structure, y=one, u=other)
        if axes:
            axis.require_period(axes[0].dt)
        axes.append(axis)
        output, signal = _as_columns(structure, one, other, i)
        if structure is ANY_TIMES:
            times.append(_times(axis.index, when, len(output)))
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
    in_time = len(recordings) > 1 and not are_several(y, u)
    if len(recordings) < len(parts) or in_time:
        jumps = f"{len(recordings) - 1} jumps of the time axis"
        what = f"gaps of more than {LONG_GAP} samples in u" if len(recordings) < len(parts) else jumps
        text = f"{what}: {len(parts)} recordings, each with a level and a start"
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


def _split_in_time(structure: Structure | Signals, y: Any, u: Any, t: Any) -> list[tuple[Any, Any, Any]]:
    """Return the recordings between long jumps of a time axis."""
    pd = sys.modules.get("pandas")
    index = getattr(y, "index", None)
    if pd is None or not isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)) or structure.takes_phi:
        return [(y, u, t)]
    if index.hasnans or (u is not None and not (hasattr(u, "index") and index.equals(u.index))):
        return [(y, u, t)]
    steps = np.diff(index.asi8).astype(float)
    usual = float(np.median(steps)) if steps.size else 0.0
    cuts = np.flatnonzero(steps > (LONG_GAP + 0.5) * usual) + 1
    if usual <= 0.0 or not cuts.size or (np.diff([0, *cuts, len(index)]) < _LEAST).any():
        return [(y, u, t)]
    spans = [slice(a, b) for a, b in zip([0, *cuts], [*cuts, len(index)], strict=True)]
    return [(y.iloc[part], None if u is None else u.iloc[part], None) for part in spans]


def _as_columns(structure: Structure | Signals, y: Any, u: Any, i: int) -> tuple[Array, Array]:
    """Return outputs and inputs, both of which may have gaps, as columns, or raise."""
    if isinstance(structure, Signals):
        output = columns_of("y", y)
        for j in np.flatnonzero(np.isnan(output).all(axis=0)):
            raise ValueError(f"y: expected some measured samples of output {j} in recording {i}, got none")
        output = signals.with_squares(output)
        structure = Signals(0 if u is None else columns_of("u", u).shape[1], output.shape[1])
    else:
        output = signals.measured_output(y)[:, None]
    signals.require_squares(output)
    if u is None or not structure.n_inputs:
        return output, signals.recorded_input(structure, u, len(output))
    signal = input_columns("u", u, structure.n_inputs)
    signals.recorded_input(structure, np.where(np.isnan(signal), 0.0, signal), len(output))
    return output, signal


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
    physical = structure is ANY_TIMES
    if physical and gaps[0]:
        raise ValueError("u: expected finite numbers, the first of them measured")
    long = [(a, b) for a, b in runs if not physical and (b - a > LONG_GAP or a == 0 or b == gaps.size)]
    short, u, findings = [run for run in runs if run not in long], held(u, 0.0), []
    if short:
        most = "" if physical else f", never in more than {LONG_GAP} in a row"
        text = (
            f"{where}u is missing in {sum(b - a for a, b in short)} samples{most}: held at the value before each; fill "
            "u with what acted if that is known"
        )
        findings.append(Finding("gap", text, float("nan"), (short[0][0], short[-1][1])))
    bounds = [0, *(edge for run in long for edge in run), gaps.size]
    spans = [slice(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a >= _LEAST]
    return [(y[part], u[part]) for part in spans], findings


def columns_of(name: str, signal: Any) -> Array:
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
