"""A model together with levels of its output: their sizes are free parameters as any other."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel

__all__ = ["Levelled"]


class Levelled:
    """Residuals and their derivatives for an output less levels of sizes that are found with the model."""

    # The free parameters are those of the model, then the sizes.

    def __init__(self, model: PolynomialModel, columns: Array) -> None:
        """Keep both."""
        self.model, self.columns, self.n = model, columns, model.n + columns.shape[1]

    def __getattr__(self, name: str) -> Any:
        """Return what levels do not change."""
        return getattr(self.model, name)

    def inner(self, p: Array) -> tuple[PolynomialModel, Array]:
        """Return the model of the output less the levels, and its own free parameters."""
        return self.model.with_output(self.model.y - self.columns @ p[self.model.n :]), p[: self.model.n]

    def with_output(self, y: Array) -> Levelled:
        """Return the same for another output."""
        return Levelled(self.model.with_output(y), self.columns)

    def residuals(self, p: Array) -> Array:
        """Return the residuals."""
        model, q = self.inner(p)
        return model.residuals(q)

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the free parameters."""
        model, q = self.inner(p)
        rest = model.with_output(np.zeros(model.y.size)).residuals(q)
        levels = [rest - model.with_output(column).residuals(q) for column in self.columns.T]
        return np.column_stack((model.jacobian(q), *levels))
