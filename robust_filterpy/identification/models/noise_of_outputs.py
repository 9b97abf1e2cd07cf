"""The noise of several outputs: each has a variance and outliers of its own, learnt from its own residuals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.models.learnt_noise import Noise

__all__ = ["Noises"]


class Noises(NamedTuple):
    """Noise of residuals of several outputs, in one row.

    Attributes
    ----------
    parts : tuple of Noise
        That of each output.
    which : ndarray of int, shape (N,)
        The output of each residual.
    """

    parts: tuple[Noise, ...]
    which: Any

    @property
    def variance(self) -> Array:
        """R of each residual, shape (N,)."""
        return np.array([noise.R for noise in self.parts])[self.which]

    def refitted(self, residual: Array, steps: int = 5) -> Noises:
        """Return the noise that these residuals show."""
        parts = enumerate(self.parts)
        return self._replace(parts=tuple(noise.refitted(residual[self.which == j], steps) for j, noise in parts))

    def learnt(self) -> Noises:
        """Return the same with the mixture in the place of each influence function."""
        return self._replace(parts=tuple(Noise(START, one.R, one.known, one.least) for one in self.parts))

    def weights(self, residual: Array) -> Array:
        """Return psi(e)/e of each residual."""
        return self._each(residual, lambda noise, own: noise.weights(own))

    def psi(self, residual: Array) -> Array:
        """Return psi of each residual in units of its standard deviation."""
        return self._each(residual, lambda noise, own: noise.psi(own))

    def slope(self, residual: Array) -> Array:
        """Return the mean of psi' of its output for each residual."""
        return self._each(residual, lambda noise, own: np.full(own.size, noise.slope(own)))

    def cost(self, residual: Array) -> float:
        """Return -log of the likelihood of the residuals, up to a constant that the variances determine."""
        return sum(noise.cost(residual[self.which == j]) for j, noise in enumerate(self.parts))

    def log_likelihood(self, residual: Array) -> float:
        """Return the log-likelihood of the residuals."""
        return sum(noise.log_likelihood(residual[self.which == j]) for j, noise in enumerate(self.parts))

    def _each(self, residual: Array, of: Callable[[Noise, Array], Array]) -> Array:
        """Return what the noise of its output makes of each residual."""
        found = np.zeros(residual.size)
        for j, noise in enumerate(self.parts):
            found[self.which == j] = of(noise, residual[self.which == j])
        return found
