"""A tracker as a regressor of river, for its pipelines, metrics and evaluation.

This module imports river, and nothing imports this module::

    from robust_filterpy.adapters.river import RiverTracker
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from river.base import Regressor

from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.tracker import ParameterTracker

__all__ = ["RiverTracker"]


class RiverTracker(Regressor):  # type: ignore[misc, unused-ignore]
    """Follow the parameters of a linear model by river's `learn_one` and `predict_one`.

    Parameters
    ----------
    structure : Structure
        What phi is made of.
    inputs : sequence of str
        Which features are the inputs of the structure, in its order.
    options : dict, optional
        Further arguments of `ParameterTracker`.

    Attributes
    ----------
    tracker : ParameterTracker
        The tracker that learns.

    Raises
    ------
    ValueError
        If there are not as many names as inputs.
    ValueError, TypeError
        As `ParameterTracker`.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import FIR
    >>> regressor = RiverTracker(FIR(1, nk=0), inputs=["valve"], options={"start": 0, "R": 0.01})
    >>> for u in np.random.default_rng(1).choice([-1.0, 1.0], 50):
    ...     regressor.learn_one({"valve": u}, 2.0 * u)
    >>> round(regressor.predict_one({"valve": 3.0}), 2)
    6.0
    """

    def __init__(
        self, structure: Structure, inputs: Sequence[Hashable] = (), options: Mapping[str, Any] | None = None
    ) -> None:
        """Set up the tracker."""
        if isinstance(inputs, str) or len(inputs) != structure.n_inputs:
            needed = f"{structure.n_inputs} name(s) of features for {structure}"
            raise ValueError(f"inputs: expected {needed}, got {inputs!r}")
        self.structure, self.inputs, self.options = structure, inputs, options
        self.tracker = ParameterTracker(structure, **(options or {}))

    def learn_one(self, x: Mapping[Any, Any], y: float | None) -> None:
        """Take one sample.

        Parameters
        ----------
        x : mapping
            Features; those that are inputs are used.
        y : float or None
            Measured output; NaN or None if it is missing.

        Raises
        ------
        KeyError
            If an input is not among the features.
        ValueError, TypeError
            As `ParameterTracker.update`.
        """
        self.tracker.update(y, self._values(x))

    def predict_one(self, x: Mapping[Any, Any]) -> float:
        """Predict the output that comes with these features, and change nothing.

        Parameters
        ----------
        x : mapping
            Features of the same sample.

        Returns
        -------
        float

        Raises
        ------
        KeyError
            If an input is not among the features.
        """
        return self.tracker.predict(self._values(x))

    def _values(self, x: Mapping[Any, Any]) -> list[float] | None:
        """Return the inputs among the features."""
        missing = [name for name in self.inputs if name not in x]
        if missing:
            raise KeyError(f"x: expected the features {list(self.inputs)}, got {list(x)}")
        return [x[name] for name in self.inputs] or None
