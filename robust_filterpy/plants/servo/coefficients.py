"""Uncertain coefficients of the pneumatic servo: alpha(t) and beta(t) of eqs (2) and (6).

alpha is the polytropic exponent of the air in the chambers (1: isothermal, kappa: adiabatic); beta joins it with the
discharge coefficient of the valve and the temperature of the gas. Both are known only within a range, and wander in it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, option

#: A number, a function of time, or a pair (times, values) that is interpolated linearly.
Coefficient: TypeAlias = "float | Callable[[float], float] | tuple[ArrayLike, ArrayLike]"

ALPHA_RANGE = (1.0, 1.3997)
BETA_RANGE = (0.075, 1.3297)
RANGES = {"alpha": ALPHA_RANGE, "beta": BETA_RANGE}


def beta_coefficient(alpha: ArrayLike, discharge_coefficient: ArrayLike, temperature_ratio: ArrayLike = 1.0) -> Any:
    """Combine the heat coefficient, the valve's discharge and the gas temperature: eq (6).

    ``beta = alpha C_d sqrt(tau)``.

    Parameters
    ----------
    alpha : float or array_like, shape (N,)
        Heat coefficient, in [1, 1.3997].
    discharge_coefficient : float or array_like, shape (N,)
        C_d of the valve, dimensionless, positive.
    temperature_ratio : float or array_like, shape (N,)
        tau, absolute temperature of the gas over the nominal one, dimensionless, positive.

    Returns
    -------
    float or numpy.ndarray, shape (N,)
        beta, dimensionless.

    Raises
    ------
    ValueError
        If alpha or the resulting beta leaves its range, or C_d or tau is not positive.

    Examples
    --------
    >>> round(beta_coefficient(1.2, 0.25, 1.21), 12)
    0.33
    """
    alpha = checked(alpha, "alpha", ALPHA_RANGE)
    discharge = np.asarray(discharge_coefficient, dtype=float)
    tau = np.asarray(temperature_ratio, dtype=float)
    for name, value in (("discharge_coefficient", discharge), ("temperature_ratio", tau)):
        if not np.all(value > 0):
            raise ValueError(f"{name}: expected positive numbers, got a minimum of {np.min(value)}")
    beta = checked(alpha * discharge * np.sqrt(tau), "beta", BETA_RANGE)
    return float(beta) if beta.ndim == 0 else beta


def random_coefficient(
    name: str,
    t: ArrayLike,
    *,
    low: float | None = None,
    high: float | None = None,
    spread: float = 0.05,
    start: float | None = None,
    rng: Any = None,
) -> Array:
    """Draw a slow random path of alpha(t) or beta(t), eqs (2) and (6).

    A random walk reflected at `low` and `high`: it is continuous in time, and in the long run every value between
    the two is equally likely.

    Parameters
    ----------
    name : {"alpha", "beta"}
        The heat coefficient, in [1, 1.3997], or the bound parameter, in [0.075, 1.3297].
    t : array_like, shape (N,)
        Times, strictly increasing, in s.
    low, high : float, optional
        Bounds of the path, within its range; by default the ends of it.
    spread : float
        Standard deviation of the unreflected walk after one second, as a fraction of ``high - low``.
    start : float, optional
        Value at ``t[0]``; the middle of the bounds by default.
    rng : None, int or numpy.random.Generator
        Source of randomness, handed to `numpy.random.default_rng`.

    Returns
    -------
    numpy.ndarray, shape (N,)

    Raises
    ------
    ValueError
        If there is no coefficient of this name, the bounds leave its range, `start` leaves the bounds, `spread` is
        negative or `t` does not increase.

    Notes
    -----
    The range of beta is wide: from its bottom to its top the gain from valve to velocity grows 18 times, more than one
    position loop can carry well; give narrower bounds, or compose beta from its causes with `beta_coefficient`.

    Examples
    --------
    >>> import numpy as np
    >>> path = random_coefficient("alpha", np.arange(0, 20, 0.01), low=1.1, high=1.3, rng=1)
    >>> bool(1.1 <= path.min() and path.max() <= 1.3)
    True
    """
    limits = RANGES[option("name", name, RANGES)]
    times = _increasing(t, "t")
    low, high = limits[0] if low is None else low, limits[1] if high is None else high
    checked([low, high], f"bounds of {name}", limits)
    if not low < high:
        raise ValueError(f"bounds of {name}: expected low < high, got {low} and {high}")
    if not (np.isfinite(spread) and spread >= 0):
        raise ValueError(f"spread: expected a number >= 0, got {spread}")
    first = 0.5 * (low + high) if start is None else float(checked(start, f"start of {name}", (low, high)))
    width = high - low
    steps = np.random.default_rng(rng).standard_normal(times.size - 1) * spread * width * np.sqrt(np.diff(times))
    free = np.concatenate([[first - low], first - low + np.cumsum(steps)])
    # To fold a free walk is the same as to reflect it at the bounds.
    folded = np.abs((free + width) % (2 * width) - width)
    return np.clip(low + folded, low, high)


def coefficient_function(value: Coefficient, name: str, limits: tuple[float, float]) -> Callable[[float], float]:
    """Return a coefficient as a function of time that refuses to leave its range.

    Parameters
    ----------
    value : float, callable or pair of array_like, each of shape (k,)
        A constant, a function of time in s, or ``(times, values)``, interpolated linearly and held at its ends.
    name : str
        What error messages call it.
    limits : (float, float)
        The range, both ends included.

    Returns
    -------
    callable
        float -> float.

    Raises
    ------
    ValueError
        If a value leaves the range: at once for numbers and paths, when it is called for a function.
    TypeError
        If `value` is none of the three.
    """
    if callable(value):

        def function(t: float) -> float:
            now = float(value(t))
            if not limits[0] <= now <= limits[1]:
                checked(now, f"{name}({t:g})", limits)
            return now

        return function
    if isinstance(value, tuple):
        if len(value) != 2:
            raise ValueError(f"{name}: expected a pair (times, values), got a tuple of length {len(value)}")
        times, path = _increasing(value[0], f"times of {name}"), checked(value[1], name, limits)
        if path.shape != times.shape:
            raise ValueError(f"{name}: expected as many values as times {times.shape}, got shape {path.shape}")
        return lambda t: float(np.interp(t, times, path))
    constant = checked(value, name, limits)
    if constant.ndim:
        raise TypeError(
            f"{name}: expected a number, a function of time or a pair (times, values), got an array of shape "
            f"{constant.shape}; use (t, {name})"
        )
    number = float(constant)
    return lambda t: number


def _increasing(t: ArrayLike, name: str) -> Array:
    """Return times as an array, or refuse them."""
    times = np.asarray(t, dtype=float)
    if times.ndim != 1 or times.size == 0:
        raise ValueError(f"{name}: expected a non-empty sequence of times, got shape {times.shape}")
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise ValueError(f"{name}: expected finite, strictly increasing times")
    return times


def checked(value: Any, name: str, limits: tuple[float, float]) -> Array:
    """Return value as an array inside limits, or refuse it."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected numbers, got {type(value).__name__}") from None
    if not np.all((array >= limits[0]) & (array <= limits[1])):
        worst = array.flat[int(np.argmin((array >= limits[0]) & (array <= limits[1])))]
        raise ValueError(f"{name}: expected values in [{limits[0]:g}, {limits[1]:g}], got {worst:g}")
    return array
