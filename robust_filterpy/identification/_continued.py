"""A tracker that goes on where a batch estimate ends: its memory filled, the level of the output taken care of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, numbers
from robust_filterpy.identification._regressor import Layout, Memory
from robust_filterpy.identification.results import Sample, TrackingResult
from robust_filterpy.identification.structures import Structure
from robust_filterpy.identification.tracker import ParameterTracker

__all__ = ["LevelledTracker", "filled_memory"]


class LevelledTracker(ParameterTracker):
    """Follow the parameters of a model around a level of its output.

    Parameters
    ----------
    structure : Structure
        What phi is made of.
    level : float
        What the output is at rest; it stays as it is.
    **options
        Those of `ParameterTracker`.
    """

    def __init__(self, structure: Structure, *, level: float, **options: Any) -> None:
        """Keep the level."""
        super().__init__(structure, **options)
        self.level = float(level)

    def update(self, y: float | None, u: ArrayLike | None = None, R: float | None = None) -> Sample:
        """Take one sample; see `ParameterTracker.update`.

        Parameters
        ----------
        y : float or None
            Measured output.
        u : array_like, shape (n_inputs,), or float
            Input of the same sample.
        R : float, optional
            Variance of the noise in this sample.

        Returns
        -------
        Sample
        """
        sample = super().update(None if y is None else float(y) - self.level, u, R)
        return sample._replace(prediction=sample.prediction + self.level)

    def run(self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None) -> TrackingResult:
        """Take a whole recording; see `ParameterTracker.run`.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output.
        u : array_like, shape (N,) or (N, n_inputs)
            Input.
        R : array_like, shape (N,), or float, optional
            Variance of the noise in each sample.

        Returns
        -------
        TrackingResult
        """
        result = super().run(numbers("y", y) - self.level, u, R)
        return result._replace(prediction=result.prediction + self.level)

    def predict(self, u: ArrayLike | None = None) -> float:
        """Predict the next output; see `ParameterTracker.predict`.

        Parameters
        ----------
        u : array_like, shape (n_inputs,), or float, optional
            The next input.

        Returns
        -------
        float
        """
        return super().predict(u) + self.level

    def simulate(self, u: ArrayLike, *, continued: bool = False) -> Array:
        """Run the model on inputs alone; see `ParameterTracker.simulate`.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs)
            Input.
        continued : bool, default False
            Whether the run goes on where the tracker is.

        Returns
        -------
        ndarray, shape (N,)
        """
        return super().simulate(u, continued=continued) + self.level


def filled_memory(structure: Structure, y: Array, u: Array, residual: Array, gradients: Array) -> Memory:
    """Return what a tracker would remember after a recording.

    Parameters
    ----------
    structure : Structure
        What phi is made of.
    y : ndarray, shape (N,)
        Output that stands in phi, its level taken off.
    u : ndarray, shape (N, n_inputs)
        Input.
    residual : ndarray, shape (N - first,)
        Residuals.
    gradients : ndarray, shape (N - first, n_theta)
        Derivatives of the prediction by theta.

    Returns
    -------
    Memory
    """
    layout = Layout(structure)
    memory = Memory(layout)
    _, memory.inputs = memory.regressors(layout, u)
    memory.outputs = -y[::-1][: layout.na]
    memory.residuals = residual[::-1][: layout.nc].copy()
    memory.gradients = np.ascontiguousarray(gradients[::-1][: layout.order])
    return memory
