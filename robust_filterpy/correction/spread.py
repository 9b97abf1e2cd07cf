"""How large a sensor's innovations usually are, learned: the unit of its thresholds under scaling="learnt".

Nothing is an outlier before there is a typical innovation. What a memory of 23 numbers a sensor does to a correction
does not depend on a common factor of P, Q and R, on units, on the order of the sensors or on psi. `prepared` comes
before a correction and `after` behind it; B = H P H' as given, B+ what the last correction left of it::

    w_i   max(1, (1 + B/R) / (1 + e^g B+/R)), g the usual growth of log(B/R)  only the noise has outliers
          as far as such e_i have been, if they were many
    s_i   the median of |e_i| over .6745, of new and not far readings         e_i = y_i / sqrt(S_ii), S as given
    k_i   Huber's minimax threshold (17) for the share of those beyond 3 s_i  the fewer outliers, the less is clipped
    v_i   (k_i^2 + 4 log(max(1, B/R)))^(1/2), B/R as is usual                 and the more a clipped clean one costs
    width v_i / 1.345 w_i s_i sqrt(S_ii)                                      the unit of psi's threshold

docs/equations.md has the whole rule, and what each number does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

#: Columns of a memory, shape (m, 23).
WEIGHT, SPREAD, SHARE, OUTLIERS, RUN, REST, JUMP, LAST, REPEATS = range(9)
STEP, LEFT, GROWTH, USED, HELD, FILLED, WIDE, WIDENED, LASTED, VAIN, ON, REACH, AGE, OPEN = range(9, 23)
NUMBERS = 23

QUARTILE = 0.6744897501960817  #: median of |e| for a normal e of deviation 1
BEND = 1.345  #: beyond so many spreads an innovation counts as clipped, whatever psi is
FAR = 3.0  #: beyond so many spreads or deviations it is an outlier, or a jump; others contradict it
PACE, MEMORY = 2.0, 100.0  #: steps of log(spread): 2/n of n samples, at least 2/100
#: Minimax threshold of a share e of outliers (17), e from .004 to .5, within half a percent: a polynomial in the root
#: of -log(e).
MINIMAX = (0.1903, 0.5837, -0.1838)
FEW = 10.0  #: the share starts from so many without an outlier; so many far ones in a row, and another one is typical
RUN_LENGTH = 4.0  #: a jump: so many clipped in a row, until some have lasted,
AGREE = 2.5  #: each within 2.5 spreads of where the last left x
RARE, RETURN = 0.05, 0.2  #: a share of outliers with which one innovation is a return, if within a fifth of the jump;
# and the chance of a jump, over the number of readings that the state stands on
SPARED = 0.1  #: states that tell a tenth as much of the prediction as the one that tells most do not jump with it
WHOLE = 0.01  #: so little wider is as usual
SUDDEN = 4.0  #: what is so many spreads off has not crept there
STEEP = 1.5  #: a run goes on while it grows by less than half
ROUNDED = 1e-13  #: an innovation of so much of the reading and of its standard deviation is rounding
FLOOR, STEEPEST = 1e-9, 50.0  #: less of H P H' / R is rounding; its logarithm does not grow by more
LARGEST_GROWTH = 1e6  #: of S at one jump; makes the gain 1 - 1e-6
WITNESS, APART = 0.47, 1.5  #: see `_added_noise`


class Prepared(NamedTuple):
    """What a correction begins with under scaling "learnt"; C and S are as given unless P has grown."""

    #: Memory after the innovation, shape (m, 23).
    memory: np.ndarray
    #: Unit of each sensor's threshold, in that of its measurement, shape (m,).
    width: np.ndarray
    #: Variance that is a sensor's own noise beyond R, shape (m,).
    added: np.ndarray
    #: Factor of each state's standard deviation, shape (n,).
    growth: np.ndarray
    #: Variance that a jump adds to what each sensor sees of the state, shape (m,).
    opened: np.ndarray
    #: Which readings say nothing new and are missing therefore, shape (m,).
    held: np.ndarray

    def spread(self, S: np.ndarray) -> np.ndarray:
        """Return s, the width in units of the S that the correction is by, shape (m,)."""
        variances = np.diag(S) + self.added
        return np.asarray(self.width / np.sqrt(np.where(variances > 0.0, variances, 1.0)))


def begin(m: int) -> np.ndarray:
    """Return the memory of sensors of which nothing was learned."""
    return np.zeros((m, NUMBERS))


def prepared(
    memory: np.ndarray, z: np.ndarray, y: np.ndarray, S: np.ndarray, R: np.ndarray, C: np.ndarray, P: np.ndarray,
    patience: int | None = None,
) -> Prepared:  # fmt: skip
    """Learn from an innovation, and say how it is to be judged; patience: how many that agree are a jump."""
    memory, here = memory.copy(), np.isfinite(y) & (np.diag(S) > 0)
    nominal, size = np.sqrt(np.where(here, np.diag(S), 1.0)), np.zeros(len(y))
    ratio = _ratio(np.diag(S - R), R, S)
    coarse = np.where(memory[:, REPEATS] > 0, memory[:, STEP] / BEND, 0.0) / nominal
    excess = np.where(here, _excess(memory, ratio), 1.0)
    wider, bend = _wider(memory, excess, coarse), _tolerance(memory, ratio, BEND)
    # Below a number whose square is a number.
    size[here] = np.minimum(np.abs(y[here]) / nominal[here], 1e100) / wider[here]
    held = np.array([bool(here[i]) and _holds(memory[i], z[i], size[i], coarse[i]) for i in range(len(y))], dtype=bool)
    here &= ~held
    for i in np.flatnonzero(here & (excess > 1 + WHOLE)):
        _widen(memory[i], size[i] * wider[i], excess[i])
    # A typical innovation is no rounding: of a state that was set from the reading itself, say. What repeats the
    # reading before tells nothing of the noise.
    begins = (memory[:, WEIGHT] > 0) | (np.abs(y) > ROUNDED * (np.abs(z) + nominal))
    new = (memory[:, STEP] == 0) | (z != memory[:, LAST])
    for i in np.flatnonzero(here & begins & new & (size > 0)):
        weight = math.sqrt(min(max(R[i, i] / S[i, i], 1e-9), 1.0))
        _learn(memory[i], size[i] * wider[i], coarse[i], weight, FEW + (patience or 0))
    # Who has no typical innovation yet has shown zeros alone: any width will do.
    s = np.where(memory[:, WEIGHT] > 0, np.maximum(memory[:, SPREAD], coarse), 1.0)
    B = S - R
    added = _added_noise(y, s, nominal, B, here) if here.sum() > 1 else np.zeros(len(y))
    width = np.maximum(_tolerance(memory, ratio, minimax(memory)) * s, bend * coarse) / BEND * nominal * wider
    unit, out, back = s * nominal * wider, here & (size > bend * s), np.zeros(len(y), dtype=bool)
    # No chance is to end a longer run: the difference of two innovations has twice the variance of one.
    near = (AGREE if patience is None else math.sqrt(2.0) * FAR) * unit
    for i in np.flatnonzero(here):
        own, ordinary = memory[i], not out[i]
        _note_reading(own, z[i], ordinary and own[RUN] == 0)
        _grow_old(own, unit[i], ordinary)
        if ordinary and own[RUN] == 0:
            _learn_growth(own, ratio[i], excess[i])
        if ordinary or not _goes_on(own, y[i], near[i]):
            _end_run(own, unit[i])
        own[RUN] += out[i]
        # Back where the state was before a jump.
        landing = max(near[i], RETURN * abs(own[JUMP]))
        back[i] = out[i] and own[JUMP] != 0 and abs(y[i] + own[JUMP]) < landing
    # What others that see the same are not off by is a sensor's own noise, no jump.
    growth, opened = np.ones(len(C)), np.zeros(len(y))
    for i in np.flatnonzero(out & (added == 0) & (np.diag(B) > 0)):
        # What its last reading says of the whole run, against no jump of a state that stands on R / H P H' readings.
        tells = memory[i, RUN] * size[i] ** 2 / 2 >= -math.log(RARE * ratio[i]) * s[i] ** 2
        if not _believed(memory[i], y[i], unit[i], back[i], tells, patience):
            continue
        wanted = min((size[i] / (bend[i] * s[i])) ** 2 - 1, LARGEST_GROWTH) * S[i, i]
        # What creeps away is moved by all that correlates; what is suddenly far, by what the sensor sees.
        if size[i] < SUDDEN * s[i]:
            growth = np.maximum(growth, np.sqrt(1 + wanted / B[i, i] * moved(C[:, i], np.diag(P))))
        else:
            opened[i] = wanted
        # Believed: as large as is usual.
        width[i] = abs(y[i])
        if back[i] and abs(memory[i, JUMP]) > SUDDEN * unit[i]:
            _note_outcome(memory[i], memory[i, AGE] == 0, memory[i, AGE] - 1)
        memory[i, AGE] = 0.0 if back[i] else memory[i, RUN]
        _forgive(memory[i], 0.0 if back[i] else y[i])
    return Prepared(memory, width, added, growth, opened, held)


def after(memory: np.ndarray, rest: np.ndarray, left: np.ndarray, S: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return the memory that knows what a correction left over."""
    memory, here = memory.copy(), np.isfinite(rest)
    memory[here, REST], memory[here, LEFT] = rest[here], _ratio(left, R, S)[here]
    return memory


