"""The model of a tracker as it stands: parameters, noise, level, predictions and simulations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array
from robust_filterpy.identification.models import regressor
from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.identification.models.regressor import Guard, Layout, Memory
from robust_filterpy.identification.models.responses import PolynomialSystem
from robust_filterpy.identification.models.signals import one_input, recorded_input
from robust_filterpy.identification.models.time_axis import recording
from robust_filterpy.identification.recursive import setup, track
from robust_filterpy.identification.recursive.recursion import Gradient

__all__ = ["Standing"]


def _matrix(name: str, doc: str) -> Any:
    """Return a property that reads and writes the part of one of the filter's matrices that is theta's."""

    def read(self: Standing) -> Array:
        return np.array(getattr(self._filter, name), dtype=float)[np.ix_(self.form.own, self.form.own)]

    def write(self: Standing, value: ArrayLike) -> None:
        own, kf = self.form.own, self._shown()
        whole = setup.embedded(getattr(kf, name), own, setup.checked_values(len(own), **{name: value})[name])
        setattr(kf, name, whole)
        self._used = None

    return property(read, write, doc=doc)


class Standing(track.Following, PolynomialSystem):
    """What a filter with the parameters as its state, and a state of the recursion, say of the model."""

    _filter: Any
    _asked: bool
    _used: Any
    dt: float | None

    Q = _matrix("Q", "Covariance of a step of theta (paper 8), shape (n, n); may be set, to a number q for q I.")
    F = _matrix("F", "Transition matrix C of (9), shape (n, n); may be set.")

    @property
    def gradient(self) -> Gradient:
        """What the gain is computed from: "filtered" or "pseudolinear"."""
        return str(self.form.gradient[0])  # type: ignore[return-value]

    @property
    def guard(self) -> Guard:
        """What happens to an unstable step: "halve", "reject" or "none"."""
        return str(self.form.guard[0])  # type: ignore[return-value]

    @property
    def theta(self) -> Array:
        """Parameters, shape (n,)."""
        return self._standing().theta[0][self.form.own]

    @property
    def offset(self) -> float:
        """Constant of the equation: what an OutputError, FIR or LinearRegression adds to the output; 0 without one."""
        a, f = self._rest_gains
        return float(self._now.centre[0]) * a + (self._constant / f if abs(f) > 1e-9 else 0.0)

    @property
    def level(self) -> float:
        """What the output is at rest; the center that was taken off y if the model integrates."""
        a, f = self._rest_gains
        return float(self._now.centre[0]) + (self._constant / (a * f) if abs(a * f) > 1e-9 else 0.0)

    @property
    def _constant(self) -> float:
        """Constant in phi' theta, for outputs from the center."""
        return float(self._standing().theta[0, self.structure.constant_place]) if self.form.has_offset else 0.0

    @property
    def _rest_gains(self) -> tuple[float, float]:
        """A(1) and F(1)."""
        theta, places = self.theta, self.structure.polynomials
        return 1.0 + float(theta[places.a].sum()), 1.0 + float(theta[places.f].sum())

    @property
    def P(self) -> Array:
        """Covariance of the parameters, shape (n, n)."""
        return self._standing().P[0][np.ix_(self.form.own, self.form.own)]

    @property
    def R(self) -> float:
        """Variance of the ordinary noise, as it is followed; may be set, and is then no longer followed."""
        return setup.noise_variance(self._filter) if self._asked else float(self._now.scale[0, 0])

    @R.setter
    def R(self, value: float) -> None:
        self._filter.R = setup.checked_values(self.form.layout.n, R=value)["R"]
        scale = self._now.scale.copy()
        scale[0, [0, 3]] = self._filter.R.item(), 0.0
        self._now = self._now._replace(scale=scale)

    @property
    def _noise_samples(self) -> float:
        """How many samples R stands on; one that is told is known."""
        return float(self._now.scale[0, 3]) or np.inf

    @property
    def forgetting(self) -> float:
        """Forgetting factor, in (0, 1]; may be set."""
        return float(self._filter.alpha) ** -2

    @forgetting.setter
    def forgetting(self, value: float) -> None:
        setup.forget(self._shown(), value)
        self._used = None

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n,); infinite until the start has found a model."""
        return super().std if self._now.begun[0] else np.full(len(self.form.own), np.inf)

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says beside the parameters."""
        return {"R": f"{self.R:.4g}", "Level": f"{self.level:.4g}", "Forgetting": f"{self.forgetting:.4g}"}

    @property
    def _doubt(self) -> str:
        """That there is no model yet."""
        return "" if self._now.begun[0] else "the start has not found a model yet"

    def predict(self, u: ArrayLike | None = None) -> float:
        """Predict the next output, phi(k+1)' theta (paper 22), and change nothing.

        Parameters
        ----------
        u : array_like, shape (n_inputs,), or float, optional
            The next input; needed if it acts at once (nk = 0).

        Returns
        -------
        float

        Raises
        ------
        ValueError
            If the next input is needed and not given.
        """
        setup.require_next_input(self.structure, u)
        values = np.zeros(self.structure.n_inputs) if u is None else one_input(self.structure, u)
        using = self._using()._replace(F=np.asarray(self._filter.F, dtype=float)[None, None])
        return float(track.predicted(self.form, using, self.now, values[None])[0])

    def simulate(self, u: ArrayLike, *, continued: bool = False) -> Array:
        """Run the model as it stands on inputs alone, without measurements: y = B/A u.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs)
            Input.
        continued : bool, default False
            Whether the run goes on where the tracker is, with its past inputs and outputs; otherwise it starts at
            rest.

        Returns
        -------
        ndarray, shape (N,)

        Raises
        ------
        ValueError
            If u does not fit or is not finite, or the output of an unstable model overflows.
        """
        axis, u = recording(self.structure, u=u)
        axis.require_period(self.dt)
        signal = recorded_input(self.structure, u, None)
        if continued:
            layout, signal = self.form.layout, self.form.with_constant(signal)
            now = self._standing()
            x, memory, level = now.theta[0], Memory(*(a[0] for a in now.past)), now.centre[0]
        else:
            layout = Layout(self.structure)
            x, memory, level = self.theta, Memory.at_rest(layout), self.level
        y = regressor.simulate(self.structure, layout, memory, x, signal) + level
        return axis.series(y, "simulated")

    @staticmethod
    def fit(y: ArrayLike, y_model: ArrayLike) -> float:
        """Compute the normalized root-mean-square fit, 100 (1 - ||y - y_model||/||y - mean(y)||), in percent.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output; NaN does not count.
        y_model : array_like, shape (N,)
            Output of the model.

        Returns
        -------
        float
            100 is perfect, 0 no better than the mean.

        Raises
        ------
        ValueError
            If the shapes differ or y is constant.
        """
        return fit_percent(y, y_model)

    def _using(self, first: int | None = None) -> track.Settings:
        """Return what may have been changed since the last call."""
        raise NotImplementedError

    def _shown(self) -> Any:
        """Return the filter, which shows its last correction."""
        raise NotImplementedError
