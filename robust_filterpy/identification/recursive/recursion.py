"""The recursion of one actuator, one sample after the other: the definition that the kernel is held to.

One sample: predict theta, predict y from phi, leave out a sensor that is stuck, look again at outputs that were
replaced, correct theta along the gradient, restrain an unstable step, follow R, remember.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.special import erfc, gammainc

from robust_filterpy._checks import Array
from robust_filterpy.correction import repeats
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.identification.models.regressor import (
    CLEANED_FROM,
    Memory,
    are_stable,
    bounded,
    gradient,
    pushed,
    restrained,
)
from robust_filterpy.identification.models.results import Sample
from robust_filterpy.identification.recursive import setup
from robust_filterpy.identification.recursive.state import Form, State

#: What the gain is computed from.
Gradient: TypeAlias = Literal["pseudolinear", "filtered"]
GRADIENTS: Final[tuple[Gradient, ...]] = ("pseudolinear", "filtered")
#: Which outputs an ARX or ARMAX has in its regressor.
Regressor: TypeAlias = Literal["measured", "cleaned"]
REGRESSORS: Final[tuple[Regressor, ...]] = ("measured", "cleaned")

# The sharpness of a sample is phi'phi tr(P)/R, about by how much it may shrink P in its direction.
# The rounding of one correction is about 1e-16 P times the sharpness; from here on it is mended.
SHARP: Final = 1e6

# Beyond this, rounding of a P that is right would exceed R in H P H' + R.
_SHARPEST: Final = 1e13

# Standard deviations from which on an innovation is as large as any.
_REACH: Final = 2.0
# The first samples count as if there had been none before, so that R may be wrong by many powers of ten.
_FIRST: Final = 5.0
#: Up to so many samples P grows with R: what was learned with an R far too small is less certain by as much.
EARLY: Final = 20.0
# min(e^2, 4) moves with R two thirds as much as e^2 does.
_PACE: Final = 1.5


class NoiseScale(NamedTuple):
    """What following R takes besides R itself."""

    #: How many samples R stands on.
    samples: float
    #: Mean of min(e^2, 4) where R is right.
    mean: float
    #: Number of samples that R is to remember; 0: R stays as it is.
    memory: float
    #: Steps of the sensor, or what arithmetic loses, in the unit of y; 0: unknown. R is what they make at least.
    rounding: float


class Recursion:
    """One of the actuators of a form on its way: a filter with theta as its state, what it remembers, how R moves."""

    def __init__(self, form: Form, i: int, kf: Any, now: State, row: int, enabled: bool) -> None:
        """Go on from a row of a state, which is that of actuator i."""
        self.filter, self.layout, self.cleans, self.enabled = kf, form.layout, form.cleans, enabled
        self.judges, self.readings = form.judges, now.readings[row].copy()
        self.guard, self.filtered = str(form.guard[i]), form.gradient[i] == "filtered" and form.layout.is_filtered
        self.memory, self.windup = Memory(*(a[row] for a in now.past)), float(now.windup[row])
        self.scale = NoiseScale(*now.scale[row, 1:].tolist())

    def step(self, y: float, u: Array, R: float | None) -> Sample:
        """Take a sample, y from the center and u with the constant."""
        kf, layout, memory = self.filter, self.layout, self.memory
        inputs = memory.with_input(layout, u)
        H, outputs = memory.regressor(layout, inputs)[None], memory.outputs
        seen, gradients, prefiltered, old = y == y, memory.gradients, memory.prefiltered, np.ravel(kf.x)
        weight, event, outlying = math.nan, 0, False
        # Once P has wound up under forgetting theta and P stay.
        if self.enabled and (kf.alpha == 1.0 or np.trace(kf.P) <= self.windup):
            kf.predict()
        x = kf.x
        shown = predicted = H.dot(x).item()
        r = setup.noise_variance(kf) if R is None else R
        stuck = seen and self.judges and self._is_stuck(y, predicted, H, r)
        # What is stuck counts as missing.
        seen = seen and not stuck
        if self.cleans and seen and not np.array_equal(outputs, memory.measured):
            other = H.copy()
            other[0, layout.outputs] = memory.measured
            explained = other.dot(x).item()
            if is_far(y - predicted, H, kf.P, r) and abs(y - explained) < abs(y - predicted):
                # Wild outputs explain no other wild one by being about as far out. Outputs that were replaced by what
                # a wrong theta predicted run away, and those as measured are the smaller ones.
                smaller = variance(other, kf.P, r) <= variance(H, kf.P, r)
                if smaller or not is_far(y - explained, other, kf.P, r):
                    H, outputs, predicted = other, memory.measured, explained
        G = H
        if self.filtered:
            past, newest = np.ravel(x), H[0] * layout.precedes_noise
            if self.guard != "none" or are_stable(past, layout.stable):
                psi, newest = gradient(layout, H[0], past, memory)
                G = psi[None, :]
            gradients, prefiltered = pushed(gradients, G[0]), pushed(prefiltered, newest)
        if self.enabled and seen:
            S = variance(G, kf.P, r)
            outlying = abs(y - predicted) > CLEANED_FROM * math.sqrt(S)
            weight = _corrected(kf, G, y, predicted, R, r, self.filtered)
            # What vanishes next to R brings no information, as while input and output rest, and says nothing of noise.
            if R is None and self.scale.memory and S + (y - predicted) * (y - predicted) != r:
                self.scale = _followed(kf, self.scale, r, y - predicted, S)
        if self.enabled and layout.stable:
            moved, event = restrained(np.ravel(kf.x), old, layout.stable, self.guard)
            if event:
                kf.x = moved.reshape(np.shape(kf.x))
        if stuck:
            self.readings[repeats.WIDTH] += 1.0
        elif seen and self.judges:
            note(self.readings, y, y - predicted)
        theta, phi = np.ravel(kf.x), H[0]
        believed = bounded(predicted) if not seen or (self.cleans and outlying) else y
        before = bounded(phi[layout.before_noise].dot(theta[layout.before_noise]).item())
        alone = bounded(phi[layout.through].dot(theta[layout.through]).item()) if layout.nf else 0.0
        self.memory = Memory(
            outputs=layout.remembered(outputs, believed, before),
            measured=layout.remembered(memory.measured, y if seen else bounded(predicted), before),
            inputs=inputs,
            residuals=pushed(memory.residuals, bounded(believed - phi.dot(theta).item()) if seen else 0.0),
            undisturbed=pushed(memory.undisturbed, -alone),
            prefiltered=prefiltered,
            gradients=gradients,
        )
        return Sample(shown, y - shown if seen else math.nan, weight, event)

    def _is_stuck(self, y: float, predicted: float, H: Array, r: float) -> bool:
        """Tell whether the sensor repeats itself far from what was predicted, or has done so since."""
        if not repeats.again(self.readings[: repeats.WIDTH], np.array(y), np.array(r)):
            return False
        return self.readings[repeats.WIDTH] > 0.0 or is_far(y - predicted, H, self.filter.P, r)


def _corrected(kf: Any, G: Array, y: float, predicted: float, R: float | None, r: float, filtered: bool) -> float:
    """Correct theta along the gradient and return the weight of the sample."""
    square, trace = G[0].dot(G[0]), np.trace(kf.P)
    factor, target = tempering(square, trace, r), y
    if filtered or factor < 1.0:
        G = G * factor
        # So that the filter's own innovation, target - G x, is y - phi' theta.
        target = (y - predicted) * factor + G.dot(kf.x).item()
    kf.H = G
    kf.update(target, R=R)
    if square * trace > SHARP * r:
        P = kf.P
        mended = repaired(P)
        if mended is not P:
            kf.P = mended
    return float(np.ravel(kf.weights)[0])


def _followed(kf: Any, scale: NoiseScale, R: float, nu: float, S: float) -> NoiseScale:
    """Let the filter's R follow the size of the innovations."""
    estimate, samples = followed(R, scale, nu, S)
    kf.R = np.array([[estimate]])
    if scale.samples < EARLY and estimate > R:
        kf.P = kf.P * (estimate / R)
    return scale._replace(samples=samples)


