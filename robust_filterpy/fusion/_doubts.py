"""Hypotheses about a reading that is far from the state, beside each other: `reacquisition` says which and why."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.fusion._faults import corrected
from robust_filterpy.fusion._policies import State
from robust_filterpy.fusion._stepping import Moment, Setup, covariance

__all__ = ["FAR", "JUMPED", "OVER", "Doubt", "opened", "stepped"]

#: A reading is far beyond so many standard deviations.
FAR = 6.0
# Places of hypotheses: those with another sensor off follow.
_STILL, OVER, JUMPED = 1, 2, 3
# A hypothesis less probable than this is forgotten.
_GONE = 1e-6
# Share of readings that are of no known class, and their variance over that of ordinary noise.
_STRAY, _WILD = 1e-3, 1e6
# How far beyond the first far reading the state may have jumped; among jumps, the share with another sensor off.
_REACH, _OTHERS = 3.0, 0.5


class Doubt(NamedTuple):
    """Hypotheses beside each other, N of them; nothing in here is ever written to."""

    sensor: int
    """Whose reading was far."""
    since: Any
    """Key of the stamp."""
    agreed: int
    """How many of its readings have agreed with one another."""
    served: int
    """Place of the hypothesis whose x is served; -1 as long as it is the state as ever."""
    sure: bool
    """Whether that is decided."""
    x: Array
    """State and offsets of all components, (N, n + M)."""
    P: Array
    """(N, n + M, n + M)"""
    logs: Array
    """Logarithms of their probabilities, (N,)."""
    quiet: Array
    """Seconds since each sensor has spoken, (S,)."""

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
    """Return the variances of ordinary noise as learnt, (M,); of what nobody knows yet, 1."""
    r = setup.policy.factors(state.memory) * covariance(setup.layout, state.sizes).diagonal()
    return np.where(np.isnan(state.sizes), 1.0, r)


def stepped(setup: Setup, state: State, doubt: Doubt, seconds: float, z: Array) -> Doubt:
    """Return the hypotheses some seconds later, after what was read."""
    n, owner, first = setup.layout.n, setup.layout.owner, not doubt.agreed
    x, P, quiet = doubt.x.copy(), doubt.P.copy(), doubt.quiet + seconds
    slack = setup.policy.slack(state.kept)
    step = setup.motion.over(seconds, x[0, :n], state.u)
    for i in range(len(x)):
        F, Q, drift = step if setup.motion.is_linear or not i else setup.motion.over(seconds, x[i, :n], state.u)
        x[i, :n] = F @ x[i, :n] + drift
        P[i, :n] = F @ P[i, :n]
        P[i, :, :n] = P[i, :, :n] @ F.T
        P[i, :n, :n] += slack * Q
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
    shares = np.column_stack([shares * (1.0 - _STRAY), np.full(layout.size, _STRAY)])
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
        logs += corrected(x, P, zs, h, np.full(len(x), r[c]), scales, np.broadcast_to(shares[c], (len(x), len(scales))))
    return agrees
