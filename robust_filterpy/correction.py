"""The equations of the robust correction, as pure functions of arrays: the one place where they stand.

For an innovation y = z - H x with covariance S = H P H' + R and cross-covariance C = P H'::

    e  = T y                       standardized innovation            (paper 29, 36)
    x+ = x + C T' psi(e)           bounded influence                  (26, 37, 42, 47)
    P+ = P - C T' D T C'           information D between 0 and I      (28, 39, 44, 49)

T, D and psi are `Choices`. `correct` is the definition; the short forms for one sensor (below it), for two (`_pair`)
and for joint grouping (`_joint`) say the same, and the tests hold them together.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from robust_filterpy._checks import Array
from robust_filterpy.choices import Choices, length_and_direction, ratio

__all__ = [
    "Choices",
    "Correction",
    "NotPositiveDefiniteError",
    "SingularInnovationError",
    "correct",
    "log_density",
    "posterior_covariance",
    "standardize",
]

Inverse = Callable[[Array], Array]
_DEFAULT = Choices()
_LARGEST = sys.float_info.max
_EPS = sys.float_info.epsilon
# Up to here a product with T does not overflow.
SAFE = 1e150


class NotPositiveDefiniteError(np.linalg.LinAlgError):
    """Say that scaling "unit" would make P indefinite: it is a filter only while H P H' < 1."""


class SingularInnovationError(np.linalg.LinAlgError):
    """Say that the innovation covariance S has no inverse."""


class Correction(NamedTuple):
    """Posterior and everything that led to it. Where a component is missing, y, e, psi, T, SI and K are 0."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    y: Array
    """Innovation z - H x, shape (m,)."""
    S: Array
    """Innovation covariance, shape (m, m)."""
    SI: Array | None
    """Its inverse, shape (m, m); None under scaling "innovation", where it is T T."""
    K: Array
    """Gain before psi, C T'T, shape (n, m): x+ = x + K y_bounded."""
    T: Array
    """Scaling, shape (m, m)."""
    e: Array
    """Standardized innovation T y, shape (m,)."""
    psi: Array
    """psi(e), shape (m,)."""
    slope: Array | list[float]
    """psi'(e), NaN where missing, m floats."""

    @property
    def inverse(self) -> Array:
        """Inverse of S, shape (m, m)."""
        return self.T.dot(self.T) if self.SI is None else self.SI

    @property
    def y_bounded(self) -> Array:
        """Bounded innovation T^-1 psi(T y), in the measurement's unit, shape (m,)."""
        if np.array_equal(self.psi, self.e):
            return np.array(self.y)
        if self.T.shape == (1, 1):
            return self.psi / self.T[0]
        return np.asarray(np.linalg.pinv(self.T, hermitian=True) @ self.psi)

    @property
    def weights(self) -> Array:
        """psi(e)/e, NaN where missing, shape (m,)."""
        return np.where(np.isnan(self.slope), np.nan, ratio(self.psi, self.e))

    @property
    def clipped(self) -> np.ndarray:
        """Whether psi'(e) <= 0, bool, shape (m,): the component tells no more by being further away."""
        return np.asarray(self.slope) <= 0.0


class Observed(NamedTuple):
    """`Correction` by a complete measurement, with C in place of K, at which few programs look."""

    x: Array
    P: Array
    C: Array
    y: Array
    S: Array
    SI: Array | None
    T: Array
    e: Array
    psi: Array
    slope: Array | list[float]

    def as_arrays(self) -> Correction:
        """Return the same with K."""
        x, P, C, y, S, SI, T, e, psi, slope = self
        return Correction(x, P, y, S, SI, C.dot(T).dot(T), T, e, psi, slope)