def _ratio(seen: np.ndarray, R: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Return H P H' / R, R at least what is not rounding of S, shape (m,)."""
    noise = np.maximum(np.diag(R), 1e-12 * np.diag(S))
    return np.maximum(seen / np.where(noise > 0, noise, 1.0), FLOOR)


def _excess(memory: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Return S / R over what would be, had the usual time passed since a sensor's last reading, at least 1 (m,)."""
    usual = memory[:, LEFT] * np.exp(np.minimum(memory[:, GROWTH], STEEPEST))
    return np.where(memory[:, USED] > 0, np.maximum((1 + ratio) / (1 + usual), 1.0), 1.0)


def _tolerance(memory: np.ndarray, ratio: np.ndarray, threshold: np.ndarray | float) -> np.ndarray:
    """Return a threshold in spreads, larger where a reading usually says more than the state before it (m,)."""
    now = np.log(np.maximum(ratio, 1.0))
    return np.asarray(np.sqrt(threshold**2 + 4 * np.where(memory[:, USED] > 0, np.minimum(now, memory[:, OPEN]), now)))


def minimax(memory: np.ndarray) -> np.ndarray:
    """Return Huber's minimax threshold for a sensor's share of outliers, that is known to half a reading (m,)."""
    least = np.maximum(1 / (memory[:, WEIGHT] + FEW), 1 / MEMORY) / 2
    return np.asarray(np.polyval(MINIMAX, np.sqrt(-np.log(np.clip(memory[:, SHARE], least, 0.5)))))


def _wider(memory: np.ndarray, excess: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Return by what a width grows with S / R: no further than readings that were wider than usual have been (m,)."""
    usual = BEND * np.maximum(memory[:, SPREAD], coarse)
    bounded = (excess > 1 + WHOLE) & (memory[:, WIDENED] > FEW) & (usual > 0)
    most = FAR * memory[:, WIDE] / np.where(usual > 0, usual, 1.0)
    return np.where(bounded, np.maximum(np.minimum(excess, most), 1.0), excess)


def _widen(own: np.ndarray, e: float, excess: float) -> None:
    """Learn how far readings are that are wider than usual."""
    before, weight, aim = own[WIDENED], 1 - 1 / excess, e / QUARTILE
    own[WIDENED] += weight
    pace = PACE * max(weight / before, weight / MEMORY) if before > 0 else 0.0
    own[WIDE] = _towards(own[WIDE], aim, pace, pace) if before > 0 else aim


def _learn_growth(own: np.ndarray, ratio: float, excess: float) -> None:
    """Learn how log(H P H' / R) grows from one ordinary reading to the next, and what it usually is, 0 below 1."""
    if own[LEFT] > 0:
        grown = math.log(max(ratio, FLOOR) / own[LEFT]) - own[GROWTH]
        # A step at most e-fold; one that would be more is not the mean yet.
        own[USED] += own[USED] == 0 or grown < 1
        pace = max(1 / own[USED], 1 / MEMORY)
        own[GROWTH] += min(grown, 1.0) * pace
        if not excess > 1 + WHOLE:
            own[OPEN] += (math.log(max(ratio, 1.0)) - own[OPEN]) * pace


def _towards(median: float, aim: float, up: float, down: float) -> float:
    """Return a median by recursion after one step: up or down by a pace, but never beyond what was seen."""
    if aim > median:
        return min(aim, median * math.exp(min(up, 700.0)))
    return max(aim, median * math.exp(-down))


def _learn(own: np.ndarray, size: float, coarse: float, weight: float, most: float) -> None:
    """Let one sensor's |e| move its spread and its share of outliers, of which at most so many are in a row."""
    if own[OUTLIERS] >= most:
        own[[WEIGHT, SHARE, OUTLIERS]] = 0.0
    before, aim = own[WEIGHT], size / QUARTILE
    own[WEIGHT] += weight
    if before == 0:
        own[SPREAD] = aim
        return
    pace, far = max(weight / before, 1 / MEMORY), size > FAR * max(own[SPREAD], coarse)
    # The far ones are left out of it.
    share = float(own[SHARE])
    own[SPREAD] = _towards(float(own[SPREAD]), aim, PACE * pace * (1 - share), PACE * pace * (1 + share))
    own[OUTLIERS] = own[OUTLIERS] + 1 if far else 0
    own[SHARE] += (far - own[SHARE]) * max(weight / (own[WEIGHT] + FEW), 1 / MEMORY)


def _forgive(own: np.ndarray, jump: float) -> None:
    """Note a jump: the far ones in a row were no outliers, and it may be undone."""
    own[SHARE] = max(own[SHARE] - own[OUTLIERS] * _step(own), 0.0)
    own[[OUTLIERS, RUN, HELD]], own[JUMP] = 0.0, jump


def _as_jumps(own: np.ndarray, far: float, unit: float) -> bool:
    """Tell whether something is far, and as far as jumps have gone."""
    reach = float(own[REACH])
    return far > FAR * unit and (reach == 0 or (far < FAR * reach and FAR * far > reach))


def _believed(own: np.ndarray, y: float, unit: float, back: bool, tells: bool, patience: int | None) -> bool:
    """Tell whether a run is a jump, no outliers nor chance: by the odds of those before, or by length and evidence."""
    if patience is not None:
        return bool(own[RUN] >= patience)
    # What has not lasted yet is undone at once.
    if (own[RUN] >= RUN_LENGTH and tells) or (back and (own[AGE] > 0 or own[SHARE] < RARE)):
        return True
    again = (own[ON] + 1) / (own[VAIN] + own[ON] + 2)
    odds = own[LASTED] / ((own[VAIN] + 1) * math.exp((own[RUN] - 1) * math.log(again)))
    return bool(own[REACH] > 0 and _as_jumps(own, abs(float(y)), unit) and odds * (1 + 1e-9) >= 1)


def _note_outcome(own: np.ndarray, lasted: bool, length: float) -> None:
    """Note what became of a run of far readings: a jump, or so many that came to nothing."""
    own[[LASTED, VAIN, ON]] *= 1 - 1 / MEMORY
    if not lasted:
        own[[VAIN, ON]] += 1.0, length - 1
        return
    own[LASTED] += 1
    far, reach = abs(float(own[JUMP])), float(own[REACH])
    own[REACH] = reach * math.exp(math.log(far / reach) / min(own[LASTED], FEW)) if reach > 0 else far


def _end_run(own: np.ndarray, unit: float) -> None:
    """Let a run end with a reading that does not go on with it."""
    if own[RUN] > 0 and _as_jumps(own, abs(float(own[REST])), unit):
        _note_outcome(own, False, own[RUN])
    own[RUN] = 0.0


def _grow_old(own: np.ndarray, unit: float, ordinary: bool) -> None:
    """Let a jump that was believed grow older: one that nothing has undone has lasted."""
    own[AGE] += own[AGE] > 0
    if own[AGE] > FEW and ordinary:
        own[AGE] = 0.0
        if abs(own[JUMP]) > SUDDEN * unit:
            _note_outcome(own, True, 0)


def _holds(own: np.ndarray, z: float, size: float, coarse: float) -> bool:
    """Tell whether a reading says nothing new: a far one that repeats the one before, or goes on doing so."""
    # Of a sensor of which most readings repeat some count.
    counts, before, unit = max(2 * own[REPEATS] - 1, 0.0), own[HELD], max(own[SPREAD], coarse)
    far = 0 < BEND * unit < size
    if not (own[STEP] != 0 and z == own[LAST] and (far or before > 0)):
        # One that is near those that were held bears them out.
        own[RUN] += before if own[RUN] > 0 else 0
        own[HELD] = 0.0
        return False
    own[HELD] = before + 1
    own[FILLED] += size > FAR * unit
    return int(own[HELD] * counts + 0.5) == int(before * counts + 0.5)


def _note_reading(own: np.ndarray, z: float, ordinary: bool) -> None:
    """Learn how usual it is that an ordinary reading repeats the one before, and by what steps readings change."""
    change, step = abs(z - own[LAST]), float(own[STEP])
    if step == 0:
        own[STEP] = -1.0
    elif change > 0 and ordinary:
        own[STEP] = min(change, step) if step > 0 else change
    if ordinary:
        own[REPEATS] += ((step != 0 and change == 0) - own[REPEATS]) * _step(own)
    own[LAST] = z


def _step(own: np.ndarray) -> float:
    """Return how much one more innovation weighs in a share."""
    return max(1 / (float(own[WEIGHT]) + FEW), 1 / MEMORY)


def settled(memory: np.ndarray) -> np.ndarray:
    """Return the spread of each sensor as a threshold's unit, 1 where there is none yet."""
    learned = memory[:, WEIGHT] > 0
    return np.where(learned, memory[:, SPREAD] * minimax(memory) / BEND, 1.0)


def _seen_by(B: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return the part of sensor i's prediction error that sensor j sees too, squared correlations (m, m)."""
    b = np.where(here, np.diag(B), 0.0)
    scale = np.outer(b, b)
    seen = np.where((scale > 0) & (np.minimum.outer(b, b) > 0), B**2 / np.where(scale > 0, scale, 1.0), 0.0)
    if not np.isfinite(scale).all():
        root = np.sqrt(np.maximum(b, np.finfo(float).tiny))
        seen = np.where(np.isfinite(scale), seen, (B / np.outer(root, root)) ** 2)
    np.fill_diagonal(seen, here)
    return seen


def _added_noise(y: np.ndarray, s: np.ndarray, nominal: np.ndarray, B: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Return what each sensor is noisier than those that see the same: that can only be its own noise."""
    seen = _seen_by(B, here)
    added, b = np.zeros(len(y)), np.diag(B)
    for i in np.flatnonzero(here & (b > 0)):
        w = seen[i]
        total = w.sum()
        # The spread that the better half of the witnesses has: a witness sees nine tenths of the same (.47/.53).
        others = np.flatnonzero(w > 0)
        usual = min(s[j] for j in others if w[others][s[others] <= s[j]].sum() > WITNESS * total * (1 + 1e-9))
        # What they say that y_i should be: the weighted median nearest to the prediction.
        says = np.array([y[i] if j == i else y[j] * B[i, j] / b[j] for j in others])
        low = min(v for v in says if w[others][says <= v].sum() >= total * (0.5 - 1e-9))
        high = max(v for v in says if w[others][says >= v].sum() >= total * (0.5 - 1e-9))
        odd = abs(y[i] - min(max(0.0, low), high)) / nominal[i]
        own = max(s[i] / APART, min(odd, 1e100) / FAR)
        added[i] = nominal[i] ** 2 * max((own / usual) ** 2 - 1, 0.0)
    return added


def _goes_on(own: np.ndarray, y: float, near: float) -> bool:
    """Tell whether a clipped innovation goes on with a run: of its sign, where the one before left x, or further."""
    rest = float(own[REST])
    steep = abs(rest) <= abs(y) < STEEP * abs(rest)
    return bool(own[RUN] > 0 and y * np.sign(rest) > 0 and (abs(y - rest) < near or steep))


def moved(c: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return which states have jumped, given their covariances c with a prediction and their variances p."""
    share = np.where(p > 0, c**2 / np.where(p > 0, p, 1.0), 0.0)
    return np.asarray((share > SPARED * share.max()) & (p > 0))
