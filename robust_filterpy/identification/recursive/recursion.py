"""The recursion of one actuator, one sample after the other: the definition that the kernel is held to.

One sample: predict theta, predict y from phi, leave out a sensor that is stuck, look again at outputs that were
replaced, correct theta along the gradient, restrain an unstable step, follow R, remember.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import repeats
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
from robust_filterpy.identification.recursive.conditioning import SHARP, repaired, tempering
from robust_filterpy.identification.recursive.noise_scale import EARLY, NoiseScale, followed
from robust_filterpy.identification.recursive.state import Form, State

#: What the gain is computed from.
Gradient: TypeAlias = Literal["pseudolinear", "filtered"]
GRADIENTS: Final[tuple[Gradient, ...]] = ("pseudolinear", "filtered")
#: Which outputs an ARX or ARMAX has in its regressor.
Regressor: TypeAlias = Literal["measured", "cleaned"]
REGRESSORS: Final[tuple[Regressor, ...]] = ("measured", "cleaned")


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
        """Take a sample, y from the centre and u with the constant."""
        kf, layout, memory = self.filter, self.layout, self.memory
        inputs = memory.with_input(layout, u)
        H, outputs = memory.regressor(layout, inputs)[None], memory.outputs
        known, gradients, prefiltered, old = y == y, memory.gradients, memory.prefiltered, np.ravel(kf.x)
        weight, event, outlying = math.nan, 0, False
        # Once P has wound up under forgetting theta and P stay.
        if self.enabled and (kf.alpha == 1.0 or np.trace(kf.P) <= self.windup):
            kf.predict()
        x = kf.x
        shown = predicted = H.dot(x).item()
        r = setup.noise_variance(kf) if R is None else R
        stuck = known and self.judges and self._is_stuck(y, predicted, H, r)
        # What is stuck counts as missing.
        known = known and not stuck
        if self.cleans and known and not np.array_equal(outputs, memory.measured):
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
        if self.enabled and known:
            S = variance(G, kf.P, r)
            outlying = abs(y - predicted) > CLEANED_FROM * math.sqrt(S)
            weight = _corrected(kf, G, y, predicted, R, r, self.filtered)
            if R is None and self.scale.memory:
                self.scale = _followed(kf, self.scale, r, y - predicted, S)
        if self.enabled and layout.stable:
            moved, event = restrained(np.ravel(kf.x), old, layout.stable, self.guard)
            if event:
                kf.x = moved.reshape(np.shape(kf.x))
        if stuck:
            self.readings[repeats.WIDTH] += 1.0
        elif known and self.judges:
            note(self.readings, y, y - predicted)
        theta, phi = np.ravel(kf.x), H[0]
        believed = bounded(predicted) if not known or (self.cleans and outlying) else y
        before = bounded(phi[layout.before_noise].dot(theta[layout.before_noise]).item())
        alone = bounded(phi[layout.through].dot(theta[layout.through]).item()) if layout.nf else 0.0
        self.memory = Memory(
            outputs=layout.remembered(outputs, believed, before),
            measured=layout.remembered(memory.measured, y if known else bounded(predicted), before),
            inputs=inputs,
            residuals=pushed(memory.residuals, bounded(believed - phi.dot(theta).item()) if known else 0.0),
            undisturbed=pushed(memory.undisturbed, -alone),
            prefiltered=prefiltered,
            gradients=gradients,
        )
        return Sample(shown, y - shown if known else math.nan, weight, event)

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
    found, samples = followed(R, scale, nu, S)
    kf.R = np.array([[found]])
    if scale.samples < EARLY and found > R:
        kf.P = kf.P * (found / R)
    return scale._replace(samples=samples)


def note(readings: Array, y: float, nu: float) -> None:
    """Note in place a reading that was not left out and what was not foreseen of it."""
    row = readings[: repeats.WIDTH]
    if readings[repeats.WIDTH]:
        # While a sensor was stuck it has told nothing of its habits.
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