def correct(
    x: Array,
    P: Array,
    y: Array,
    H: Array,
    R: Array,
    choices: Choices = _DEFAULT,
    M: Array | None = None,
    inv: Inverse | None = None,
) -> Correction:
    """Correct a state by an innovation whose influence is bounded.

    x+ = x + C T' psi(T y) and P+ = P - C T' D T C' (paper 26-28, 37-39, 42-44, 47-49).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    P : ndarray, shape (n, n)
        Prior covariance.
    y : ndarray, shape (m,)
        Innovation z - H x; NaN marks a missing component.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Measurement noise covariance, positive definite.
    choices : Choices
        Influence function, scaling, information, grouping.
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise; then C = P H' + M and
        S = H P H' + H M + M' H' + R.
    inv : callable, optional
        What inverts S, such as `numpy.linalg.pinv`; T is then the symmetric root of inv(S). By default a
        singular S is an error.

    Returns
    -------
    Correction

    Raises
    ------
    NotPositiveDefiniteError
        If scaling is "unit" and P+ would be indefinite.
    SingularInnovationError
        If S is singular and inv is not given.

    Examples
    --------
    >>> c = correct(np.zeros(1), np.eye(1), np.array([100.0]), np.eye(1), np.eye(1))
    >>> c.x.round(3), c.P, c.clipped
    (array([0.951]), array([[1.]]), array([ True]))
    """
    if sum(map(abs, y.tolist())) < SAFE:
        return correct_observed(x, P, y, H, R, choices, M, inv).as_arrays()
    part = np.flatnonzero(y == y)
    if part.size == y.size:
        return correct_observed(x, P, y, H, R, choices, M, inv, small=False).as_arrays()
    _, S = innovation_moments(P, H, R, M)
    if part.size == 0:
        return nothing_observed(x, P, S, y.size)
    M = None if M is None else M[:, part]
    some = correct_observed(x, P, y[part], H[part], R[np.ix_(part, part)], choices, M, inv, small=False)
    return _embed(some.as_arrays(), part, S)


def correct_observed(
    x: Array,
    P: Array,
    y: Array,
    H: Array,
    R: Array,
    choices: Choices,
    M: Array | None = None,
    inv: Inverse | None = None,
    small: bool = True,
) -> Observed:
    """Correct with every component observed, all of them below `SAFE` or not: the equations as they read."""
    C, S = innovation_moments(P, H, R, M)
    T, SI, defect = standardize(S, choices.scaling, inv)
    e = T.dot(y) if small else standardized(T, y)
    psi, D, slope = choices.bound(e, None if choices.grouping == "component" else H.any(axis=1))
    G = C.dot(T)
    x_post = x + G.dot(psi)
    P_post = posterior_covariance(P, H, R, G, T, D, defect, M)
    if choices.scaling == "unit":
        _require_positive(P_post, D, S - R)
    return Observed(x_post, P_post, C, y, S, SI, T, e, psi, slope)


def innovation_moments(P: Array, H: Array, R: Array, M: Array | None) -> tuple[Array, Array]:
    """Return C = P H' + M and S = H P H' + H M + M' H' + R."""
    C = P.dot(H.T)
    S = H.dot(C)
    S += R
    if M is not None:
        C += M
        HM = H.dot(M)
        S += HM + HM.T
    return C, S


def standardize(S: Array, scaling: str, inv: Inverse | None = None) -> tuple[Array, Array | None, Array | None]:
    """Return the scaling T of innovations with covariance S.

    T = S^(-1/2), the symmetric root (paper 36); T = I (42); or S^(-1/2) with the eigenvalues of S floored at 1.

    Parameters
    ----------
    S : ndarray, shape (m, m)
        Innovation covariance.
    scaling : {"innovation", "unit", "bounded"}
        Which T.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    T : ndarray, shape (m, m)
        Symmetric.
    SI : ndarray, shape (m, m), or None
        Inverse of S; None where it is T T.
    defect : ndarray, shape (m, m), or None
        I - T S T'; None where it is 0.

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.
    """
    m = len(S)
    if scaling == "unit":
        return np.eye(m), _inverse(S) if inv is None else inv(S), np.eye(m) - S
    if inv is not None:
        return _root_of_inverse(inv(S), S, scaling)
    if scaling == "innovation" and m == 2:
        (a, b), (_, c) = S.tolist()
        p, q, r = root_of_pair(a, b, c)
        return np.array([[p, q], [q, r]]), None, None
    values, vectors = _eigen(S)
    if scaling == "bounded":
        quarter = vectors / np.maximum(values, 1.0) ** 0.25
        defect = (vectors * np.maximum(1.0 - values, 0.0)).dot(vectors.T)
        return quarter.dot(quarter.T), (vectors / values).dot(vectors.T), defect
    # T as a product of one factor with its own transpose is symmetric to the last bit.
    # A triangular solve of bandwidth 0 divides the rows in half the time of numpy's broadcasting.
    quarter, _ = lapack.dtbtrs(np.sqrt(np.sqrt(values))[None], vectors.T)
    return quarter.T.dot(quarter), None, None


def standardized(T: Array, y: Array) -> Array:
    """Return e = T y (paper 29), finite even where the product overflows."""
    peak = max(map(abs, y.tolist()))
    if peak < SAFE:
        return T.dot(y)
    with np.errstate(over="ignore"):
        return np.clip(T.dot(y / peak) * peak, -_LARGEST, _LARGEST)


