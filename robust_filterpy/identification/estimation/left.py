"""What any model of a recording leaves that it should not: jumps where y wraps round, another plant, a closed loop.

Given its own past, an input of an open loop tells nothing of the noise before it. So each input is regressed on its
past and then on past residuals of the model too, clipped so that outliers count little; what these explain is feedback.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.stats import f as fisher

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.dependence import LAGS, autocovariances, broken, dependence, whitening_of
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.influence.regression import mad_scale

# A jump goes over so much of the range, its neighbors over no more than the other, and the model misses so much of it.
_JUMP: Final = 0.7
_QUIET: Final = 0.4
_MISSED: Final = 0.3
# So many are no accident, in which most are missed. Of outliers on a plant that swings some look like it in many.
_FEWEST: Final = 4
_ACCIDENTS: Final = 1 / 5000
_MOST: Final = 0.5
# Parts of a recording that are held against its inputs, and how long one may be.
_PARTS: Final = 8
_LEAST_PART: Final = 120
_MOST_PART: Final = 400
# Samples of a short recording for each lag of the inputs.
_EACH_LAG: Final = 12
# Feedback: samples of the past of an input, residuals before it, and at how many of their scales they are clipped.
_PAST: Final = 16
_RESIDUALS: Final = 6
_CLIP: Final = 2.0
_CHANCE: Final = 1e-7
# What the residuals must explain of what the past of the input leaves of it.
_SHARE: Final = 0.02


def wraps(y: Array, residual: Array) -> tuple[Finding, ...]:
    """Find out whether an output leaves its range at one end and comes back at the other."""
    low, high = np.nanquantile(y, [0.005, 0.995])
    size = float(high - low)
    if not size > 0.0 or y.size < 4:
        return ()
    change = np.abs(np.nan_to_num(np.diff(y), nan=np.inf)) / size
    within = (y >= low - 0.02 * size) & (y <= high + 0.02 * size)
    alone = (change[1:-1] > _JUMP) & (change[:-2] < _QUIET) & (change[2:] < _QUIET) & within[1:-2] & within[2:-1]
    at = np.flatnonzero(alone) + 2
    # A plant that switches jumps too, and its model with it.
    missed = np.abs(np.nan_to_num(residual[at])) > _MISSED * size
    if at.size < max(_FEWEST, _ACCIDENTS * y.size) or missed.sum() < _FEWEST or missed.mean() < _MOST:
        return ()
    text = (
        f"y jumps {at.size} times from one end of its range, {low:.4g} to {high:.4g}, to the other and stays there, "
        "which the model does not: an angle or a counter that wraps? numpy.unwrap(y, period=..) first"
    )
    return (Finding("wraps", text, float("nan"), (int(at[0]), int(at[-1]) + 1)),)


def parts_of(samples: int, others: bool) -> Any:
    """Return the samples of each part of a recording, equally many, up to its end; none if a model is of it alone."""
    span = max(_LEAST_PART, min(samples // _PARTS, _MOST_PART))
    if others:
        span = min(span, samples)
    parts = np.arange(samples % span, samples - span + 1, span)[:, None] + np.arange(span)
    return parts if others or len(parts) > 1 else parts[:0]


def unlike(residual: Array, signals: Array, others: bool = False) -> tuple[Finding, ...]:
    """Find the parts of a recording in which what any model leaves follows the inputs."""
    parts = parts_of(residual.size, others)
    if not len(parts):
        return ()
    lags = min(LAGS, parts.shape[1] // _EACH_LAG) if others else LAGS
    whitening = whitening_of(autocovariances(residual))
    # Two neighbors together are surer of a plant that differs from the model less.
    for windows in (parts, np.hstack((parts[:-1], parts[1:]))):
        test = dependence(residual[windows], signals[windows], lags, whitening) if len(windows) else None
        if test is None or not test.significant.any():
            continue
        where = windows[test.significant]
        first, last = int(where[0, 0]), int(where[-1, -1]) + 1
        text = (
            f"between samples {first} and {last} up to {100 * float(test.share.max()):.0f} % of what the model leaves "
            "follow u: the plant is another one there, a sensor is stuck, or the structure is too small"
        )
        return (Finding("another plant", text, _evidence(test.chance), (first, last)),)
    return ()


def another_gain(residual: Array, x: Array) -> tuple[Finding, ...]:
    """Find out whether the gain of the plant changes in a recording, from all of its samples together."""
    sample, before, after, z = broken(residual, x)
    if not z:
        return ()
    text = (
        f"from about sample {sample} on the gain from u to y is {1.0 + after:.2f} times the model's, before "
        f"{1.0 + before:.2f} times: the plant is another one there, or the structure is too small"
    )
    return (Finding("another plant", text, z * z, (sample, residual.size)),)


def feedback(parts: list[tuple[Array, Array]], direct: bool, meaning: str) -> tuple[Finding, ...]:
    """Find out whether inputs follow the residuals of any model."""
    lags = range(int(direct), _RESIDUALS + 1)
    pasts, lagged, wanted = [], [], []
    for u, left in parts:
        if len(u) <= 2 * _PAST:
            continue
        residual = np.column_stack([_ordinary(one) for one in left.T])
        rows = np.arange(_PAST, len(u))
        pasts.append(np.hstack((*(u[rows - lag] for lag in range(1, _PAST + 1)), np.ones((rows.size, 1)))))
        lagged.append(np.hstack([residual[rows - j] for j in lags]))
        wanted.append(u[rows])
    if not pasts:
        return ()
    X, E, U = np.concatenate(pasts), np.concatenate(lagged), np.concatenate(wanted)
    freedom = len(X) - X.shape[1] - E.shape[1]
    if freedom < 2 * X.shape[1]:
        return ()
    basis = _basis(X)
    left, more = U - basis @ (basis.T @ U), E - basis @ (basis.T @ E)
    own = _basis(more)
    total, explained = np.square(left).sum(axis=0), np.square(own.T @ left).sum(axis=0)
    # An input whose past says all of it has nothing left to be explained.
    varies = total > 1e-9 * np.square(U).sum(axis=0)
    share = np.where(varies, explained / np.where(varies, total, 1.0), 0.0)
    chance = fisher.sf(share / E.shape[1] / (np.maximum(1.0 - share, 1e-12) / freedom), E.shape[1], freedom)
    follows = (share > _SHARE) & (chance < _CHANCE)
    if not follows.any():
        return ()
    which = ", ".join(str(j) for j in np.flatnonzero(follows))
    text = (
        f"input {which} follows what y did before, {100 * float(share.max()):.0f} % of what is new in it: the "
        f"recording comes from a closed loop; {meaning}"
    )
    return (Finding("closed loop", text, _evidence(chance), (0, sum(len(u) for u, _ in parts))),)


def _evidence(chance: Array) -> float:
    """Return twice the log-likelihood of the least chance."""
    return float(-2.0 * np.log(np.maximum(chance.min(), np.finfo(float).tiny)))


def _ordinary(residual: Array) -> Array:
    """Return residuals in units of their scale, clipped, 0 where there are none."""
    measured = ~np.isnan(residual)
    centre = float(np.median(residual[measured])) if measured.any() else 0.0
    scale = mad_scale(residual[measured] - centre) if measured.any() else 0.0
    return np.where(measured, np.clip((np.nan_to_num(residual) - centre) / (scale or 1.0), -_CLIP, _CLIP), 0.0)


def _basis(X: Array) -> Any:
    """Return an orthonormal basis of the columns."""
    left, values, _ = np.linalg.svd(X, full_matrices=False)
    return left[:, values > 1e-9 * max(values[0], np.finfo(float).tiny)]