def note(readings: Array, y: float, nu: float) -> None:
    """Note in place a reading that was not left out and what was not foreseen of it."""
    row = readings[: repeats.WIDTH]
    if readings[repeats.WIDTH]:
        # While a sensor was stuck it has shown nothing of its habits.
        row[-1], readings[repeats.WIDTH] = abs(row[-1]), 0.0
    repeats.note_reading(row, y)
    repeats.note_change(row, nu)
    row[0] = nu


def is_far(nu: float, phi: Array, P: Array, r: float) -> bool:
    """Tell whether an innovation is one that a cleaned regressor replaces."""
    return abs(nu) > CLEANED_FROM * math.sqrt(variance(phi, P, r))


def variance(phi: Array, P: Array, r: float) -> float:
    """Return the variance of an innovation, phi' P phi + r, for a row phi."""
    # Rounding of a P that a spike in phi has made singular may have a sign.
    return max(float(phi.dot(P).dot(phi.T).item()), 0.0) + r


# The variance R of the ordinary noise, followed sample by sample through outliers. What is followed is a scale of the
# standardized innovation e = nu/sqrt(S): the mean of min(e^2, 4), which no outlier moves by more than 4 (Huber's
# proposal 2), against what it would be if R were right. The learned share and size of the outliers belong to what it
# would be, so that R stays the variance of the ordinary samples.


