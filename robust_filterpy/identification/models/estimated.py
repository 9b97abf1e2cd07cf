"""What anything with estimated parameters tells of them: intervals, a table, coefficients, a transfer function."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from robust_filterpy._brief import wrapped
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import coefficients
from robust_filterpy.identification.models.results import Intervals, intervals
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.summary import Summary

if TYPE_CHECKING:
    import control

__all__ = ["Estimated", "EstimatedPolynomials"]


class Estimated:
    """Parameters with standard deviations: a model, a tracker, physics."""

    theta: Any
    P: Any

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n,)."""
        return np.sqrt(np.maximum(np.diagonal(self.P), 0.0))

    def _valued(self, names: tuple[str, ...]) -> str:
        """Return the parameters with their standard deviations, as a line shows them."""
        each = zip(names, self.theta, self.std, strict=True)
        return ", ".join(f"{name}={value:.4g}+-{std:.2g}" for name, value, std in each)

    def __str__(self) -> str:
        """Return what `repr` says, on lines that a screen holds."""
        return wrapped(repr(self))

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (n,).

        Raises
        ------
        ValueError
            If level is no probability.

        Notes
        -----
        Of a tracker as honest as its Q and R: P is the covariance for noise of variance R.
        """
        return intervals(self.theta, self.std, level)

    def summary(self, level: float = 0.95) -> Summary:
        """Return a table of the parameters with their uncertainty, and what was found beside them.

        Parameters
        ----------
        level : float, default 0.95
            As in `confidence_intervals`.

        Returns
        -------
        Summary
            It prints as a table.

        Raises
        ------
        ValueError
            If level is no probability.
        """
        return self._summarized(level)

    def to_frame(self, level: float = 0.95) -> Any:
        """Return the parameters as a pandas DataFrame, the table of `summary`.

        Parameters
        ----------
        level : float, default 0.95
            As in `confidence_intervals`.

        Returns
        -------
        pandas.DataFrame
            A row for each: estimate, std, z, lower, upper.

        Raises
        ------
        ValueError
            If level is no probability.
        ImportError
            If pandas is not installed.
        """
        return self.summary(level).to_frame()

    def _summarized(self, level: float) -> Summary:
        """Return the table, with the facts that there are."""
        raise NotImplementedError


class EstimatedPolynomials(Estimated):
    """The same with a structure: the parameters are coefficients of polynomials."""

    structure: Structure
    dt: float | None

    @property
    def coefficients(self) -> Any:
        """a, b and c as `Coefficients`, or of a BoxJenkins b, f, c and d as `BoxJenkinsCoefficients`."""
        return coefficients.coefficients(self.structure, self.theta)

    def transfer_function(self, dt: float | bool | Literal["recorded"] = "recorded") -> control.TransferFunction:
        """Return the way from u to y, B(q)/A(q) or B(q)/F(q), as it stands.

        Parameters
        ----------
        dt : float, True or "recorded", default "recorded"
            Sampling period in s; True leaves it open. "recorded": as an index told it, True if none did.

        Returns
        -------
        control.TransferFunction
            One output and as many inputs as the structure has.

        Raises
        ------
        ValueError
            If the structure has no input, or a regressor of the caller's.

        Examples
        --------
        >>> from robust_filterpy import ARX, ParameterTracker
        >>> tf = ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0]).transfer_function(dt=0.1)
        >>> tf.poles().real, float(tf.dcgain())
        (array([0.5]), 4.0)
        """
        return coefficients.transfer_function(self.structure, self.theta, coefficients.period(dt, self.dt))
