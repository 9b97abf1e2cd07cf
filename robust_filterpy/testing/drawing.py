"""Problems with everything known: model, recording, truth, labels, and what a filter that has them gets.

`draw` draws them all: state estimation (`robust_filterpy.testing.models` lists the systems), identification
(`robust_filterpy.testing.plants`), spoiled in the ways of `robust_filterpy.testing.contamination`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import filterpy.kalman
import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.testing import runs
from robust_filterpy.testing.contamination import Kinds, objects, spoilt
from robust_filterpy.testing.models import MODELS, StateModel
from robust_filterpy.testing.plants import PLANTS, Plant, draw_plant, jump_rows
from robust_filterpy.testing.runs import Run

__all__ = ["Scenario", "draw"]


@dataclass(frozen=True, eq=False)
class Scenario:
    """Hold a recording of N steps and everything behind it.

    Attributes
    ----------
    model : StateModel
        What a filter is given.
    u : ndarray, shape (N, dim_u), or None
        Inputs.
    z : ndarray, shape (N, m)
        Measurements, NaN where missing.
    x : ndarray, shape (N, n)
        True states.
    is_outlier, is_missing : ndarray of bool, shape (N, m)
        Labels of the samples.
    is_jump : ndarray of bool, shape (N,)
        Steps at which the state does what the filter does not know.
    noise_ratio : ndarray, shape (N, m)
        Deviation of each sample's noise over the ordinary one; infinite where z tells nothing.
    Qs : ndarray, shape (N, n, n)
        Covariance of each step's process noise, jumps included.
    """

    model: StateModel
    u: Array | None
    z: Array
    x: Array
    is_outlier: np.ndarray
    is_missing: np.ndarray
    is_jump: np.ndarray
    noise_ratio: Array
    Qs: Array

    __str__ = brief

    def load(self, kf: Any) -> Any:
        """Put the model into a filter and return it.

        Parameters
        ----------
        kf : filter object
            With ``x, P, F, H, Q, R`` that can be set.

        Returns
        -------
        filter object
            kf itself.
        """
        return runs.load(kf, self.model)

    @cached_property
    def reference(self) -> Run:
        """The Kalman filter (extended, for a nonlinear sensor) that knows every label and every jump."""
        model, (x, P), steps = self.model, (self.model.x, self.model.P), []
        telling = np.isfinite(self.noise_ratio) & ~self.is_missing
        scales = np.where(np.isfinite(self.noise_ratio), self.noise_ratio, 1.0)
        for k, z in enumerate(self.z):
            x, P = filterpy.kalman.predict(x, P, model.F, self.Qs[k])
            if self.u is not None and model.B is not None:
                x = x + model.B @ self.u[k]
            H, R, use = model.jacobian(x), np.outer(scales[k], scales[k]) * model.R, np.flatnonzero(telling[k])
            y, S = z - model.measured(x), H @ P @ H.T + R
            if use.size:
                # Linearised at x: z - h(x) + H x is what a linear sensor would have said.
                x, P = filterpy.kalman.update(x, P, (y + H @ x)[use], R[np.ix_(use, use)], H[use])
            steps.append((y, S, x, P))
        ys, Ss, xs, Ps = (np.array(part) for part in zip(*steps, strict=True))
        return Run(ys, Ss, xs, Ps, self.x, self)


def draw(
    problem: str | StateModel | Plant, steps: int = 200, *, contamination: Kinds = "none",
    jumps: Mapping[int, ArrayLike] | None = None, rng: np.random.Generator | int | None = None, **options: Any,
) -> Any:  # fmt: skip
    """Draw a scenario.

    Parameters
    ----------
    problem : str, StateModel or Plant
        A name out of the tables of `robust_filterpy.testing.models` and
        `robust_filterpy.testing.plants`, or a system of your own.
    steps : int, default 200
        Length N of the recording.
    contamination : str, mapping of str to options, callable, or sequence of these, default "none"
        How the measurements go wrong: "mixture" (options probability, scale_ratio, length), "one-sided" (probability,
        scale_ratio), "bursts" (as "mixture"), "student" (df), "sentinels" (probability, value), "stuck", "missing"
        (probability, length); with options as ``{"bursts": {"length": 8}}``, or several that act one after another.
    jumps : mapping of int to array_like of shape (n,) or (n_theta,), optional
        What is added to the true state, or to the parameters, before which step.
    rng : numpy.random.Generator or int, optional
        Draws everything.
    **options : optional
        Arguments of the function that makes the problem of that name.

    Returns
    -------
    Scenario or PlantScenario

    Raises
    ------
    ValueError, TypeError
        If the problem, an option or a kind of contamination is unknown, or a jump does not fit.

    Examples
    --------
    >>> scenario = draw("constant velocity", 100, contamination="mixture", rng=1)
    >>> scenario.z.shape, bool(scenario.is_outlier.any())
    ((100, 2), True)
    """
    rng = np.random.default_rng(rng)
    steps = _checks.count("steps", steps, 1)
    if isinstance(problem, str):
        build: Callable[..., Any] = {**MODELS, **PLANTS}[_checks.option("problem", problem, (*MODELS, *PLANTS))]
        more = {"rng": rng} if _checks.takes(build, "rng") else {}
        problem = build(**options, **more)
    elif options:
        raise TypeError(f"{', '.join(options)}: expected only with the name of a problem, not with a system")
    if isinstance(problem, Plant):
        return draw_plant(problem, steps, contamination, dict(jumps or {}), rng)
    if not isinstance(problem, StateModel):
        raise TypeError(f"problem: expected a name, a StateModel or a Plant, got {_checks.shown(problem)}")
    return _draw_states(problem, steps, contamination, dict(jumps or {}), rng)


def _draw_states(
    model: StateModel, N: int, contamination: Kinds, jumps: dict[int, ArrayLike], rng: np.random.Generator
) -> Scenario:
    """Draw inputs, noises and states, then spoil what the sensors say."""
    n, m, p = model.dims
    shifts = jump_rows(jumps, N, n)
    ratio = np.where(rng.random(N) < model.jump_probability, model.jump_ratio, 1.0)
    moves = _normal(rng, N, model.Q) * ratio[:, None] + shifts
    u = rng.choice([-1.0, 1.0], (N, p)) if p else None
    if model.B is not None and u is not None:
        moves = moves + u @ model.B.T
    states, x = np.empty((N, n)), model.x + _normal(rng, 1, model.P)[0]
    for k in range(N):
        x = states[k] = model.F @ x + moves[k]
    clean = np.array([model.measured(x) for x in states]).reshape(N, m)
    sigma = np.sqrt(model.R.diagonal())
    seen = spoilt(clean + _normal(rng, N, model.R), clean, sigma, objects(contamination), rng)
    missing = np.isnan(seen.z)
    is_jump = (ratio > 1.0) | shifts.any(axis=1)
    Qs = ratio[:, None, None] ** 2 * model.Q + shifts[:, :, None] * shifts[:, None, :]
    return Scenario(model, u, seen.z, states, seen.is_outlier & ~missing, missing, is_jump, seen.noise_ratio, Qs)


def _normal(rng: np.random.Generator, size: int, covariance: Array) -> Array:
    """Draw normal vectors with a covariance that may be singular."""
    return rng.multivariate_normal(np.zeros(len(covariance)), covariance, size, method="eigh")
