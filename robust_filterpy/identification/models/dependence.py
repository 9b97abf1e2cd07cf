"""What any model leaves that it should not: what follows its inputs, jumps where y wraps round, a closed loop.

What follows the inputs says that the plant has another gain, sign or pole than the model. Where a gain changes its
sign time and again, or y is as |u|, nothing follows them, but how large it is follows their squares: what any linear
plant leaves of its inputs depends on neither.

Given its own past, an input of an open loop tells nothing of the noise before it. So each input is regressed on its
past and then on past residuals of the model too, clipped so that outliers count little; what these explain is feedback.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve
from scipy.special import fdtrc

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import ROUNDING
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.regression import in_directions

# A residual follows u if that much of it does, and a model that is right shows as much in so few windows.
SHARE: Final = 0.25
#: How many samples of the inputs to look back at.
LAGS: Final = 16
_CHANCE: Final = 1e-8
#: Residuals beyond so many robust standard deviations count as that.
CLIP: Final = 2.0
#: Blocks of so many samples whose scores are kept.
BLOCKS: Final = 12
BLOCK: Final = 40
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
# A jump goes over so much of the range, its neighbors over no more than the other, and the model misses so much of it.
_JUMP: Final = 0.7
_QUIET: Final = 0.4
_MISSED: Final = 0.3
# So many are no accident, in which most are missed. Of outliers on a plant that swings some look like it in many.
_FEWEST_JUMPS: Final = 4
_ACCIDENTS: Final = 1 / 5000
_MOST: Final = 0.5
# Parts of a recording that are held against its inputs, and how long one may be.
_PARTS: Final = 8
_LEAST_PART: Final = 120
_MOST_PART: Final = 400
# Samples of a short recording for each lag of the inputs.
_EACH_LAG: Final = 12
# Feedback: samples of the past of an input, and residuals before it.
_PAST: Final = 16
_RESIDUALS: Final = 6
_CHANCE_OF_FEEDBACK: Final = 1e-7
# Means of so many samples of an input are what a plant makes of it where it is slow.
_SLOW: Final = (1, 4, 16, 64)
# Columns that add no more than this to others, as a change of basis makes them.
_NOTHING: Final = 1e-8
# What the residuals must explain of what the past of the input leaves of it.
_SHARE_OF_FEEDBACK: Final = 0.02


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
    clipped, scale = _ordinary(residuals[..., lags - 1 :])
    seen = ~np.isnan(residuals[..., lags - 1 :])
    count = seen.sum(axis=-1)
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
    enough = scale > ROUNDING * np.ptp(inputs[..., 0], axis=-1)
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
    return np.asarray(sum(d * signals[..., order - j : n - j, :] for j, d in enumerate((1.0, *whitening))))


def autocovariances(residuals: Array) -> Array:
    """Return the autocovariances at lags 0 to 2 of clipped residuals in units of their scale."""
    e, _ = _ordinary(residuals)
    return np.array([e[j:] @ e[: e.size - j] for j in range(3)]) / e.size


def level_and_scale(values: Array, seen: Any) -> tuple[Array, Array]:
    """Return the median of values seen along the last axis, and their standard deviation by the median deviation."""
    # Both are 0 where none is seen.
    level = _median(values, seen)
    return level, 1.4826 * _median(np.abs(values - level[..., None]), seen)


def _median(values: Array, seen: Any) -> Array:
    """Return the median of the values seen along the last axis, 0 where there are none."""
    ordered, count = np.sort(np.where(seen, values, np.inf), axis=-1), seen.sum(axis=-1)[..., None]
    middle = np.take_along_axis(ordered, np.maximum(count - np.array([1, 0]), 0) // 2, -1)
    return np.where(count[..., 0] > 0, 0.5 * (middle[..., 0] + middle[..., 1]), 0.0)


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


def scored(scores: Array, residuals: Array, x: Array) -> Array:
    """Return scores and information of the gain in blocks, with those of a window behind, 0 where it does not tell."""
    blocks, samples = residuals.size // BLOCK, _of_samples(residuals, x)
    new = np.zeros((2, blocks * BLOCK))
    if samples is not None:
        new[:, new.shape[1] - x.size :] = samples
    return np.concatenate((scores, new.reshape(2, -1, BLOCK).sum(axis=2).T))[blocks:]


def changed(scores: Array) -> float:
    """Return by how much of the model's the gain has changed, 0 if by no more than chance or too little to matter."""
    s, i = scores.T
    if not i.any() or i.sum() ** 2 < _FEWEST * (i @ i):
        return 0.0
    g, n = s.sum() / i.sum(), i.sum() ** 2 / (i @ i)
    variance = max(float(i.sum()), float(np.square(s - g * i).sum()) * n / (n - 1.0)) / i.sum() ** 2
    return float(g) if abs(g) > max(_LEAST, _SURE * np.sqrt(variance)) else 0.0


