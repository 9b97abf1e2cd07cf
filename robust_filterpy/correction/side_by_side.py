"""Models of a filter side by side that differ in what they take the process for (interacting multiple models).

q models take the process noise for s_j Q; from one step to the next the scale stays with probability 1 - 1/dwell. One
more, the candidate, is for a state that has jumped, to which Q says nothing. It begins where an innovation is beyond
three standard deviations, at the place that the measurement tells, with a P in which it would be just three, since what
has moved one state may have moved all (`with_candidates`). Since it is made to fit, that measurement is no evidence for
it, and no later one is worth more than a hundred to one, so that samples have to agree, however wild. It is hidden
while three to one is against it, shown alone while nineteen to one is for it (`merged`), taken over when it is all but
certain (`settled`) and dropped when it has lost, so that there is one at a time; a reading that is far from it and from
all others decides (`decided`). A start is a guess: where the first reading of a part is far from it, the part has
jumped with a probability of .96.

States of which none moves, or is measured, with another's are parts of their own: the axes of a point that moves, a
box's center and its shape. Each part has its own probabilities of the models, its own jumps and its own candidate, so
that a part whose Q is too large says nothing of the others. Where F, Q, P, H or R couple two parts, they become one
(`coupled`), with the scales that are likely in both and a candidate of either, and stay one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.factor import Given, scaled
from robust_filterpy.correction.spread import FAR

__all__ = ["Models", "Scales", "collapse", "coupled", "extended", "merged", "predict", "require_belief", "start"]

# Chance that the state is not where the start says, where its first reading is far from there.
_START = 0.96
# Standard deviations from which on an innovation that asks for a jump cannot tell where to.
_FARTHEST = 1e12
# A jump of more standard deviations makes P no wider, which would leave rounding. Of its square, this part is left of
# the variance of what the sensor sees: less would be rounding, where it has next to no noise.
_FAR, _LEFT = 1e4, 0.01
# Of a scale that one of two parts contradicts, at least so much is left where they become one.
_UNLIKELY = 1e-30
# A candidate that is so probable is taken over; one whose probability is this part of a jump's is dropped, or is this
# where its part becomes one with another.
_TAKEN, DROPPED = 0.999, 0.01
# One that is less probable is hidden; one that is more probable than the second is shown alone.
_SHOWN, _ALONE = 0.25, 0.95


@dataclass(frozen=True)
class Scales:
    """Say which models there are.

    Parameters
    ----------
    scales : sequence of float, default (1, 0.01, 0.1, 10, 100)
        Factors of the covariance Q, > 0; the first is the likeliest at the start, and another one less so by as much
        as it differs: a tenth or ten times it has a tenth of its probability. ``(1,)`` trusts Q.
    dwell : float, default 1000
        Mean number of steps that the process keeps a scale, > 1.
    jump : float, default 1e-5
        Chance that a far reading is a jump of the state, in [0, 1), while none has been seen. Samples have to agree
        before it is believed, four to six with 1e-5, six to eight with 1e-9; outliers that agree for longer are
        believed too. 0 means never, and then the start is trusted as P says.
    probabilities : sequence of float, optional
        Probabilities of the scales where each step draws its own; `dwell` means nothing then.

    Raises
    ------
    ValueError, TypeError
        If one is out of range.
    """

    scales: Sequence[float] = (1.0, 0.01, 0.1, 10.0, 100.0)
    dwell: float = 1000.0
    jump: float = 1e-5
    probabilities: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check the parameters."""
        scales = _checks.numbers("process_scales", self.scales)
        if scales.ndim != 1 or not scales.size or not (np.isfinite(scales) & (scales > 0.0)).all():
            raise ValueError(f"process_scales: expected one or more finite numbers > 0, got {self.scales!r}")
        if not _checks.positive("dwell", self.dwell) > 1.0:
            raise ValueError(f"dwell: expected a number of steps > 1, got {self.dwell!r}")
        object.__setattr__(self, "scales", tuple(scales.tolist()))
        object.__setattr__(self, "dwell", float(self.dwell))
        object.__setattr__(self, "jump", _checks.fraction("jump", self.jump))
        if self.probabilities is not None:
            shares = _checks.probabilities("probabilities", self.probabilities, scales.size)
            object.__setattr__(self, "probabilities", tuple(shares.tolist()))

    @property
    def count(self) -> int:
        """How many models there are."""
        return len(self.scales) + (1 if self.jump > 0.0 else 0)

    @property
    def rows(self) -> int:
        """How many recursions there are, that as given among them."""
        return self.count + (len(self.scales) > 1 and self.probabilities is None)

    @property
    def stay(self) -> float:
        """Probability that the scale stays."""
        return 1.0 - 1.0 / self.dwell if len(self.scales) > 1 else 1.0

    @property
    def moves(self) -> Array:
        """Probabilities of the next scale, a row for each scale, shape (q, q)."""
        q = len(self.scales)
        if self.probabilities is not None:
            return np.tile(self.probabilities, (q, 1))
        moves = np.full((q, q), (1.0 - self.stay) / max(q - 1, 1))
        np.fill_diagonal(moves, self.stay)
        return moves

    @property
    def begin(self) -> Array:
        """Probabilities of the models before the first step, shape (count,)."""
        q, factors = len(self.scales), np.array(self.scales) / self.scales[0]
        # A Q is wrong by a factor with its inverse as chance.
        probabilities = np.zeros(self.count)
        probabilities[:q] = np.minimum(factors, 1.0 / factors)
        if self.probabilities is not None:
            probabilities[:q] = self.probabilities
        return np.asarray(probabilities / probabilities.sum())


