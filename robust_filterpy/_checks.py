"""Argument checks with uniform messages: name, what was expected, what was found, the likely mend."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FLOAT = np.dtype(np.float64)

# np.asarray(.., float) silently accepts text, dates and durations.
_NO_NUMBERS = "cmMSU"
_NO_NUMBER = (str, bytes, np.datetime64, np.timedelta64)


def shown(value: Any) -> str:
    """Return a value as a message can show it: as its repr, the middle of a long one left out."""
    with np.printoptions(threshold=20):
        text = repr(value)
    return text if len(text) <= 200 else f"{text[:120]} ... {text[-40:]}"


def positive(name: str, value: Any, *, infinite: bool = False) -> float:
    """Return value as a float > 0 or raise."""
    number = real(name, value)
    if not number > 0 or (math.isinf(number) and not infinite):
        kind = "a number > 0" if infinite else "a finite number > 0"
        raise ValueError(f"{name}: expected {kind}, got {shown(value)}")
    return number


def fraction(name: str, value: Any) -> float:
    """Return value as a float in [0, 1) or raise."""
    number = real(name, value)
    if not 0 <= number < 1:
        raise ValueError(f"{name}: expected a number in [0, 1), got {shown(value)}")
    return number


def real(name: str, value: Any) -> float:
    """Return value as a float or raise."""
    if isinstance(value, (*_NO_NUMBER, bool)) or np.ndim(value) != 0:
        raise TypeError(f"{name}: expected a number, got {shown(value)}")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a number, got {shown(value)}") from None


def count(name: str, value: Any, least: int = 0) -> int:
    """Return value as an int >= least or raise."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected an integer >= {least}, got {shown(value)}")
    if value < least:
        raise ValueError(f"{name}: expected an integer >= {least}, got {shown(value)}")
    return int(value)


_Option = TypeVar("_Option", bound=str)


def option(name: str, value: Any, allowed: Iterable[_Option]) -> _Option:
    """Return value if it is one of the allowed strings or raise."""
    allowed = tuple(allowed)
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected one of {', '.join(map(repr, allowed))}, got {shown(value)}")
    if value not in allowed:
        raise ValueError(f"{name}: expected one of {', '.join(map(repr, allowed))}, got {shown(value)}")
    return value  # type: ignore[return-value]


