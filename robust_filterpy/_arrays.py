"""From filterpy's many shapes to one: what the filters make of the arrays that users set and pass."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import FLOAT, Array

# Size up to which a checked covariance is remembered by its bytes: 256 of them take two megabytes.
_REMEMBERED = 32
# The bytes of the last Q of each size: to compare them takes a tenth of the time that it takes to look them up.
_last_Q: dict[int, bytes] = {}


def state_of(kf: Any) -> tuple[Array, Array]:
    """Return x, shape (n,) or (n, 1), and P, shape (n, n), as float arrays."""
    x, P, n = kf.x, kf.P, kf.dim_x
    if type(x) is type(P) is np.ndarray and x.dtype is P.dtype == FLOAT:
        if P.shape == (n, n) and (x.shape == (n, 1) or x.shape == (n,)):
            return x, P
    x = _checks.numbers("x", x)
    if x.ndim == 0 and n == 1:
        x = x.reshape(1)
    if x.shape not in ((n, 1), (n,)):
        raise ValueError(f"x: expected shape {(n, 1)} or {(n,)} for dim_x={n}, got {_checks.described(x)}")
    # filterpy multiplies by P, so there a scalar acts as P I.
    return x, square("P", P, n, "dim_x={}")


def measured(z: Any, m: int, missing: bool = False) -> Any:
    """Return z as an array of shape (m,), as a float if m = 1, or None if nothing was measured."""
    if m == 1 and type(z) is float:
        number = z
    else:
        array = z if type(z) is np.ndarray and z.dtype == FLOAT else _checks.numbers("z", z)
        if array.shape != (m,) and (array.size != m or array.ndim > 2 or (array.ndim == 2 and 1 not in array.shape)):
            plural = "number" if m == 1 else "numbers"
            raise ValueError(f"z: expected {m} {plural} for H with {m} row(s), got {_checks.described(array)}")
        if m > 1:
            # A copy: what the caller does to his array afterwards must not change kf.z.
            array = array.flatten()
            total = sum(array.tolist())
            if total - total == 0.0:
                return array
            if np.isinf(array).any():
                raise ValueError(f"z: expected finite numbers or NaN (missing), got {array}")
            return array if missing or not np.isnan(array).all() else None
        number = array.item()
    if math.isinf(number):
        raise ValueError(f"z: expected a finite number or NaN (missing), got {number}")
    return number if missing or number == number else None


def square(name: str, value: Any, n: int, reason: str) -> Array:
    """Return a matrix, shape (n, n), of a scalar that times I; reason: what n is, with a place for it."""
    if type(value) is np.ndarray and value.dtype == FLOAT and value.shape == (n, n):
        return value
    if np.ndim(value) == 0 and value is not None:
        value = _checks.real(name, value) * np.eye(n)
    return _checks.matrix(name, value, (n, n), reason.format(n))


def noise_covariance(default: Any, given: Any, m: int) -> Array:
    """Return R, shape (m, m), positive semidefinite; a scalar means times I, wherever it comes from."""
    R = square("R", default if given is None else given, m, "dim_z={}")
    if m == 1:
        if not 0.0 <= R.item() < math.inf:
            raise ValueError(f"R: expected a variance >= 0, got {R.item()}; use NaN in z for a sensor that is absent")
    elif m <= _REMEMBERED:
        # By content, since users write into R, and by the bytes, since most never do.
        _require("R", R.tobytes(), m, _checks.GIVEN)
    else:
        _checks.covariance("R", R)
    return R


@lru_cache(maxsize=256)
def _require(name: str, content: bytes, m: int, slack: float) -> None:
    """Raise as the check of a covariance does; what passed once is remembered."""
    _checks.covariance(name, np.frombuffer(content).reshape(m, m), slack)


def process_noise(default: Any, given: Any, n: int) -> Array:
    """Return Q, shape (n, n), symmetric, with variances >= 0; a scalar means times I, wherever it comes from."""
    Q = square("Q", default if given is None else given, n, "dim_x={}")
    content = Q.tobytes()
    if content != _last_Q.get(n):
        if n <= _REMEMBERED:
            _require("Q", content, n, math.inf)
        else:
            _checks.covariance("Q", Q, math.inf)
        _last_Q[n] = content
    return Q


def measurement_rows(zs: Any, m: int, name: str = "zs") -> Array:
    """Return measurements as shape (N, m), NaN where missing, or raise."""
    zs = _checks.entries(name, zs)
    if not hasattr(zs, "__len__"):
        raise TypeError(f"{name}: expected a sequence of measurements, got {_checks.shown(zs)}")
    if not isinstance(zs, np.ndarray):
        zs = list(zs)
        if any(z is None or isinstance(z, np.ma.MaskedArray) for z in zs):
            gap = np.full(m, np.nan)
            zs = [gap if z is None else np.ravel(_checks.numbers(name, z)) for z in zs]
    steps = len(zs)
    if steps == 0:
        raise ValueError(f"{name}: expected at least one entry, got none")
    try:
        values = _checks.numbers(name, zs)
    except TypeError:
        _require_size(zs, m, name)
        raise
    if values.size != steps * m or values.ndim > 3 or (values.ndim == 3 and 1 not in values.shape[1:]):
        _require_size(zs, m, name)
        raise ValueError(f"{name}: expected shape {(steps, m)}, as the model has, got {values.shape}")
    return np.ascontiguousarray(values.reshape(steps, m))


def _require_size(zs: Any, m: int, name: str) -> None:
    """Raise if the entries of a list do not hold so many numbers each."""
    sizes = set() if isinstance(zs, np.ndarray) else {np.size(z) for z in zs} - {m}
    if sizes:
        raise ValueError(f"{name}: expected {m} number(s) at each step, as the model has, got {sizes.pop()}") from None


def stack(name: str, default: Any, values: Any, steps: int | None, shape: tuple[int | None, int]) -> Array:
    """Return one matrix, or one a step, with the axis of steps in front; a scalar Q or R stands for itself times I."""
    rows, columns = shape
    scalar = rows == columns and (name in "QR" or rows == 1)
    if values is None:
        matrices = _checks.numbers(name, default)
        matrices = (matrices * np.eye(columns) if matrices.ndim == 0 and scalar else matrices)[None]
    else:
        values = _checks.entries(f"{name}s", values)
        if not hasattr(values, "__len__"):
            raise TypeError(f"{name}s: expected a sequence of matrices, got {_checks.shown(values)}")
        if steps is not None and len(values) < steps:
            raise ValueError(f"{name}s: expected an entry for each of the {steps} measurements, got {len(values)}")
        try:
            matrices = _checks.numbers(f"{name}s", values if isinstance(values, np.ndarray) else list(values)[:steps])
        except TypeError:
            raise TypeError(
                f"{name}s: expected matrices of one shape for all steps, got {_checks.shown(values)}"
            ) from None
        matrices = matrices[:steps]
        matrices = matrices[:, None, None] * np.eye(columns) if matrices.ndim == 1 and scalar else matrices
    if matrices.ndim != 3 or matrices.shape[2] != columns or (rows is not None and matrices.shape[1] != rows):
        expected = f"({'dim_z' if rows is None else rows}, {columns})"
        raise ValueError(f"{name}: expected shape {expected} at each step, got {matrices.shape[1:]}")
    return matrices


def control_matrix(B: Any, n: int) -> Array:
    """Return B, shape (n, dim_u), without columns where there is no input."""
    B = _checks.numbers("B", B)
    if B.ndim == 0 and B == 0.0:
        return np.zeros((n, 0))
    if B.ndim > 2 or (B.shape[:1] != (n,) and (B.ndim or n > 1)):
        raise ValueError(f"B: expected shape ({n}, dim_u) for dim_x={n}, got {_checks.described(B)}")
    return B.reshape(n, -1)


def control_term(B: Any, u: Any, shape: tuple[int, ...]) -> Array:
    """Return B u in the shape of x."""
    u, n = _checks.numbers("u", u), shape[0]
    if np.ndim(B) == 0 and B == 0.0:
        return np.zeros(shape)
    B = control_matrix(B, n)
    width = B.shape[1]
    if u.ndim == 0 and (u == 0.0 or width == 1):
        return (B[:, 0] * u if width else np.zeros(n)).reshape(shape)
    if u.size != width:
        raise ValueError(f"u: expected {width} numbers for B of shape {B.shape}, got {_checks.described(u)}")
    return B.dot(u.reshape(width)).reshape(shape)


def regardless(function: Any, *args: Any) -> Any:
    """Call a pure function; anew and without floating-point errors where the program has numpy raise them.

    That underflow is 0 and overflow is seen in the result, the functions of this package rely on. To set numpy's
    error state at every step would cost more than the few steps that are taken twice.
    """
    try:
        return function(*args)
    except FloatingPointError:
        with np.errstate(all="ignore"):
            return function(*args)


def require_finite_prediction(x: Array, P: Array) -> None:
    """Raise unless x and P are finite: one product shows whether any entry of either is not."""
    total = sum(P.dot(x).ravel().tolist())
    if total - total != 0.0:
        for name, value, causes in (("x", x, "x, F, B and u"), ("P", P, "P, F and Q")):
            if not np.isfinite(value).all():
                raise ValueError(f"predict: expected a finite {name}, got NaN or infinity; check {causes}")
