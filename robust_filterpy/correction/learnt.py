"""The correction under noise that is a mixture of classes, learned or given: one step as a pure function of arrays.

The scalar step that serves every filter (DESIGN section 2): with score a and information b of the sensor taken next,

    x += C_i a,   y -= S_i a,   P -= b C_i C_i',   C -= b C_i S_i',   S -= b S_i S_i'.

Under class k the variance of y_i is S_ii + (s_k - 1) r R_ii: what an outlier has in excess is independent of everything
else, correlated noises included. Its density is a mixture, a the mixture's score and b the derivative of it, which is
the exact second moment (Masreliez 1975) and may be negative. Each model has its own x, P, C, S, y, a, b; the
probabilities of the classes are shared. Sensors that fail together as given are taken at once: a is a vector, b a
matrix. Others may: with the probability that they do, as it has been learned, the classes of each sensor are those that
the whole innovation tells, else those that its own does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import factor, learning, side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.options import Grouping, leads
from robust_filterpy.correction.result import SingularInnovationError, correlation_whitening, singular
from robust_filterpy.correction.side_by_side import Models, Scales

__all__ = ["Corrected", "correct"]

_LOG_2PI = math.log(2.0 * math.pi)
# Standard deviations of the widest class up to which an innovation counts as what it is. Beyond, no part of the noise
# model says anything, and the score of a normal distribution would grow without bound.
REACH = 8.0
# And where all are weighed together.
_TOGETHER = 1e8
# One that is worth so much for a jump tells nothing of the scale of Q: a jump and a larger Q explain the same.
_LOG_TELLS = math.log(30.0)
# A state that is so much less certain than a sensor's noise, in variance, is unknown: P - b C C' would leave rounding.
_WIDEST = 1e12
# A variance that has shrunk to this part of what it was is rounding.
_CANCELLED = 1e-13


class Corrected(NamedTuple):
    """The models and the noise after a correction, and what has become of each component."""

    #: Corrected.
    models: Models
    #: What was learned of the noise, shape (g, ...), as `robust_filterpy.correction.learning` orders it.
    memory: Array
    #: log p(z).
    log_density: float
    #: Expected precision of each component over that of ordinary noise, NaN where there is none, shape (m,).
    weights: Array
    #: Probability that each component was an outlier, 1 where a sensor is stuck, 0 where there is none, shape (m,).
    outlier_probabilities: Array


class _Part(NamedTuple):
    """The models while sensor after sensor is taken: x and what is left of the innovation, one Gaussian vector each."""

    #: (q, n)
    x: Array
    #: (q, n, n)
    P: Array
    #: (q, m)
    y: Array
    #: (q, n, m)
    C: Array
    #: (q, m, m)
    S: Array
    #: Of the models in the part that each sensor sees, (q, m).
    probabilities: Array
    #: Which part that is, (m,).
    parts: Array


class _Shared(NamedTuple):
    """What the whole innovation says of the class that all its sensors are in, if they are in the same."""

    #: Probabilities of the classes, (K,).
    given: Array
    log_density: float
    #: Probability that they are, from the samples before.
    chance: float


class _Scores(NamedTuple):
    """What the classes of a group of g sensors make of its innovation, under each of q models."""

    #: Score, (q, g).
    a: Array
    #: Its derivative, (q, g, g).
    b: Array
    #: Probabilities of the classes under each model, (q, K).
    given: Array
    #: (q,)
    log_densities: Array
    #: E[v^2 | class 0]/(r R) of each sensor, or in the mean over the group, (q, g) or (q, 1).
    energies: Array
    #: Share of its variance that is ordinary noise, likewise.
    parts: Array


def correct(
    models: Models,
    memory: Array,
    z: Array,
    H: Array,
    R: Array,
    noise: NoiseClasses,
    process: Scales,
    M: Array | None = None,
    readings: Array | None = None,
) -> Corrected:
    """Correct models of a filter by one measurement and learn the noise from it."""
    given = models.given
    if given is None or not noise.learns or noise.grouping != "component":
        return _corrected(models, memory, z, H, R, noise, process, M, readings)[0]
    # What is learned of a sensor is in units of R; of the state's factor only what is inside here knows.
    seen = np.argmax(H != 0.0, axis=1)
    memory, root = memory.copy(), np.sqrt(given.factor)
    memory[:, learning.R_FACTOR] /= given.factor[seen]
    N = factor.scaled(R, given.factor[seen])
    corrected, logs = _corrected(
        models, memory, z, H, N, noise, process, M if M is None else M * root[:, None] * root[seen], readings
    )
    (models, memory), parts = corrected[:2], corrected.models.parts
    memory = memory.copy()
    if given.looks[parts[seen[~np.isnan(logs)]].astype(int)].any():
        before = given.factor
        raised = factor.scaled(R, _raised(given.P[None], H, R.diagonal()))
        given, memory[:, learning.GIVEN] = factor.judged(
            given, memory[:, learning.GIVEN], z, z if readings is None else readings, H, raised, M, logs, parts
        )
        models, new = models._replace(given=given), given.factor != before
        if new.any():
            models = side_by_side.begun_again(models, given, new, process)
            memory[new[seen]] = noise.start(1)
    memory[:, learning.R_FACTOR] *= given.factor[seen]
    return corrected._replace(models=models, memory=memory)


def _corrected(
    models: Models, memory: Array, z: Array, H: Array, R: Array, noise: NoiseClasses, process: Scales,
    M: Array | None, readings: Array | None,
) -> tuple[Corrected, Array]:  # fmt: skip
    """Return what `correct` does with R as it is, and the log densities of the readings, shape (m,)."""
    # Groups are taken one after the other, the most plausible first by the moments of all models together, so that the
    # order of the sensors in z does not matter. What H does not see says nothing, and nothing is learned from it. An
    # innovation beyond 8 standard deviations of the widest class is shortened to 8, it has no place in the model; not
    # that of a sensor without noise.
    m, joint, K = len(z), noise.grouping == "joint", len(noise.scales)
    alike, follows = noise.learns and noise.grouping == "component", noise.learns and not joint
    weights, outlying, logs = np.full(m, np.nan), np.zeros(m), np.full(m, np.nan)
    part, readings = np.flatnonzero(~np.isnan(z) & H.any(axis=1)), z if readings is None else readings
    if follows:
        stuck = _stuck(part, models, memory, z, readings, H, R, K, process)
        part, weights[stuck], outlying[stuck] = np.setdiff1d(part, stuck), 0.0, 1.0
    if part.size == 0:
        return Corrected(models, memory, 0.0, weights, outlying), logs
    z, H, R, M = z[part], H[part], R[np.ix_(part, part)], None if M is None else M[:, part]
    memory, rows = memory.copy(), np.zeros(len(part), dtype=int) if joint else part
    groups, seen = _groups(part, noise.grouping), np.argmax(H != 0.0, axis=1)
    models = side_by_side.coupled(models, _links(H, R, M, groups), process)
    own, readings = memory[rows], readings[part]
    models, own, r, wide, chances, new, goes_on = _foreseen(models, own, z, readings, H, R, noise, process)
    memory[rows] = own
    # Where a sensor is more exact than rounding of the state's variance, a first reading counts as no more exact than
    # that: it sets the state, and the next one finds it certain enough for the sensor as it is.
    raised = _raised(models.P[: len(process.scales)], H, r * R.diagonal())
    wide = np.maximum(wide / np.sqrt(raised), 1.0)
    begin, N = _begin(models, z, H, R, r * raised, M)
    now, log_density, belief = begin, 0.0, models.belief.copy()
    shared = _shared(now, N, own, noise, wide, len(process.scales)) if alike and len(part) > 1 else None
    while groups:
        group = groups.pop(_most_plausible(now, groups))
        of = rows[group[:1]] if joint else rows[group]
        scores = _group_scores(group, begin, now, N, memory[of], noise, wide, len(process.scales), joint, shared)
        head = int(now.parts[group[0]])
        shares, log_total, logs[part[group]] = _weighed(
            now.probabilities[:, group[0]], scores.log_densities, len(process.scales), bool(new[head]),
            float(chances[group[0]]), alike and learning.is_established(memory[of[0]]),
        )  # fmt: skip
        posterior = shares @ scores.given
        if noise.learns:
            memory[of] = _learned(memory[of], posterior, r[group], shares, scores, noise)
        log_density += log_total
        weights[part[group]], outlying[part[group]] = posterior @ (1.0 / np.array(noise.scales)), 1.0 - posterior[0]
        now = _taken(now, group, scores, shares)
        belief[:-2, models.parts == head] = shares[:, None]
    corrected = Models(now.x, 0.5 * (now.P + np.swapaxes(now.P, 1, 2)), belief, models.given)
    corrected, believed = side_by_side.settled(corrected, np.isin(models.parts, now.parts), process)
    own = memory[rows]
    if alike:
        followed = goes_on & (own[:, learning.last_class(K).start] > 0.5)
        own = learning.jumped(own, believed[seen], noise, followed)
    if shared is not None:
        own = learning.weigh_together(own, shared.log_density, log_density, noise)
    memory[rows] = learning.left_over(own, z - H @ _slow(corrected, process)[0], R) if follows else own
    return Corrected(corrected, memory, log_density, weights, outlying), logs


def _stuck(
    part: np.ndarray, models: Models, memory: Array, z: Array, readings: Array, H: Array, R: Array, K: int,
    process: Scales,
) -> np.ndarray:  # fmt: skip
    """Return which sensors of a part are stuck: one that is tells nothing of the state, nor of its noise."""
    again = part[learning.repeated(memory[part], readings[part], R[np.ix_(part, part)])]
    if not again.size:
        return again
    outlier = memory[again, learning.last_class(K).start] < 0.5
    r = memory[again, learning.R_FACTOR] * R[again, again]
    return again[outlier | side_by_side.far_off(models, z[again], H[again], r, process)]


def _foreseen(
    models: Models, own: Array, z: Array, readings: Array, H: Array, R: Array, noise: NoiseClasses, process: Scales
) -> tuple[Models, Array, Array, Array, Array, np.ndarray, np.ndarray]:
    """Return the models, with candidates where readings ask for them, and the sensors' rows before one is taken; and of
    each reading r, what the deviation of its widest class grows by, odds times density of a jump like the last one; of
    each state whether its candidate is new; whether each reading goes on from where an outlier was.
    """
    at, spread = _slow(models, process)
    r, goes_on, chances, y = own[:, learning.R_FACTOR], np.zeros(len(z), bool), np.zeros(len(z)), z - H @ at
    if noise.learns and noise.grouping != "joint":
        goes_on = learning.goes_on(own, y, R, len(noise.scales))
        r, own = learning.ordinary_size(own, readings, z, y, H @ spread @ H.T, H, R, noise.memory)
    noisy, variances, wide = r * R.diagonal(), ((H @ spread) * H).sum(axis=1), np.ones(len(z))
    # An outlier is far from what is expected of a reading, by all models together.
    grown = noise.learns & learning.is_seasoned(own, noise) & (noisy > 0.0)
    wide[grown] = np.sqrt(np.maximum(variances[grown] / noisy[grown], 1.0))
    alike, seen = noise.learns and noise.grouping == "component", np.argmax(H != 0.0, axis=1)
    if alike:
        chances = learning.jump_chances(own, y, variances, noisy, R.diagonal(), noise.scales, wide)
        chances = np.maximum(chances, process.jump)
    models, new, believed = side_by_side.decided(models, z, H, noisy, process, chances)
    models, begun = side_by_side.with_candidates(models, z, H, noisy, process, new)
    if alike:
        own = learning.jumped(own, believed[seen], noise)
        own, chances = learning.began(own, models.parts[seen], *begun, R.diagonal())
    return models, own, r, wide, chances, new, goes_on


def _groups(part: np.ndarray, grouping: Grouping) -> list[np.ndarray]:
    """Return the places, among the sensors that are there, of those that fail together."""
    first = leads(grouping, 1 + int(part.max()))[part]
    return [np.flatnonzero(first == lead) for lead in dict.fromkeys(first.tolist())]


def _chance(of: Any, memory: Array, noise: NoiseClasses) -> Array:
    """Return the probabilities of the classes of a group's next sample: the mean of what its sensors know."""
    return np.asarray(np.mean([of(row, len(noise.scales)) for row in memory], axis=0))


