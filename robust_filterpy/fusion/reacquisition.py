"""After a blackout or a jump: "this reading is wrong" and "I am wrong" are both carried until later readings decide.

A reading more than six standard deviations from what is expected opens a doubt. From the state before it go, next to
each other and each with a number c more for each component that is off::

    moves along   the sensor is off by c:    z = h(x) + c + v
    stands still  it tells a fixed place:    z = c + v
    jumped        x was wrong in what the sensor sees: P grows there, and all readings are right
    jumped, g off x was wrong, and another sensor g goes on being off by c; for each g
    over          the sensor was off, and is right again

Who is off is right again within dt seconds with probability 1 - exp(-dt/length): the hypothesis then passes that share
of its weight to "over", or to "jumped", at each reading of the sensor, and what fits that reading is what remains. So a
cluster of false readings is taken for a jump, if nothing tells the two apart, after some length * log(100) seconds, and
not before; ``length`` and ``jump``, the share of jumps among such events, are the prior, since data alone cannot tell.

Weights are the densities of all readings, under noise as learned and a class of far readings more, so that a single one
decides nothing. What is served meanwhile:

* until three readings of the sensor agree with one another the state goes on as ever: a single outlier changes no bit;
* then, until hypotheses with one x have a probability of .99, x of the most probable one, and P about it that covers
  all of them; nothing is learned;
* then the state of that one, with the filter's policy again, without the sensor that is off.

Hypotheses go on behind a decision until they are one in a million, so that readings which jump back undo it at once.
All of it is part of the moment after a stamp, as what a filter has learned is: a late reading makes it be judged anew,
to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.hypotheses import corrected, moved
from robust_filterpy.fusion._stepping import FAR, Moment, Setup, State, advanced, covariance
from robust_filterpy.fusion._watch import begun_anew

# Places of hypotheses: those with another sensor off follow.
_STILL, OVER, JUMPED = 1, 2, 3
# A hypothesis less probable than this is forgotten.
_GONE = 1e-6
# Share of readings that are of no known class, and their variance over that of ordinary noise.
_STRAY, _WILD = 1e-3, 1e6
# How far beyond the first far reading the state may have jumped; among jumps, the share with another sensor off.
_REACH, _OTHERS = 3.0, 0.5


class Doubt(NamedTuple):
    """Hypotheses side by side, N of them; nothing in here is ever written to."""

    #: Whose reading was far.
    sensor: int
    #: Key of the stamp.
    since: Any
    #: How many of its readings have agreed with one another.
    agreed: int
    #: Place of the hypothesis whose x is served; -1 as long as it is the state as ever.
    served: int
    #: Whether that is decided.
    sure: bool
    #: State and offsets of all components, (N, n + M).
    x: Array
    #: (N, n + M, n + M)
    P: Array
    #: Logarithms of their probabilities, (N,).
    logs: Array
    #: Seconds since each sensor has spoken, (S,).
    quiet: Array

    @property
    def off(self) -> int:
        """Which sensor is left out of the state that is served; -1 if none is."""
        return int(_offs(self)[self.served]) if self.served >= 0 and self.sure else -1

    @property
    def moved(self) -> bool:
        """Whether the state that is served is another one than before."""
        return self.served >= JUMPED

    @property
    def probability(self) -> float:
        """That the state was right, if that is served; else of what is served."""
        p = np.exp(self.logs)
        return float(p[self.served] if self.moved else p[:JUMPED].sum())


def _offs(doubt: Doubt) -> np.ndarray:
    """Return which sensor is off under each hypothesis, -1 if none is, (N,)."""
    others = [g for g in range(len(doubt.quiet)) if g != doubt.sensor]
    return np.array([doubt.sensor, doubt.sensor, -1, -1, *others])


def opened(setup: Setup, before: Moment, seconds: float, key: Any, z: Array, s: int) -> Doubt:
    """Return all hypotheses after the first far reading."""
    layout, state, prior = setup.layout, before.state, setup.reacquire
    n, M, S = layout.n, layout.size, len(layout.names)
    F, _, drift = setup.motion.over(seconds, state.x, state.u)
    ahead = F @ state.x + drift
    # Of readings of 0, the expected ones with the sign turned.
    seen = layout.seen_from(ahead, np.zeros(M))
    expected, own = np.nan_to_num(seen.H @ ahead - seen.z), layout.owner == s
    y = np.where(np.isnan(z), 0.0, z - expected)
    reach = (10.0 * np.sqrt(_noise(setup, state)) + np.abs(expected)) ** 2
    reach[own] = (_REACH * np.abs(y[own]).max()) ** 2
    others = [g for g in range(S) if g != s]
    N = 4 + len(others)
    x, P = np.zeros((N, n + M)), np.zeros((N, n + M, n + M))
    x[:, :n], P[:, :n, :n] = state.x, state.P
    for i, sensors in enumerate([[s], [s], [], [s], *([s, g] for g in others)]):
        # What is wrong in x, and what is off: as far as the first reading may be.
        off = np.isin(layout.owner, sensors[-1:]) if i != JUMPED else np.zeros(M, dtype=bool)
        P[i, n:, n:] = np.diag(np.where(off, reach, 0.0))
        for g in sensors if i >= JUMPED else ():
            back = np.linalg.pinv(seen.H[layout.owner == g])
            P[i, :n, :n] += back * reach[layout.owner == g] @ back.T
    x[_STILL, n:][own] = expected[own]
    shares = np.array([0.5 * (1.0 - prior.jump)] * 2 + [0.0, prior.jump] + [_OTHERS * prior.jump] * len(others))
    shares[JUMPED:] *= 1.0 if not others else np.array([1.0 - _OTHERS] + [1.0 / len(others)] * len(others))
    with np.errstate(divide="ignore"):
        doubt = Doubt(s, key, 0, -1, False, x, P, np.log(shares), np.zeros(S))
    return stepped(setup, state, doubt, seconds, z)


def _noise(setup: Setup, state: State) -> Array:
    """Return the variances of ordinary noise as learned, (M,); of what nobody knows yet, 1."""
    r = setup.policy.factors(state.memory) * covariance(setup.layout, state.sizes).diagonal()
    return np.where(np.isnan(state.sizes), 1.0, r)


def stepped(setup: Setup, state: State, doubt: Doubt, seconds: float, z: Array) -> Doubt:
    """Return the hypotheses some seconds later, after what was read."""
    n, owner, first = setup.layout.n, setup.layout.owner, not doubt.agreed
    x, P, quiet = doubt.x.copy(), doubt.P.copy(), doubt.quiet + seconds
    slack = setup.policy.slack(state.carried)
    if setup.motion.is_linear:
        F, Q, drift = setup.motion.over(seconds, x[0, :n], state.u)
    else:
        steps = [setup.motion.over(seconds, row, state.u) for row in x[:, :n]]
        F, Q, drift = (np.array(part) for part in zip(*steps, strict=True))
    moved(x, P, F, slack * Q, drift)
    spoke = np.unique(owner[~np.isnan(z)])
    offs, logs = _offs(doubt), doubt.logs.copy()
    # Who is off may be right again, when he speaks: another row for each, without an offset.
    ends = np.flatnonzero(np.isin(offs, spoke) & (offs >= 0) & (not first) & np.isfinite(logs))
    stays = -quiet[offs[ends]] / setup.reacquire.length
    with np.errstate(divide="ignore"):
        logs = np.concatenate([logs, logs[ends] + np.log(-np.expm1(stays))])
    logs[ends] += stays
    x, P = np.concatenate([x, x[ends]]), np.concatenate([P, P[ends]])
    right = slice(len(offs), None)
    x[right, n:], P[right, n:, :], P[right, :, n:] = 0.0, 0.0, 0.0
    # Whether a reading agrees with the far ones before it, not with what was expected.
    far = np.where(np.arange(len(offs)) == OVER, -np.inf, doubt.logs)
    still = np.arange(len(x)) == _STILL
    agrees = _read(setup, state, doubt.sensor, (x, P, logs), z, still, int(np.argmax(far)))
    P = 0.5 * (P + np.swapaxes(P, 1, 2))
    N = len(offs)
    for row, i in enumerate(ends.tolist(), N):
        into = OVER if i < OVER else JUMPED
        if logs[row] > logs[into]:
            x[into], P[into] = x[row], P[row]
        logs[into] = np.logaddexp(logs[into], logs[row])
    logs = logs[:N] - np.logaddexp.reduce(logs[:N])
    logs = np.where(logs < math.log(_GONE), -np.inf, logs)
    quiet[spoke] = 0.0
    agreed = doubt.agreed + int(doubt.sensor in spoke and (first or agrees))
    return doubt._replace(agreed=agreed, x=x[:N], P=P[:N], logs=logs, quiet=quiet)


def _read(
    setup: Setup, state: State, sensor: int, rows: tuple[Array, Array, Array], z: Array, still: np.ndarray, one: int
) -> bool:
    """Correct all rows by what was read, in place; return whether the sensor agrees with one of them."""
    layout, (x, P, logs), n = setup.layout, rows, setup.layout.n
    r, (scales, shares) = _noise(setup, state), setup.policy.shares(state.memory)
    scales = np.append(scales, _WILD)
    shares = np.log(np.column_stack([shares * (1.0 - _STRAY), np.full(layout.size, _STRAY)]))
    seen = [layout.seen_from(row[:n], z) for row in x]
    agrees = True
    for c in np.flatnonzero(~np.isnan(z) & ~np.isnan(state.sizes)).tolist():
        h, zs = np.zeros(x.shape), np.array([at.z[c] for at in seen])
        h[:, :n] = [at.H[c] for at in seen]
        h[:, n + c] = 1.0
        h[still & (layout.owner[c] == sensor), :n] = 0.0
        zs[still & (layout.owner[c] == sensor)] = z[c]
        # Where a sensor's function has no answer its reading is a wild one.
        lost = np.isnan(zs)
        h[lost], zs[lost] = 0.0, math.sqrt(_WILD * r[c])
        if layout.owner[c] == sensor:
            spread = h[one] @ P[one] @ h[one] + r[c]
            agrees &= bool(abs(zs[one] - h[one] @ x[one]) < FAR * math.sqrt(spread))
        logs += corrected(x, P, zs, h, scales[:, None] * r[c], shares[c, :, None])
    return agrees


# So many readings that agree with one another, and the state is no longer served as ever.
_AGREE = 3
# A decision, and standard deviations within which two hypotheses mean the same.
_SURE, _SAME = 0.99, 3.0


@dataclass(frozen=True)
class Reacquisition:
    """What is to be expected where readings and state are suddenly far apart.

    Parameters
    ----------
    length : float, default 25
        Seconds that a sensor is off in the mean, when it is. Readings that stay apart from the state, and could be
        right as well, are believed after about 4.6 of them.
    jump : float, default 0.5
        Probability that it is the state which is wrong, before anything tells.

    Raises
    ------
    ValueError, TypeError
        If length is not > 0, or jump not between 0 and 1.
    """

    length: float = 25.0
    jump: float = 0.5

    def __post_init__(self) -> None:
        """Check."""
        _checks.positive("length", self.length)
        if not 0.0 < _checks.real("jump", self.jump) < 1.0:
            raise ValueError(f"jump: expected a probability between 0 and 1, got {self.jump!r}")


def doubted(setup: Setup, before: Moment, seconds: float, key: Any, z: Array, control: Array | None) -> Moment:
    """Return the moment some seconds later, with what is in doubt, if that is asked for."""
    if setup.reacquire is None:
        return advanced(setup, before, seconds, z, control)
    doubt, watch, owner = before.doubt, before.watch, setup.layout.owner
    used = z if doubt is None or doubt.off < 0 else np.where(owner == doubt.off, np.nan, z)
    moment = advanced(setup, before, seconds, used, control)
    if watch is not None and watch.fault.any():
        # What lies tells no hypothesis from another.
        z = np.where(watch.out[setup.layout.party], np.nan, z)
    if doubt is not None:
        after, near = _judged(stepped(setup, before.state, doubt, seconds, z), setup.layout.n)
        same = after.served == doubt.served and after.sure == doubt.sure
        if not (same and after.sure and doubt.off < 0 and moment.far >= 0):
            return _as_served(setup, before, moment, after, near, same)
        # Nothing that is carried explains it: another event. While a sensor is left out it stays so.
    return moment if moment.far < 0 else moment._replace(doubt=opened(setup, before, seconds, key, z, moment.far))


def _agreeing(doubt: Doubt, n: int) -> np.ndarray:
    """Return which hypotheses have the same x as the most probable one, up to what they do not know, (N,)."""
    top = int(np.argmax(doubt.logs))
    apart, spread = doubt.x[:, :n] - doubt.x[top, :n], doubt.P[:, :n, :n] + doubt.P[top, :n, :n]
    far = (apart[:, None] @ np.linalg.pinv(spread, hermitian=True) @ apart[:, :, None])[:, 0, 0]
    return np.asarray(np.isfinite(doubt.logs) & (far < _SAME**2 + n))


def _judged(doubt: Doubt, n: int) -> tuple[Doubt, np.ndarray]:
    """Return what is served of the hypotheses, and which agree with the most probable one."""
    near = _agreeing(doubt, n)
    if doubt.served < 0 and (doubt.agreed < _AGREE or near[OVER]):
        return doubt, near
    sure = bool(np.exp(doubt.logs[near]).sum() >= _SURE)
    return doubt._replace(served=int(np.argmax(doubt.logs)), sure=sure), near


def _as_served(setup: Setup, before: Moment, moment: Moment, doubt: Doubt, near: np.ndarray, same: bool) -> Moment:
    """Return the moment with the state that is served, and the doubt as long as there is one."""
    p, n, at = np.exp(doubt.logs), setup.layout.n, doubt.served
    if at < 0:
        # An outlier and no more: the state has gone on as ever.
        return moment if near[OVER] and p[near].sum() >= _SURE else moment._replace(doubt=doubt)
    # Nothing is left to be decided.
    remaining = None if doubt.off < 0 and not p[~near].any() and doubt.sure else doubt
    if doubt.sure and same:
        return moment._replace(doubt=remaining)
    x, P = doubt.x[at, :n], doubt.P[at, :n, :n]
    if not doubt.sure:
        apart = doubt.x[:, :n] - x
        P = np.einsum("i,ijk->jk", p, doubt.P[:, :n, :n] + apart[:, :, None] * apart[:, None, :])
    was, now = before.state, moment.state
    state = now._replace(x=x, P=P, memory=was.memory, carried=setup.policy.start(x, P, runs=True))
    # The tests of sensors were of another state.
    watch = moment.watch and begun_anew(before.watch, np.zeros(len(before.watch.fault), dtype=bool), setup.layout.party)
    return moment._replace(state=state, watch=watch, doubt=remaining, anew=True)
