"""Many filters advanced together online: a fleet of like actuators, tracks, or sensors.

Where the kernel does not serve, numpy corrects all filters at once: a second form of the definition, which takes .02 to
.35 of the time of a loop over filters (``python tests/benchmarks/compare_peers.py``, the column of the bank).
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array, numbers
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.covariance import NotPositiveDefiniteError
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling, ratio
from robust_filterpy.correction.whitening import SingularInnovationError, standardized
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.influence.information import expected_joint_information

__all__ = ["FilterBank"]

_EPS = sys.float_info.epsilon


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
        Measurement noise covariance.
    y, e, weights : ndarray, shape (n, dim_z)
        Innovation, standardized innovation (0 where missing) and psi(e)/e (NaN where missing) of the last update.
    S : ndarray, shape (n, dim_z, dim_z)
        Innovation covariance; a missing component has a row of the identity.
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
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
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

    @np.errstate(all="ignore")
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
        Bu = None if u is None else self._control(B, u)
        kernel = dispatch.bank(self._choices)
        if kernel is not None:
            moved, covariance = np.empty((self.n, d)), np.empty((self.n, d, d))
            control = np.zeros((1, d)) if Bu is None else Bu
            if kernel.predict(*(dispatch.usable(a) for a in (x, P, F, Q, control)), moved, covariance):
                self.x, self.P = moved, covariance
                return
        if len(F) == 1:
            # One product for all: P F' as rows, and then the other side through the transpose.
            moved = x @ F[0].T
            half = (P.reshape(-1, d) @ F[0].T).reshape(P.shape)
            covariance = (half.transpose(0, 2, 1).reshape(-1, d) @ F[0].T).reshape(P.shape)
        else:
            moved = (F @ x[:, :, None])[:, :, 0]
            covariance = F @ P @ F.transpose(0, 2, 1)
        covariance += Q
        covariance += covariance.transpose(0, 2, 1).copy()
        covariance *= 0.5
        if Bu is not None:
            moved = moved + Bu
        if not math.isfinite(moved.sum() + covariance.sum()):
            raise ValueError("predict: expected finite x and P, got NaN or infinity; check x, P, F, Q, B and u")
        self.x, self.P = moved, covariance

    @np.errstate(all="ignore")
    def update(self, z: ArrayLike | None) -> None:
        """Correct every state by its measurement (paper 37, 39, 42, 44, 47, 49).

        Parameters
        ----------
        z : array_like, shape (n, dim_z), or None
            Measurements; NaN marks a missing component, a row of NaN a filter that has none, None that all have none.

        Raises
        ------
        ValueError
            If a shape does not fit, z is infinite or an R no covariance.
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
            _require_covariances(R)
            self._checked = R.copy() if m > 1 else None
        seen = z == z
        kernel = dispatch.bank(choices)
        if kernel is None:
            found = self._corrected(x, P, z, H, R, seen)
        else:
            found = self._by_kernel(kernel, x, P, z, H, R, seen)
        self.x, self.P, self.y, self.e, self.S, self.weights = found

    def _by_kernel(
        self, kernel: Any, x: Array, P: Array, z: Array, H: Array, R: Array, seen: np.ndarray
    ) -> tuple[Array, ...]:
        """Correct by the kernel, and in numpy what that leaves to the definition."""
        n, m = self.n, self.dim_z
        x, P = x.copy(), np.array(P, order="C")
        y, e, weights, S = np.empty((n, m)), np.empty((n, m)), np.empty((n, m)), np.empty((n, m, m))
        fine = np.zeros(n, dtype=np.bool_)
        arrays = (dispatch.usable(a) for a in (z, H, R))
        kernel.correct(x, P, *arrays, dispatch.encoded(self._choices, m), y, e, S, weights, fine)
        left = np.flatnonzero(~fine)
        if left.size:
            H, R = (a if len(a) == 1 else a[left] for a in (H, R))
            try:
                rest = self._corrected(x[left], P[left], z[left], H, R, seen[left])
            except (ValueError, np.linalg.LinAlgError) as error:
                error.args = (renumbered(str(error), "filter", left), *error.args[1:])
                raise
            for whole, part in zip((x, P, y, e, S, weights), rest, strict=True):
                whole[left] = part
        return x, P, y, e, S, weights

    def _corrected(self, x: Array, P: Array, z: Array, H: Array, R: Array, seen: np.ndarray) -> tuple[Array, ...]:
        """Return x, P, y, e, S and weights after the correction, all filters at once."""
        m, d, n = self.dim_z, self.dim_x, len(x)
        everything = bool(seen.all())
        if len(H) == 1 and everything:
            C = (P.reshape(-1, d) @ H[0].T).reshape(n, d, m)
            y = z - x @ H[0].T
        else:
            # A sensor whose row of H is zero and whose noise is independent moves nothing, like a missing one.
            H = H * seen[:, :, None]
            C = P @ H.transpose(0, 2, 1)
            y = np.where(seen, z, 0.0) - (H @ x[:, :, None])[:, :, 0]
            R = R * (seen[:, :, None] & seen[:, None, :])
        S = H @ C + R
        if not everything:
            S[:, np.arange(m), np.arange(m)] += ~seen
        T, defect = self._standardize(S)
        e = y * T[:, :, 0] if m == 1 else (T @ y[:, :, None])[:, :, 0]
        for s in np.flatnonzero(~np.isfinite(e).all(axis=1)):
            if not np.isfinite(y[s]).all():
                raise ValueError(f"filter {s}: update: expected finite innovations, got NaN or infinity; check x and H")
            e[s] = standardized(T[s], y[s])
        psi, w, D = self._bound(e, seen, H)
        G = C * T if m == 1 else C @ T.transpose(0, 2, 1)
        full = bool((D == 1.0).all()) if D.ndim == 2 else False
        GD = G if full else G * D[:, None, :] if D.ndim == 2 else G @ D
        K = GD * T if m == 1 else GD @ T
        moved = x + (G[:, :, 0] * psi if m == 1 else (G @ psi[:, :, None])[:, :, 0])
        # In place: a large array's fresh memory costs more than the arithmetic.
        W = K * H if m == 1 else K @ H
        np.subtract(np.eye(d), W, out=W)
        covariance = W @ P @ W.transpose(0, 2, 1)
        # What is left of the noise: K R K' + G (D - D^2) G' + G D (I - T S T') D G'.
        covariance += _sandwich(K, R)
        unused = D - D * D if D.ndim == 2 else D - D @ D
        if unused.any():
            covariance += (G * unused[:, None, :]) @ G.transpose(0, 2, 1) if D.ndim == 2 else _sandwich(G, unused)
        if defect is not None:
            covariance += _sandwich(GD, defect)
        covariance += covariance.transpose(0, 2, 1).copy()
        covariance *= 0.5
        if self._choices.scaling == "unit":
            least = np.linalg.eigvalsh(covariance)[:, 0]
            bad = np.flatnonzero(least < -1e-13 * np.abs(covariance).max(axis=(1, 2)))
            if bad.size:
                raise NotPositiveDefiniteError(
                    f'filter {bad[0]}: scaling="unit" would make P indefinite: it needs D H P H\' < 1 in the unit of '
                    f'the measurement squared; use scaling="bounded" or "innovation"'
                )
        return moved, covariance, y, e, S, w if everything else np.where(seen, w, np.nan)

    def state(self) -> dict[str, Array]:
        """Return everything that the filters need to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            ``format``, as in `RobustKalmanFilter.state`; x, P, F, Q, H and R.
        """
        x, P = self._state()
        return _state.labelled("FilterBank", {"x": x, "P": P, **{name: getattr(self, name) for name in "FQHR"}})

    def restore(self, state: Any) -> None:
        """Go back to a state of this bank, or of another one of the same sizes.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it; F, Q, H and R stay as they are if it
            does not hold them.

        Raises
        ------
        ValueError
            If it is not of a bank or of a newer format, an array is missing, does not fit, or is not finite, or a P is
            no covariance; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit; y, e, S and weights show nothing until the next `update`.
        """
        n, d, m = self.n, self.dim_x, self.dim_z
        sizes = {"F": (d, d), "Q": (d, d), "H": (m, d), "R": (m, m)}
        shared = [name for name in sizes if name in state and np.ndim(state[name]) == 2]
        optional = {name: shape if name in shared else (n, *shape) for name, shape in sizes.items()}
        found = _state.checked(state, "FilterBank", {"x": (n, d), "P": (n, d, d)}, optional)
        if not _checks.all_covariances(0.5 * (found["P"] + found["P"].swapaxes(1, 2))):
            for i, matrix in enumerate(found["P"]):
                _state.require_covariance(f"P[{i}]", matrix)
        for name, value in found.items():
            setattr(self, name, value)
        self.y, self.e = np.zeros((n, m)), np.zeros((n, m))
        self.S, self.weights = np.zeros((n, m, m)), np.full((n, m), np.nan)

    @property
    @np.errstate(all="ignore")
    def log_likelihood(self) -> Array:
        """Log-likelihood of each filter's last measurement, 0 where all of it was missing."""
        seen = self.weights == self.weights
        count = seen.sum(axis=1)
        if not seen.any():
            return np.zeros(self.n)
        choices, e = self._choices, self.e
        if choices.scaling != "innovation":
            e = (_whitening(self.S) @ self.y[:, :, None])[:, :, 0]
        # A missing component has a row of the identity in S.
        log_det = np.log(self.S[:, 0, 0]) if self.dim_z == 1 else np.linalg.slogdet(self.S)[1]
        normal = getattr(choices.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
        if choices.grouping == "component":
            loss = np.where(seen, choices.evaluated("rho", e), 0.0).sum(axis=1) + count * normal(1)
        else:
            table = np.array([0.0, *(normal(dim) for dim in range(1, self.dim_z + 1))])
            loss = choices.evaluated("rho", _lengths(e)) + table[count]
        return np.where(count > 0, -np.minimum(loss, sys.float_info.max) - 0.5 * log_det, 0.0)

    _checked: Array | None = None

    def _state(self) -> tuple[Array, Array]:
        """Return x and P, checked."""
        x, P = numbers("x", self.x), numbers("P", self.P)
        for name, value, shape in (("x", x, (self.n, self.dim_x)), ("P", P, (self.n, self.dim_x, self.dim_x))):
            if value.shape != shape:
                raise ValueError(f"{name}: expected shape {shape} for n={self.n}, got {value.shape}")
        return x, P

    def _control(self, B: Any, u: Any) -> Array:
        """Return B u, shape (n, dim_x), checked."""
        B, d = numbers("B", B), self.dim_x
        if B.ndim not in (2, 3) or B.shape[-2] != d:
            raise ValueError(f"B: expected shape ({d}, dim_u) or ({self.n}, {d}, dim_u), got {B.shape}")
        return np.asarray((B @ np.broadcast_to(numbers("u", u), (self.n, B.shape[-1]))[:, :, None])[:, :, 0])

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
        if scaling == "innovation":
            return _whitening(S), None
        if scaling == "bounded":
            return _bounded_whitening(S)
        _whitening(S)
        unit = np.broadcast_to(np.eye(self.dim_z), S.shape)
        return unit, unit - S

    def _bound(self, e: Array, seen: np.ndarray, H: Array) -> tuple[Array, Array, Array]:
        """Return psi(e), psi(e)/e and D, its diagonals (n, m) or matrices (n, m, m)."""
        choices, influence = self._choices, self._choices.influence
        psi = choices.evaluated("psi", e)
        w = ratio(psi, e)
        if choices.information == "expected":
            D = np.full(e.shape, choices.expected)
        else:
            D = np.clip(choices.evaluated("psi_deriv", e) if choices.information == "realized" else w, 0.0, 1.0)
        if choices.grouping == "component" or self.dim_z == 1:
            return psi, w, D
        visible = np.broadcast_to(H.any(axis=2), seen.shape) & seen
        inside = np.where(visible, e, 0.0)
        length = _lengths(inside)
        direction = inside / np.where(length > 0.0, length, 1.0)[:, None]
        weight = ratio(choices.evaluated("psi", length), length)
        if choices.information == "expected":
            table = np.array([1.0, *(expected_joint_information(influence, i) for i in range(1, self.dim_z + 1))])
            across = radial = np.clip(table, 0.0, 1.0)[visible.sum(axis=1)]
        else:
            across = radial = np.clip(weight, 0.0, 1.0)
            if choices.information == "realized":
                radial = np.where(length > 0.0, np.clip(choices.evaluated("psi_deriv", length), 0.0, 1.0), across)
        matrices = np.where(visible, across[:, None], D)[:, :, None] * np.eye(self.dim_z)
        matrices += (radial - across)[:, None, None] * direction[:, :, None] * direction[:, None, :]
        psi = np.where(visible, weight[:, None] * inside, psi)
        return psi, np.where(visible, weight[:, None], w), matrices


@np.errstate(invalid="ignore")
def _require_covariances(R: Array) -> None:
    """Raise unless every R is a covariance."""
    if _checks.all_covariances(R):
        return
    bad: list[int] = []
    sentence = ""
    for s, R_s in enumerate(R):
        try:
            _checks.covariance("R", R_s)
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


def _whitening(S: Array) -> Array:
    """Return T = Z^(-1/2) diag(S)^(-1/2) of every S, Z being its correlation matrix."""
    m = S.shape[1]
    variances = np.einsum("sii->si", S)
    _require_positive(variances.min(axis=1), variances.max(axis=1))
    if m == 1:
        return 1.0 / np.sqrt(S)
    unit = np.sqrt(variances)
    Z = S / unit[:, :, None] / unit[:, None, :]
    if m == 2:
        correlation = Z[:, 0, 1]
        _require_positive(1.0 - np.abs(correlation) - 2.0 * _EPS, np.ones(len(S)))
        p, q = 1.0 / np.sqrt(1.0 + correlation), 1.0 / np.sqrt(1.0 - correlation)
        roots = 0.5 * np.stack([p + q, p - q, p - q, p + q], axis=1).reshape(-1, 2, 2)
    else:
        values, vectors = np.linalg.eigh(Z)
        _require_positive(values[:, 0] - m * _EPS * values[:, -1], values[:, -1])
        roots = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(roots / unit[:, None, :])


def _bounded_whitening(S: Array) -> tuple[Array, Array]:
    """Return T = S^(-1/2) of every S, its eigenvalues floored at 1, and I - T S T'."""
    m = S.shape[1]
    if m == 1:
        _require_positive(S[:, 0, 0], S[:, 0, 0])
        return 1.0 / np.sqrt(np.maximum(S, 1.0)), np.maximum(1.0 - S, 0.0)
    if not np.isfinite(S).all():
        raise SingularInnovationError("S = H P H' + R: not finite; check H, P and R")
    values, vectors = np.linalg.eigh(S)
    _require_positive(values[:, 0] - m * _EPS * values[:, -1] * (np.count_nonzero(S, axis=(1, 2)) > m), values[:, -1])
    T = (vectors / np.sqrt(np.maximum(values, 1.0))[:, None, :]) @ vectors.transpose(0, 2, 1)
    # Exactly I where it is I: rounding must not mix the sensors.
    T[values[:, -1] <= 1.0] = np.eye(m)
    return T, (vectors * np.maximum(1.0 - values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)


def _lengths(e: Array) -> Array:
    """Return |e| of every row, at most the largest float, without overflow."""
    peak = np.abs(e).max(axis=1)
    scale = np.where(peak > 0.0, peak, 1.0)
    with np.errstate(over="ignore"):
        return np.minimum(scale * np.linalg.norm(e / scale[:, None], axis=1), sys.float_info.max)


def renumbered(message: str, word: str, rows: np.ndarray) -> str:
    """Return the message of a bank with the number of its filter replaced by that of a row: "filter 2: .."."""
    head, colon, rest = message.partition(": ")
    found, _, number = head.partition(" ")
    return f"{word} {rows[int(number)]}: {rest}" if colon and found == "filter" and number.isdigit() else message


def _require_positive(least: Array, most: Array) -> None:
    """Raise unless every S has an inverse."""
    bad = np.flatnonzero(~((least > 0.0) & (most < math.inf)))
    if bad.size:
        raise SingularInnovationError(
            f"filter {bad[0]}: S = H P H' + R is singular or not finite; make R positive definite"
        )
