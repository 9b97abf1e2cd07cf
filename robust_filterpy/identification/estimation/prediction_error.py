"""The least robust loss of a model's residuals, their color, and the covariance that both make of the parameters.

Levenberg and Marquardt's steps, the noise re-estimated at each: a weighted least-squares problem, by orthogonal
transformation; a step that leaves the stable region or raises the loss is shortened. scipy's `least_squares` needs the
scale of the noise beforehand, and thus a whole optimization for each scale.

Slow noise explains what a step, a ramp or another parameter would explain, and leaves parameters less sure. So whatever
is held against residuals is held against these with a color of their own, and standard deviations count it: that of an
autoregression, its order by evidence (Schwarz, Annals of Statistics 6, 1978).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import fftconvolve, lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import Noise, Noises
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.regressor import stabilised
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.regression import in_directions

# Denominators that are drawn where that of a start is not stable within the limits.
_DRAWS: Final = 3000


class Limits(NamedTuple):
    """Where each parameter may be.

    Attributes
    ----------
    lower, upper : ndarray, shape (n_theta,)
        Infinite where there is no limit; the same where a parameter is fixed.
    """

    lower: Array
    upper: Array

    @classmethod
    def of(cls, structure: Structure, fixed: Any, bounds: Any) -> Limits | None:
        """Return them from names, checked; None if nothing is given."""
        given = {"fixed": dict(_mapping("fixed", fixed)), "bounds": _mapping("bounds", bounds)}
        if structure.integrated:
            given["fixed"] = {"d1": -1.0, **given["fixed"]}
            if given["fixed"]["d1"] != -1.0:
                raise ValueError(f"fixed: expected no d1 for {structure}, which has it at -1, got {fixed!r}")
        lower, upper = np.full(structure.n_theta, -np.inf), np.full(structure.n_theta, np.inf)
        for argument, values in given.items():
            for name, value in values.items():
                place = _place(structure, argument, name)
                if argument == "fixed":
                    lower[place] = upper[place] = _checks.finite(f"fixed[{name!r}]", value, ())
                elif name in given["fixed"]:
                    raise ValueError(f"bounds: expected parameters that are not fixed, got {_checks.shown(name)}")
                else:
                    lower[place], upper[place] = _checks.interval(f"bounds[{name!r}]", value)
        if (lower == upper).all():
            raise ValueError(f"fixed: expected at least one parameter of {structure} that is free, got all of them")
        return cls(lower, upper) if np.isfinite([lower, upper]).any() else None

    @property
    def fixed(self) -> Any:
        """Which parameters are numbers, shape (n_theta,)."""
        return self.lower == self.upper

    def times(self, factor: Array) -> Limits:
        """Return them for parameters in other units."""
        return Limits(self.lower * factor, self.upper * factor)

    def inside(self, p: Array) -> Array:
        """Return free parameters, theta first, with theta moved to where it may be."""
        n = self.lower.size
        return np.concatenate((np.clip(p[:n], self.lower, self.upper), p[n:]))

    def start(self, model: PolynomialModel, p: Array) -> Array:
        """Return the stable parameters within the limits that are next to some, or of many drawn ones."""
        best, nearest, rng = self.inside(p), np.inf, np.random.default_rng(0)
        if model.is_stable(best):
            return best
        for _ in range(_DRAWS):
            trial = p.copy()
            for part in model.structure.stable_parts:
                trial[part] = _drawn(rng, part.stop - part.start)
            trial = self.inside(trial)
            if model.is_stable(trial) and np.linalg.norm(trial - p) < nearest:
                best, nearest = trial, float(np.linalg.norm(trial - p))
        if not np.isfinite(nearest):
            raise ValueError(
                f"fixed: expected limits that a stable model of {model.structure} keeps, got none in {_DRAWS} draws; "
                "free some of its denominator"
            )
        return best

    def held(self, p: Array, gradient: Array) -> Any:
        """Return which free parameters are fixed, or at a limit beyond which the loss would fall."""
        n = self.lower.size
        held = np.zeros(p.size, dtype=bool)
        at_lower, at_upper = p[:n] <= self.lower, p[:n] >= self.upper
        held[:n] = self.fixed | (at_lower & (gradient[:n] > 0.0)) | (at_upper & (gradient[:n] < 0.0))
        return held


def _drawn(rng: Any, order: int) -> Array:
    """Return the coefficients of a random stable polynomial, by Schur and Cohn's recursion upwards."""
    c = np.zeros(0)
    for k in rng.uniform(-1.0, 1.0, order):
        c = np.append(c + k * c[::-1], k)
    return c


