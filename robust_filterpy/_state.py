"""States as plain arrays: the label that says what one belongs to, and the checks before it is taken over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

#: Version of what `state` returns; a state of an older one is always taken.
FORMAT: Final = 1
#: Name of the label among a state's arrays.
LABEL: Final = "format"

#: Shape of an array: sizes, and None for any.
Shape = tuple[int | None, ...]

# Arrays of a state that are covariances, or stacks of them, and what `_checks.covariance` is given for them.
_MOVING: Final = {"slack": _checks.GATHERED, "gathered": _checks.ROUNDING}
_COVARIANCES: Final[dict[str, dict[str, float]]] = {
    **{name: _MOVING for name in ("P", "R", "covariances", "prior_P", "window_R")},
    **{name: {"slack": math.inf} for name in ("Q", "window_Q")},
}


# Numbers that a state held of a sensor's spread before it held more, which then follow.
_FORMER: Final = (10, 15, 17)
# What is learned of a sensor's noise had nothing of jumps once, nor of typical innovations: so many numbers, which
# stand before so many.
_OF_NOISE: Final = ((5, 10), (22, 17))


# Arrays of as many sensors, or numbers, as there are.
_ANY_LENGTH: Final = ("learnt", "insisting", "random", "generator")


class StateError(ValueError):
    """A state that nothing can go on from: damaged, of something else, or of a newer format."""


def labelled(kind: str, arrays: Mapping[str, Any]) -> dict[str, Array]:
    """Return copies of arrays as a state, the label first."""
    return {
        LABEL: spelt(kind, FORMAT),
        **{name: np.array(value, dtype=float, order="C") for name, value in arrays.items()},
    }


def schema(arrays: Mapping[str, Any]) -> dict[str, Shape]:
    """Return the shapes that another state like this one has."""
    shapes = {name: np.shape(value) for name, value in arrays.items()}
    return {name: (None, *shape[1:]) if name in _ANY_LENGTH else shape for name, shape in shapes.items()}


def spelt(text: str, *before: float) -> Array:
    """Return a text as the numbers of its characters, after other numbers."""
    return np.array([*before, *map(ord, text)], dtype=float)


def read(numbers: Array) -> str:
    """Return the text of such numbers."""
    return "".join(chr(int(number)) for number in np.ravel(numbers))


def kind_of(state: Any) -> str:
    """Return what a state says it belongs to, empty if it has no label; raise if it is of a newer format or none."""
    if not (hasattr(state, "keys") and hasattr(state, "__getitem__")):
        raise TypeError(
            f"state: expected what state() returned, or what numpy.load makes of a file that holds it, "
            f"got {type(state).__name__}"
        )
    if LABEL not in state:
        return ""
    label = _numbers(LABEL, state[LABEL])
    if label.ndim != 1 or not label.size or not ((label >= 0) & (label < 0x110000) & (label % 1 == 0)).all():
        raise StateError(f"state: expected {LABEL} to be a version and a name, got {_checks.shown(label)}")
    if label[0] > FORMAT:
        raise StateError(
            f"state: expected format {FORMAT} or older, got {label[0]:g}; it comes from a newer robust_filterpy, "
            f"update this one"
        )
    return read(label[1:])


def require_kind(state: Any, kind: str) -> None:
    """Raise unless a state belongs to this kind, or does not say what it belongs to."""
    given = kind_of(state)
    if given and given != kind:
        raise StateError(f"state: expected one of a {kind}, got one of a {given}")


def checked(
    state: Any, kind: str | None, needed: Mapping[str, Shape], optional: Mapping[str, Shape], gaps: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Return a state's arrays, copied, or raise; those named in gaps may hold NaN.

    Without a kind its label has been looked at. x may be a vector or a column, an optional matrix a number that stands
    for itself times I.
    """
    if kind is not None:
        require_kind(state, kind)
    entries = {}
    for name, shape in {**needed, **optional}.items():
        if name not in state:
            if name in optional:
                continue
            raise StateError(f"state: expected {name}, of shape {_text(shape)}, got none")
        value = widened(name, _numbers(name, state[name]).copy(), shape[-1] if shape else None)
        if value.size == 0 and len(shape) != value.ndim and math.prod(size or 0 for size in shape) == 0:
            # Text formats, JSON among them, do not keep the shape of what is empty.
            value = value.reshape([size or 0 for size in shape])
        column = name == "x" and value.shape == (*shape, 1)
        if not (_fits(value.shape, shape) or column or (name in optional and value.ndim == 0)):
            raise StateError(f"state: expected {name} of shape {_text(shape)}, got {value.shape}")
        if not (np.isfinite(value) | (np.isnan(value) & (name in gaps))).all():
            raise StateError(f"state: expected finite numbers in {name}, got NaN or infinity")
        if name in _COVARIANCES and value.ndim >= 2:
            require_covariance(name, value)
        entries[name] = value
    return entries


def widened(name: str, value: Array, width: int | None) -> Array:
    """Return what a state holds of sensors, with 0 in the columns that there were not yet when it was stored."""
    missing = (width or 0) - (value.shape[-1] if value.ndim else 0)
    if value.ndim < 2 or missing <= 0:
        return value
    if name.endswith("spread") and value.shape[-1] in _FORMER:
        return np.concatenate((value, np.zeros((*value.shape[:-1], missing))), axis=-1)
    for count, behind in _OF_NOISE if name.endswith(("learnt", "memory")) else ():
        if missing in (count, sum(dict(_OF_NOISE))) and value.shape[-1] > behind:
            value, missing = np.insert(value, [value.shape[-1] - behind] * count, 0.0, axis=-1), missing - count
    return value


def require_covariance(name: str, stack: Array) -> None:
    """Raise unless a matrix of a state, or every one of a stack, is a covariance, up to what a recursion gathers."""
    try:
        _checks.covariance(name, stack, **_COVARIANCES.get(name, _MOVING))
    except ValueError as error:
        raise StateError(f"state: {error}") from None


def _numbers(name: str, value: Any) -> Array:
    """Return an array of a state, or raise."""
    try:
        return _checks.numbers(name, value)
    except (TypeError, ValueError, OverflowError) as error:
        raise StateError(f"state: {error}") from None


def _fits(given: tuple[int, ...], shape: Shape) -> bool:
    """Return whether an array has a shape."""
    return len(given) == len(shape) and all(b is None or a == b for a, b in zip(given, shape, strict=True))


def _text(shape: Shape) -> str:
    """Return a shape as a message shows it."""
    return (
        "(" + ", ".join("any" if size is None else str(size) for size in shape) + ("," if len(shape) == 1 else "") + ")"
    )
