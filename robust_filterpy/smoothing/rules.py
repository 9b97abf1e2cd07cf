"""What a robust smoother makes of the residuals of one sweep for the next: weights of a psi, or learnt noise.

A measurement rule returns the precision d and offset o of each whitened component, a process rule the scale q of each
step's noise. Rules keep what they found: ``weights``, and ``mixture`` if noise is learnt.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.smoothing.linear_pass import Model, Smooth, Weighting
from robust_filterpy.smoothing.mixture import (
    Belief,
    Mixture,
    Verdict,
    judge_components,
    judge_measurements,
    judge_steps,
)

# Least weight of a step of the process, the inverse of the largest scale of its noise.
_LEAST = 1e-12


class Ordinary:
    """Noise that is what the model says."""

    tolerance = np.inf
    mixture: Mixture | None = None

    def __init__(self, counted: Array) -> None:
        """Keep which components there are, (series, steps, kinds)."""
        self.weights = np.where(counted, 1.0, np.nan)

    def measurement(
        self, model: Model, smooth: Smooth, weighting: Weighting, temperature: Array, frozen: Array
    ) -> tuple[Array, Array]:
        """Return d and o as they are."""
        return weighting.precision, weighting.offset

    def process(self, smooth: Smooth, weighting: Weighting, frozen: Array) -> Array:
        """Return q as it is."""
        return weighting.process_scale


class Psi:
    """Weights psi(e)/e of the residuals: iteratively reweighted least squares."""

    mixture: Mixture | None = None
    #: Largest root-mean-square change of the estimate in a sweep, in its standard deviations: a stationary point.
    tolerance = 1e-3

    def __init__(self, influence: Any, joint: bool, counted: Array) -> None:
        """Keep psi, whether it looks at lengths, and which components there are."""
        self.influence, self.joint, self.counted = influence, joint, counted
        self.weights = np.where(counted, 1.0, np.nan)

    def measurement(
        self, model: Model, smooth: Smooth, weighting: Weighting, temperature: Array, frozen: Array
    ) -> tuple[Array, Array]:
        """Return the weights and no offset."""
        weights = self._of((model.z - smooth.fitted) / np.sqrt(temperature))
        return np.where(self.counted, weights, 0.0), np.zeros_like(weights)

    def process(self, smooth: Smooth, weighting: Weighting, frozen: Array) -> Array:
        """Return the scale 1/w of each step's noise w ~ N(0, I/w)."""
        weights = self._of(weighting.process_scale[..., None] * smooth.score)
        return 1.0 / np.maximum(weights.max(axis=-1), _LEAST)

    def _of(self, e: Array) -> Array:
        """Return the weight of every component, and keep those that there are."""
        weights = psi_weights(self.influence, np.where(self.counted, e, 0.0), self.joint)
        self.weights = np.where(self.counted, weights, np.nan)
        return weights


class Learnt:
    """Weights from noise whose contamination and scale ratio are learnt along the way."""

    tolerance = 2e-2

    def __init__(self, joint: bool, counted: np.ndarray) -> None:
        """Start from what is usual; who knows better sets belief and mixture."""
        series, _, kinds = counted.shape
        self.joint, self.counted, self.belief = joint, counted, Belief()
        self.mixture = Mixture.guess(series, 1 if joint else kinds)
        self._verdict: Verdict | None = None
        self._each = (counted.any(axis=-1, keepdims=True) if joint else counted).astype(float)

    def measurement(
        self, model: Model, smooth: Smooth, weighting: Weighting, temperature: Array, frozen: Array
    ) -> tuple[Array, Array]:
        """Return the factors that fit, and learn."""
        if self.joint:
            e, d = model.z - smooth.fitted, weighting.precision
            verdict = judge_measurements(e, smooth.spread, d, self.mixture, self.counted, temperature)
            d, o = verdict.mean_precision(self.mixture) * self.counted, np.zeros_like(d)
        else:
            verdict, d, o = judge_components(smooth, model.z, weighting, self.mixture, self.counted, temperature)
        self._learn(verdict, frozen)
        return d, o

    def process(self, smooth: Smooth, weighting: Weighting, frozen: Array) -> Array:
        """Return the scales that fit, and learn."""
        now = weighting.process_scale[..., None]
        verdict = judge_steps(smooth.score, smooth.information, now, self.mixture, self.counted)
        self._learn(verdict, frozen)
        return verdict.mean_variance(self.mixture)[..., 0]

    def _learn(self, verdict: Verdict, frozen: Array) -> None:
        """Fit the mixture of the series that are not finished."""
        self._verdict = verdict
        new = self.mixture.towards(self.belief.joined(verdict, self._each).mixture)
        self.mixture = Mixture(*(np.where(frozen[:, None], a, b) for a, b in zip(self.mixture, new, strict=True)))

    @property
    def weights(self) -> Array:
        """Mean precision of each noise, NaN where there is none."""
        found = 1.0 if self._verdict is None else self._verdict.mean_precision(self.mixture)
        return np.where(self.counted, found, np.nan)

    def remembered(self, memory: float) -> Belief:
        """Return the belief after the first step has gone, older ones forgotten by a factor."""
        first = Verdict(*(a[:, :1] for a in self._verdict or ()))
        kept = (start + memory * (now - start) for start, now in zip(Belief(), self.belief, strict=True))
        return Belief(*kept).joined(first, self._each[:, :1])


def psi_weights(influence: Any, e: Array, joint: bool) -> Array:
    """Return psi(e)/e of each component, or of the length over the last axis, shape of e, checked."""
    at = np.linalg.norm(e, axis=-1, keepdims=True) if joint else e
    found = np.asarray(influence.weights(at), dtype=float)
    if found.shape != at.shape or not np.isfinite(found).all():
        raise ValueError(
            f"influence: expected weights(e) finite and of the shape of e, got shape {found.shape} for {at.shape}, "
            f"{np.count_nonzero(~np.isfinite(found))} of them not finite; check {influence!r}"
        )
    return np.broadcast_to(np.clip(found, 0.0, None), e.shape)


def checked_influence(name: str, influence: Any) -> Any:
    """Return an influence function or raise TypeError naming the argument."""
    try:
        return Choices(influence).influence
    except TypeError as error:
        raise TypeError(str(error).replace("influence:", f"{name}:", 1)) from None