def followed(R: float, scale: NoiseScale, nu: float, S: float) -> tuple[float, float]:
    """Return R after one more innovation, and how many samples it stands on."""
    # A sample whose regressor overflows tells nothing of R.
    if not S < 1e290:
        return R, scale.samples
    share = R / S
    gain = share * max(_PACE / scale.memory, min(1.0, _FIRST / (scale.samples + 1.0)))
    surprise = min(nu * nu / S, _REACH * _REACH) / scale.mean - 1.0
    # A plant at rest shows no noise in steps of its sensor, one that moves does.
    least = max(scale.rounding * scale.rounding / 12.0, 1e-290)
    return max(R * math.exp(gain * surprise), least), scale.samples + share


def ordinary_mean(influence: Any) -> float:
    """Return the mean of min(e^2, 4) for normal noise, or for a learned mixture."""
    if not isinstance(influence, Contaminated):
        return _mean(1.0)
    c = influence.contamination
    return (1.0 - c) * _mean(1.0) + c * _mean(influence.scale_ratio)


def _mean(scale: float) -> float:
    """Return the mean of min(s^2, 4) of a normal s with this standard deviation."""
    a = _REACH / scale
    # s^2 below a^2 has three degrees of freedom; as a difference it would be lost in a wide mixture.
    return scale * scale * float(gammainc(1.5, 0.5 * a * a)) + _REACH * _REACH * float(erfc(a / math.sqrt(2.0)))


# Where a sample is highly informative, as after a spike in a signal that stands in phi.


def tempering(square: float, trace: float, r: float) -> float:
    """Return the factor, at most 1, by which to shrink a sample whose regressor has phi'phi = square."""
    if square * trace <= _SHARPEST * r:
        return 1.0
    return math.sqrt(_SHARPEST / square) * math.sqrt(r / trace)


def repaired(P: Array) -> Array:
    """Return P, or if it has lost its symmetry or its sign the nearest covariance."""
    symmetric = 0.5 * (P + P.T)
    values, vectors = np.linalg.eigh(symmetric)
    floor = np.finfo(float).eps * values[-1]
    if values[0] >= -floor:
        return P if np.array_equal(P, symmetric) else symmetric
    return np.asarray((vectors * np.maximum(values, floor)).dot(vectors.T))
