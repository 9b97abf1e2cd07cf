"""Argument checks with uniform messages: name, what was expected, what was found, the likely mend."""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FLOAT = np.dtype(np.float64)

#: How far below 0 an eigenvalue may be where the variances are 1: of what a user passes, and of what a recursion gives.
GIVEN, GATHERED = 1e-10, 1e-8
#: What rounding leaves of a variance of 0 in a recursion, as a share of the largest one.
ROUNDING = 1e-15

# np.asarray(.., float) silently accepts text, dates and durations.
_NO_NUMBERS = "cmMSU"
_NO_NUMBER = (str, bytes, np.datetime64, np.timedelta64)
_TOO_LARGE = "{}: expected numbers up to 1.8e308 in size, got {}"


def shown(value: Any) -> str:
    """Return a value as a message can show it: as its repr, the middle of a long one left out."""
    try:
        with np.printoptions(threshold=20):
            text = repr(value.item() if isinstance(value, np.generic) else value)
    except Exception:
        # An integer of too many digits has no repr, nor have some objects.
        text = f"{type(value).__name__} without a repr"
    if "\n" in text and not isinstance(value, (np.ndarray, list, tuple)):
        return f"a {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:120]} ... {text[-40:]}"


def positive(name: str, value: Any, *, infinite: bool = False) -> float:
    """Return value as a float > 0 or raise."""
    number = real(name, value)
    if not number > 0 or (math.isinf(number) and not infinite):
        kind = "a number > 0" if infinite else "a finite number > 0"
        raise ValueError(f"{name}: expected {kind}, got {shown(value)}")
    return number


def interval(name: str, value: Any) -> tuple[float, float]:
    """Return the ends of an interval, None standing for no end, or raise."""
    if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != 2:
        raise ValueError(f"{name}: expected (low, high), got {shown(value)}")
    low, high = (none if end is None else real(name, end) for end, none in zip(value, (-np.inf, np.inf), strict=True))
    if not low < high:
        raise ValueError(f"{name}: expected low < high, got {value}; fixed= takes a number")
    return low, high


def fraction(name: str, value: Any) -> float:
    """Return value as a float in [0, 1) or raise."""
    number = real(name, value)
    if not 0 <= number < 1:
        raise ValueError(f"{name}: expected a number in [0, 1), got {shown(value)}")
    return number


def probabilities(name: str, value: Any, count: int) -> Array:
    """Return value as so many numbers > 0 with sum 1 or raise."""
    values = numbers(name, value)
    if values.shape != (count,) or not (values > 0.0).all() or not np.isclose(values.sum(), 1.0):
        raise ValueError(f"{name}: expected {count} numbers > 0 that sum to 1, one for each scale, got {shown(value)}")
    return values


