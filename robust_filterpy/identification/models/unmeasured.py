"""What of recorded outputs is no measurement: fill values, a reading of 1e300, a sensor that is stuck, a copy.

A measured output has noise, and hardly ever the same number twice. A number that many samples have, or a stretch of
them, while the others are all different, is no rounding; and if inputs moved as much then as at other times, it is no
rest of the plant. A robust estimate takes the majority for the plant, so such samples are taken for missing.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy.identification.models.results import Finding, of_fill_values

__all__ = ["measurements", "require_motion"]

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
        signal, held = _without_held(signal, u)
        columns.append(signal)
        findings += [
            one._replace(text=f"output {j}: " * several + one.text) for one in (*of_fill_values(fills), *wild, *held)
        ]
    for j, column in enumerate(columns):
        others = [*((f"output {i}", one) for i, one in enumerate(columns[:j])), *_named(u)]
        own = f"output {j}" if several else "y"
        findings += [one for name, other in others for one in _copied(own, column, name, other)]
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
    others = int(seen.sum() - counts[often].sum())
    # Of a few numbers that are all often nobody can say that they are no rounding.
    if (~often).sum() < _DIFFERENT * others or (others < _LEAST_OTHERS and often.sum() > 1):
        return values[:0], others
    return np.array([value for value in values[often] if _moves(u, y == value)]), others


def _moves(u: Array, held: Any) -> bool:
    """Tell whether every input moves as usual in, and some samples before, those in which an output is held."""
    if not u.shape[1]:
        return True
    if (held[1:] & (np.diff(u, axis=0) != 0.0).any(axis=1)).sum() < _FEWEST:
        return False
    before = [(u[: held.size - lag], held[lag:]) for lag in range(_LAGS + 1)]
    least = np.min([_motion(acted[rows]) for acted, rows in before if rows.any()], axis=0)
    return not (least < _MOVES * _motion(u)).any()


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