def numbers(name: str, value: Any) -> Array:
    """Return value as a float array (None, pandas' NA and masked entries become NaN) or raise TypeError."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)
    try:
        found = np.asarray(value)
        if found.dtype.kind in _NO_NUMBERS:
            raise TypeError(f"{name}: expected real numbers, got dtype {found.dtype}: {shown(value)}")
        if found.dtype.kind == "O" and any(isinstance(item, _NO_NUMBER) for item in found.flat):
            raise TypeError(f"{name}: expected real numbers, got text or times among them: {shown(value)}")
        if found.dtype.kind == "O" and "pandas" in sys.modules:
            absent = sys.modules["pandas"].NA
            value = np.where([item is absent for item in found.flat], np.nan, found.ravel()).reshape(found.shape)
    except ValueError:
        raise TypeError(f"{name}: expected real numbers, got {shown(value)}") from None
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected real numbers, got {shown(value)}") from None


def entries(name: str, values: Any) -> Any:
    """Return values that are read step by step: a table (pandas, polars) as its rows, else as given; or raise."""
    if isinstance(values, (Mapping, set, frozenset)):
        raise TypeError(f"{name}: expected a sequence with an entry for each step, got a {type(values).__name__}")
    if hasattr(values, "to_numpy") and len(getattr(values, "shape", ())) == 2:
        return np.asarray(values)
    return values


def matrix(name: str, value: Any, shape: tuple[int, int], reason: str) -> Array:
    """Return value as a float array of this shape or raise, telling what the shape follows from."""
    if type(value) is np.ndarray and value.dtype == FLOAT and value.shape == shape:
        return value
    if value is None:
        raise TypeError(f"{name}: expected an array of shape {shape} for {reason}, got None")
    found = numbers(name, value)
    if found.shape == shape:
        return found
    if found.size == 1 and shape == (1, 1):
        return found.reshape(shape)
    raise ValueError(f"{name}: expected shape {shape} for {reason}, got {_mend(name, found, shape)}")


def _mend(name: str, found: Array, shape: tuple[int, int]) -> str:
    """Describe what was found and, where it is plain, what was meant."""
    if found.ndim == 0:
        return f"scalar {found}; use {found}*np.eye({shape[0]})" if shape[0] == shape[1] else f"scalar {found}"
    text = f"{found.shape}"
    if found.ndim == 1 and shape[0] == shape[1] == found.size:
        return f"{text}; use np.diag({name})"
    if found.ndim == 1 and found.size == shape[0] * shape[1]:
        return f"{text}; use {name}.reshape{shape}"
    if found.ndim == 2 and found.T.shape == shape:
        return f"{text}; use {name}.T"
    return text


def described(found: Array) -> str:
    """Say what was found: a scalar's value or an array's shape."""
    return f"scalar {found}" if found.ndim == 0 else f"shape {found.shape}"


def covariance(name: str, value: Array) -> None:
    """Raise ValueError unless value is symmetric and positive semidefinite, both to rounding and in any units."""
    if not np.isfinite(value).all():
        mend = "; use NaN in z for an absent sensor" if name == "R" else ""
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity{mend}")
    symmetric(name, value)
    try:
        np.linalg.cholesky(value)
    except np.linalg.LinAlgError:
        if not _is_semidefinite(value):
            raise ValueError(
                f"{name}: expected a positive semidefinite matrix, got one whose least eigenvalue is "
                f"{np.linalg.eigvalsh(value)[0]:.3g}"
            ) from None


def process_covariance(name: str, stack: Array) -> None:
    """Raise ValueError unless a matrix, or every matrix of a stack, is finite and symmetric with variances >= 0.

    Programs live with a Q that is slightly indefinite, filterpy's own tests among them: P + Q is what matters.
    """
    if not np.isfinite(stack).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    symmetric(name, stack)
    least = np.diagonal(stack, axis1=-2, axis2=-1).min(initial=0.0)
    if least < 0.0:
        raise ValueError(f"{name}: expected variances >= 0 on the diagonal, got {least:.4g}")


def symmetric(name: str, stack: Array) -> None:
    """Raise ValueError unless a matrix, or every matrix of a stack, is symmetric to rounding; NaN may stand there."""
    if not _is_symmetric(stack):
        raise ValueError(f"{name}: expected a symmetric matrix, got one that differs from its transpose")


def all_covariances(stack: Array) -> bool:
    """Return whether `covariance` takes every matrix of a stack; quickly, if all are positive definite."""
    if stack.shape[1] == 1:
        return stack.size == 0 or bool(stack.min() >= 0.0 and stack.max() < math.inf)
    try:
        if (stack == stack.transpose(0, 2, 1)).all() and np.isfinite(np.linalg.cholesky(stack)).all():
            return True
    except np.linalg.LinAlgError:
        pass
    return bool(np.isfinite(stack).all()) and _is_symmetric(stack) and _is_semidefinite(stack)


def _is_symmetric(stack: Array) -> bool:
    """Return whether nothing differs from its transpose but by rounding, in any units."""
    apart, unit = np.abs(stack - stack.swapaxes(-1, -2)), _unit(stack)
    return not (apart > 1e-8 * unit[..., :, None] * unit[..., None, :]).any()


def _is_semidefinite(stack: Array) -> bool:
    """Return whether no eigenvalue is negative but by rounding, in any units."""
    unit = _unit(stack)
    unit[unit == 0.0] = 1.0
    return bool(np.linalg.eigvalsh(stack / unit[..., :, None] / unit[..., None, :]).min() >= -1e-10)


def _unit(stack: Array) -> Array:
    """Return the standard deviations of covariances: the units of their rows."""
    return np.sqrt(np.abs(np.diagonal(stack, axis1=-2, axis2=-1)))


def finite_vector(name: str, value: Any) -> Array:
    """Return value as a finite one-dimensional float array of at least one number or raise."""
    found = numbers(name, value)
    if found.ndim != 1 or found.size == 0:
        mend = f"; use {name}.ravel()" if found.ndim == 2 and 1 in found.shape and found.size else ""
        raise ValueError(
            f"{name}: expected a one-dimensional array of at least 1 number, got shape {found.shape}{mend}"
        )
    if not np.isfinite(found).all():
        bad = int(np.argmin(np.isfinite(found)))
        raise ValueError(f"{name}: expected finite numbers, got {found[bad]} at index {bad}")
    return found