def _links(H: Array, R: Array, M: Array | None, groups: list[np.ndarray]) -> Array:
    """Return which states a measurement couples, (n, n): those of one sensor, of correlated ones, of a group."""
    sees, together = (H != 0.0).astype(float), (R != 0.0).astype(float)
    for group in groups:
        together[np.ix_(group, group)] = 1.0
    if M is not None:
        sees += (M != 0.0).T
    return np.asarray(sees.T @ together @ sees)


def _slow(models: Models, process: Scales) -> tuple[Array, Array]:
    """Return mean and covariance over the models that have not jumped."""
    q = len(process.scales)
    return side_by_side.collapse(side_by_side.slow(models, process), models.x[:q], models.P[:q], models.parts)


def _shared(now: _Part, N: Array, memory: Array, noise: NoiseClasses, wide: Array, q: int) -> _Shared | None:
    """Return what an innovation says if all sensors are in the same class, by the q models that have not jumped."""
    shares = now.probabilities[:q] / now.probabilities[:q].sum(axis=0)
    # Between models that far innovations all but equal there would be rounding.
    reach = _TOGETHER * np.sqrt(np.diagonal(now.S, axis1=1, axis2=2).max(axis=0))
    y, S = side_by_side.collapse(shares, np.clip(now.y[:q], -reach, reach), now.S[:q], now.parts)
    before = _chance(learning.predicted, memory, noise)[None]
    try:
        scores = _scores(y[None], S[None], N, before, noise.scales, wide)
    except SingularInnovationError:
        # Where noise drowns in the uncertainty of the state, each sensor still tells of it, and all together nothing.
        return None
    return _Shared(scores.given[0], float(scores.log_densities[0]), learning.together(memory))


