"""What the nonlinear filters share: the innovation of a nonlinear sensor, sigma points and their moments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter, unscented_transform

from robust_filterpy._arrays import measured, state_of
from robust_filterpy._checks import FLOAT, Array, described, numbers
from robust_filterpy.correction.definition import Innovation, innovation_moments
from robust_filterpy.filters.driver import columns_of, take_steps, without_rounding
from robust_filterpy.filters.policies import regressed
from robust_filterpy.filters.shell import Shell

#: Whether the installed filterpy draws new points from the predicted covariance for the correction; 1.4.5 does not.
REDRAWS = "sigma_points" in UnscentedKalmanFilter.predict.__code__.co_names


def drawn(points: Any, x: Array, P: Array) -> Array:
    """Return the sigma points of a state, shape (2 n + 1, n)."""
    plain = type(points) is MerweScaledSigmaPoints and points.subtract is np.subtract
    if not (plain and type(x) is np.ndarray and x.dtype == FLOAT and x.shape == (points.n,)):
        return points.sigma_points(x, P)  # type: ignore[no-any-return]
    n = points.n
    U = points.sqrt((points.alpha**2 * (n + points.kappa) - n + n) * P)
    sigmas = np.empty((2 * n + 1, n))
    sigmas[0] = x
    np.add(x, U, out=sigmas[1 : n + 1])
    np.subtract(x, U, out=sigmas[n + 1 :])
    return sigmas


def transformed(
    sigmas: Array, Wm: Array, Wc: Array, noise: Any, mean: Any = None, residual: Any = np.subtract
) -> tuple[Array, Array]:
    """Return mean and covariance of points, the latter symmetric to the last bit and with that of the noise."""
    if mean is None and residual is np.subtract:
        x = Wm.dot(sigmas)
        P = covariance(sigmas - x, sigmas - x, Wc) + noise
    else:
        x, P = unscented_transform(sigmas, Wm, Wc, noise, mean, residual)
    # From nearby points with large weights of both signs rounding may leave much, which the kernel would decline.
    return x, 0.5 * (P + P.T)


def covariance(dx: Array, dz: Array, Wc: Array) -> Array:
    """Return sum W_i dx_i dz_i' of differences, one a row."""
    return np.asarray((dx * Wc[:, None]).T.dot(dz))


class NonlinearFilterMixin(Shell):
    """Correct by an innovation, and run through a recording step by step."""

    _none_is_column = True

    def _correct_by_moments(
        self, source: str, z: Any, at: Any, C: Array, S: Array | None, R: Array, residual: Callable[[Any, Any], Any],
        add: Callable[[Any, Any], Any] = np.add,
    ) -> bool:  # fmt: skip
        """Correct by z, which is predicted to be at; return False where nothing was measured. C, S as in `_corrected`.
        """
        x, P = state_of(self)
        values, y = innovation_of(z, at, len(R), residual, source)
        if values is None:
            self._skip()
            return False
        if self._stepped(values, None, y, C, S, R):
            if add is not np.add:
                # The kernel has added the correction; a state with angles is moved by its own function.
                moved = np.asarray(add(x.ravel(), (self.x - x).ravel()), dtype=float)
                require_finite(x=moved)
                self.x = moved.reshape(x.shape)
                self.x_post, self._kept = self.x.copy(), self._kept and self._kept.at(moved)
            return True
        last, carried = self._corrected(P, values, y, C, S, R)
        last = last._replace(x=np.asarray(add(x.ravel(), last.x), dtype=float))
        require_finite(x=last.x)
        self._keep(last, None if carried is None else carried.at(last.x), values)
        return True

    def _corrected(self, P: Array, z: Array, y: Array, C: Array, S: Array | None, R: Array) -> tuple[Any, Any]:
        """Return the correction of a state at 0; C and S are the innovation's moments, or the Jacobian H and None."""
        before = self._prior(len(y))
        if before.carried is not None:
            before = before._replace(carried=self._current().at(np.zeros(len(P))))

        def correct(before: Any, P: Array) -> Any:
            """Correct with the moments of P, where C is a Jacobian."""
            cross, spread = innovation_moments(P, C, R) if S is None else (C, S)
            innovation = Innovation(z, y, cross, spread, R, C if S is None else None)
            return self._policy.corrected_by_moments(before, np.zeros(len(P)), P, innovation, self._skips)

        return without_rounding(type(self).__name__, correct, before, P, C if S is None else None, R)

    def _current(self) -> Any:
        """Return the models, None where there is one."""
        x, P = state_of(self)
        return None if self._kept is None else self._policy.current(self._kept, x.ravel(), P)

    def _move(self, before: Any, dx: Array, moved: Array, weights: Array, x: Array, P: Array, Q: Array) -> None:
        """Predict the models by sigma points, dx and moved from the mean, (points, n), which have moved to x and P."""
        cross = covariance(dx, moved, weights)
        self.x, self.P = x, before.P.copy()
        if before is not self._kept or not self._predict_extended(None, cross, P):
            F, curvature = regressed(before.P, cross, P - Q)
            self._kept = self._policy.predicted_to(before, x.ravel(), F, Q, curvature)
            self.x, self.P = self._kept.x.reshape(x.shape).copy(), self._kept.P.copy()
            require_finite(x=self.x, P=self.P)
            self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def _filtered(self, zs: Any, columns: dict[str, Any], step: Callable[..., None], saver: Any) -> tuple[Array, Array]:
        """Do a step for each measurement, with what each of the columns has for it; all of them or none."""
        table = columns_of({"zs": zs, **columns})
        n, steps = self.dim_x, len(table[0])
        means, covariances = np.zeros((steps, n)), np.zeros((steps, n, n))

        def take(k: int) -> None:
            """Take one step."""
            step(*(column[k] for column in table))
            means[k], covariances[k] = np.ravel(self.x), self.P

        take_steps(self, range(steps), take, saver)
        return means, covariances


def innovation_of(
    z: Any, predicted: Any, m: int, residual: Callable[[Any, Any], Any], source: str
) -> tuple[Array | None, Array]:
    """Return z and its innovation, shape (m,), NaN where missing; None for a z that is missing altogether."""
    # The residual function sees neither NaN nor shapes that broadcast: a missing component takes its predicted value,
    # and both arguments have the shape of the prediction.
    at = numbers(source, predicted)
    if at.size != m:
        raise ValueError(f"{source}: expected {m} number(s), as the measurement has, got {described(at)}")
    if not np.isfinite(at).all():
        raise ValueError(f"{source}: expected finite numbers, got {at.ravel()}; check x and the measurement function")
    at = at.reshape(at.shape or (1,))
    values = measured(z, m)
    if values is None:
        return None, np.full(m, np.nan)
    values = np.atleast_1d(values)
    missing = np.isnan(values)
    filled = np.where(missing, at.ravel(), values).reshape(at.shape)
    y = numbers("residual", residual(filled, at.copy())).ravel()
    if y.size != m or not np.isfinite(y).all():
        raise ValueError(f"residual: expected {m} finite number(s), got {y}")
    return values, np.where(missing, np.nan, y)


def require_finite(**arrays: Array) -> None:
    """Raise ValueError, naming the array, unless every number is finite."""
    for name, value in arrays.items():
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity; check x and the model functions")