# Rows of a belief behind its probabilities.
_UNSEEN, _PART = -2, -1


class Models(NamedTuple):
    """The models: those of the scales of Q, then, if there are jumps, the candidate."""

    #: Means, shape (q, n).
    x: Array
    #: Covariances, shape (q, n, n).
    P: Array
    #: Shape (q + 2, n): for each state the probabilities of the models in its part, the chance that the part has jumped
    #: since its last measurement, and the first state of the part.
    belief: Array
    #: The recursion as given, where P, Q and R may have one wrong factor.
    given: Given | None = None

    @property
    def probabilities(self) -> Array:
        """Shape (q, n), each column with sum 1; that of the candidate is 0 where there is none."""
        return self.belief[:-2]

    @property
    def unseen(self) -> Array:
        """Chance that the part of a state has jumped since its last measurement, shape (n,)."""
        return np.asarray(self.belief[_UNSEEN])

    @property
    def parts(self) -> Array:
        """The first state of each state's part, shape (n,)."""
        return np.asarray(self.belief[_PART])

    @classmethod
    def unpacked(cls, x: Array, P: Array, belief: Array) -> Models:
        """Return the models of which these are the arrays, with those of the recursion as given in the last rows."""
        if len(belief) == len(x) + 2:
            return cls(x, P, belief)
        return cls(x[:-1], P[:-1], belief[:-3], Given(x[-1], P[-1], *belief[-3:]))

    @property
    def packed(self) -> tuple[Array, Array, Array]:
        """The models as three arrays."""
        if self.given is None:
            return self[:3]
        x, P, *shown = self.given
        return np.vstack((self.x, x)), np.concatenate((self.P, P[None])), np.vstack((self.belief, shown))


def start(x: Array, P: Array, process: Scales, runs: bool = False) -> Models:
    """Return the models before the first step, all at the same place; of a filter that runs no start is a guess."""
    n, count = len(x), process.count
    belief = np.empty((count + 2, n))
    belief[:-2] = process.begin[:, None]
    belief[_UNSEEN] = _START if process.jump > 0.0 and not runs else process.jump
    # A process that draws its scale anew in each step draws one for all.
    belief[_PART] = np.arange(n) if process.probabilities is None else 0.0
    given = None
    if process.rows > count:
        given = Given(x, P, *np.array([[0.0], [0.0], [1.0]]) * np.ones(n))
    return coupled(Models(np.tile(x, (count, 1)), np.tile(P, (count, 1, 1)), belief, given), P, process)


