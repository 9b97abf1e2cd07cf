"""States as plain arrays: the label that says what one belongs to, and the checks before it is taken over."""

from __future__ import annotations

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


def labelled(kind: str, arrays: Mapping[str, Any]) -> dict[str, Array]:
    """Return copies of arrays as a state, the label first."""
    return {
        LABEL: spelt(kind, FORMAT),
        **{name: np.array(value, dtype=float, order="C") for name, value in arrays.items()},
    }


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
    label = _checks.numbers(LABEL, state[LABEL])
    if label.ndim != 1 or not label.size or not ((label >= 0) & (label < 0x110000) & (label % 1 == 0)).all():
        raise ValueError(f"state: expected {LABEL} to be a version and a name, got {_checks.shown(label)}")
    if label[0] > FORMAT:
        raise ValueError(
            f"state: expected format {FORMAT} or older, got {label[0]:g}; it comes from a newer robust_filterpy, "
            f"update this one"
        )
    return read(label[1:])


def require_kind(state: Any, kind: str) -> None:
    """Raise unless a state belongs to this kind, or does not say what it belongs to."""
    found = kind_of(state)
    if found and found != kind:
        raise ValueError(f"state: expected one of a {kind}, got one of a {found}")


def checked(
    state: Any, kind: str, needed: Mapping[str, Shape], optional: Mapping[str, Shape], gaps: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Return a state's arrays, copied, or raise; those named in gaps may hold NaN.

    x may be a vector or a column, an optional matrix a number that stands for itself times I.
    """
    require_kind(state, kind)
    found = {}
    for name, shape in {**needed, **optional}.items():
        if name not in state:
            if name in optional:
                continue
            raise ValueError(f"state: expected {name}, of shape {_text(shape)}, got none")
        value = _checks.numbers(name, state[name]).copy()
        column = name == "x" and value.shape == (*shape, 1)
        if not (_fits(value.shape, shape) or column or (name in optional and value.ndim == 0)):
            raise ValueError(f"state: expected {name} of shape {_text(shape)}, got {value.shape}")
        if not (np.isfinite(value) | (np.isnan(value) & (name in gaps))).all():
            raise ValueError(f"state: expected finite numbers in {name}, got NaN or infinity")
        found[name] = value
    for name in ("P", "Q", "R"):
        matrix = found.get(name)
        if matrix is not None and matrix.ndim == 2:
            require_covariance(name, matrix)
    return found


def require_covariance(name: str, matrix: Array) -> None:
    """Raise unless a matrix is a covariance, up to more than rounding adds in a long recursion."""
    slack = 1e-8 * np.abs(matrix).max(initial=1e-300)
    if np.abs(matrix - matrix.T).max(initial=0.0) <= slack:
        least = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
        if least >= -slack:
            return
        raise ValueError(f"state: expected a positive semidefinite {name}, got eigenvalue {least:.3g}")
    raise ValueError(f"state: expected a symmetric {name}, got one that differs from its transpose")


def _fits(found: tuple[int, ...], shape: Shape) -> bool:
    """Return whether an array has a shape."""
    return len(found) == len(shape) and all(b is None or a == b for a, b in zip(found, shape, strict=True))


def _text(shape: Shape) -> str:
    """Return a shape as a message shows it."""
    return (
        "(" + ", ".join("any" if size is None else str(size) for size in shape) + ("," if len(shape) == 1 else "") + ")"
    )