def _begin(models: Models, z: Array, H: Array, R: Array, r: Array, M: Array | None) -> tuple[_Part, Array]:
    """Return the models with their innovations, and the covariance of ordinary noise, (m, m)."""
    root = np.sqrt(r)
    N = R * np.multiply.outer(root, root)
    with np.errstate(over="ignore", invalid="ignore"):
        y = np.clip(z - models.x @ H.T, -1e300, 1e300)
    # A candidate that began with a far reading is as uncertain as that is far, and the others' noise is none of it.
    P = _limited(models.P, H, N.diagonal())
    C = P @ H.T
    S = H @ C + N
    if M is not None:
        C, cross = C + M * root, H @ (M * root)
        S = S + cross + cross.T
    seen = np.argmax(H != 0.0, axis=1)
    return _Part(models.x, P, y, C, S, models.probabilities[:, seen], models.parts[seen]), N


def _limited(P: Array, H: Array, noise: Array) -> Array:
    """Return P, what a sensor sees of it no more than 1e12 of its noise: beyond, P - b C C' would leave rounding."""
    for h, variance in zip(H, noise.tolist(), strict=True):
        C = P @ h
        seen = C @ h
        wide = seen > _WIDEST * variance
        if variance > 0.0 and wide.any():
            seen = np.where(wide, seen, 1.0)
            excess = np.where(wide, (1.0 - _WIDEST * variance / seen) / seen, 0.0)
            P = P - excess[:, None, None] * C[:, :, None] * C[:, None, :]
    return P


