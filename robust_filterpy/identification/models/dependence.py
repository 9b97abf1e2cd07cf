"""What is left of a model that follows its inputs: the plant has another gain, sign or pole than the model."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import fdtrc

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import ROUNDING
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.regression import mad_scale

# A residual follows u if that much of it does, and a model that is right shows as much in so few windows.
SHARE: Final = 0.25
#: How many samples of the inputs to look back at.
LAGS: Final = 16
_CHANCE: Final = 1e-8
#: Residuals beyond so many robust standard deviations count as that.
CLIP: Final = 2.0
#: Blocks of samples whose scores are kept.
BLOCKS: Final = 12
# Fewer blocks do not tell how much their scores scatter; of blocks that tell more than others there are fewer: a slow
# input tells all that it does where it moves, and colored noise has one value there.
_FEWEST: Final = 6
# A gain that is off by less is no other plant: the fit is 90 % yet.
_LEAST: Final = 0.1
# Standard deviations, by either variance. In 320 quiet runs (white, colored and changing noise, structures that are
# too small) gains off by _LEAST reached 3.3.
_SURE: Final = 4.5
# The same where each place in a recording of so many blocks is tried, of no fewer samples each; a side of that place
# with fewer blocks that tell is not judged. In 300 quiet runs the largest was 4.1.
_SURE_OF_ANY: Final = 5.5
_SPLIT: Final = 16
_SHORTEST: Final = 30
_BESIDE: Final = 2.5


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
    def significant(self) -> Any:
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
    seen = ~np.isnan(r)
    count = seen.sum(axis=-1)
    r = np.where(seen, r, 0.0)
    level, scale = level_and_scale(r, seen)
    clipped = np.where(seen, np.clip(r - level[..., None], -CLIP * scale[..., None], CLIP * scale[..., None]), 0.0)
    weight = seen / np.maximum(count, 1)[..., None]
    clipped = np.where(seen, clipped - (clipped * weight).sum(axis=-1)[..., None], 0.0)
    centred = columns - np.einsum("...n,...nj->...j", weight, columns)[..., None, :]
    centred = np.where(seen[..., None], centred, 0.0)
    unwhitened, columns = clipped, centred
    if whitening:
        clipped, centred = (_filtered(part, whitening) for part in (clipped[..., None], centred))
        clipped, count = clipped[..., 0], count - len(whitening)
    left, values, right = np.linalg.svd(centred, full_matrices=False)
    usable = values > 1e-6 * np.maximum(values[..., :1], np.finfo(float).tiny)
    rank = usable.sum(axis=-1)
    along = np.einsum("...nj,...n->...j", left, clipped) * usable
    explained = (along**2).sum(axis=-1)
    weights = np.einsum("...ji,...j->...i", right, along / np.where(usable, values, 1.0))
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
    filtered = signals[..., order:, :].copy()
    for j, d in enumerate(whitening, start=1):
        filtered += d * signals[..., order - j : n - j, :]
    return filtered


def autocovariances(residuals: Array) -> Array:
    """Return the autocovariances at lags 0 to 2 of clipped residuals in units of their scale."""
    seen = ~np.isnan(residuals)
    level = np.median(residuals[seen]) if seen.any() else 0.0
    scale = mad_scale(residuals[seen] - level) if seen.any() else 0.0
    e = np.where(seen, np.clip((residuals - level) / (scale or 1.0), -CLIP, CLIP), 0.0)
    return np.array([e[j:] @ e[: e.size - j] for j in range(3)]) / e.size


def level_and_scale(values: Array, seen: Any) -> tuple[Array, Array]:
    """Return the median of values seen along the last axis, and their standard deviation by the median deviation."""
    # Both are 0 where none is seen.
    level = _median(values, seen)
    return level, 1.4826 * _median(np.abs(values - level[..., None]), seen)


def _median(values: Array, seen: Any) -> Array:
    """Return the median of the values seen along the last axis, 0 where there are none."""
    ordered = np.sort(np.where(seen, values, np.inf), axis=-1)
    count = seen.sum(axis=-1)
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


def driven(structure: Structure, theta: Array, prediction: Array, u: Array) -> Array:
    """Return what the model makes of the inputs of a window, as it stands in the residuals."""
    if not structure.na + structure.nc + structure.nd:
        return prediction
    u = u - np.median(u, axis=0)
    model = PolynomialModel(structure, np.zeros(len(u)), u, offset=False, moving=False)
    if model.first >= len(u):
        return np.zeros(0)
    with np.errstate(all="ignore"):
        return -model.residuals(theta)


def score(residuals: Array, x: Array, n: int) -> tuple[float, float]:
    """Return score and information of the gain in the last n samples of a window, 0 and 0 where they tell nothing."""
    samples = _of_samples(residuals, x)
    if samples is None or x.size < n:
        return 0.0, 0.0
    return float(samples[0, -n:].sum()), float(samples[1, -n:].sum())


def changed(scores: Array) -> float:
    """Return by how much of the model's the gain has changed, 0 if by no more than chance or too little to matter."""
    s, i = scores.T
    if not i.any() or i.sum() ** 2 < _FEWEST * (i @ i):
        return 0.0
    g, n = s.sum() / i.sum(), i.sum() ** 2 / (i @ i)
    variance = max(float(i.sum()), float(np.square(s - g * i).sum()) * n / (n - 1.0)) / i.sum() ** 2
    return float(g) if abs(g) > max(_LEAST, _SURE * np.sqrt(variance)) else 0.0


def broken(residual: Array, x: Array) -> tuple[int, float, float, float]:
    """Return where the gain of a plant has changed in a recording, if it has."""
    nothing, samples, span = (residual.size, 0.0, 0.0, 0.0), _of_samples(residual, x), x.size // _SPLIT
    if samples is None or span < _SHORTEST:
        return nothing
    first = x.size - span * _SPLIT
    s, i = samples[:, first:].reshape(2, _SPLIT, span).sum(axis=2)
    best = nothing
    for k in range(1, _SPLIT):
        sides = [np.arange(_SPLIT) < k, np.arange(_SPLIT) >= k]
        information = np.array([i[side].sum() for side in sides])
        if min(i[side].sum() ** 2 / max(i[side] @ i[side], 1e-300) for side in sides) < _BESIDE:
            continue
        g = np.array([s[side].sum() for side in sides]) / information
        left = s - np.where(sides[0], *g) * i
        scattered = max(1.0, float(left @ left) / i.sum() * _SPLIT / (_SPLIT - 2.0))
        z = float(np.diff(g)[0] / np.sqrt(scattered * (1.0 / information).sum()))
        if np.abs(g).max() > _LEAST and abs(z) > max(_SURE_OF_ANY, abs(best[3])):
            best = residual.size - x.size + first + k * span, float(g[0]), float(g[1]), z
    return best


def _of_samples(residual: Array, x: Array) -> Array | None:
    """Return what each sample that x tells of adds to score and information, shape (2, M); None if nearly none do."""
    e = residual[residual.size - x.size :]
    seen = ~np.isnan(e) & np.isfinite(x)
    if seen.sum() < max(x.size // 4, 1):
        return None
    level, scale = level_and_scale(e, seen)
    clipped = np.where(seen, np.clip(e - level, -CLIP * scale, CLIP * scale), 0.0)
    R = float(clipped @ clipped) / seen.sum()
    if not R > 0.0:
        return None
    clipped, x = (np.where(seen, part - part[seen].mean(), 0.0) for part in (clipped, np.where(seen, x, 0.0)))
    return np.stack((clipped * x, x * x)) / R
