"""Inputs that excite a plant: binary signals with a prescribed autocovariance, and what to prescribe.

A binary signal has the most power that its amplitude allows; its spectrum is shaped by choosing where it switches.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.linalg
import scipy.special
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, finite_vector, numbers, real

__all__ = ["bandlimited_pink_autocovariance", "receding_horizon_binary"]

MAX_HORIZON = 16


def bandlimited_pink_autocovariance(w_low: float, w_high: float, n_lags: int) -> Array:
    """Compute the autocovariance of band-limited 1/f noise of unit variance, eq (57).

    ``r_0 = 1`` and ``r_k = (Ci(k w_high) - Ci(k w_low)) / ln(w_high / w_low)``, Ci being the cosine integral.

    Parameters
    ----------
    w_low, w_high : float
        Ends of the band, in rad/sample, ``0 < w_low < w_high <= pi``.
    n_lags : int
        Last lag, >= 0.

    Returns
    -------
    ndarray, shape (n_lags + 1,)
        r_0 .. r_n_lags.

    Raises
    ------
    ValueError
        If the band is empty or leaves (0, pi], or n_lags is negative.
    TypeError
        If an argument is of the wrong kind.

    Notes
    -----
    The spectrum is (56), ``1 / (w ln(w_high / w_low))`` in the band. The paper prints ``1 / (ln w_high - w_low)`` for
    the factor; with that the variance would not be 1.

    Examples
    --------
    >>> bandlimited_pink_autocovariance(0.5, 2.5, 3).round(4)
    array([ 1.    ,  0.2881, -0.3277, -0.2204])
    """
    w_low, w_high = _band(w_low, w_high)
    k = np.arange(1, count("n_lags", n_lags) + 1)
    _, ci_low = scipy.special.sici(k * w_low)
    _, ci_high = scipy.special.sici(k * w_high)
    return np.concatenate(([1.0], (ci_high - ci_low) / math.log(w_high / w_low)))


def receding_horizon_binary(
    autocovariance: ArrayLike, length: int, horizon: int = 1, levels: tuple[float, float] = (-1, 1),
    rng: np.random.Generator | int | None = None,
) -> Array:  # fmt: skip
    """Generate a binary signal whose sampled autocovariance comes close to a prescribed one.

    At every instant the 2^m continuations of m samples are compared; of the one whose sampled autocovariance (54)
    is nearest to the prescribed one in the Euclidean norm, the first sample is kept: steps 1-7 of section 3.2.

    Parameters
    ----------
    autocovariance : array_like, shape (n + 1,)
        r_0 .. r_n of the wanted signal about its mean, in the unit of the levels squared. For levels a < b it needs
        ``0 < r_0 <= (b - a)^2 / 4`` and has to be positive semidefinite.
    length : int
        Number N of samples, >= 1.
    horizon : int, default 1
        Number m of samples looked ahead, 1 to 16. The work grows with 2^m; the result seldom does.
    levels : (float, float), default (-1, 1)
        The two values a < b of the signal.
    rng : numpy.random.Generator or int, optional
        Chooses at random among continuations that are equally good. Default: the first of them in lexicographic
        order (a before b), as the paper's enumeration does, so that the signal is the same in every call.

    Returns
    -------
    ndarray, shape (N,)
        The signal. Its mean is near ``a + (b - a) mean01`` (see Notes): for r_0 below the greatest variance
        (b - a)^2 / 4 it is above the middle of the levels.

    Raises
    ------
    ValueError
        If no binary signal of these levels has the autocovariance (r_0 too large, not positive semidefinite), or a
        number is out of its range.
    TypeError
        If an argument is of the wrong kind.

    Notes
    -----
    The search runs on {0, 1}. There the non-central target is ``r_k / (b - a)^2 + mean01^2`` with
    ``mean01 = 1/2 + sqrt(1/4 - r_0 / (b - a)^2)``, which makes its lag 0 equal to mean01, as it must be where
    s^2 = s; for levels -1, 1 and r_0 = 1 it is ``(r_k + 1) / 4``. Eq (55) leads back to the levels.

    The lag sums of (54) are updated and never recomputed: O(2^m m n N) operations, where the steps as printed take
    O(2^m n N^2). The tuple of step 4 ends at t+m-1 (printed: t+m+1).

    Positive semidefinite is necessary, not sufficient: a +-1 signal cannot have every autocovariance, and the last
    per cent of error does not vanish with a longer signal or horizon.

    Examples
    --------
    >>> r = bandlimited_pink_autocovariance(0.5, 2.5, 40)
    >>> s = receding_horizon_binary(r, 10_000)
    >>> s[:8]
    array([-1.,  1.,  1., -1.,  1.,  1., -1.,  1.])
    >>> sampled = np.array([s[k:] @ s[: s.size - k] for k in range(41)]) / s.size
    >>> round(float(np.sqrt(np.mean((sampled - r) ** 2))), 4)
    0.0078
    """
    low, high = _levels(levels)
    target = _binary_target(autocovariance, high - low)
    length = count("length", length, 1)
    horizon = count("horizon", horizon, 1)
    if horizon > MAX_HORIZON:
        raise ValueError(f"horizon: expected at most {MAX_HORIZON} (2^horizon continuations a sample), got {horizon}")
    generator = None if rng is None else np.random.default_rng(rng)
    return np.where(search_bits(target, length, horizon, generator), high, low)


def _binary_target(autocovariance: ArrayLike, span: float) -> Array:
    """Convert a central autocovariance at the levels into the non-central one at {0, 1}, or raise."""
    r = finite_vector("autocovariance", autocovariance) / span**2
    if r[0] <= 0:
        raise ValueError(f"autocovariance: expected r_0 > 0, got {r[0] * span**2:.6g}")
    # Half a unit of the tenth digit: r_0 = 1 may come out of a computation.
    if r[0] > 0.25 * (1 + 1e-10):
        raise ValueError(
            f"autocovariance: a signal with levels {span:g} apart has a variance of at most (b - a)^2/4 = "
            f"{span**2 / 4:g}, got r_0 = {r[0] * span**2:.6g}; scale the autocovariance or widen the levels"
        )
    least = scipy.linalg.eigvalsh(scipy.linalg.toeplitz(r), subset_by_index=[0, 0])[0]
    if least < -1e-10 * r.size * r[0]:
        raise ValueError(
            "autocovariance: expected a positive semidefinite sequence, got one whose Toeplitz matrix has the "
            f"eigenvalue {least * span**2:.3g}: no signal has it"
        )
    mean = 0.5 + math.sqrt(max(0.0, 0.25 - r[0]))
    return r + mean**2


def _band(w_low: Any, w_high: Any) -> tuple[float, float]:
    """Return the ends of a frequency band or raise."""
    low, high = real("w_low", w_low), real("w_high", w_high)
    if not 0 < low < high <= math.pi:
        raise ValueError(
            f"w_low, w_high: expected 0 < w_low < w_high <= pi rad/sample, got {w_low!r} and {w_high!r}; "
            "a frequency in Hz becomes 2 pi f/f_sample"
        )
    return low, high


def _levels(levels: Any) -> tuple[float, float]:
    """Return the two levels of a binary signal or raise."""
    pair = numbers("levels", levels)
    if pair.shape != (2,) or not np.isfinite(pair).all() or not pair[0] < pair[1]:
        raise ValueError(f"levels: expected two finite numbers (a, b) with a < b, got {levels!r}")
    return float(pair[0]), float(pair[1])


def search_bits(target: Array, length: int, horizon: int, rng: np.random.Generator | None) -> np.ndarray:
    """Return a signal of zeros and ones whose non-central autocovariance (54) is near target, lags 0 .. n."""
    n, m = target.size - 1, horizon
    # All of {0, 1}^m in lexicographic order, and the lag sums of each one's own products. Small whole numbers: single
    # precision holds them exactly and is twice as fast.
    tuples = (np.arange(1 << m)[:, None] >> np.arange(m - 1, -1, -1) & 1).astype(np.float32)
    lags = range(min(m, n + 1))
    own = np.column_stack([np.einsum("ij,ij->i", tuples[:, k:], tuples[:, : m - k]) for k in lags])
    # m - 1 zeros in front stand for the samples that are still to come.
    signal = np.zeros(m - 1 + length + n, dtype=np.float32)
    rows = sliding_window_view(signal, n + 1)
    sums = np.zeros(n + 1)
    # Two continuations whose costs differ by less than rounding are equally good.
    tolerance = 8.0 * float(np.finfo(float).eps) * (n + 1) * m * (length + m)
    for t in range(1, length + 1):
        here = m - 1 + length - t
        gap = sums - (t + m - 1) * target
        # Row j holds s_{t+j}, s_{t+j-1}, ..: the products of a one at t+j with the past, 0 with what is to come.
        change = tuples @ rows[here - m + 1 : here + 1][::-1].copy()
        change[:, : own.shape[1]] += own
        # |gap + change|^2 - |gap|^2
        cost = np.einsum("ij,ij->i", change, change + 2.0 * gap)
        best = cost <= cost.min() + tolerance
        index = int(best.argmax()) if rng is None else int(rng.choice(np.flatnonzero(best)))
        if index >> (m - 1):
            signal[here] = 1.0
            sums += rows[here]
    return signal[m - 1 : m - 1 + length][::-1]