def _of_samples(residual: Array, x: Array) -> Array | None:
    """Return what each sample that x tells of adds to score and information, shape (2, M); None if nearly none do."""
    e = np.where(np.isfinite(x), residual[residual.size - x.size :], np.nan)
    seen = ~np.isnan(e)
    if seen.sum() < max(x.size // 4, 1):
        return None
    clipped, scale = _ordinary(e)
    R = float(scale**2 * (clipped @ clipped)) / seen.sum()
    if not R > 0.0:
        return None
    clipped, x = (np.where(seen, part - part[seen].mean(), 0.0) for part in (scale * clipped, np.where(seen, x, 0.0)))
    return np.stack((clipped * x, x * x)) / R


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
    if at.size < max(_FEWEST_JUMPS, _ACCIDENTS * y.size) or missed.sum() < _FEWEST_JUMPS or missed.mean() < _MOST:
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


def another_delay(residual: Array, signals: Array) -> tuple[Finding, ...]:
    """Find out whether what a model leaves follows an input that it has long forgotten."""
    e, most, whitening = _ordinary(residual)[0], len(signals) // _PARTS, whitening_of(autocovariances(residual))
    for j, u in enumerate(signals.T if most > LAGS else ()):
        news = _filtered(u[:, None], whitening_of(autocovariances(u)))[:, 0]
        pulls = np.abs(fftconvolve(e, news[::-1])[u.size - 1 :][:most])
        lag = int(pulls[LAGS:].argmax()) + LAGS
        shift = lag - LAGS // 2
        test = dependence(residual[shift:], u[:-shift, None], LAGS, whitening)
        if test.significant and pulls[lag] > pulls[:LAGS].max():
            text = (
                f"{100 * float(test.share):.0f} % of what the model leaves follow input {j} about {lag} samples "
                "before: its delay nk is longer than the structure has it, or the structure too small for a slow plant"
            )
            return (Finding("another delay", text, _evidence(test.chance), (0, residual.size)),)
    return ()


def slow_inputs(u: Array) -> Array:
    """Return means of inputs over the last samples, as plants of several speeds make them, shape (speeds, N, m)."""
    spans = [w for w in _SLOW if 8 * w < len(u)]
    return np.array([uniform_filter1d(u, w, axis=0, mode="nearest", origin=(w - 1) // 2) for w in spans])


def uneven(residual: Array, inputs: Array) -> tuple[Finding, ...]:
    """Find out whether the size of what a model leaves follows the inputs, in whichever direction these move."""
    size = np.where(np.isnan(residual), np.nan, np.abs(_ordinary(residual)[0]))
    whitening = whitening_of(autocovariances(size))
    for j, means in enumerate(slow_inputs(inputs).T):
        products = [a * b for i, a in enumerate(means.T) for b in means.T[i:]]
        test = dependence(size, np.column_stack(products), 2, whitening)
        if test.chance < _CHANCE and test.share > _LEAST:
            text = (
                f"the size of the residuals follows input {j} ({100 * float(test.share):.0f} % of it): the gain "
                "changes its sign or size, y goes as |u|, or the noise grows with u"
            )
            return (Finding("nonlinear", text, _evidence(test.chance), (0, residual.size)),)
    return ()


def another_gain(residual: Array, x: Array) -> tuple[Finding, ...]:
    """Find out whether the gain of the plant changes in a recording, from all of its samples together."""
    findings: tuple[Finding, ...] = ()
    samples, span, largest = _of_samples(residual, x), x.size // _SPLIT, _SURE_OF_ANY
    if samples is None or span < _SHORTEST:
        return findings
    first = x.size - span * _SPLIT
    s, i = samples[:, first:].reshape(2, _SPLIT, span).sum(axis=2)
    for k in range(1, _SPLIT):
        sides = [np.arange(_SPLIT) < k, np.arange(_SPLIT) >= k]
        information = np.array([i[side].sum() for side in sides])
        if min(i[side].sum() ** 2 / max(i[side] @ i[side], 1e-300) for side in sides) < _BESIDE:
            continue
        g = np.array([s[side].sum() for side in sides]) / information
        left = s - np.where(sides[0], *g) * i
        scattered = max(1.0, float(left @ left) / i.sum() * _SPLIT / (_SPLIT - 2.0))
        z = float(np.abs(np.diff(g))[0] / np.sqrt(scattered * (1.0 / information).sum()))
        if np.abs(g).max() > _LEAST and z > largest:
            largest, sample = z, residual.size - x.size + first + k * span
            text = (
                f"from about sample {sample} on the gain from u to y is {1.0 + g[1]:.2f} times the model's, before "
                f"{1.0 + g[0]:.2f} times: the plant is another one there, or the structure is too small"
            )
            findings = (Finding("another plant", text, z * z, (sample, residual.size)),)
    return findings


def feedback(parts: list[tuple[Array, Array]], direct: bool, meaning: str) -> tuple[Finding, ...]:
    """Find out whether inputs follow the residuals of any model."""
    lags = range(int(direct), _RESIDUALS + 1)
    pasts, lagged, wanted = [], [], []
    for u, left in parts:
        if len(u) <= 2 * _PAST:
            continue
        residual = _ordinary(left.T)[0].T
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
    basis = basis_of(X)
    left, more = U - basis @ (basis.T @ U), E - basis @ (basis.T @ E)
    own = basis_of(more)
    total, explained = np.square(left).sum(axis=0), np.square(own.T @ left).sum(axis=0)
    # An input whose past says all of it has nothing left to be explained.
    varies = total > 1e-9 * np.square(U).sum(axis=0)
    share = np.where(varies, explained / np.where(varies, total, 1.0), 0.0)
    chance = fdtrc(E.shape[1], freedom, share / E.shape[1] / (np.maximum(1.0 - share, 1e-12) / freedom))
    follows = (share > _SHARE_OF_FEEDBACK) & (chance < _CHANCE_OF_FEEDBACK)
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


def _ordinary(residual: Array) -> tuple[Array, Array]:
    """Return residuals in units of their scale along the last axis, clipped, 0 where there are none; and the scale."""
    measured = ~np.isnan(residual)
    level, scale = level_and_scale(residual, measured)
    shown = (residual - level[..., None]) / np.where(scale > 0.0, scale, 1.0)[..., None]
    return np.where(measured, np.clip(shown, -CLIP, CLIP), 0.0), scale


def basis_of(X: Array) -> Array:
    """Return an orthonormal basis of the columns, each taken of unit size."""
    left, values, _, _ = in_directions(X)
    return np.asarray(left[:, values > _NOTHING * values.max(initial=0.0)])
