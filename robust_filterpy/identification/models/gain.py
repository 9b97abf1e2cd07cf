"""Whether the gain of a plant is still its model's, by the score of the gain over many samples.

With x what the model makes of its inputs, as it stands in the residuals (H^-1 G u in y = G u + H e), a plant whose gain
is 1 + g times the model's leaves e + g x. A block of samples adds s = sum(e x)/R to the score of g and i = sum(x^2)/R
to its information, so that g = sum(s)/sum(i), of variance 1/sum(i) where the noise is white, and in any noise of
variance sum((s - g i)^2)/sum(i)^2 (Huber, Proceedings of the Fifth Berkeley Symposium 1, 1967). One direction needs
less evidence than all lags of the inputs do, and least squares have made it orthogonal to what a structure that is too
small leaves.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.dependence import CLIP, level_and_scale
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import Structure

__all__ = ["BLOCKS", "broken", "changed", "driven", "score"]

#: Blocks of samples whose scores are kept.
BLOCKS: Final = 12
# Fewer blocks do not tell how much their scores scatter; of blocks that tell more than others there are fewer: a slow
# input tells all that it does where it moves, and coloured noise has one value there.
_FEWEST: Final = 6
# A gain that is off by less is no other plant: the fit is 90 % yet.
_LEAST: Final = 0.1
# Standard deviations, by either variance. In 320 quiet runs (white, coloured and changing noise, structures that are
# too small) gains off by _LEAST reached 3.3.
_SURE: Final = 4.5
# The same where each place in a recording of so many blocks is tried, of no fewer samples each; a side of that place
# with fewer blocks that tell is not judged. In 300 quiet runs the largest was 4.1.
_SURE_OF_ANY: Final = 5.5
_SPLIT: Final = 16
_SHORTEST: Final = 30
_BESIDE: Final = 2.5


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
    found = nothing
    for k in range(1, _SPLIT):
        sides = [np.arange(_SPLIT) < k, np.arange(_SPLIT) >= k]
        told = np.array([i[side].sum() for side in sides])
        if min(i[side].sum() ** 2 / max(i[side] @ i[side], 1e-300) for side in sides) < _BESIDE:
            continue
        g = np.array([s[side].sum() for side in sides]) / told
        left = s - np.where(sides[0], *g) * i
        scattered = max(1.0, float(left @ left) / i.sum() * _SPLIT / (_SPLIT - 2.0))
        z = float(np.diff(g)[0] / np.sqrt(scattered * (1.0 / told).sum()))
        if np.abs(g).max() > _LEAST and abs(z) > max(_SURE_OF_ANY, abs(found[3])):
            found = residual.size - x.size + first + k * span, float(g[0]), float(g[1]), z
    return found


def _of_samples(residual: Array, x: Array) -> Array | None:
    """Return what each sample that x tells of adds to score and information, shape (2, M); None if nearly none do."""
    e = residual[residual.size - x.size :]
    known = ~np.isnan(e) & np.isfinite(x)
    if known.sum() < max(x.size // 4, 1):
        return None
    level, scale = level_and_scale(e, known)
    clipped = np.where(known, np.clip(e - level, -CLIP * scale, CLIP * scale), 0.0)
    R = float(clipped @ clipped) / known.sum()
    if not R > 0.0:
        return None
    clipped, x = (np.where(known, part - part[known].mean(), 0.0) for part in (clipped, np.where(known, x, 0.0)))
    return np.stack((clipped * x, x * x)) / R
