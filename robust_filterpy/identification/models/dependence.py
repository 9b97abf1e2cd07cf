"""What is left of a model that follows its inputs: the plant has another gain, sign or pole than the model."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import fdtrc

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.fit import ROUNDING
from robust_filterpy.influence.regression import mad_scale

__all__ = ["CLIP", "LAGS", "SHARE", "Dependence", "autocovariances", "dependence", "level_and_scale", "whitening_of"]

# A residual follows u if that much of it does, and a model that is right shows as much in so few windows.
SHARE: Final = 0.25
#: How many samples of the inputs to look back at.
LAGS: Final = 16
_CHANCE: Final = 1e-8
#: Residuals beyond so many robust standard deviations count as that.
CLIP: Final = 2.0


class Dependence(NamedTuple):
    """How much of the residuals the past inputs explain.

    Attributes
    ----------
    share : ndarray, shape (..)
        Of the clipped residuals' variance, less what as many other columns would explain by chance.
    chance : ndarray, shape (..)
        Probability of as much for residuals that are white; 1 where too few are known.
    """

    share: Array
    chance: Array

    @property
    def found(self) -> Any:
        """Whether the residuals follow the inputs, so that the dynamics are others than those of the model."""
        return (self.share > SHARE) & (self.chance < _CHANCE)


def dependence(
    residuals: Array, inputs: Array, lags: int = LAGS, whitening: tuple[float, ...] | None = None
) -> Dependence:
    """Regress clipped residuals of a window on the inputs of the same window and before."""
    # A model that is right leaves nothing of u in its residuals, however large the noise has become and however slow u
    # is; after a change of gain, sign or pole, and while a sensor is stuck, they follow u. Clipped at 2 robust standard
    # deviations, an outlier counts little. Residuals that are rounding of the model's output follow nothing.
    n, k = inputs.shape[-2:]
    lags = max(lags // max(k, 1), 2)
    columns = np.concatenate([inputs[..., lags - 1 - j : n - j, :] for j in range(lags)], axis=-1)
    r = residuals[..., lags - 1 :]
    known = ~np.isnan(r)
    count = known.sum(axis=-1)
    r = np.where(known, r, 0.0)
    level, scale = level_and_scale(r, known)
    clipped = np.where(known, np.clip(r - level[..., None], -CLIP * scale[..., None], CLIP * scale[..., None]), 0.0)
    weight = known / np.maximum(count, 1)[..., None]
    clipped = np.where(known, clipped - (clipped * weight).sum(axis=-1)[..., None], 0.0)
    centred = columns - np.einsum("...n,...nj->...j", weight, columns)[..., None, :]
    centred = np.where(known[..., None], centred, 0.0)
    unwhitened, columns = clipped, centred
    if whitening:
        clipped, centred = (_filtered(part, whitening) for part in (clipped[..., None], centred))
        clipped, count = clipped[..., 0], count - len(whitening)
    left, values, right = np.linalg.svd(centred, full_matrices=False)
    kept = values > 1e-6 * np.maximum(values[..., :1], np.finfo(float).tiny)
    rank = kept.sum(axis=-1)
    along = np.einsum("...nj,...n->...j", left, clipped) * kept
    explained = (along**2).sum(axis=-1)
    weights = np.einsum("...ji,...j->...i", right, along / np.where(kept, values, 1.0))
    followed = np.einsum("...nj,...j->...n", columns, weights)
    total = (clipped**2).sum(axis=-1)
    freedom = count - rank - 1
    output = inputs[..., 0] - np.median(inputs[..., 0], axis=-1)[..., None]
    enough = scale > ROUNDING * np.abs(output).max(axis=-1)
    enough &= (total > 0.0) & (freedom >= rank) & (rank > 0) & (count >= n // 2)
    raw = np.where(enough, explained / np.where(total > 0.0, total, 1.0), 0.0)
    odds = raw / np.maximum(rank, 1) / (np.maximum(1.0 - raw, 1e-12) / np.maximum(freedom, 1))
    # Of the residuals as they are: what is sure may still be small.
    size = (followed**2).sum(axis=-1) / np.maximum((unwhitened**2).sum(axis=-1), np.finfo(float).tiny)
    share = np.minimum(size, 1.0) - rank / np.maximum(count, 1) * (1.0 - np.minimum(raw, 1.0))
    chance = np.where(enough, fdtrc(np.maximum(rank, 1), np.maximum(freedom, 1), odds), 1.0)
    return Dependence(np.where(enough, share, 0.0), chance)


def _filtered(signals: Array, whitening: tuple[float, ...]) -> Array:
    """Filter signals of shape (.., n, k) along n, and leave out the first samples."""
    order, n = len(whitening), signals.shape[-2]
    found = signals[..., order:, :].copy()
    for j, d in enumerate(whitening, start=1):
        found += d * signals[..., order - j : n - j, :]
    return found


def autocovariances(residuals: Array) -> Array:
    """Return the autocovariances at lags 0 to 2 of clipped residuals in units of their scale."""
    known = ~np.isnan(residuals)
    level = np.median(residuals[known]) if known.any() else 0.0
    scale = mad_scale(residuals[known] - level) if known.any() else 0.0
    e = np.where(known, np.clip((residuals - level) / (scale or 1.0), -CLIP, CLIP), 0.0)
    return np.array([e[j:] @ e[: e.size - j] for j in range(3)]) / e.size


def level_and_scale(values: Array, known: Any) -> tuple[Array, Array]:
    """Return the median of known values along the last axis, and their standard deviation by the median deviation."""
    # Both are 0 where none is known.
    level = _median(values, known)
    return level, 1.4826 * _median(np.abs(values - level[..., None]), known)


def _median(values: Array, known: Any) -> Array:
    """Return the median of the known values along the last axis, 0 where there are none."""
    ordered = np.sort(np.where(known, values, np.inf), axis=-1)
    count = known.sum(axis=-1)
    padded = np.where(np.isfinite(ordered), ordered, 0.0)
    pick = lambda i: np.take_along_axis(padded, np.maximum(i, 0)[..., None], -1)[..., 0]  # noqa: E731
    return 0.5 * (pick((count - 1) // 2) + pick(count // 2))


def whitening_of(covariances: Array) -> tuple[float, ...]:
    """Return the filter of second order that makes noise with these autocovariances white."""
    r0, r1, r2 = covariances
    if not r0 > 0.0:
        return ()
    gram = np.array([[r0, r1], [r1, r0]]) + 0.02 * r0 * np.eye(2)
    return tuple(-np.linalg.solve(gram, np.array([r1, r2])))
