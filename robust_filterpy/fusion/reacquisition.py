"""After a blackout or a jump: "this reading is wrong" and "I am wrong" are both carried until later readings decide.

A reading more than six standard deviations from what is expected opens a doubt. From the state before it go, beside
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

Weights are the densities of all readings, under noise as learnt and a class of far readings more, so that a single one
decides nothing. What is served meanwhile:

* until three readings of the sensor agree with one another the state goes on as ever: a single outlier changes no bit;
* then, until hypotheses with one x have a probability of .99, x of the most probable one, and P about it that covers
  all of them; nothing is learnt;
* then the state of that one, with the filter's policy again, without the sensor that is off.

Hypotheses go on behind a decision until they are one in a million, so that readings which jump back undo it at once.
All of it is part of the moment after a stamp, as what a filter has learnt is: a late reading makes it be judged anew,
to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.fusion._doubts import FAR, OVER, Doubt, opened, stepped
from robust_filterpy.fusion._stepping import Moment, Setup, advanced

__all__ = ["Reacquisition", "doubted"]

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
    """Return the moment some seconds later, with what is in doubt.

    Parameters
    ----------
    setup : Setup
        What does not change.
    before, seconds, z, control
        As `advanced` takes them.
    key : float or int
        Of the stamp.

    Returns
    -------
    Moment
    """
    doubt, owner = before.doubt, setup.layout.owner
    used = z if doubt is None or doubt.off < 0 else np.where(owner == doubt.off, np.nan, z)
    moment = advanced(setup, before, seconds, used, control)
    if doubt is not None:
        after = _judged(stepped(setup, before.state, doubt, seconds, z), setup.layout.n)
        same = after.served == doubt.served and after.sure == doubt.sure
        if same and after.sure and doubt.off < 0 and _farthest(setup, moment) >= 0:
            # Nothing that is carried explains it: another event. While a sensor is left out it stays so.
            return moment._replace(doubt=opened(setup, before, seconds, key, z, _farthest(setup, moment)))
        return _as_served(setup, before, moment, after, same)
    sensor = _farthest(setup, moment)
    return moment if sensor < 0 else moment._replace(doubt=opened(setup, before, seconds, key, z, sensor))


def _farthest(setup: Setup, moment: Moment) -> int:
    """Return the sensor with the farthest reading, -1 if none is far."""
    with np.errstate(invalid="ignore"):
        e = np.nan_to_num(np.abs(moment.innovation / moment.deviation))
    return int(setup.layout.owner[np.argmax(e)]) if e.max() > FAR else -1


def _agreeing(doubt: Doubt, n: int) -> np.ndarray:
    """Return which hypotheses have the same x as the most probable one, up to what they do not know, (N,)."""
    top = int(np.argmax(doubt.logs))
    apart, spread = doubt.x[:, :n] - doubt.x[top, :n], doubt.P[:, :n, :n] + doubt.P[top, :n, :n]
    far = (apart[:, None] @ np.linalg.pinv(spread, hermitian=True) @ apart[:, :, None])[:, 0, 0]
    return np.asarray(np.isfinite(doubt.logs) & (far < _SAME**2 + n))


def _judged(doubt: Doubt, n: int) -> Doubt:
    """Return what is served of the hypotheses."""
    near = _agreeing(doubt, n)
    if doubt.served < 0 and (doubt.agreed < _AGREE or near[OVER]):
        return doubt
    return doubt._replace(served=int(np.argmax(doubt.logs)), sure=bool(np.exp(doubt.logs[near]).sum() >= _SURE))


def _as_served(setup: Setup, before: Moment, moment: Moment, doubt: Doubt, same: bool) -> Moment:
    """Return the moment with the state that is served, and the doubt as long as there is one."""
    p, n, at, near = np.exp(doubt.logs), setup.layout.n, doubt.served, _agreeing(doubt, setup.layout.n)
    if at < 0:
        # An outlier and no more: the state has gone on as ever.
        return moment if near[OVER] and p[near].sum() >= _SURE else moment._replace(doubt=doubt)
    # Nothing is left to be decided.
    kept = None if doubt.off < 0 and not p[~near].any() and doubt.sure else doubt
    if doubt.sure and same:
        return moment._replace(doubt=kept)
    x, P = doubt.x[at, :n], doubt.P[at, :n, :n]
    if not doubt.sure:
        apart = doubt.x[:, :n] - x
        P = np.einsum("i,ijk->jk", p, doubt.P[:, :n, :n] + apart[:, :, None] * apart[:, None, :])
    was, now = before.state, moment.state
    state = now._replace(x=x, P=P, memory=was.memory, kept=setup.policy.start(x, P, len(now.sizes)))
    return moment._replace(state=state, doubt=kept)
