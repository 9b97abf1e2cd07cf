"""The linear system of a state-space model: its poles and responses with bands, in continuous time, for control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import regressor as coefficients
from robust_filterpy.identification.models.banded import Banded
from robust_filterpy.identification.models.continuous import ContinuousModel, continuous
from robust_filterpy.identification.models.reduction import truncated
from robust_filterpy.identification.models.response_records import FrequencyResponse, NoiseSpectrum, StepResponse
from robust_filterpy.identification.models.uncertainty import Regions, regions

if TYPE_CHECKING:
    import control

    from robust_filterpy.identification.models.state_space import StateSpace

# A zero as far out is rounding of one at infinity.
_INFINITE: Final = 1e6


class StateSpaceSystem(Banded):
    """What anything with matrices A, B, C, D, K and the covariance of their entries tells of its responses."""

    structure: StateSpace
    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    R: Any
    weights: Array

    @property
    def theta(self) -> Array:
        """All entries of A, B, C, and D and K if there are any, shape (s,)."""
        return np.concatenate([part.ravel() for part in self._parts.values()])

    @property
    def _parts(self) -> dict[str, Array]:
        """The matrices that are estimated, by name, in the order of theta."""
        parts = {"A": self.A, "B": self.B, "C": self.C}
        parts |= {"D": self.D} if self.structure.feedthrough else {}
        return parts | ({"K": self.K} if self.structure.disturbance else {})

    def to_control(self, dt: Any = "recorded") -> control.StateSpace:
        """Return the way from u to y.

        Parameters
        ----------
        dt : float, True or "recorded", default "recorded"
            Sampling period in s; True leaves it open.

        Returns
        -------
        control.StateSpace
        """
        import control

        return control.ss(self.A, self.B, self.C, self.D, coefficients.period(dt, self.dt))

    def reduced(self, n: int) -> control.StateSpace:
        """Return a system with fewer states: the basis is balanced, and those that do least are left out.

        Parameters
        ----------
        n : int
            How many states are left, 1 to those that there are.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ValueError
            If there are not so many.
        """
        return truncated((self.A, self.B, self.C, self.D), n, coefficients.period("recorded", self.dt))

    def to_continuous(self, dt: float | None = None, level: float = 0.95) -> ContinuousModel:
        """Return the system in continuous time whose samples this model gives, with inputs held between them.

        Parameters
        ----------
        dt, level
            As in `Model.to_continuous`.

        Returns
        -------
        ContinuousModel

        Raises
        ------
        ValueError
            If there is no dt, or a pole is at 0 or on the negative real axis.
        """
        n = len(self.A)
        part = slice(0, n * n)
        return continuous(
            (self.A, self.B, self.C, self.D), [0] * self.B.shape[1], self.dt if dt is None else dt, self.theta[part],
            self.P[part, part], lambda theta: np.linalg.eigvals(theta.reshape(n, n)), level,
        )  # fmt: skip

    def poles(self, level: float = 0.95, rng: Any = None) -> Regions:
        """Return the poles, the eigenvalues of A, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            Where a region is sampled.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If level is no probability.
        """
        n = len(self.A)
        part = slice(0, n * n)
        return regions(
            self.theta[part], self.P[part, part], lambda t: np.linalg.eigvals(t.reshape(n, n)).astype(complex), level,
            rng,
        )  # fmt: skip

    def zeros(
        self, level: float = 0.95, rng: Any = None, input: int | None = None, output: int | None = None
    ) -> Regions:
        """Return the transmission zeros, as python-control computes them, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            Where a region is sampled.
        input, output : int, optional
            The way from one input to one output; default: of all together.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If there is no such input or output, level is no probability, or there are not as many outputs as inputs and
            slycot, by which python-control finds their zeros, is not installed.
        """
        import control

        p, m = self.D.shape
        if input is not None and _checks.count("input", input) >= m:
            raise ValueError(f"input: expected 0 to {m - 1}, got {input}")
        rows = slice(None) if output is None else [self._output(output)]
        columns = slice(None) if input is None else [input]

        def roots(theta: Array) -> Any:
            A, B, C, D = self._matrices(theta)
            found = control.ss(A, B[:, columns], C[rows], D[rows][:, columns], True).zeros()
            return found[np.abs(found) < _INFINITE]

        try:
            return regions(self.theta, self.P, roots, level, rng)
        except NotImplementedError:
            raise ValueError(
                f"zeros: expected as many outputs as inputs, got {p} and {m}, for which python-control needs slycot; "
                "install it, or name input= and output="
            ) from None

    def noise_spectrum(
        self, omega: ArrayLike, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> NoiseSpectrum:
        """Return the power spectral density of what the ordinary noise does to one output, with bands.

        Parameters
        ----------
        omega, output, level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        NoiseSpectrum
            Flat without a disturbance.

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        (w, period, delays), which, n = self._frequencies(omega, dt), self._output(output), self.theta.size
        p = len(self.C)

        def logarithm(rows: Array) -> Array:
            found = np.empty((len(rows), w.size))
            for row, theta in zip(found, rows, strict=True):
                A, _, C, _ = self._matrices(theta)
                K = theta[n - self.K.size : n].reshape(self.K.shape) if self.structure.disturbance else self.K
                shifted = np.eye(len(A)) / delays[:, None, None] - A
                H = C[which] @ np.linalg.solve(shifted, np.broadcast_to(K, (w.size, *K.shape))) + np.eye(p)[which]
                row[:] = np.log(np.square(np.abs(H)) @ (self.R * np.exp(theta[n:])))
            return found

        samples = np.maximum(np.nansum(self.weights, axis=0), 1.0)
        return self._banded_density(logarithm, 1.0, samples, w, period, level, rng)

    def frequency_response(
        self, omega: ArrayLike, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> FrequencyResponse:
        """Return the frequency response from the inputs to one output, with bands.

        Parameters
        ----------
        omega : array_like, shape (k,)
            Frequencies in rad/s, in [0, pi/dt].
        output : int, default 0
            Which output.
        level : float, default 0.95
            Probability of the band at each frequency.
        dt : float, optional
            Sampling period in s. Default: that of the recording, else 1.
        rng : numpy.random.Generator or int, optional
            Where bands are sampled.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        (w, period, delays), which = self._frequencies(omega, dt), self._output(output)

        def response(theta: Array) -> Any:
            A, B, C, D = self._matrices(theta)
            shifted = np.eye(len(A)) / delays[:, None, None] - A
            return (C[which] @ np.linalg.solve(shifted, np.broadcast_to(B, (w.size, *B.shape))) + D[which]).T

        return self._banded_frequencies(
            lambda rows: np.array([response(theta) for theta in rows]), w, period, level, rng
        )

    def step_response(
        self, steps: int = 50, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> StepResponse:
        """Return what one output does after a unit step of each input, with bands.

        Parameters
        ----------
        steps : int, default 50
            How many samples.
        output, level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        StepResponse

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        length, which, period = _checks.count("steps", steps, 1), self._output(output), self._period(dt)

        def steps_of(thetas: Array) -> Array:
            found = np.empty((len(thetas), self.B.shape[1], length))
            for row, theta in zip(found, thetas, strict=True):
                A, B, C, D = self._matrices(theta)
                x = np.zeros(B.shape)
                for k in range(length):
                    row[:, k] = C[which] @ x + D[which]
                    x = A @ x + B
            return found

        return self._banded_steps(steps_of, length, period, level, rng)

    # Helpers.

    def _output(self, output: Any) -> int:
        """Return the number of an output or raise."""
        if _checks.count("output", output) >= len(self.C):
            raise ValueError(f"output: expected 0 to {len(self.C) - 1}, got {output}")
        return int(output)

    def _matrices(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of other parameters."""
        n, (p, m) = len(self.A), self.D.shape
        ends = np.cumsum([n * n, n * m, p * n, p * m])
        D = theta[ends[2] : ends[3]].reshape(p, m) if self.structure.feedthrough else self.D
        A, B, C = np.split(theta[: ends[2]], ends[:2])
        return A.reshape(n, n), B.reshape(n, m), C.reshape(p, n), D

    def _stable(self, theta: Array) -> bool:
        """Tell whether the model is stable for other parameters."""
        return bool(np.abs(np.linalg.eigvals(self._matrices(theta)[0])).max() < 1.0)