def _raised(P: Array, H: Array, noise: Array) -> Array:
    """Return the factor that makes each sensor's noise at least 1e-12 of the variance of what it sees, shape (m,)."""
    least = ((P @ H.T) * H.T).sum(axis=1).max(axis=0) / _WIDEST
    low = (noise > 0.0) & (noise < least)
    return np.asarray(np.where(low, np.minimum(least / np.where(low, noise, 1.0), 1e300), 1.0))


def _most_plausible(now: _Part, groups: list[np.ndarray]) -> int:
    """Return the place of the group whose farthest innovation is the smallest in standard deviations, of all models."""
    if len(groups) == 1:
        return 0
    sensors = np.concatenate(groups)
    y, variances, p = now.y[:, sensors], now.S[:, sensors, sensors], now.probabilities[:, sensors]
    unit = np.maximum(np.abs(y).max(axis=0), 1e-100)
    mean = (p * (y / unit)).sum(axis=0)
    spread = (p * (variances / unit / unit + (y / unit - mean) ** 2)).sum(axis=0)
    begins = np.cumsum([0, *map(len, groups[:-1])])
    return int(np.argmin(np.maximum.reduceat(np.abs(mean) / np.sqrt(np.maximum(spread, 1e-300)), begins)))


def _scores(
    y: Array, S: Array, N: Array, before: Array, scales: Sequence[float], stretched: Array, one_r: bool = False,
    shared: _Shared | None = None,
) -> _Scores:  # fmt: skip
    """Return score, information and likelihoods: y (q, g), S (q, g, g), N (g, g) ordinary noise, before (q, K).

    The deviation of the widest class grows by `stretched`, shape (g,), and its chance falls by that: a reading that is
    wrongly refused costs so many more deviations of the noise.
    """
    before = np.column_stack((before[:, :-1], before[:, -1] / np.max(stretched)))
    beyond = (np.array(scales) - 1.0)[:, None, None] * N
    beyond[-1] *= np.outer(stretched, stretched)
    inverses, log_dets = _inverted(S[:, None] + beyond)
    y = np.broadcast_to(y[:, None], log_dets.shape + y.shape[1:])
    # A sensor without noise is right however far off.
    y = _shortened(y, inverses) if N.any() else y
    pulls = (inverses @ y[..., None])[..., 0]
    logs = np.log(before) - 0.5 * ((pulls * y).sum(axis=2) + log_dets + y.shape[2] * _LOG_2PI)
    peaks = logs.max(axis=1)
    given = np.exp(logs - peaks[:, None])
    totals = given.sum(axis=1)
    given /= totals[:, None]
    if shared is not None:
        given += shared.chance * (shared.given - given)
    a = (given[..., None] * pulls).sum(axis=1)
    b = (given[..., None, None] * (inverses - pulls[..., :, None] * pulls[..., None, :])).sum(axis=1)
    # What is left of y under the ordinary class is noise: E[v' N^-1 v] = g + (S^-1 y)' N (S^-1 y) - tr(S^-1 N), where
    # of all the variance that S has no more than all can be noise. The terms of both are the sensors'.
    expected, energy, size = (inverses[:, 0] * N).sum(axis=2), (pulls[:, 0] @ N) * pulls[:, 0], 1
    if one_r:
        expected, energy, size = expected.sum(axis=1)[:, None], energy.sum(axis=1)[:, None], y.shape[2]
    excess = np.divide(energy, expected, out=np.ones_like(energy), where=expected > 0.0) - 1.0
    parts = np.minimum(expected / size, 1.0)
    energies = np.maximum(1.0 + parts * excess, 0.0)
    return _Scores(a, b + a[:, :, None] * a[:, None, :], given, peaks + np.log(totals), energies, parts)