def _mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return a dict of names, empty for None, or raise."""
    if value is not None and not isinstance(value, Mapping):
        raise TypeError(f"{name}: expected a dict of parameter names, got {_checks.shown(value)}")
    return value or {}


def _place(structure: Structure, argument: str, name: Any) -> int:
    """Return where a parameter stands in theta, or raise."""
    if name not in structure.names:
        mend = "; offset=False leaves the constant out" if name == "offset" else ""
        raise ValueError(f"{argument}: expected parameters among {', '.join(structure.names)}, got {name!r}{mend}")
    return structure.names.index(name)


# A step that would change the residuals by less than this share of them ends the search.
_PRECISION: Final = 1e-9
MOST_STEPS: Final = 100
_MOST_SHORTENINGS: Final = 12
# The order of a color, and the least number of samples for each.
_MOST: Final = 20
_SAMPLES_EACH: Final = 20
# A residual beyond so many standard deviations of the ordinary ones tells the autoregression no more.
_CLIP: Final = 3.0

_Noise: TypeAlias = Noise | Noises


class Optimum(NamedTuple):
    """Where the search ended.

    Attributes
    ----------
    p : ndarray, shape (n,)
        Free parameters.
    noise : Noise or Noises
        Noise of the residuals there.
    residual : ndarray, shape (N - first,)
        Residuals there.
    converged : bool
        Whether the steps became small, rather than many.
    """

    p: Array
    noise: Any
    residual: Array
    converged: bool


def minimised(
    model: Any, p: Array, noise: _Noise, rows: Array, most_steps: int = MOST_STEPS,
    limits: Limits | None = None, precision: float = 0.0,
) -> Optimum:  # fmt: skip
    """Minimise the loss of the residuals from p on."""
    residual, damping = model.residuals(p), 1e-3
    for _ in range(most_steps):
        noise = noise.refitted(residual[rows])
        root = np.sqrt(noise.weights(residual[rows]) / noise.variance)
        jacobian, target = model.jacobian(p)[rows] * root[:, None], root * residual[rows]
        cost = noise.cost(residual[rows])
        if limits is not None:
            jacobian[:, limits.held(p, jacobian.T @ target)] = 0.0
        size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
        size[size == 0.0] = 1.0
        triangle = np.asarray(np.linalg.qr(np.column_stack((jacobian / size, target)), mode="r"))
        if not np.isfinite(triangle).all():
            # A model far from stable has derivatives that overflow; the search from another start goes on.
            return Optimum(p, noise, residual, False)
        taken = None
        for _ in range(_MOST_SHORTENINGS):
            step, change = _step(triangle, damping)
            trial = p - step / size if limits is None else limits.inside(p - step / size)
            if model.is_stable(trial):
                new = model.residuals(trial)
                if np.isfinite(new).all() and noise.cost(new[rows]) < cost:
                    taken = trial, new
                    break
            damping = max(4.0 * damping, 1e-6)
        if taken is None:
            return Optimum(p, noise, residual, True)
        p, residual = taken
        damping = max(damping / 10.0, 1e-12)
        if change <= max(_PRECISION * np.linalg.norm(target), precision):
            return Optimum(p, noise.refitted(residual[rows]), residual, True)
    return Optimum(p, noise.refitted(residual[rows]), residual, False)


def _step(triangle: Array, damping: float) -> tuple[Array, float]:
    """Return the step for a damping, with columns of unit size, and the change of the residuals that it brings."""
    n = triangle.shape[1] - 1
    R, z = triangle[:n, :n], triangle[:n, n]
    damped = np.vstack((R, np.sqrt(damping) * np.eye(n)))
    step = np.linalg.lstsq(damped, np.concatenate((z, np.zeros(n))), rcond=None)[0]
    return step, float(np.linalg.norm(R @ step))


def sandwich(jacobian: Array, residual: Array, noise: _Noise, shared: int) -> tuple[Array, float]:
    """Return the covariance of the free parameters at an optimum."""
    # ``(N/(N - n)) R (J'J)^-1 J' C J (J'J)^-1 / mean(psi')^2`` with C the covariance of psi: diag(psi^2) where psi is
    # white (Huber, Robust Statistics, 1981, section 7.6), otherwise that of the autoregression that it shows. This
    # holds whatever the distribution of the residuals is. Rounding counts as white and as no less than R in each
    # sample. With a noise for each output, J and psi are weighted by mean(psi')/R of it, and each psi has a color;
    # directions that nothing depends on have no variance.
    psi, slope = noise.psi(residual), noise.slope(residual)
    weighted = jacobian * np.broadcast_to(np.sqrt(slope / noise.variance), residual.shape)[:, None]
    # Derivatives of theta by psi, (J'J)^-1 J', without forming J'J.
    left, values, right, size = in_directions(weighted)
    determined = values > 1e-10 * values[0]
    effect = (right[determined].T / values[determined]) @ left[:, determined].T / size[:, None] / np.sqrt(slope)
    parts = (noise,) if isinstance(noise, Noise) else noise.parts
    outputs = [slice(None)] if isinstance(noise, Noise) else [noise.which == j for j in range(len(parts))]
    # What rounding leaves follows the signal: at rest its color and its zeros say nothing of errors elsewhere.
    for part, own in zip(parts, outputs, strict=True):
        if part.is_rounding:
            psi[own] = np.maximum(np.abs(psi[own]), 1.0)
    white = carried = effect * psi
    colours = [
        np.ones(1) if part.is_rounding else colour_of(psi[own]).response
        for part, own in zip(parts, outputs, strict=True)
    ]
    if any(h.size > 1 for h in colours):
        carried = np.hstack([
            white[:, own] if h.size == 1
            else fftconvolve(effect[:, own], h[None, ::-1], axes=1) * np.sqrt(np.mean(psi[own] ** 2))
            for own, h in zip(outputs, colours, strict=True)
        ])  # fmt: skip
    more = residual.size / (residual.size - int(determined.sum()))
    P, plain = more * (carried @ carried.T), more * (white @ white.T)
    before, after = plain.diagonal()[:shared], P.diagonal()[:shared]
    return P, float(np.sqrt(np.mean(np.divide(after, before, out=np.ones(before.size), where=before > 0.0))))


class Colour(NamedTuple):
    """What makes a signal white.

    Attributes
    ----------
    polynomial : ndarray, shape (order + 1,)
        Its coefficients from 1 on.
    gain : float
        How much likelier a normal signal is with it than white, less what Schwarz's criterion asks for the order.
    """

    polynomial: Array
    gain: float

    @property
    def response(self) -> Array:
        """The filter that makes this color of white noise, by its impulse response of unit energy."""
        if self.polynomial.size == 1:
            return np.ones(1)
        h = lfilter([1.0], stabilised(self.polynomial), np.eye(1, 1000).ravel())
        return np.asarray(h[: np.flatnonzero(np.abs(h) > 1e-3 * np.abs(h).max())[-1] + 1] / np.linalg.norm(h))


def colour_of(signal: Array) -> Colour:
    """Return the color of a signal without outliers, NaN where it is missing."""
    # White noise is that of the samples that are measured, each against those that are measured before it.
    seen, signal = ~np.isnan(signal), np.nan_to_num(signal)
    most = min(_MOST, int(seen.sum()) // _SAMPLES_EACH)
    if most < 1 or not signal[most:].any():
        return Colour(np.ones(1), 0.0)
    lagged = sliding_window_view(signal, most + 1)[seen[most:], ::-1]
    triangle = np.asarray(np.linalg.qr(np.column_stack((lagged[:, 1:], lagged[:, 0])), mode="r"))
    shared = triangle[:, -1]
    left = np.maximum(np.cumsum(shared[::-1] ** 2)[::-1], 1e-12 * (shared @ shared))
    gains = 0.5 * len(lagged) * np.log(left[0] / left) - 0.5 * np.arange(most + 1) * np.log(len(lagged))
    order = int(gains.argmax())
    a = np.linalg.lstsq(triangle[:order, :order], shared[:order], rcond=None)[0]
    return Colour(np.concatenate(([1.0], -a)), float(gains[order]))


def evidence(noise: Noise, residual: Array, rows: Any) -> float:
    """Return the log-likelihood of residuals of an output with the color that they have."""
    shown = residual[rows]
    alone = noise.log_likelihood(shown) + colour_of(np.where(rows, noise.psi(residual), np.nan)).gain
    reach = _CLIP * float(np.sqrt(np.mean(np.square(shown))))
    carried = colour_of(np.where(rows, np.clip(residual, -reach, reach), np.nan)).polynomial
    if carried.size == 1:
        return alone
    left = lfilter(carried, [1.0], np.where(rows, residual, 0.0))[rows]
    learnt = noise.settled(left)
    return max(alone, learnt.log_likelihood(left) - 0.5 * (carried.size - 1) * float(np.log(shown.size)))


def evidence_of_outputs(noise: tuple[Noise, ...], residual: Array, spans: Any) -> float:
    """Return the log-likelihood of what is left of several outputs in several recordings, with its color."""
    parts = [(one, own[part]) for one, own in zip(noise, residual.T, strict=True) for part in spans]
    return sum(evidence(one, np.nan_to_num(e), ~np.isnan(e)) for one, e in parts if not np.isnan(e).all())


@lru_cache(maxsize=1)
def _controller() -> Any:
    """Return what controls the threads of BLAS, None where threadpoolctl is not installed."""
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[Any]:
    """Let BLAS work with one thread: on a busy machine its threads wait for each other, many times the work's time."""
    controller = _controller()
    return nullcontext() if controller is None else controller.limit(limits=1, user_api="blas")
