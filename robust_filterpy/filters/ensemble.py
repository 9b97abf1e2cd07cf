"""RobustEnsembleKalmanFilter: filterpy's EnsembleKalmanFilter with a bounded correction."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise
from robust_filterpy._checks import Array
from robust_filterpy._filterpy import EnsembleKalmanFilter
from robust_filterpy._state import StateError, read, spelt
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters.nonlinear_mixin import NonlinearFilterMixin, require_finite
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.snapshot import whole

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["RobustEnsembleKalmanFilter"]


class RobustEnsembleKalmanFilter(NonlinearFilterMixin, EnsembleKalmanFilter):
    """Filter like `filterpy.kalman.EnsembleKalmanFilter`, without believing outliers.

    The ensemble gives the moments C = cov(x, z) and S = cov(z); its mean moves by the bounded innovation, and its
    spread shrinks by as much as P does::

        x_i+ = x_i + C T' psi(T y) + C T' (I - (I - D)^(1/2)) T (v_i - (h(x_i) - mean)),    P+ = P - C T' D T C'

    Parameters
    ----------
    x : array_like, shape (dim_x,)
        Mean.
    P : array_like, shape (dim_x, dim_x)
        Covariance.
    dim_z : int
        Length of the measurement, >= 1.
    dt : float
        Time between steps, handed to fx.
    N : int
        Number of members, >= 2.
    hx : callable
        ``hx(x)`` returns the measurement that belongs to x, shape (dim_z,).
    fx : callable
        ``fx(x, dt)`` returns the next state, shape (dim_x,).
    influence : Influence, default Huber(1.345)
        psi, as in `RobustKalmanFilter`.
    scaling : {"learnt", "innovation", "unit", "bounded"}, optional
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"} or tuple of tuple of int
        psi of each component of e, or of the length of e.
    noise, process, patience : None
        What other filters take; refused here, where members move by a bounded innovation.
    rng : numpy.random.Generator, optional
        Where random numbers come from, a new generator by default; filterpy takes them from numpy's global state.

    Attributes
    ----------
    sigmas : ndarray, shape (N, dim_x)
        Members.
    weights, clipped, e, T, y_bounded : ndarray
        What the last correction did, as in `RobustKalmanFilter`.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range. A call that is refused changes nothing.

    Notes
    -----
    With ``influence=Linear()`` and the same random numbers every attribute is filterpy's.

    Examples
    --------
    >>> kf = RobustEnsembleKalmanFilter(
    ...     [1.0], [[0.1]], 1, 1.0, 50, lambda x: x, lambda x, dt: x, rng=np.random.default_rng(0)
    ... )
    >>> kf.Q = 0.01 * np.eye(1)
    >>> for z in [1.1, 0.9, 1e6, 1.0]:
    ...     kf.predict()
    ...     kf.update([z])
    >>> bool(abs(kf.x[0] - 1.0) < 0.5)
    True
    """

    _takes_mixtures = False

    @with_options
    def __init__(
        self,
        x: ArrayLike,
        P: ArrayLike,
        dim_z: int,
        dt: float,
        N: int,
        hx: Callable[..., ArrayLike],
        fx: Callable[..., ArrayLike],
        *,
        rng: np.random.Generator | None = None,
        **options: Unpack[Options],
    ) -> None:
        """Draw the ensemble and set up filterpy's attributes and the choices."""
        _checks.count("N", N, 2)
        self._set_policy(options, dim_z=dim_z)
        self.rng = np.random.default_rng() if rng is None else rng
        self.dim_z, self.inv = dim_z, np.linalg.inv
        x = _checks.finite_vector("x", x)
        super().__init__(x, _checks.matrix("P", P, (x.size, x.size), f"dim_x={x.size}"), dim_z, dt, N, hx, fx)
        self.y = np.zeros(dim_z)
        self._start()

    @whole
    def initialize(self, x: ArrayLike, P: ArrayLike) -> None:
        """Draw the members anew.

        Parameters
        ----------
        x, P : array_like, shape (dim_x,) and (dim_x, dim_x)
            Their mean and covariance.
        """
        self.x = _checks.finite_vector("x", x)
        self.P = _checks.matrix("P", P, (self.x.size, self.x.size), f"dim_x={self.x.size}")
        self.sigmas = self.rng.multivariate_normal(self.x, self.P, self.N)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    @whole
    def predict(self) -> None:
        """Predict the next state: every member by fx and a noise of its own.

        Raises
        ------
        ValueError
            If the prediction is not finite; nothing has changed then.
        """
        n = self.dim_x
        moved = _rows([self.fx(s, self.dt) for s in self.sigmas])
        Q = process_noise(self.Q, None, n) * np.ones((n, n))
        self.sigmas = moved + self.rng.multivariate_normal(np.zeros(n), Q, self.N)
        require_finite(fx=self.sigmas)
        self.x = np.mean(self.sigmas, axis=0)
        apart = self.sigmas - self.x
        self.P = apart.T @ apart / (self.N - 1)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    @whole
    def update(self, z: ArrayLike | None, R: Any = None, *, sensor: str | int | None = None) -> None:
        """Correct the members by a measurement whose influence is bounded.

        Parameters
        ----------
        z : array_like, shape (dim_z,), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        sensor : str or int, optional
            Whose reading it is, where several sensors take turns, as in `RobustKalmanFilter.update`; else its place in
            z tells.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit, z is infinite or R not a covariance; nothing has changed then.
        SingularInnovationError, NotPositiveDefiniteError
            As in `RobustKalmanFilter.update`.
        """
        if sensor is not None:
            self._spoken(sensor, lambda: RobustEnsembleKalmanFilter.update(self, z, R))
            return
        if z is None:
            self._skip()
            return
        m = self.dim_z
        R = noise_covariance(self.R, R, m)
        predicted = _rows([self.hx(s) for s in self.sigmas])
        require_finite(hx=predicted)
        mean, before = predicted.mean(axis=0), self.x
        apart, seen = self.sigmas - self.x, predicted - mean
        C, S = apart.T @ seen / (self.N - 1), seen.T @ seen / (self.N - 1) + R
        if not self._correct_by_moments("hx", z, mean, C, S, R, np.subtract):
            return
        last: Any = self._arrays()
        noise = self.rng.multivariate_normal(np.zeros(m), R, self.N)
        self.sigmas = self.sigmas + (self.x - before) + (noise - seen) @ self._shrinking(last, C).T
        self.x = np.mean(self.sigmas, axis=0)
        self.x_post = self.x.copy()

    def _moving(self) -> dict[str, Any]:
        """Return x, P, the members and where the random numbers are."""
        drawn = json.dumps(self.rng.bit_generator.state, default=np.ndarray.tolist)
        return {**super()._moving(), "sigmas": self.sigmas, "random": spelt(drawn)}

    def _go_on(self, entries: dict[str, Array]) -> None:
        """Take over a checked state, with a generator of its own at the same place."""
        generator, drawn = type(self.rng.bit_generator)(), {}
        try:
            drawn = json.loads(read(entries["random"]))
            generator.state = drawn
        except (ValueError, TypeError, KeyError, OverflowError):
            name, other = type(generator).__name__, drawn.get("bit_generator", "none")
            raise StateError(f"state: expected random numbers of a {name}, got those of a {other}") from None
        super()._go_on(entries)
        self.sigmas, self.rng = entries["sigmas"], np.random.Generator(generator)

    def _shrinking(self, last: Correction, C: Array) -> Array:
        """Return the gain C L with which noisy members have covariance P - C B C': B = 2 L - L S L."""
        part = np.flatnonzero(~np.isnan(last.weights))
        pick = np.ix_(part, part)
        root = np.linalg.cholesky(last.S[pick])
        values, vectors = np.linalg.eigh(root.T @ last.information[pick] @ root)
        inner = (vectors * (1.0 - np.sqrt(np.clip(1.0 - values, 0.0, 1.0)))) @ vectors.T
        half = np.linalg.solve(root, C[:, part].T)
        gain = np.zeros_like(C)
        gain[:, part] = np.linalg.solve(root.T, inner @ half).T
        return gain


def _rows(values: list[Any]) -> Array:
    """Return vectors, columns or numbers of the members, one a row."""
    return np.array(values, dtype=float).reshape(len(values), -1)