def real(name: str, value: Any) -> float:
    """Return value as a float or raise."""
    if isinstance(value, float):
        return float(value)
    if isinstance(value, (*_NO_NUMBER, bool, np.bool_)) or np.ndim(value) != 0:
        raise TypeError(f"{name}: expected a number, got {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(_TOO_LARGE.format(name, shown(value))) from None
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a number, got {shown(value)}") from None


def count(name: str, value: Any, least: int = 0) -> int:
    """Return value as an int >= least or raise."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected an integer >= {least}, got {shown(value)}")
    if not least <= value < 2**62:
        beyond = "" if value < least else " and < 2**62"
        raise ValueError(f"{name}: expected an integer >= {least}{beyond}, got {shown(value)}")
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
    if type(value) is np.ndarray and value.dtype is FLOAT:
        return value
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)
    if isinstance(value, bytearray):
        raise TypeError(f"{name}: expected real numbers, got {shown(value)}")
    try:
        array = np.asarray(value)
        if array.dtype.kind in _NO_NUMBERS:
            raise TypeError(f"{name}: expected real numbers, got {_no_number(array)}")
        if array.dtype.kind == "O" and any(isinstance(item, _NO_NUMBER) for item in array.flat):
            raise TypeError(f"{name}: expected real numbers, got {_no_number(array)}")
        if array.dtype.kind == "O" and "pandas" in sys.modules:
            absent = sys.modules["pandas"].NA
            value = np.where([item is absent for item in array.flat], np.nan, array.ravel()).reshape(array.shape)
    except ValueError:
        raise TypeError(f"{name}: expected real numbers, got {shown(value)}") from None
    try:
        return np.asarray(value, dtype=float)
    except OverflowError:
        raise ValueError(_TOO_LARGE.format(name, shown(value))) from None
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected real numbers, got {shown(value)}") from None


def _no_number(array: Any) -> str:
    """Return what of an array is no number, where, and what to do: of text the first that does not even read as one."""
    if array.dtype.kind in "cmM":
        return f"dtype {array.dtype}: {shown(array)}"
    others = [k for k, item in enumerate(array.flat) if isinstance(item, _NO_NUMBER)]
    k = next((k for k in others if not _reads_as_number(array.flat[k])), others[0])
    place = f" at index {', '.join(map(str, map(int, np.unravel_index(k, array.shape))))}" if array.ndim else ""
    mend = "; pandas.to_numeric(.., errors='coerce') makes numbers of a column of text, and NaN of what is none"
    item = array.flat[k]
    return f"{shown(item.item() if isinstance(item, np.generic) else item)}{place}{mend if array.size > 1 else ''}"


def _reads_as_number(item: Any) -> bool:
    """Return whether text reads as a number."""
    try:
        float(item)
    except (TypeError, ValueError):
        return False
    return isinstance(item, (str, bytes))


def takes(function: Callable[..., Any], name: str) -> bool:
    """Return whether a function has an argument of that name."""
    try:
        return name in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def entries(name: str, values: Any) -> Any:
    """Return values that are read step by step: a table (pandas, polars) as its rows, else as given; or raise."""
    single = isinstance(values, np.ndarray) and values.ndim == 0
    if single or isinstance(values, (Mapping, set, frozenset, str, bytes, bytearray)):
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
    array = numbers(name, value)
    if array.shape == shape:
        return array
    if array.size == 1 and shape == (1, 1):
        return array.reshape(shape)
    raise ValueError(f"{name}: expected shape {shape} for {reason}, got {_mend(name, array, shape)}")


def finite(name: str, value: Any, shape: tuple[int, ...], reshaped: bool = False) -> Array:
    """Return value as a finite float array of this shape, or of as many numbers where it is reshaped, or raise."""
    array = numbers(name, value)
    if reshaped and array.size == math.prod(shape):
        array = array.reshape(shape)
    if array.shape != shape or not np.isfinite(array).all():
        what = f"finite numbers of shape {shape}" if shape else "a finite number"
        raise ValueError(f"{name}: expected {what}, got {shown(value)}")
    return array


def _mend(name: str, array: Array, shape: tuple[int, int]) -> str:
    """Describe what was found and, where it is plain, what was meant."""
    if array.ndim == 0:
        return f"scalar {array}; use {array}*np.eye({shape[0]})" if shape[0] == shape[1] else f"scalar {array}"
    text = f"{array.shape}"
    if array.ndim == 1 and shape[0] == shape[1] == array.size:
        return f"{text}; use np.diag({name})"
    if array.ndim == 1 and array.size == shape[0] * shape[1]:
        return f"{text}; use {name}.reshape{shape}"
    if array.ndim == 2 and array.T.shape == shape:
        return f"{text}; use {name}.T"
    return text


def described(array: Array) -> str:
    """Say what was found: a scalar's value or an array's shape."""
    return f"scalar {array}" if array.ndim == 0 else f"shape {array.shape}"


def covariance(name: str, stack: Array, slack: float = GIVEN, gathered: float = 0.0) -> None:
    """Raise ValueError unless a matrix, or every matrix of a stack, is a covariance, in whatever units."""
    bad = ~are_covariances(stack, slack, gathered)
    if not bad.any():
        return
    first = tuple(int(i) for i in np.unravel_index(int(np.argmax(bad)), bad.shape))
    if bad.size > 1:
        name = f"{name}[{', '.join(map(str, first))}]"
    one = stack[first]
    if not np.isfinite(one).all():
        mend = "; use NaN in z for an absent sensor" if name == "R" else ""
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity{mend}")
    if not _is_symmetric(one, _unit(one, slack, gathered)):
        raise ValueError(f"{name}: expected a symmetric matrix, got one that differs from its transpose")
    if slack == math.inf:
        raise ValueError(f"{name}: expected variances >= 0 on the diagonal, got {np.diagonal(one).min():.4g}")
    raise ValueError(
        f"{name}: expected a positive semidefinite matrix, got one whose least eigenvalue is "
        f"{np.linalg.eigvalsh(one)[0]:.3g}"
    )


def are_covariances(stack: Array, slack: float = GIVEN, gathered: float = 0.0) -> NDArray[np.bool_]:
    """Return which matrices of a stack `covariance` takes, shape (..); quickly, if all are positive definite."""
    if stack.shape[-1] == 1:
        return (stack[..., 0, 0] >= 0.0) & (stack[..., 0, 0] < math.inf)
    good = np.asarray(np.isfinite(stack).all(axis=(-2, -1)))
    if good.all() and _are_positive(stack):
        return good
    stack = stack if good.all() else np.where(good[..., None, None], stack, np.eye(stack.shape[-1]))
    unit = _unit(stack, slack, gathered)
    good &= _is_symmetric(stack, unit)
    if slack == math.inf:
        return good & (np.diagonal(stack, axis1=-2, axis2=-1) >= 0.0).all(axis=-1)
    good &= np.linalg.eigvalsh(stack / unit[..., :, None] / unit[..., None, :])[..., 0] >= -slack
    return np.asarray(good)


def all_covariances(stack: Array) -> bool:
    """Return whether `covariance` takes every matrix of a stack."""
    return bool(are_covariances(stack).all())


def _are_positive(stack: Array) -> bool:
    """Return whether all matrices are symmetric to the last bit, and positive definite."""
    try:
        return bool((stack == stack.swapaxes(-1, -2)).all() and np.isfinite(np.linalg.cholesky(stack)).all())
    except np.linalg.LinAlgError:
        return False


@np.errstate(under="ignore")
def _is_symmetric(stack: Array, unit: Array) -> NDArray[np.bool_]:
    """Return which matrices differ from their transposes by no more than rounding, in their units."""
    apart = np.abs(stack - stack.swapaxes(-1, -2))
    return np.asarray((apart <= 1e-8 * unit[..., :, None] * unit[..., None, :]).all(axis=(-2, -1)))


def _unit(stack: Array, slack: float, gathered: float) -> Array:
    """Return the standard deviations of covariances, the units of their rows; where there is none, the smallest."""
    variances = np.abs(np.diagonal(stack, axis1=-2, axis2=-1))
    floor = variances.max(axis=-1, keepdims=True) * max(gathered / slack, 1e-300)
    return np.sqrt(np.maximum(variances, np.maximum(floor, 1e-300)))


def finite_vector(name: str, value: Any) -> Array:
    """Return value as a finite one-dimensional float array of at least one number or raise."""
    vector = numbers(name, value)
    if vector.ndim != 1 or vector.size == 0:
        mend = f"; use {name}.ravel()" if vector.ndim == 2 and 1 in vector.shape and vector.size else ""
        raise ValueError(
            f"{name}: expected a one-dimensional array of at least 1 number, got shape {vector.shape}{mend}"
        )
    if not np.isfinite(vector).all():
        bad = int(np.argmin(np.isfinite(vector)))
        raise ValueError(f"{name}: expected finite numbers, got {vector[bad]} at index {bad}")
    return vector