def coupled(models: Models, links: Array, process: Scales) -> Models:
    """Return the models, parts that are linked as one: with the scales that are likely in both, a candidate of either.
    """
    parts, q = models.parts, len(process.scales)
    linked, together = links != 0.0, parts[:, None] == parts
    # As in all but a few steps.
    if not (linked & ~together).any():
        return models
    reached = (linked | linked.T | together).astype(float)
    for _ in range(len(parts).bit_length()):
        reached = np.minimum(reached @ reached, 1.0)
    labels = reached.argmax(axis=1)
    x, P, belief = models.x.copy(), models.P.copy(), models.belief.copy()
    for label in np.unique(labels):
        states = np.flatnonzero(labels == label)
        heads = np.unique(parts[states]).astype(int)
        if len(heads) < 2:
            continue
        # What was likely at first is counted once. Parts may contradict each other beyond what a number can say.
        likely = np.prod(belief[:q, heads] / process.begin[:q, None], axis=1) * process.begin[:q]
        likely = np.maximum(likely, _UNLIKELY)
        jumped = belief[q:-2, heads].max(initial=0.0)
        if jumped >= DROPPED:
            # In the part that has no candidate it follows the first model.
            none = states[belief[q, states] < DROPPED]
            x[q, none], P[q, none] = x[0, none], P[0, none]
        else:
            jumped = 0.0
        belief[:q, states] = ((1.0 - jumped) * likely / likely.sum())[:, None]
        belief[q:-2, states] = jumped
        belief[_UNSEEN, states], belief[_PART, states] = belief[_UNSEEN, heads].max(), heads[0]
    return Models(x, P, belief, models.given)


def extended(models: Models, covariance: Array, like: np.ndarray, process: Scales) -> Models:
    """Return the models with further states at 0, shape (k, k), each in the part of one that there is, shape (k,)."""
    (x, P, belief), n, k = models.packed, models.x.shape[1], len(covariance)
    whole, links = np.zeros((len(x), n + k, n + k)), np.zeros((n + k, n + k))
    whole[:, :n, :n], whole[:, n:, n:], links[n:, n:] = P, covariance, covariance
    more = Models.unpacked(np.hstack((x, np.zeros((len(x), k)))), whole, np.hstack((belief, belief[:, like])))
    return coupled(more, links, process)


def require_belief(name: str, belief: Array, process: Scales) -> None:
    """Raise if this is no packed `Models.belief`, or several in front of each other."""
    probabilities, unseen, parts = np.split(belief[..., : process.count + 2, :], [-2, -1], axis=-2)
    if not ((probabilities >= 0.0).all() and np.allclose(probabilities.sum(axis=-2), 1.0)):
        raise ValueError(f"{name}: expected probabilities >= 0 of the models that sum to 1 for each state")
    if not ((unseen >= 0.0) & (unseen <= 1.0)).all():
        raise ValueError(f"{name}: expected a chance of a jump between 0 and 1 for each state, got {unseen}")
    n = belief.shape[-1]
    first = np.isin(parts, np.arange(n)) & (parts <= np.arange(n))
    if not (first.all() and (np.take_along_axis(parts, parts.astype(int), -1) == parts).all()):
        raise ValueError(f"{name}: expected the first state of each state's part, got {parts}")
    given = belief[..., process.count + 2 :, :]
    if not ((given >= 0.0).all() and (given[..., 2:, :] > 0.0).all()):
        raise ValueError(f"{name}: expected evidence and readings >= 0 and a factor > 0 for each state, got {given}")


def slow(models: Models, process: Scales) -> Array:
    """Return the probabilities of the scales of Q if nothing has jumped, shape (q, n)."""
    shares = models.belief[: len(process.scales)]
    return np.asarray(shares / shares.sum(axis=0))


def predict(
    models: Models, F: Array, Q: Array, process: Scales, Bu: Array | None = None, alpha_sq: float = 1.0
) -> Models:
    """Return the models after a prediction: mixed as the scale may have changed, then moved."""
    x, P, belief, given = models = coupled(models, (F != 0.0) | (Q != 0.0), process)
    if given is not None:
        given, Q = given.moved(F, Q, Bu, alpha_sq), scaled(Q, given.factor)
    q, scales = len(process.scales), np.array(process.scales)[:, None] * np.ones(len(F))
    belief = belief.copy()
    # Row j: where model j comes from.
    origin = process.moves.T[:, :, None] * belief[:q]
    belief[:q] = origin.sum(axis=1)
    mixed_x, mixed_P = collapse(origin / belief[:q, None], x[None, :q], P[None, :q], models.parts)
    if process.jump > 0.0:
        usual = np.exp(np.log(process.scales) @ belief[:q] / belief[:q].sum(axis=0))
        # Where there is no candidate its place follows the first model.
        there = belief[q] > 0.0
        candidate = np.where(there, x[q], mixed_x[0]), np.where(there[:, None] & there, P[q], mixed_P[0])
        scales = np.concatenate([scales, usual[None]])
        mixed_x, mixed_P = np.concatenate([mixed_x, candidate[0][None]]), np.concatenate([mixed_P, candidate[1][None]])
        belief[_UNSEEN] += process.jump * (1.0 - belief[_UNSEEN])
    moved = mixed_x @ F.T
    root = np.sqrt(scales)
    return Models(
        moved if Bu is None else moved + Bu,
        alpha_sq * (F @ mixed_P @ F.T) + root[:, :, None] * root[:, None, :] * Q,
        belief,
        given,
    )


