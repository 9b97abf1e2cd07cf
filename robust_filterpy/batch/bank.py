"""Many filters advanced together online: a fleet of like actuators, tracks, or sensors, in numpy alone."""

from __future__ import annotations

import math
import sys

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array, numbers
from robust_filterpy.correction.covariance import NotPositiveDefiniteError
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.whitening import SingularInnovationError
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.influence.information import expected_joint_information

__all__ = ["FilterBank"]

_EPS = sys.float_info.epsilon
_SAFE = 1e150


class FilterBank:
    """Advance n robust filters together; equal to a loop over n `RobustKalmanFilter`.

    Parameters
    ----------
    n : int
        Number of filters, >= 1.
    dim_x, dim_z : int
        Length of the state and of the measurement of each.
    influence, scaling, information, grouping
        As in `RobustKalmanFilter`.

    Attributes
    ----------
    x : ndarray, shape (n, dim_x)
        States.
    P : ndarray, shape (n, dim_x, dim_x)
        Covariances.
    F, Q : ndarray, shape (dim_x, dim_x) or (n, dim_x, dim_x)
        Transition matrix and process noise covariance, shared or each filter's own.
    H : ndarray, shape (dim_z, dim_x) or (n, dim_z, dim_x)
        Measurement matrix.
    R : ndarray, shape (dim_z, dim_z) or (n, dim_z, dim_z)
        Measurement noise covariance, positive definite.
    y, e, weights : ndarray, shape (n, dim_z)
        Innovation, standardized innovation (0 where missing) and psi(e)/e (NaN where missing) of the last update.
    S : ndarray, shape (n, dim_z, dim_z)
        Innovation covariance; a missing component has a row of zeros but for the diagonal.
    log_likelihood : ndarray, shape (n,)
        Of the last update; 0 where all of it was missing.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range; a refused call changes nothing.

    Examples
    --------
    >>> bank = FilterBank(1000, dim_x=2, dim_z=1)
    >>> bank.F, bank.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    >>> bank.predict()
    >>> bank.update(np.linspace(0.0, 1e6, 1000)[:, None])
    >>> bool(np.abs(bank.x).max() < 3.0)
    True
    """

    def __init__(
        self,
        n: int,
        dim_x: int,
        dim_z: int,
        *,
        influence: Influence = Huber(),
        scaling: str = "innovation",
        information: str = "realized",
        grouping: str = "component",
    ) -> None:
        """Set up n filters with filterpy's initial values."""
        self.n = _checks.count("n", n, 1)
        self.dim_x, self.dim_z = _checks.count("dim_x", dim_x, 1), _checks.count("dim_z", dim_z, 1)
        self._choices = Choices(influence, scaling, information, grouping)
        self.x = np.zeros((n, dim_x))
        self.P = np.tile(np.eye(dim_x), (n, 1, 1))
        self.F, self.Q = np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)
        self.y, self.e = np.zeros((n, dim_z)), np.zeros((n, dim_z))
        self.S, self.weights = np.zeros((n, dim_z, dim_z)), np.full((n, dim_z), np.nan)

    def __repr__(self) -> str:
        """Show the size and the choices."""
        return f"FilterBank(n={self.n}, dim_x={self.dim_x}, dim_z={self.dim_z}, {self._choices})"

    @np.errstate(over="ignore", invalid="ignore")
    def predict(self, u: ArrayLike | None = None, B: ArrayLike | None = None) -> None:
        """Predict every state: x = F x + B u, P = F P F' + Q.

        Parameters
        ----------
        u : array_like, shape (n, dim_u) or (dim_u,), optional
            Control inputs.
        B : array_like, shape (dim_x, dim_u) or (n, dim_x, dim_u), optional
            Control matrix; needed with u.

        Raises
        ------
        ValueError
            If a shape does not fit or the prediction is not finite.
        """
        d = self.dim_x
        x, P = self._state()
        F, Q = self._matrix("F", (d, d)), self._matrix("Q", (d, d))
        if len(F) == 1:
            # One product for all: P F' as rows, and then the other side through the transpose.
            moved = x @ F[0].T
            half = (P.reshape(-1, d) @ F[0].T).reshape(P.shape)
            covariance = (half.transpose(0, 2, 1).reshape(-1, d) @ F[0].T).reshape(P.shape)
        else:
            moved = (F @ x[:, :, None])[:, :, 0]
            covariance = F @ P @ F.transpose(0, 2, 1)
        covariance += Q
        if u is not None:
            B = numbers("B", B)
            if B.ndim not in (2, 3) or B.shape[-2] != d:
                raise ValueError(f"B: expected shape ({d}, dim_u) or ({self.n}, {d}, dim_u), got {B.shape}")
            moved = moved + (B @ np.broadcast_to(numbers("u", u), (self.n, B.shape[-1]))[:, :, None])[:, :, 0]
        if not math.isfinite(moved.sum() + covariance.sum()):
            raise ValueError("predict: expected finite x and P, got NaN or infinity; check x, P, F, Q, B and u")
        self.x, self.P = moved, covariance

    def update(self, z: ArrayLike | None) -> None:
        """Correct every state by its measurement (paper 37, 39, 42, 44, 47, 49).

        Parameters
        ----------
        z : array_like, shape (n, dim_z), or None
            Measurements; NaN marks a missing component, a row of NaN a filter that has none, None that all have none.

        Raises
        ------
        ValueError
            If a shape does not fit, z is infinite or an R not positive definite.
        SingularInnovationError, NotPositiveDefiniteError
            As in `RobustKalmanFilter.update`; no filter has changed then.
        """
        m, d, choices = self.dim_z, self.dim_x, self._choices
        x, P = self._state()
        z = np.full((self.n, m), np.nan) if z is None else numbers("z", z)
        if z.shape != (self.n, m):
            mend = "; use z[:, None]" if z.shape == (self.n,) and m == 1 else ""
            raise ValueError(f"z: expected shape {(self.n, m)}, got {z.shape}{mend}")
        if np.isinf(z).any():
            raise ValueError("z: expected finite numbers or NaN (missing), got infinity")
        H, R = self._matrix("H", (m, d)), self._matrix("R", (m, m))
        # By content, since users write into R.
        if m == 1 or self._checked is None or not np.array_equal(R, self._checked):
            _require_positive_definite(R)
            self._checked = R.copy() if m > 1 else None
        seen = z == z
        everything = bool(seen.all())
        if len(H) == 1 and everything:
            C = (P.reshape(-1, d) @ H[0].T).reshape(self.n, d, m)
            y = z - x @ H[0].T
        else:
            # A sensor without sight, whose noise is independent: it moves nothing, like one that is not there.
            H = H * seen[:, :, None]
            C = P @ H.transpose(0, 2, 1)
            y = np.where(seen, z, 0.0) - (H @ x[:, :, None])[:, :, 0]
            R = R * (seen[:, :, None] & seen[:, None, :])
        S = H @ C + R
        filler = None
        if not everything:
            filler = np.where(seen, np.diagonal(S, axis1=1, axis2=2), 0.0).max(axis=1)
            filler[filler == 0.0] = 1.0
            S[:, np.arange(m), np.arange(m)] += np.where(seen, 0.0, filler[:, None])
        T, defect = self._standardize(S)
        e = y * T[:, :, 0] if m == 1 else (T @ y[:, :, None])[:, :, 0]
        if not np.isfinite(e).all():
            raise ValueError("update: expected finite innovations, got NaN or infinity; check x and H")
        psi, w, D = self._bound(e, seen, H)
        G = C * T if m == 1 else C @ T
        full = bool((D == 1.0).all()) if D.ndim == 2 else False
        GD = G if full else G * D[:, None, :] if D.ndim == 2 else G @ D
        K = GD * T if m == 1 else GD @ T
        moved = x + (G[:, :, 0] * psi if m == 1 else (G @ psi[:, :, None])[:, :, 0])
        # In place: a large array's fresh memory costs more than the arithmetic.
        W = K * H if m == 1 else K @ H
        np.subtract(np.eye(d), W, out=W)
        covariance = W @ P @ W.transpose(0, 2, 1)
        # What is left of the noise: K R K' + G (D - D^2) G' + G D (I - T S T) D G'.
        covariance += _sandwich(K, R)
        unused = D - D * D if D.ndim == 2 else D - D @ D
        if unused.any():
            covariance += (G * unused[:, None, :]) @ G.transpose(0, 2, 1) if D.ndim == 2 else _sandwich(G, unused)
        if defect is not None:
            covariance += _sandwich(GD, defect)
        if choices.scaling == "unit":
            least = np.linalg.eigvalsh(covariance)[:, 0]
            bad = np.flatnonzero(least < -1e-13 * np.abs(covariance).max(axis=(1, 2)))
            if bad.size:
                raise NotPositiveDefiniteError(
                    f'filter {bad[0]}: scaling="unit" would make P indefinite: it needs D H P H\' < 1 in the unit of '
                    f'the measurement squared; use scaling="bounded" or "innovation"'
                )
        self.x, self.P, self.y, self.e, self.S = moved, covariance, y, e, S
        self.weights = w if everything else np.where(seen, w, np.nan)
        self._filler = filler

    @property
    def log_likelihood(self) -> Array:
        """Log-likelihood of each filter's last measurement, 0 where all of it was missing."""
        seen = self.weights == self.weights
        count = seen.sum(axis=1)
        if not seen.any():
            return np.zeros(self.n)
        choices, e = self._choices, self.e
        if choices.scaling != "innovation":
            e = (_root(self.S, 0.0)[0] @ self.y[:, :, None])[:, :, 0]
        log_det = np.log(self.S[:, 0, 0]) if self.dim_z == 1 else np.linalg.slogdet(self.S)[1]
        if self._filler is not None:
            log_det = log_det - (self.dim_z - count) * np.log(self._filler)
        normal = getattr(choices.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
        if choices.grouping == "component":
            loss = np.where(seen, choices.influence.rho(e), 0.0).sum(axis=1) + count * normal(1)
        else:
            table = np.array([0.0, *(normal(dim) for dim in range(1, self.dim_z + 1))])
            loss = choices.influence.rho(np.linalg.norm(e, axis=1)) + table[count]
        return np.where(count > 0, -np.minimum(loss, sys.float_info.max) - 0.5 * log_det, 0.0)

    _filler: Array | None = None
    _checked: Array | None = None

    def _state(self) -> tuple[Array, Array]:
        """Return x and P, checked."""
        x, P = numbers("x", self.x), numbers("P", self.P)
        for name, value, shape in (("x", x, (self.n, self.dim_x)), ("P", P, (self.n, self.dim_x, self.dim_x))):
            if value.shape != shape:
                raise ValueError(f"{name}: expected shape {shape} for n={self.n}, got {value.shape}")
        return x, P

    def _matrix(self, name: str, shape: tuple[int, int]) -> Array:
        """Return a matrix as shape (1 or n, ., .), checked."""
        given = getattr(self, name)
        if given is None:
            raise ValueError(f"{name}: expected shape {shape} or {(self.n, *shape)}, got None")
        value = numbers(name, given)
        value = value[None] if value.ndim == 2 else value
        if value.ndim != 3 or value.shape[1:] != shape or len(value) not in (1, self.n):
            raise ValueError(f"{name}: expected shape {shape} or {(self.n, *shape)}, got {value.shape}")
        return value

    def _standardize(self, S: Array) -> tuple[Array, Array | None]:
        """Return T and I - T S T', None where that is 0."""
        scaling = self._choices.scaling
        if scaling == "unit":
            _root(S, 0.0)
            unit = np.broadcast_to(np.eye(self.dim_z), S.shape)
            return unit, unit - S
        return _root(S, 1.0 if scaling == "bounded" else 0.0)

    def _bound(self, e: Array, seen: np.ndarray, H: Array) -> tuple[Array, Array, Array]:
        """Return psi(e), psi(e)/e and D, its diagonals (n, m) or matrices (n, m, m)."""
        choices, influence = self._choices, self._choices.influence
        e = np.clip(e, -_SAFE, _SAFE)
        psi, w = np.asarray(influence.psi(e)), np.asarray(influence.weights(e))
        if choices.information == "expected":
            D = np.full(e.shape, choices.expected)
        else:
            D = np.clip(influence.psi_deriv(e) if choices.information == "realized" else w, 0.0, 1.0)
        if choices.grouping == "component" or self.dim_z == 1:
            return psi, w, D
        visible = np.broadcast_to(H.any(axis=2), seen.shape) & seen
        inside = np.where(visible, e, 0.0)
        length = np.linalg.norm(inside, axis=1)
        direction = inside / np.where(length > 0.0, length, 1.0)[:, None]
        weight = np.asarray(influence.weights(length))
        if choices.information == "expected":
            table = np.array([1.0, *(expected_joint_information(influence, i) for i in range(1, self.dim_z + 1))])
            across = radial = np.clip(table, 0.0, 1.0)[visible.sum(axis=1)]
        else:
            across = radial = np.clip(weight, 0.0, 1.0)
            if choices.information == "realized":
                radial = np.where(length > 0.0, np.clip(influence.psi_deriv(length), 0.0, 1.0), across)
        matrices = np.where(visible, across[:, None], D)[:, :, None] * np.eye(self.dim_z)
        matrices += (radial - across)[:, None, None] * direction[:, :, None] * direction[:, None, :]
        psi = np.where(visible, weight[:, None] * inside, psi)
        return psi, np.where(visible, weight[:, None], w), matrices


@np.errstate(invalid="ignore")
def _require_positive_definite(R: Array) -> None:
    """Raise unless every R is symmetric positive definite, and finite where it is one number."""
    if _checks.all_positive_definite(R):
        return
    bad: list[int] = []
    sentence = ""
    for s, R_s in enumerate(R):
        try:
            if not np.isfinite(R_s).all():
                raise ValueError("R: expected finite numbers, got NaN or infinity")
            _checks.positive_definite("R", R_s)
        except ValueError as error:
            sentence = sentence if bad else str(error)
            bad.append(s)
    which = "" if len(R) == 1 else f" (filter {bad[0]}{f' and {len(bad) - 1} more' if len(bad) > 1 else ''})"
    raise ValueError(sentence + which)


def _sandwich(A: Array, B: Array) -> Array:
    """Return A B A' for stacks."""
    if A.shape[2] == 1:
        return (A * B) * A.transpose(0, 2, 1)
    return A @ B @ A.transpose(0, 2, 1)


def _root(S: Array, floor: float) -> tuple[Array, Array | None]:
    """Return S^(-1/2) with the eigenvalues of S floored, and I - T S T', None if floor = 0."""
    m = S.shape[1]
    if m == 1:
        _require_positive(S[:, 0, 0], S[:, 0, 0], 1)
        T = 1.0 / np.sqrt(np.maximum(S, floor))
        return T, np.maximum(1.0 - S, 0.0) if floor else None
    if m == 2 and not floor:
        a, b, c = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
        determinant = a * c - b * b
        _require_positive(np.where(np.minimum(a, c) > 0.0, determinant, -1.0), a * c, 4)
        s = np.sqrt(determinant)
        t = np.sqrt(a + c + 2.0 * s) * s
        return np.stack([(c + s) / t, -b / t, -b / t, (a + s) / t], axis=1).reshape(-1, 2, 2), None
    if not np.isfinite(S).all():
        raise SingularInnovationError("S = H P H' + R: not finite; check H, P and R")
    values, vectors = np.linalg.eigh(S)
    _require_positive(values[:, 0], values[:, -1], m)
    T = (vectors / np.sqrt(np.maximum(values, floor))[:, None, :]) @ vectors.transpose(0, 2, 1)
    if not floor:
        return T, None
    return T, (vectors * np.maximum(1.0 - values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)


def _require_positive(least: Array, scale: Array, m: int) -> None:
    """Raise unless every S has an inverse."""
    bad = np.flatnonzero(~((least > m * _EPS * scale * (m > 1)) & (least < math.inf)))
    if bad.size:
        raise SingularInnovationError(
            f"filter {bad[0]}: S = H P H' + R is singular or not finite; make R positive definite"
        )