def _group_scores(
    group: np.ndarray, begin: _Part, now: _Part, N: Array, memory: Array, noise: NoiseClasses, wide: Array, q: int,
    joint: bool, shared: _Shared | None,
) -> _Scores:  # fmt: skip
    """Return what the classes make of an innovation, memory the rows of its sensors; q models have not jumped."""
    S = now.S[:, group[:, None], group]
    if (S[:, 0, 0] <= _CANCELLED * begin.S[:, group[0], group[0]]).any():
        raise singular(now.S[0])
    # What the last sample was only models know that were there then.
    before = np.tile(_chance(learning.predicted, memory, noise), (len(now.x), 1))
    before[q:] = _chance(learning.usual, memory, noise)
    return _scores(now.y[:, group], S, N[np.ix_(group, group)], before, noise.scales, wide[group], joint, shared)


def _learned(memory: Array, posterior: Array, r: Array, shares: Array, scores: _Scores, noise: NoiseClasses) -> Array:
    """Return the rows of a group's sensors after what all models, with these shares, make of its sample."""
    ordinary, after = shares * scores.given[:, 0], memory.copy()
    energies, parts = (ordinary @ a / max(float(ordinary.sum()), 1e-300) for a in scores[4:])
    for k, (row, part) in enumerate(zip(memory, parts.tolist(), strict=True)):
        excess = (float(energies[k]) - 1.0) / part if part > 0.0 else 0.0
        after[k] = learning.learn(row, posterior, float(r[k]), excess, part, noise)
    return after


