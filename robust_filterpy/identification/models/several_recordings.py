"""Residuals of several recordings of one plant: theta in common, each with a level and a start of its own.

The free parameters are [theta, offset of each recording if there is one, start of each]. Recordings follow each other;
residual k belongs to sample ``first + k``, and those of a recording's first samples, whose regressors would reach into
the recording before it, are 0 and never count.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import Structure

__all__ = ["SeveralRecordings", "ends_of"]

# Samples without output between two recordings, where a start is looked for in all of them as one.
_BETWEEN: Final = 30


class SeveralRecordings(PolynomialModel):
    """Residuals and their derivatives for recordings that follow each other in ``y`` and ``u``."""

    def __init__(
        self, structure: Structure, y: Array, u: Array, offset: bool, moving: bool, begins: tuple[int, ...]
    ) -> None:
        """Make a model of each recording."""
        super().__init__(structure, y, u, offset, moving)
        self.begins = begins
        self.spans = tuple(slice(b, e) for b, e in zip(begins, ends_of(begins, y.size), strict=True))
        self._models = [PolynomialModel(structure, y[part], u[part], offset, moving) for part in self.spans]
        k, n = len(begins), structure.n_theta
        starts = n + offset * k + np.arange(k * self.nf * moving).reshape(k, -1)
        shared = np.arange(n)
        self._places = [np.concatenate((shared, np.full(int(offset), n + i), starts[i])).astype(int) for i in range(k)]
        self.n = n + k * (offset + self.nf * moving)

    def with_output(self, y: Array) -> SeveralRecordings:
        """Return the same model for other outputs."""
        return SeveralRecordings(self.structure, y, self.u, self.offset, self.moving, self.begins)

    @property
    def pieces(self) -> tuple[tuple[slice, slice], ...]:
        """Which residuals and which samples belong to each recording."""
        return tuple((slice(part.start, part.stop - self.first), part) for part in self.spans)

    @property
    def conditioned(self) -> Any:
        """Which residuals need nothing from before their recording."""
        found = np.zeros(self.y.size - self.first, dtype=bool)
        for (rows, _), model in zip(self.pieces, self._models, strict=True):
            found[rows] = model.conditioned
        return found

    def of(self, i: int, p: Array) -> tuple[PolynomialModel, Array]:
        """Return the model of one recording, and its own free parameters."""
        return self._models[i], p[self._places[i]]

    def residuals(self, p: Array) -> Array:
        """Return the residuals of all recordings."""
        return self._together(lambda model, q: model.residuals(q), p)

    def equation_error(self, p: Array) -> Array:
        """Return A y - w - d of all recordings."""
        return self._together(lambda model, q: model.equation_error(q), p)

    def undisturbed(self, p: Array) -> Array:
        """Return what the inputs and the starts make of B/F."""
        return self._together(lambda model, q: model.undisturbed(q), p)

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the free parameters, shape (N - first, n)."""
        found = np.zeros((self.y.size - self.first, self.n))
        for i, (rows, _) in enumerate(self.pieces):
            model, q = self.of(i, p)
            found[rows, self._places[i]] = model.jacobian(q)
        return found

    def joined(self, missing: Any) -> tuple[PolynomialModel, Any]:
        """Return all recordings as one, with gaps between them, and where its output is missing."""
        space = max(_BETWEEN, self.first + 1)
        y, u, gaps = [], [], []
        for part in self.spans:
            y += [self.y[part], np.zeros(space)]
            u += [self.u[part], np.zeros((space, self.u.shape[1]))]
            gaps += [missing[part], np.ones(space, dtype=bool)]
        whole = PolynomialModel(self.structure, np.concatenate(y), np.concatenate(u), self.offset, self.moving)
        return whole, np.concatenate(gaps)

    def shared(self, p: Array) -> Array:
        """Return free parameters with the theta and offset of another model of the same structure, without motion."""
        n, found = self.structure.n_theta, np.zeros(self.n)
        found[:n] = p[:n]
        if self.offset:
            found[n : n + len(self.begins)] = p[n]
        return found

    def _together(self, of: Any, p: Array) -> Array:
        """Return a signal of all recordings, 0 where a recording has none yet."""
        found = np.zeros(self.y.size - self.first)
        for i, (rows, _) in enumerate(self.pieces):
            found[rows] = of(*self.of(i, p))
        return found


def ends_of(begins: tuple[int, ...], size: int) -> tuple[int, ...]:
    """Return the sample after the last of each recording."""
    return (*begins[1:], size)
