"""The recursion of `ParameterTracker`, one sample after the other: the definition that the kernel is held to.

One sample: predict theta, predict y from phi, look again at outputs that were replaced, correct theta along the
gradient, restrain an unstable step, follow R, remember.
"""

from __future__ import annotations

import copy
import math
from itertools import repeat
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy._checks import Array
from robust_filterpy.filters._mixin import RobustFilterMixin, Snapshot
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification.models.guard import Guard, are_stable, restrained
from robust_filterpy.identification.models.regressor import CLEANED_FROM, Layout, Memory, bounded, gradient, pushed
from robust_filterpy.identification.models.results import Columns, Sample
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import setup, track
from robust_filterpy.identification.recursive.conditioning import SHARP, repaired, tempering
from robust_filterpy.identification.recursive.noise_scale import EARLY, NoiseScale, followed

#: What the gain is computed from.
Gradient: TypeAlias = Literal["pseudolinear", "filtered"]
GRADIENTS: Final[tuple[Gradient, ...]] = ("pseudolinear", "filtered")
#: Which outputs an ARX or ARMAX has in its regressor.
Regressor: TypeAlias = Literal["measured", "cleaned"]
REGRESSORS: Final[tuple[Regressor, ...]] = ("measured", "cleaned")

# What a sample moves in a filter, besides what only shows its last correction.
_MOVING: Final = ("x", "P", "H", "R", "x_prior", "P_prior")

# So many samples at most go to the definition before the kernel has another try.
_MOST_ODD: Final = 1024