def decided(
    models: Models, z: Array, H: Array, noise: Array, process: Scales, chances: Array
) -> tuple[Models, np.ndarray, np.ndarray]:
    """Return the models once a reading that is far from a candidate and from all others has decided between them."""
    # With it, which states are of a part that may have a new candidate, and of one whose candidate has been believed;
    # `chances` is how likely the reading of each sensor begins a jump.
    (x, P, belief, _), q, parts = models, len(process.scales), models.parts
    new, believed = np.zeros((2, len(parts)), dtype=bool)
    if process.jump == 0.0:
        return models, new, believed
    new = np.isin(parts, parts[(H != 0.0).any(axis=0)]) & (belief[q] < DROPPED * process.jump)
    far = far_off(models, z, H, noise, process), _asked(x[q], P[q], z, H, noise, np.inf)[1] > FAR
    for i in np.flatnonzero(np.logical_and(*far)):
        own = parts == parts[np.argmax(H[i] != 0.0)]
        chance = float(belief[q, own][0])
        if not new[own][0] and (chance > 0.5 or chance * (1.0 + 1e-9) < chances[i]):
            new |= own
            believed |= own & (chance > 0.5)
    return _from_candidate(models, believed, process), new, believed


class Begun(NamedTuple):
    """Which sensors the candidates have begun with, arrays of shape (m,)."""

    #: Innovation where it has, else 0.
    y: Array
    #: Of the innovation.
    variance: Array
    #: Whether no other sensor asked for a jump of that part from there.
    alone: np.ndarray


def with_candidates(
    models: Models, z: Array, H: Array, noise: Array, process: Scales, new: np.ndarray
) -> tuple[Models, Begun]:
    """Return the models, a candidate in each new part where an innovation asks for one, and who asked."""
    # The models are coupled as H has it; noise (m,) is the variance of ordinary noise.
    (x, P, belief, given), q, parts = models, len(process.scales), models.parts
    begun = Begun(np.zeros(len(z)), np.ones(len(z)), np.zeros(len(z), dtype=bool))
    if process.jump == 0.0:
        return models, begun
    belief, shares, seen = belief.copy(), slow(models, process), parts[np.argmax(H != 0.0, axis=1)]
    at, spread = collapse(shares, x[:q], P[:q], parts)
    chance = np.zeros(len(parts))
    heard = ~(H != 0.0)[:, new].any(axis=1)
    for _ in z:
        y, asks = _asked(at, spread, z, H, noise)
        asks[heard] = 0.0
        i = int(np.argmax(asks))
        if not asks[i] > FAR:
            break
        heard[i] = True
        own = parts == seen[i]
        first = not begun.y[seen == seen[i]].any()
        begun.alone[seen == seen[i]] = False
        if first:
            begun.y[i], begun.variance[i], begun.alone[i] = y[i], float(H[i] @ spread @ H[i]) + noise[i], True
            chance[own] = belief[_UNSEEN, own]
        at, spread = _moved(at, spread, y[i], H[i], noise[i], own)
    belief[:q, new] = ((1.0 - chance) * shares)[:, new]
    belief[q, new], belief[_UNSEEN, new] = chance[new], 0.0
    within = new[:, None] & new
    return Models(
        np.concatenate([x[:q], np.where(new, at, x[q])[None]]),
        np.concatenate([P[:q], np.where(within, spread, P[q])[None]]),
        belief,
        given,
    ), begun