def posterior_covariance(
    P: Array,
    H: Array,
    R: Array,
    G: Array,
    T: Array,
    D: Array | list[float],
    defect: Array | None = None,
    M: Array | None = None,
) -> Array:
    """Return P+ = P - G D G' with G = C T', in a form that stays positive semidefinite in rounding.

    With K_D = G D T it is Joseph's form of the gain K_D, plus what psi leaves unused::

        P+ = (I - K_D H) P (I - K_D H)' + K_D R K_D' - (I - K_D H) M K_D' - K_D M' (I - K_D H)'
             + G (D - D^2 + D (I - T S T') D) G'

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Prior covariance.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Measurement noise covariance.
    G : ndarray, shape (n, m)
        Standardized gain C T'.
    T : ndarray, shape (m, m)
        Scaling.
    D : list of m floats, or ndarray, shape (m, m)
        Information, its diagonal or the matrix.
    defect : ndarray, shape (m, m), optional
        I - T S T'; None where it is 0.
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise.

    Returns
    -------
    ndarray, shape (n, n)
        Symmetric to rounding; the form contracts what asymmetry there is.
    """
    unused = None
    if isinstance(D, list):
        none, whole = D.count(0.0), D.count(1.0)
        if none == len(D):
            return P.copy()
        if none + whole == len(D):
            GD = G.dot(_diagonal(tuple(D))) if none else G
        else:
            d = np.array(D)
            GD = G * d
            unused = (G * (d - d * d)).dot(G.T)
    else:
        GD = G.dot(D)
        unused = G.dot(D - D.dot(D)).dot(G.T)
    P_post = joseph(P, H, R, GD.dot(T), M)
    if unused is not None:
        P_post += unused
    if defect is not None:
        P_post += GD.dot(defect).dot(GD.T)
    return P_post


def joseph(P: Array, H: Array, R: Array, K: Array, M: Array | None, unused: Array | None = None) -> Array:
    """Return the covariance that a gain K leaves, (I - K H) P (I - K H)' + (K R + unused) K', and the terms of M."""
    I_KH = _identity(len(P)) - K.dot(H)
    P_post = I_KH.dot(P).dot(I_KH.T)
    noise = K.dot(R)
    if unused is not None:
        noise += unused
    P_post += noise.dot(K.T)
    if M is not None:
        cross = I_KH.dot(M).dot(K.T)
        P_post -= cross + cross.T
    return P_post


@lru_cache(maxsize=256)
def _diagonal(entries: tuple[float, ...]) -> Array:
    """Return a diagonal matrix, to be read only."""
    matrix = np.diag(entries)
    matrix.flags.writeable = False
    return matrix


@lru_cache(maxsize=64)
def _identity(n: int) -> Array:
    """Return I, to be read only."""
    return _diagonal((1.0,) * n)


def _require_positive(P_post: Array, D: Array | list[float], N: Array) -> None:
    """Raise if P+ is indefinite, naming H P H'."""
    if np.linalg.eigvalsh(P_post)[0] < -1e-13 * np.abs(P_post).max():
        informed = np.diag(D) if isinstance(D, list) else D
        raise _indefinite(float(np.linalg.eigvals(informed @ N).real.max()))


def _indefinite(hph: float) -> NotPositiveDefiniteError:
    """Return the error of a "unit" correction that would make P indefinite."""
    return NotPositiveDefiniteError(
        f'scaling="unit" would make P indefinite: it needs D H P H\' < 1 in the unit of the measurement squared, '
        f'found {hph:.6g}; use scaling="bounded" or "innovation", a smaller P, or a larger unit of measurement'
    )


def _eigen(S: Array) -> tuple[Array, Array]:
    """Return eigenvalues, ascending, and eigenvectors of a positive definite S."""
    values, vectors, failed = lapack.dsyev(S)
    spread = values.tolist()
    if failed or not spread[0] > len(spread) * _EPS * spread[-1]:
        if not np.isfinite(S).all():
            raise SingularInnovationError("S = H P H' + R: not finite; check H, P and R for NaN, infinity and overflow")
        # Sensors in very different units: as long as they are uncorrelated, the root is exact.
        values, vectors = S.diagonal(), np.eye(len(spread))
        if np.count_nonzero(S) > np.count_nonzero(values) or not values.min() > 0.0:
            raise _singular(spread[0])
    return values, vectors


def _singular(least: float) -> SingularInnovationError:
    """Return the error of an S without inverse."""
    return SingularInnovationError(
        f"S = H P H' + R: singular (least eigenvalue {least:.3g}); make R positive definite, or set "
        f"inv=numpy.linalg.pinv to ignore the directions that carry no information"
    )


def _inverse(S: Array) -> Array:
    """Return the symmetric inverse of a positive definite S."""
    values, vectors = _eigen(S)
    return np.asarray((vectors / values) @ vectors.T)