class Recursion:
    """What a tracker does with a sample; the arguments are checked, the outputs as measured."""

    structure: Structure
    filter: Any
    enabled: bool
    _gradient: Gradient
    _guard: Guard
    #: Whether the regressor holds cleaned outputs.
    _cleans: bool
    #: Whether it holds a constant, after the inputs.
    _has_offset: bool
    #: What is taken off the output, so that the constant is small.
    _centre: float
    _scale: NoiseScale
    _windup: float
    _layout: Layout
    _memory: Memory

    @property
    def _drifts(self) -> bool:
        """Whether the next sample begins with a step of theta: not once P has wound up under forgetting."""
        kf = self.filter
        return bool(getattr(kf, "alpha", 1.0) == 1.0 or np.trace(kf.P) <= self._windup)

    def _with_constant(self, u: Array) -> Array:
        """Return the input of a sample (n_inputs,) or a recording (N, n_inputs), with a constant if phi has one."""
        if not self._has_offset:
            return u
        return np.append(u, 1.0) if u.ndim == 1 else np.column_stack((u, np.ones(len(u))))

    def _held(self) -> tuple[Any, ...]:
        """Return what a sample changes: arrays are replaced, never written into."""
        moving = {name: getattr(self.filter, name) for name in _MOVING if hasattr(self.filter, name)}
        memory = {name: getattr(self._memory, name) for name in self._memory.__slots__}
        return moving, memory, self._scale, _kept_of(self.filter)

    def _put_back(self, held: tuple[Any, ...]) -> None:
        """Undo what was refused, or interrupted."""
        for place, values in zip((self.filter, self._memory), held[:2], strict=True):
            for name, value in values.items():
                setattr(place, name, value)
        self._scale = held[2]
        if held[3] is not None:
            held[3].put_back(self.filter)

    def _stepped(self, y: float, u: Array, R: float | None) -> Sample:
        """Advance by one checked sample; the caller undoes what is refused or interrupted."""
        y, u = y - self._centre, self._with_constant(u)
        kf, layout, memory = self.filter, self._layout, self._memory
        inputs = memory.with_input(layout, u)
        H, outputs = memory.regressor(layout, inputs), memory.outputs
        known, gradients, prefiltered, old = y == y, memory.gradients, memory.prefiltered, np.ravel(kf.x)
        weight, event, outlying = math.nan, 0, False
        filtered = self._gradient == "filtered" and layout.is_filtered
        if self.enabled and self._drifts:
            kf.predict()
        x = kf.x
        shown = predicted = H.dot(x).item()
        r = setup.noise_variance(kf) if R is None else R
        if self._cleans and known and not np.array_equal(outputs, memory.measured):
            other = H.copy()
            other[0, layout.outputs] = memory.measured
            S, explained = variance(H, kf.P, r), other.dot(x).item()
            if abs(y - predicted) > CLEANED_FROM * math.sqrt(S) and abs(y - explained) < abs(y - predicted):
                H, outputs, predicted = other, memory.measured, explained
        G = H
        if filtered:
            past, newest = np.ravel(x), H[0] * layout.precedes_noise
            if self._guard != "none" or are_stable(past, layout.stable):
                psi, newest = gradient(layout, H[0], past, memory)
                G = psi[None, :]
            gradients, prefiltered = pushed(gradients, G[0]), pushed(prefiltered, newest)
        if self.enabled and known:
            S = variance(G, kf.P, r)
            outlying = abs(y - predicted) > CLEANED_FROM * math.sqrt(S)
            weight = self._corrected(G, y, predicted, R, r, filtered)
            if R is None and self._scale.memory:
                self._follow(r, y - predicted, S)
        if self.enabled and layout.stable:
            moved, event = restrained(np.ravel(kf.x), old, layout.stable, self._guard)
            if event:
                kf.x = moved.reshape(np.shape(kf.x))
        after = H.dot(kf.x).item()
        believed = bounded(predicted) if not known or (self._cleans and outlying) else y
        if layout.nf:
            alone = bounded(H[0, layout.through].dot(np.ravel(kf.x)[layout.through]).item())
            memory.undisturbed = pushed(memory.undisturbed, -alone)
        before = bounded(H[0, layout.before_noise].dot(np.ravel(kf.x)[layout.before_noise]).item())
        memory.outputs = layout.remembered(outputs, believed, before)
        memory.measured = layout.remembered(memory.measured, y if known else bounded(predicted), before)
        memory.residuals = pushed(memory.residuals, bounded(believed - after) if known else 0.0)
        memory.inputs, memory.gradients, memory.prefiltered = inputs, gradients, prefiltered
        return Sample(shown + self._centre, y - shown, weight, event)

    def _corrected(self, G: Array, y: float, predicted: float, R: float | None, r: float, filtered: bool) -> float:
        """Correct theta along the gradient and return the weight of the sample."""
        kf = self.filter
        square, trace = G[0].dot(G[0]), np.trace(kf.P)
        factor, target = tempering(square, trace, r), y
        if filtered or factor < 1.0:
            G = G * factor
            # So that the filter's own innovation, target - G x, is y - phi' theta.
            target = (y - predicted) * factor + G.dot(kf.x).item()
        kf.H = G
        if R is None:
            kf.update(target)
        else:
            kf.update(target, R=R)
        if square * trace > SHARP * r:
            P = kf.P
            mended = repaired(P)
            if mended is not P:
                kf.P = mended
        return float(np.ravel(getattr(kf, "weights", 1.0))[0])

    def _follow(self, R: float, nu: float, S: float) -> None:
        """Let R follow the size of the innovations."""
        scale = self._scale
        found, samples = followed(R, scale.samples, scale.mean, scale.memory, nu, S)
        self.filter.R = np.array([[found]])
        if scale.samples < EARLY and found > R:
            self.filter.P = self.filter.P * (found / R)
        self._scale = scale._replace(samples=samples)

    def _run_stepwise(self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int) -> None:
        """Advance through samples start to stop - 1 of a recording with any filter, one by one."""
        k = start
        variances = repeat(None) if R is None else R[start:stop].tolist()
        try:
            for k, output, r in zip(range(start, stop), y[start:stop].tolist(), variances, strict=False):
                out.prediction[k], out.residual[k], out.weights[k], out.guard[k] = self._stepped(output, u[k], r)
                out.theta[k], out.variance[k] = np.ravel(self.filter.x), np.diagonal(self.filter.P)
        except (ValueError, TypeError, np.linalg.LinAlgError) as error:
            error.args = (f"sample {k}: {error}", *error.args[1:])
            raise

    @property
    def _is_plain(self) -> bool:
        """Whether the filter is our own as it comes, for which there are faster ways to the numbers of `update`."""
        kf, n = self.filter, self._layout.n
        return bool(
            self.enabled
            and type(kf) is RobustKalmanFilter
            # Not one whose methods somebody has wrapped.
            and not {"predict", "update"} & vars(kf).keys()
            and kf._choices.pointwise is not None
            and kf._inverse is None
            and setup.is_array(kf.F, (n, n))
            and setup.is_array(kf.Q, (n, n))
            and setup.is_array(kf.R, (1, 1))
            and setup.is_array(kf.P, (n, n))
            and (setup.is_array(kf.x, (n,)) or setup.is_array(kf.x, (n, 1)))
            and np.isfinite(kf.x).all()
            and np.isfinite(kf.P).all()
            and 0.0 < kf.R.item() < math.inf
            and np.isfinite(kf.F).all()
            and np.isfinite(kf.Q).all()
            and all(np.abs(a - a.T).max() <= 1e-13 * np.abs(a).max() for a in (kf.P, kf.Q))
        )

    def _run_through(self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int) -> None:
        """Advance through samples start to stop - 1: by the kernel where it serves, otherwise by the definition.

        The last sample and the last measured one are the definition's: they leave the attributes that the filter shows.
        """
        if not (self._is_plain and track.serves((self.filter._choices,))):
            self._run_stepwise(y, u, R, out, start, stop)
            return
        measured = start + np.flatnonzero(y[start:stop] == y[start:stop])
        for last in sorted({*measured[-1:].tolist(), stop - 1}):
            if last > start:
                self._run_kernel(y, u, R, out, start, last)
            self._run_stepwise(y, u, R, out, last, last + 1)
            start = last + 1

    def _run_kernel(
        self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int, most_odd: int = _MOST_ODD
    ) -> None:
        """Advance from sample start to stop - 1 by the kernel, and by the definition where the kernel declines."""
        kf, k, odd, memory = self.filter, start, 1, self._memory
        recursion = track.Recursion(
            (kf._choices,), self._cleans, [self._gradient == "filtered"], [self._guard], [True], kf.F[None], kf.Q[None],
            np.array([kf._alpha_sq]), np.array([self._windup]), np.array([self._centre]),
        )  # fmt: skip
        while k < stop:
            x, P = np.array(kf.x).reshape(1, -1), np.array(kf.P, order="C")[None]
            past = track.Memories(*(getattr(memory, name)[None].copy() for name in track.Memories._fields))
            scale = np.array([[kf.R.item(), *self._scale]])
            here = Columns(*(column[None, k:stop] for column in out))
            signals = y[None, k:stop], u[None, k:stop], None if R is None else R[None, k:stop]
            done = int(track.advance(self._layout, recursion, *signals, x, P, past, scale, here)[0])
            kf.x, kf.P = x.reshape(np.shape(kf.x)), P[0]
            for name, value in past._asdict().items():
                setattr(memory, name, value[0])
            if R is None and self._scale.memory:
                kf.R, self._scale = scale[:, :1].copy(), self._scale._replace(samples=float(scale[0, 1]))
            k += done
            if k < stop:
                odd = 1 if done >= odd else min(2 * odd, most_odd)
                self._run_stepwise(y, u, R, out, k, min(k + odd, stop))
                k = min(k + odd, stop)


class _Contents:
    """Everything that a filter of the user's holds, to the depth of the filters that it may be made of."""

    def __init__(self, kf: Any) -> None:
        """Copy it; of a filter that cannot be copied, with a lock in it, the attributes alone."""
        attributes = getattr(kf, "__dict__", {})
        try:
            self._attributes = copy.deepcopy(attributes)
        except TypeError:
            self._attributes = dict(attributes)

    def put_back(self, kf: Any) -> None:
        """Put the filter back as it was."""
        vars(kf).update(self._attributes)


def _kept_of(kf: Any) -> _Contents | Snapshot | None:
    """Return what a sample moves in a filter besides _MOVING; None if that is nothing."""
    if type(kf) in (RobustKalmanFilter, KalmanFilter):
        return None
    return Snapshot(kf) if isinstance(kf, RobustFilterMixin) else _Contents(kf)


def variance(phi: Array, P: Array, r: float) -> float:
    """Return the variance of an innovation, phi' P phi + r, for a row phi."""
    # Rounding of a P that a spike in phi has made singular may have a sign.
    return max(float(phi.dot(P).dot(phi.T).item()), 0.0) + r
