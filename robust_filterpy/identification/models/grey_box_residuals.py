"""Residuals of a physical model in continuous time, integrated between samples that may come at any times.

Runge and Kutta's method of fourth order, with as many steps between two samples as the equations ask for. All
parameters that differentiation needs are integrated at once, where f takes them as columns, else one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

_DIFFERENCE: Final = 1e-5
_MOST_STEPS: Final = 128
# Twice as many steps change an output by less than this share of its size.
_ACCURATE: Final = 1e-4
# Steps of time that differ by less than this share are the same.
_EQUAL: Final = 0.05


class GreyRecording(NamedTuple):
    """One recording.

    Attributes
    ----------
    t : ndarray, shape (N,)
        Times in s.
    y : ndarray, shape (N, p)
        Outputs, 0 where they are missing.
    u : ndarray, shape (N, m)
        Inputs.
    """

    t: Array
    y: Array
    u: Array

    @property
    def is_sampled(self) -> bool:
        """Whether the samples are equally far apart."""
        steps = np.diff(self.t)
        return bool(np.ptp(steps) <= _EQUAL * np.median(steps)) if steps.size else True


class Scale(NamedTuple):
    """Parameters in free numbers: z around 0, within bounds.

    Attributes
    ----------
    centre, size, low, high : ndarray, shape (k,)
        p = center + size z; with bounds a smooth function that stays between them.
    """

    centre: Array
    size: Array
    low: Array
    high: Array

    def free(self, p: Array) -> Array:
        """Return the free numbers of parameters, shape (k,)."""
        lower, upper = np.isfinite(self.low), np.isfinite(self.high)
        width = np.where(lower & upper, self.high - self.low, 1.0)
        share = np.clip((p - np.where(lower, self.low, 0.0)) / width, 1e-9, 1.0 - 1e-9)
        with np.errstate(divide="ignore", invalid="ignore"):
            both = np.log(share / (1.0 - share))
            above, below = np.log((p - self.low) / self.size), np.log((self.high - p) / self.size)
        free = (p - self.centre) / self.size
        return np.where(lower & upper, both, np.where(lower, above, np.where(upper, -below, free)))

    def parameters(self, z: Array) -> Array:
        """Return the parameters of free numbers, shape (k,) or (k, m)."""
        part = (slice(None),) + (None,) * (z.ndim - 1)
        low, high, centre, size = self.low[part], self.high[part], self.centre[part], self.size[part]
        lower, upper = np.isfinite(low), np.isfinite(high)
        bounded = np.clip(z, -40.0, 40.0)
        with np.errstate(invalid="ignore"):
            both = low + (high - low) / (1.0 + np.exp(-bounded))
            above, below = low + size * np.exp(bounded), high - size * np.exp(-bounded)
        return np.where(lower & upper, both, np.where(lower, above, np.where(upper, below, centre + size * z)))

    def slope(self, z: Array) -> Array:
        """Return dp/dz, shape (k,)."""
        return np.asarray(self.parameters(z + 1e-6) - self.parameters(z - 1e-6)) / 2e-6


class GreyResiduals:
    """Residuals of recordings, one row of y after the other.

    The free parameters are [z of the parameters, z of the start of each recording if it is free].

    Parameters
    ----------
    f, h : function
        As of a `GreyBox`; h gives the outputs.
    recordings : list of GreyRecording
        What was recorded.
    p, x : Scale
        Of parameters and states.
    starts : ndarray, shape (n_recordings, n)
        States in the first samples.
    free_start : bool
        Whether these are free.
    linear : bool
        Whether inputs go in straight lines from sample to sample; else they are held.
    """

    def __init__(
        self,
        f: Callable[..., Any],
        h: Callable[..., Any],
        recordings: list[GreyRecording],
        p: Scale,
        x: Scale,
        starts: Array,
        free_start: bool,
        linear: bool,
    ) -> None:
        """Find out whether f takes columns, and how many steps it needs."""
        self._f, self._h, self.recordings, self.p, self.x = f, h, recordings, p, x
        self.starts, self.free_start, self.linear = starts, free_start, linear
        self.k = p.centre.size
        self.n = self.k + starts.size * free_start
        self.steps, self._columns = 1, False
        self._columns = self._takes_columns()

    def settled(self, z: Array) -> bool:
        """Take as many steps as the equations need; False if they need too many."""
        before = None
        while self.steps <= _MOST_STEPS:
            now = [self._outputs(z[:, None], i)[:, :, 0] for i in range(len(self.recordings))]
            if before is not None and all(np.isfinite(one).all() for one in now):
                change = [np.abs(a - b).max(axis=0) for a, b in zip(now, before, strict=True)]
                # Of what is computed too: a simulation has no measured outputs.
                size = np.std([np.concatenate([one.y for one in self.recordings]), np.concatenate(now)], axis=1)
                if (np.max(change, axis=0) <= _ACCURATE * size.max(axis=0)).all():
                    self.steps = max(self.steps // 2, 1)
                    return True
            before = now if all(np.isfinite(one).all() for one in now) else None
            self.steps *= 2
        self.steps = _MOST_STEPS
        return before is not None

    def residuals(self, z: Array) -> Array:
        """Return y less the outputs of all recordings."""
        parts = [one.y - self._outputs(z[:, None], i)[:, :, 0] for i, one in enumerate(self.recordings)]
        return np.concatenate([part.ravel() for part in parts])

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of the residuals by differences to both sides."""
        both = np.concatenate((z[:, None] + _DIFFERENCE * np.eye(self.n), z[:, None] - _DIFFERENCE * np.eye(self.n)), 1)
        parts = []
        for i in range(len(self.recordings)):
            outputs = self._outputs(both, i)
            parts.append(-(outputs[..., : self.n] - outputs[..., self.n :]).reshape(-1, self.n) / (2.0 * _DIFFERENCE))
        return np.concatenate(parts)

    def is_stable(self, z: Array) -> bool:
        """Tell whether there are outputs at all: a trial that overflows is no step."""
        return bool(np.isfinite(z).all())

    def start(self, z: Array, i: int) -> Array:
        """Return the state in the first sample of a recording.

        Parameters
        ----------
        z : ndarray, shape (k,) or (k, m)
            Free parameters, or columns of them.
        i : int
            Which recording.

        Returns
        -------
        ndarray, shape (n,) or (n, m)
        """
        if not self.free_start:
            own = self.starts[i]
            return np.repeat(own[:, None], z.shape[1], axis=1) if z.ndim == 2 else own
        n = self.starts.shape[1]
        return self.x.parameters(z[self.k + i * n : self.k + (i + 1) * n])

    def _outputs(self, z: Array, i: int) -> Array:
        """Return the outputs of a recording, shape (N, p, m), for columns of free parameters."""
        if not self._columns and z.shape[1] > 1:
            return np.concatenate([self._outputs(z[:, j : j + 1], i) for j in range(z.shape[1])], axis=2)
        t, y, u = self.recordings[i]
        p, x = self.p.parameters(z[: self.k]), self.start(z, i)
        if not self._columns:
            p, x = p[:, 0], x[:, 0]
        outputs = np.empty((*y.shape, z.shape[1]))
        with np.errstate(all="ignore"):
            for k in range(len(t)):
                outputs[k] = np.reshape(self._of(self._h, x, u[k], p), (y.shape[1], -1))
                if k + 1 < len(t):
                    x = self._moved(x, u[k], u[k + 1] if self.linear else u[k], p, t[k + 1] - t[k])
        return outputs

    def _moved(self, x: Array, u: Array, then: Array, p: Array, span: float) -> Array:
        """Return the state at the next sample."""
        step = span / self.steps
        for j in range(self.steps):
            a, b = (u + (then - u) * ((j + at) / self.steps) for at in (0.0, 1.0))
            middle = 0.5 * (a + b)
            k1 = self._of(self._f, x, a, p)
            k2 = self._of(self._f, x + 0.5 * step * k1, middle, p)
            k3 = self._of(self._f, x + 0.5 * step * k2, middle, p)
            k4 = self._of(self._f, x + step * k3, b, p)
            x = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x

    def _of(self, function: Callable[..., Any], x: Array, u: Array, p: Array) -> Array:
        """Return what a function of the user's says, one row a state or output."""
        try:
            values = function(x, u, p)
            if x.ndim == 1:
                return np.asarray(values, dtype=float).ravel()
            return np.stack([np.broadcast_to(np.asarray(row, dtype=float), x.shape[1:]) for row in values])
        except (OverflowError, ZeroDivisionError, FloatingPointError):
            # A trial step too far: it is no number, and will be shortened.
            return np.full(x.shape, np.nan)

    def _takes_columns(self) -> bool:
        """Tell whether f and h do with columns what they do one by one."""
        one = self.recordings[0]
        p, x, u = self.p.centre, self.starts[0], one.u[0]
        columns = [np.stack((v, 1.01 * v, v), axis=1) for v in (x, p)]
        for function in (self._f, self._h):
            single = self._of(function, x, u, p)
            other = self._of(function, 1.01 * x, u, 1.01 * p)
            try:
                many = self._of(function, columns[0], u, columns[1])
            except Exception:
                return False
            if many.shape != (single.size, 3) or not np.allclose(many[:, 0], single, equal_nan=True):
                return False
            if not np.allclose(many[:, 1], other, equal_nan=True):
                return False
        return True


def require_inputs(structure: Any, one: GreyRecording, p: Array) -> None:
    """Raise unless equations take the inputs of a recording."""
    for name, function in (("f", structure.f), ("h", structure.h)):
        try:
            if function is not None:
                function(structure.x0, one.u[0], p)
        except (IndexError, ValueError, TypeError) as error:
            raise ValueError(
                f"u: expected the inputs that {name} takes, got {one.u.shape[1]} of them ({error})"
            ) from None
