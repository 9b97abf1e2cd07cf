"""Plants to identify, with everything known: what `draw` makes of "arx", "output error", "armax" and "fir".

A plant is a discrete `control.TransferFunction`, or theta itself, with parameters that stand still, drift or jump.

============  ===============================================  ====================================================
name          plant                                            good for
============  ===============================================  ====================================================
arx           A(q) y = B(q) u + v                              exact answers: recursive least squares
output error  y = B(q)/A(q) u + v                              bias: measured outputs in phi give a wrong a
armax         A(q) y = B(q) u + C(q) v                         noise with a color of its own
fir           y = B(q) u + v                                   robustness alone: no outlier is in phi
============  ===============================================  ====================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.signal
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification import ARMAX, ARX, FIR, OutputError, ParameterTracker
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence import Linear
from robust_filterpy.plants import simulate_arx, simulate_output_error
from robust_filterpy.plants.linear import linear_parameters, random_walk, stable
from robust_filterpy.testing.contamination import Kinds, Spoilt, objects, spoilt
from robust_filterpy.testing.runs import Run, run_tracker

if TYPE_CHECKING:
    import control

__all__ = ["Plant", "PlantScenario"]

#: Two lightly damped poles, .75 +- .37j.
DEFAULT = ([1.0, 0.5], [1.0, -1.5, 0.7])


@dataclass(frozen=True, eq=False)
class Plant:
    """Hold a plant that is linear in its parameters, and how these move.

    Attributes
    ----------
    structure : Structure
        What phi is made of, of one input.
    theta : ndarray, shape (n_theta,)
        Parameters to start from.
    sigma : float
        Deviation of the ordinary noise, in the unit of y.
    drift : float
        Variance of each parameter's step from sample to sample (c does not move).
    """

    structure: Structure
    theta: Array
    sigma: float = 0.5
    drift: float = 0.0

    @property
    def Q(self) -> Array:
        """Covariance of a step of theta that a tracker is given, shape (n_theta, n_theta)."""
        moving = self.structure.n_theta - self.structure.nc
        return np.diag(np.repeat([self.drift, 0.0], [moving, self.structure.nc]))


@dataclass(frozen=True, eq=False)
class PlantScenario:
    """Hold a recording of a plant, N samples, and everything behind it.

    Attributes
    ----------
    structure : Structure
        What phi is made of.
    u, y : ndarray, shape (N,)
        Input; measured output, NaN where missing.
    y_clean : ndarray, shape (N,)
        Output without noise.
    theta : ndarray, shape (N, n_theta)
        True parameters, row k those that make y(k).
    R : float
        Variance of the ordinary noise.
    Q : ndarray, shape (n_theta, n_theta)
        Covariance of a step of theta that a tracker is given.
    is_outlier, is_missing, is_jump : ndarray of bool, shape (N,)
        Labels.
    noise_ratio : ndarray, shape (N,)
        Deviation of each sample's noise over the ordinary one; infinite where y tells nothing.
    """

    structure: Structure
    u: Array
    y: Array
    y_clean: Array
    theta: Array
    R: float
    Q: Array
    is_outlier: np.ndarray
    is_missing: np.ndarray
    is_jump: np.ndarray
    noise_ratio: Array

    def load(self, tracker: Any) -> Any:
        """Tell a tracker R and Q, as far as it has them, and return it.

        Parameters
        ----------
        tracker : tracker object
            With ``update(y, u)`` and ``theta``.

        Returns
        -------
        tracker object
            tracker itself.
        """
        for name in ("R", "Q"):
            if hasattr(tracker, name):
                setattr(tracker, name, getattr(self, name))
        return tracker

    @cached_property
    def reference(self) -> Run:
        """The Kalman tracker that starts at the truth, with P = I, and knows every label and every jump."""
        tracker = self.load(ParameterTracker(self.structure, influence=Linear(), theta=self.theta[0], P=1.0))
        measured = np.isfinite(self.noise_ratio)
        y = np.where(measured, self.y, np.nan)
        variance = self.R * np.where(measured, self.noise_ratio, 1.0) ** 2
        moves, Q = np.diff(self.theta, axis=0, prepend=self.theta[:1]), tracker.Q

        def sample(k: int) -> Any:
            tracker.Q = Q + np.outer(moves[k], moves[k]) * self.is_jump[k]
            return tracker.update(y[k], self.u[k], variance[k])

        return run_tracker(tracker, self, sample)


def linear(
    structure: Callable[..., Structure], system: control.TransferFunction | None = None, **options: Any
) -> Plant:
    """Return a plant of a structure, its orders and parameters those of a transfer function."""
    if system is None:
        import control

        system = control.tf(*DEFAULT, True)
    theta, na, nb, nk = linear_parameters(system)
    return Plant(structure(na, nb, nk), theta, **options)


def armax(system: control.TransferFunction | None = None, c: ArrayLike = (-0.8,), **options: Any) -> Plant:
    """Return a plant whose noise has a color, A(q) y = B(q) u + C(q) v."""
    c = _checks.finite_vector("c", c)
    plant = linear(lambda na, nb, nk: ARMAX(na, nb, c.size, nk), system, **options)
    return replace(plant, theta=np.concatenate((plant.theta, c)))


def fir(b: ArrayLike = (1.0, 0.5, -0.3, 0.2), **options: Any) -> Plant:
    """Return a finite impulse response, y = B(q) u + v."""
    b = _checks.finite_vector("b", b)
    return Plant(FIR(b.size), b, **options)


#: What `draw` knows by name.
PLANTS: dict[str, Callable[..., Plant]] = {
    "arx": partial(linear, ARX), "output error": partial(linear, OutputError), "armax": armax, "fir": fir,
}  # fmt: skip


def draw_plant(
    plant: Plant, steps: int, contamination: Kinds, jumps: Mapping[int, ArrayLike], rng: np.random.Generator
) -> PlantScenario:
    """Draw a recording of a plant; see `robust_filterpy.testing.draw`."""
    structure, kinds, sigma = plant.structure, objects(contamination), np.array([plant.sigma])
    v = plant.sigma * rng.standard_normal((steps, 1))
    shifts, theta = jump_rows(jumps, steps, plant.theta.size), np.tile(plant.theta, (steps, 1))
    if plant.drift:
        theta = random_walk(plant.theta, plant.Q, steps, rng, stable(structure.na + structure.nf))
    theta, is_jump = theta + np.cumsum(shifts, axis=0), np.asarray(shifts.any(axis=1))
    u = rng.choice([-1.0, 1.0], steps)
    clean = _output(structure, theta, u, None)
    inside = [kind for kind in kinds if getattr(kind, "of_noise", False)]
    noise = spoilt(v, np.zeros_like(v), sigma, inside, rng)
    y = _output(structure, theta, u, noise.z[:, 0])
    seen = spoilt(y[:, None], clean[:, None], sigma, [kind for kind in kinds if kind not in inside], rng)
    both = Spoilt(seen.z, seen.noise_ratio * noise.noise_ratio, seen.is_outlier | noise.is_outlier)
    missing = np.isnan(both.z[:, 0])
    outlying, ratio = both.is_outlier[:, 0] & ~missing, both.noise_ratio[:, 0]
    known = structure, u, both.z[:, 0], clean, theta, plant.sigma**2, plant.Q
    return PlantScenario(*known, outlying, missing, is_jump, ratio)


def jump_rows(jumps: Mapping[int, ArrayLike], steps: int, n: int) -> Array:
    """Return what is added at each step, shape (steps, n), or raise."""
    rows = np.zeros((steps, n))
    for k, shift in jumps.items():
        if _checks.count("jumps", k) >= steps:
            raise ValueError(f"jumps: expected steps below {steps}, got {k}")
        rows[k] = _checks.matrix("jumps", np.atleast_2d(_checks.numbers("jumps", shift)), (1, n), f"{n} numbers")
    return rows


def _output(structure: Structure, theta: Array, u: Array, v: Array | None) -> Array:
    """Return the plant's output, without noise if v is None."""
    (nb, nk), na = structure.inputs[0], structure.na + structure.nf
    c = theta[0, theta.shape[1] - structure.nc :]
    if v is not None and structure.nc:
        v = scipy.signal.lfilter(np.concatenate(([1.0], c)), [1.0], v)
    simulate = simulate_output_error if structure.nf else simulate_arx
    return simulate(theta[:, : na + nb], u, noise=v, na=na, nb=nb, nk=nk).y