def root_of_pair(a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return S^(-1/2), S = [[a, b], [b, c]]: with s = sqrt(det S), S^(1/2) = (S + s I)/sqrt(tr S + 2 s)."""
    determinant = a * c - b * b
    if not (a > 0.0 and c > 0.0 and determinant > 4.0 * _EPS * a * c and determinant < math.inf):
        _eigen(np.array([[a, b], [b, c]]))
        correlation = b / math.sqrt(a) / math.sqrt(c)
        s = math.sqrt(a) * math.sqrt(c) * math.sqrt(max(1.0 - correlation**2, 0.0))
        if not 0.0 < s < math.inf:
            raise _singular(s)
    else:
        s = math.sqrt(determinant)
    t = math.sqrt(a + c + 2.0 * s)
    return (c + s) / t / s, -b / t / s, (a + s) / t / s


def _root_of_inverse(SI: Array, S: Array, scaling: str) -> tuple[Array, Array | None, Array | None]:
    """Return the symmetric root of whatever inverse the user wants of S."""
    values, vectors = np.linalg.eigh(0.5 * (SI + SI.T))
    if values[0] < -1e-10 * max(values[-1], 0.0) or not np.isfinite(values).all():
        raise SingularInnovationError(
            f"inv(S): expected a positive semidefinite matrix, got least eigenvalue {values[0]:.3g}; check R and inv"
        )
    kept = values > S.shape[0] * _EPS * max(values[-1], 0.0)
    root = np.sqrt(np.where(kept, values, 0.0))
    if scaling == "bounded":
        root = np.minimum(root, 1.0)
    T = (vectors * root) @ vectors.T
    return T, np.asarray(SI, dtype=float), np.eye(S.shape[0]) - T @ S @ T


def nothing_observed(x: Array, P: Array, S: Array, m: int) -> Correction:
    """Return the correction by a measurement that is missing altogether."""
    zero, square = np.zeros(m), np.zeros((m, m))
    return Correction(x, P, zero, S, square, np.zeros((len(x), m)), square, zero, zero, np.full(m, np.nan))


def _embed(some: Correction, part: np.ndarray, S: Array) -> Correction:
    """Put the correction by the observed components where it belongs among all of them."""
    m, square = len(S), np.ix_(part, part)
    T, SI, K = np.zeros((m, m)), np.zeros((m, m)), np.zeros((some.x.size, m))
    T[square], SI[square], K[:, part] = some.T, some.inverse, some.K
    y, e, psi = (spread(v, part, m) for v in (some.y, some.e, some.psi))
    return Correction(some.x, some.P, y, S, SI, K, T, e, psi, spread(np.array(some.slope), part, m, np.nan))


def embed_block(before: Correction | None, some: Correction, part: slice, m: int) -> Correction:
    """Put the correction by one block of a measurement beside those by the blocks before it."""
    n = len(some.P)
    if before is None or before.T.shape != (m, m) or before.K.shape != (n, m):
        before = nothing_observed(some.x, some.P, np.zeros((m, m)), m)
    square = {}
    for name, block in (("S", some.S), ("SI", some.inverse), ("T", some.T)):
        whole = (before.inverse if name == "SI" else getattr(before, name)).copy()
        whole[part], whole[:, part] = 0.0, 0.0
        whole[part, part] = block
        square[name] = whole
    K = before.K.copy()
    K[:, part] = some.K
    vectors = {}
    for name in ("y", "e", "psi", "slope"):
        vectors[name] = np.array(getattr(before, name), dtype=float)
        vectors[name][part] = getattr(some, name)
    return Correction(some.x, some.P, K=K, **square, **vectors)


def spread(values: Array, part: np.ndarray, m: int, rest: float = 0.0) -> Array:
    """Return m numbers: values at the places in part, rest elsewhere."""
    whole = np.full(m, rest)
    whole[part] = values
    return whole


def log_density(y: Array, S: Array, choices: Choices = _DEFAULT, inv: Inverse | None = None) -> float:
    """Return the log-likelihood of an innovation: log f(S^(-1/2) y) + log det S^(-1/2).

    f(e) is proportional to exp(-rho(e)), so it is normal for an infinite threshold and linear in \\|e\\| beyond a
    finite one. It is standardized by S^(-1/2) whatever the scaling of the filter.

    Parameters
    ----------
    y : ndarray, shape (m,)
        Innovation; NaN marks a missing component.
    S : ndarray, shape (m, m)
        Innovation covariance.
    choices : Choices
        Influence function and grouping.
    inv : callable, optional
        What inverts S; where that leaves out directions, so does the likelihood.

    Returns
    -------
    float
        0 if every component is missing: such a sample tells no model from another.

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    An influence function without a density of its own (redescending, or somebody else's) has f(e) =
    exp(-rho(e))/sqrt(2 pi), which does not integrate to 1.
    """
    observed = np.flatnonzero(y == y)
    if observed.size == 0:
        return 0.0
    if observed.size < y.size:
        y, S = y[observed], S[np.ix_(observed, observed)]
    T, SI, _ = standardize(S, "innovation", inv)
    rank, log_det = observed.size, -np.linalg.slogdet(T)[1]
    if SI is not None:
        values = np.linalg.eigvalsh(0.5 * (SI + SI.T))
        values = values[values > values.size * _EPS * values[-1]]
        rank, log_det = values.size, -0.5 * float(np.log(values).sum())
    e = standardized(T, y)
    return _log_standard_density(e, rank, choices) - float(log_det)


def _log_standard_density(e: Array, rank: int, choices: Choices) -> float:
    """Return log f(e), component by component or of the length."""
    normalizer = getattr(choices.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
    if choices.grouping == "component":
        losses = np.asarray(choices.influence.rho(e), dtype=float)
        total = float(np.minimum(losses, 0.5 * _LARGEST / e.size).sum())
        return -total - rank * normalizer(1)
    length, _ = length_and_direction(e)
    return -min(float(choices.influence.rho(np.array([length]))[0]), _LARGEST) - normalizer(rank)


# One sensor. The same equations in floats, because numpy's call overhead is most of what so small a filter costs.


class ScalarCorrection(NamedTuple):
    """`Correction` for m = 1: what has shape (1,) or (1, 1) there is a float here, and x keeps its shape."""

    x: Array
    P: Array
    y: float
    S: float
    SI: float
    K: Array
    T: float
    e: float
    psi: float
    slope: float

    def as_arrays(self) -> Correction:
        """Return the same with arrays."""
        x, P, y, S, SI, K, T, e, psi, slope = self
        one, square = np.array([y, e, psi, slope])[:, None], np.array([S, SI, T])[:, None, None]
        return Correction(x.ravel(), P, one[0], square[0], square[1], K, square[2], one[1], one[2], [slope])


def correct_scalar(
    x: Array, P: Array, y: float, H: Array, r: float, choices: Choices, M: Array | None = None
) -> ScalarCorrection:
    """Correct by one observed number y: x has shape (n,) or (n, 1), H (1, n); choices.pointwise must exist."""
    C = P.dot(H.T)
    hph = H.dot(C).item()
    s = hph + r
    if M is not None:
        C = C + M
        s += 2.0 * H.dot(M).item()
    if not 0.0 < s < math.inf:
        raise _singular(s)
    scaling, information = choices.scaling, choices.information
    # T^2 and 1 - T S T'
    t2, defect = 1.0 / s, 0.0
    if scaling == "unit":
        t2, defect = 1.0, 1.0 - s
    elif scaling == "bounded" and s < 1.0:
        t2, defect = 1.0, 1.0 - s
    t = math.sqrt(t2)
    e = t * y
    if not -_LARGEST <= e <= _LARGEST:
        e = math.copysign(_LARGEST, y)
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    psi, slope = function(e, a, b, c)
    if information == "realized":
        d = min(max(slope, 0.0), 1.0)
    elif information == "expected":
        d = choices.expected
    else:
        d = min(max(psi / e, 0.0), 1.0) if e != 0.0 else 1.0
    K = C * t2
    # An innovation that is not bounded moves x by exactly what filterpy's arithmetic gives.
    moved = K * (y if psi == e else psi / t)
    x_post = x + (moved if x.ndim == 2 else moved.ravel())
    if d == 0.0:
        return ScalarCorrection(x_post, P.copy(), y, s, 1.0 / s, K, t, e, psi, slope)
    K_d = K if d == 1.0 else K * d
    I_KH = _identity(len(P)) - K_d.dot(H)
    P_post = I_KH.dot(P).dot(I_KH.T)
    # With G = K/T the unused part G (d - d^2 + d^2 (1 - T S T')) G' joins the noise term d^2 K r K'.
    P_post += (K * (d * d * r + (d - d * d + d * d * defect) / t2)).dot(K.T)
    if M is not None:
        cross = I_KH.dot(M).dot(K_d.T)
        P_post -= cross + cross.T
    if scaling == "unit" and d * hph > 1.0 - 1e-9:
        _require_positive(P_post, [d], np.array([[hph]]))
    return ScalarCorrection(x_post, P_post, y, s, 1.0 / s, K, t, e, psi, slope)