def _moved(at: Array, spread: Array, y: float, h: Array, noise: float, own: np.ndarray) -> tuple[Array, Array]:
    """Return mean and covariance where a sensor says that its part of the state is."""
    seen = float(h @ spread @ h)
    # What the sensor sees of each state, as if they were independent: the others keep what they have.
    each = h * spread.diagonal() * h
    d = spread.diagonal() * h / each.sum()
    # P is so wide that the innovation does not ask any more, or would not if that state alone had moved; less what it
    # tells by Joseph's form, as d is not C / S.
    square = min(y * y, _FAR * _FAR * (seen + noise))
    most = square / (FAR * FAR)
    times = np.full(len(h), (most - noise) / seen)
    beyond = each * times > most
    times[beyond] = np.maximum(most / each[beyond], 1.0)
    root = np.sqrt(np.where(own, times, 1.0))
    left = np.eye(len(h)) - np.outer(d, h)
    return at + y * d, left @ (root[:, None] * spread * root) @ left.T + (noise + _LEFT * square) * np.outer(d, d)


def far_off(models: Models, z: Array, H: Array, noise: Array, process: Scales) -> Array:
    """Return which sensors ask for a jump, shape (m,)."""
    q = len(process.scales)
    at = collapse(slow(models, process), models.x[:q], models.P[:q], models.parts)
    return np.asarray(_asked(*at, z, H, noise, np.inf)[1] > FAR)


def _asked(
    at: Array, spread: Array, z: Array, H: Array, noise: Array, farthest: float = _FARTHEST
) -> tuple[Array, Array]:
    """Return innovations, and how many standard deviations off each is, 0 where none can tell."""
    with np.errstate(over="ignore"):
        y = z - H @ at
    seen = ((H @ spread) * H).sum(axis=1)
    asks = np.where(seen > 0.0, np.abs(y) / np.sqrt(np.where(seen > 0.0, seen + noise, 1.0)), 0.0)
    asks[~(asks <= farthest)] = 0.0
    return y, asks


def settled(models: Models, seen: np.ndarray, process: Scales) -> tuple[Models, np.ndarray]:
    """Return the models after a correction, and where a candidate is all but certain: that part goes on from it."""
    q = len(process.scales)
    if process.jump == 0.0:
        return models, np.zeros(len(seen), dtype=bool)
    belief = models.belief.copy()
    belief[_UNSEEN, seen] = 0.0
    believed = belief[q] > _TAKEN
    return _from_candidate(models._replace(belief=belief), believed, process), believed


def _from_candidate(models: Models, states: np.ndarray, process: Scales) -> Models:
    """Return the models, all of the parts that have these states where the candidate is."""
    if not states.any():
        return models
    (x, P, belief, given), q = models, len(process.scales)
    belief = belief.copy()
    belief[:q, states], belief[q, states] = slow(models, process)[:, states], 0.0
    return Models(np.where(states, x[q], x), np.where(states[:, None] & states, P[q], P), belief, given)


def begun_again(models: Models, given: Given, states: np.ndarray, process: Scales) -> Models:
    """Return the models, all of the parts that have these states where the recursion as given is, times its factor."""
    x, P, belief = models[:3]
    belief, q = belief.copy(), len(process.scales)
    belief[:-1, states] = 0.0
    belief[:q, states] = process.begin[:q, None]
    there = scaled(given.P, given.factor)
    return Models(np.where(states, given.x, x), np.where(states[:, None] & states, there, P), belief, given)


def merged(models: Models, process: Scales) -> tuple[Array, Array]:
    """Return mean and covariance of the state; an unlikely candidate is hidden, or all but a likely one."""
    x, P, p, q = models.x, models.P, models.probabilities, len(process.scales)
    if process.jump > 0.0:
        hidden = np.concatenate([slow(models, process), np.zeros((1, p.shape[1]))])
        p = np.where(p[q] > _SHOWN, p, hidden)
        p = np.where(p[q] > _ALONE, np.eye(len(p))[:, -1:], p)
    x, P = collapse(p, x, P, models.parts)
    if models.given is None or not models.given.shown.any():
        return x, P
    shown = models.given.shown
    apart = shown[:, None] != shown
    return np.where(shown, models.given.x, x), np.where(apart, 0.0, np.where(shown, models.given.P, P))


def collapse(probabilities: Array, means: Array, covariances: Array, parts: Array) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture of h models, with probabilities (..., h, n) of its own in each part."""
    # Means (..., h, n), covariances (..., h, n, n); parts (n,) has equal numbers where states are of one.
    mean = (probabilities * means).sum(axis=-2)
    apart = means - mean[..., None, :]
    within = (probabilities[..., None] * covariances).sum(axis=-3)
    among = np.swapaxes(apart * probabilities, -1, -2) @ apart
    return mean, np.where(parts[:, None] == parts, within + among, 0.0)