def _weighed(
    probabilities: Array, log_densities: Array, q: int, fresh: bool, like_before: float, sensor_is_established: bool
) -> tuple[Array, float, float]:
    """Return the probabilities of the models given a group, and log p(y), as far as one is trusted and in full."""
    # q of the models are for scales of Q.
    shares, log_total = _normalized(np.log(np.maximum(probabilities[:q], 1e-300)) + log_densities[:q])
    if len(probabilities) == q:
        return shares, log_total, log_total
    candidate, slow = float(probabilities[q]), np.maximum(probabilities[:q], 1e-300)
    log_total -= math.log(float(slow.sum()))
    # What tells for a jump so much tells nothing of the scale of Q, where a jump is no far-fetched reason.
    likely = sensor_is_established and candidate >= side_by_side.DROPPED
    if likely and log_densities[q] > log_total + _LOG_TELLS:
        shares = slow / slow.sum()
    # A candidate is made to fit what it begins with, which is no evidence for it, unless that is like the jumps before.
    own = log_total if fresh else min(float(log_densities[q]), log_total + learning.LOG_EVIDENCE)
    chances = math.log(max(1.0 - candidate, 1e-300)), math.log(max(candidate, 1e-300))
    full = float(np.logaddexp(chances[0] + log_total, chances[1] + (own if fresh else float(log_densities[q]))))
    if like_before > 0.0 and candidate > 0.0:
        own = float(np.logaddexp(own, math.log((1.0 - candidate) / candidate * like_before) - 0.5 * _LOG_2PI))
    (slow_share, jumped), log_total = _normalized(np.array([chances[0] + log_total, chances[1] + own]))
    return np.append(slow_share * shares, jumped if candidate > 0.0 else 0.0), log_total, full


def _taken(now: _Part, group: np.ndarray, scores: _Scores, shares: Array) -> _Part:
    """Return what is left when a group has been taken: the step of which the head of this module speaks."""
    C, S, (a, b) = now.C[:, :, group], now.S[:, :, group], scores[:2]
    bC, bS = b @ np.swapaxes(C, 1, 2), b @ np.swapaxes(S, 1, 2)
    return _Part(
        now.x + (C @ a[..., None])[..., 0],
        now.P - C @ bC,
        now.y - (S @ a[..., None])[..., 0],
        now.C - C @ bS,
        now.S - S @ bS,
        np.where(now.parts == now.parts[group[0]], shares[:, None], now.probabilities),
        now.parts,
    )


def _normalized(logs: Array) -> tuple[Array, float]:
    """Return exp(logs) divided by its sum, and the log of the sum."""
    peak = logs.max()
    weights = np.exp(logs - peak)
    total = weights.sum()
    return weights / total, float(peak) + math.log(total)


def _inverted(S: Array) -> tuple[Array, Array]:
    """Return the inverses and log determinants of S, shapes (..., m, m) and (...)."""
    m = S.shape[-1]
    try:
        factors = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        # It names the eigenvalue that is at fault, or finds that rounding alone was.
        T = np.array([correlation_whitening(one) for one in S.reshape(-1, m, m)]).reshape(S.shape)
        return np.swapaxes(T, -1, -2) @ T, -2.0 * np.linalg.slogdet(T)[1]
    diagonals = np.diagonal(factors, axis1=-2, axis2=-1)
    # Where S is singular but for rounding its factor is not.
    halves = np.linalg.inv(factors)
    return np.swapaxes(halves, -1, -2) @ halves, 2.0 * np.log(diagonals).sum(axis=-1)


def _shortened(y: Array, inverses: Array) -> Array:
    """Return y, shape (..., h, m), or the multiple that is 8 standard deviations of the widest hypothesis long."""
    peak = np.abs(y).max(axis=-1, keepdims=True)
    direction = y / np.where(peak > 0.0, peak, 1.0)
    squares = np.einsum("...i,...ij,...j->...", direction, inverses, direction)
    with np.errstate(over="ignore"):
        lengths = peak[..., 0] * np.sqrt(np.maximum(squares, 0.0))
    least = lengths.min(axis=-1)[..., None, None]
    if not (least > REACH).any():
        return y
    return np.where(least > REACH, direction * (peak / np.maximum(least, REACH)) * REACH, y)
