"""R and Q for those without a data sheet: scale factors by maximum likelihood of a model that knows of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import control_term, measured, noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array

__all__ = ["NoiseEstimate", "estimate_noise"]

Groups = bool | str | Sequence[int]
# Log of the scale factors, logit of the contamination, log of the scale ratio: where the search may go.
_SCALE_LIMIT = 16.0
_LOGIT_LIMITS = (-9.0, 0.0)
_RATIO_LIMITS = (np.log(2.0), np.log(1e4))
_STEP = 1e-3


@dataclass(frozen=True)
class NoiseEstimate:
    """Hold what `estimate_noise` found.

    Attributes
    ----------
    R : ndarray, shape (dim_z, dim_z)
        Measurement noise covariance of the ordinary samples.
    Q : ndarray, shape (dim_x, dim_x)
        Process noise covariance.
    R_scale : ndarray, shape (dim_z,)
        Factor by which the variance of each sensor was multiplied.
    Q_scale : ndarray, shape (dim_x,)
        Factor by which the variance of each state's noise was multiplied.
    contamination : float
        Estimated share of outliers.
    scale_ratio : float
        Estimated standard deviation of outliers over that of ordinary samples; means little where contamination
        is close to 0.
    log_likelihood : float
        Of the recording, at the estimate.
    converged : bool
        Whether the optimiser says so and no scale ended at the limit of the search.
    message : str
        Why the search ended.
    """

    R: Array
    Q: Array
    R_scale: Array
    Q_scale: Array
    contamination: float
    scale_ratio: float
    log_likelihood: float
    converged: bool
    message: str

    def apply(self, filter: Any) -> Any:
        """Give a filter this R and Q.

        Parameters
        ----------
        filter : KalmanFilter
            Any filter with attributes R and Q of these shapes.

        Returns
        -------
        KalmanFilter
            The same filter.
        """
        filter.R, filter.Q = self.R.copy(), self.Q.copy()
        return filter


class _Data(NamedTuple):
    """A linear model with its data, as arrays."""

    zs: Array
    inputs: Array
    x: Array
    P: Array
    F: Array
    H: Array
    Q: Array
    R: Array
    alpha_sq: float


def estimate_noise(
    filter: Any,
    zs: Any,
    *,
    us: Any = None,
    R: Groups = True,
    Q: Groups = True,
    contamination: float | None = None,
    scale_ratio: float | None = None,
) -> NoiseEstimate:
    """Fit scale factors of R and Q to a recording with outliers.

    Maximises the likelihood of the innovations under a measurement noise (1 - eps) N(0, R) + eps N(0, ratio^2 R)
    (paper 17), eps and the ratio being fitted too. Under a normal model a few outliers multiply the estimate of R.

    Parameters
    ----------
    filter : KalmanFilter
        Of filterpy or of this package, linear, with F, H, x, P set and R, Q as the first guess. It is not changed.
    zs : array_like, shape (N,) or (N, dim_z), or sequence
        Measurements as `batch_filter` takes them: NaN and None are missing.
    us : array_like, shape (N,) or (N, dim_u), optional
        Control inputs.
    R, Q : bool, "each" or sequence of int, default True
        What to scale: everything by one factor (True), nothing (False), every variance by a factor of its own
        ("each"), or variances in groups: ``[0, 0, 1]`` gives the first two one factor and the third another, -1
        leaves one as it is. Off-diagonal entries keep their correlation.
    contamination : float, optional
        Share of outliers in [0, 1), if it is known.
    scale_ratio : float, optional
        Standard deviation of outliers over that of ordinary samples, > 1, if it is known.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    TypeError
        If filter is not a linear filter of filterpy's kind.
    ValueError
        If the recording has fewer than 10 measurements, or an option or shape does not fit.

    Notes
    -----
    Factors that the data do not determine (Q of a state that hardly shows) run to the limit of the search, exp(-16)
    or exp(16); ``converged`` is then False. The sampling error of a variance is about sqrt(2/N) at best.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> rng = np.random.default_rng(0)
    >>> level = np.cumsum(0.5 * rng.standard_normal(600))
    >>> zs = level + np.where(rng.random(600) < 0.1, 20.0, 2.0) * rng.standard_normal(600)
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H = np.eye(1)
    >>> found = estimate_noise(kf, zs)
    >>> bool(2.8 < found.R[0, 0] < 5.2), bool(0.1 < found.Q[0, 0] < 0.5)
    (True, True)
    """
    from scipy.optimize import minimize

    data = _recording(filter, zs, us)
    groups_R, groups_Q = _groups("R", R, len(data.R)), _groups("Q", Q, len(data.Q))
    count_R, count_Q = groups_R.max() + 1, groups_Q.max() + 1
    known = _known_outliers(contamination, scale_ratio)

    def unpacked(points: Array) -> tuple[Array, Array, Array, Array]:
        logs_R = np.concatenate([points[:, :count_R], np.zeros((len(points), 1))], axis=1)[:, groups_R]
        logs_Q = np.concatenate([points[:, count_R : count_R + count_Q], np.zeros((len(points), 1))], axis=1)
        share = np.full(len(points), known[0]) if known[0] is not None else 1 / (1 + np.exp(-points[:, -2]))
        ratio = np.full(len(points), known[1]) if known[1] is not None else np.exp(points[:, -1])
        return logs_R, logs_Q[:, groups_Q], share, ratio

    def cost(points: Array, some: _Data = data) -> Array:
        return -_log_likelihoods(some, *unpacked(points)) / len(some.zs)

    def cost_and_gradient(point: Array) -> tuple[float, Array]:
        # All neighbours advance together, so the gradient costs little more than the value.
        offsets = _STEP * np.eye(point.size)
        values = cost(np.concatenate([point[None], point + offsets, point - offsets]))
        return values[0], (values[1 : 1 + point.size] - values[1 + point.size :]) / (2 * _STEP)

    limits = [(-_SCALE_LIMIT, _SCALE_LIMIT)] * (count_R + count_Q) + [_LOGIT_LIMITS, _RATIO_LIMITS]
    start = _start(count_R, count_Q, lambda points: cost(points, data._replace(zs=data.zs[:400])))
    found = minimize(cost_and_gradient, start, jac=True, method="L-BFGS-B", bounds=limits)
    logs_R, logs_Q, share, ratio = (part[0] for part in unpacked(found.x[None]))
    at_limit = bool((np.abs(found.x[: count_R + count_Q]) > _SCALE_LIMIT - 1e-6).any())
    return NoiseEstimate(
        R=_scaled(data.R, logs_R),
        Q=_scaled(data.Q, logs_Q),
        R_scale=np.exp(logs_R),
        Q_scale=np.exp(logs_Q),
        contamination=float(share),
        scale_ratio=float(ratio),
        log_likelihood=float(-found.fun * len(data.zs)),
        converged=bool(found.success) and not at_limit,
        message="a scale factor ended at the limit of the search" if at_limit else str(found.message),
    )


def _start(count_R: int, count_Q: int, cost: Any) -> Array:
    """Return the best point of a grid over one factor for R and one for Q."""
    steps = np.log(10.0) * np.arange(-5.0, 6.0)
    log_R, log_Q = (steps if count else np.zeros(1) for count in (count_R, count_Q))
    grid = [[*[r] * count_R, *[q] * count_Q, -3.0, np.log(6.0)] for r in log_R for q in log_Q]
    points = np.array(grid)
    return np.asarray(points[np.argmin(cost(points))])


def _known_outliers(contamination: float | None, scale_ratio: float | None) -> tuple[float | None, float | None]:
    """Return what the user knows of the outliers, checked."""
    share = None if contamination is None else _checks.fraction("contamination", contamination)
    ratio = None if scale_ratio is None else _checks.positive("scale_ratio", scale_ratio)
    if ratio is not None and ratio <= 1.0:
        raise ValueError(f"scale_ratio: expected a number > 1, got {scale_ratio!r}")
    return share, ratio


def _groups(name: str, value: Groups, size: int) -> np.ndarray:
    """Return the group of each variance, -1 where it stays."""
    if isinstance(value, (bool, np.bool_)):
        return np.full(size, 0 if value else -1)
    if isinstance(value, str):
        _checks.option(name, value, ("each",))
        return np.arange(size)
    groups = np.asarray(value)
    if groups.shape != (size,) or groups.dtype.kind not in "iu":
        raise ValueError(f'{name}: expected True, False, "each" or {size} integers, got {value!r}')
    present = sorted(set(groups.tolist()) - {-1})
    if present != list(range(len(present))):
        raise ValueError(f"{name}: expected groups numbered 0, 1, ... (and -1), got {value!r}")
    return groups


def _recording(kf: Any, zs: Any, us: Any) -> _Data:
    """Return the model and the data of a filter as arrays, checked."""
    missing = [name for name in ("x", "P", "F", "H", "R", "Q", "dim_x") if not hasattr(kf, name)]
    if missing or hasattr(kf, "hx") or hasattr(kf, "points_fn"):
        raise TypeError(f"filter: expected a linear filter such as RobustKalmanFilter, got {type(kf).__name__}")
    x, P = state_of(kf)
    n, m = kf.dim_x, len(kf.H)
    F, H = _checks.matrix("F", kf.F, (n, n), "dim_x"), _checks.matrix("H", kf.H, (m, n), f"dim_z={m}, dim_x={n}")
    Q = process_noise(kf.Q, None, n) * np.ones((n, n))
    rows = [measured(z, m, missing=True) if z is not None else np.full(m, np.nan) for z in zs]
    data = np.array(rows, dtype=float).reshape(len(rows), m)
    if len(rows) < 10 or not (data == data).any():
        raise ValueError(f"zs: expected at least 10 measurements that are not all missing, got {len(rows)}")
    inputs = np.zeros((len(rows), n))
    if us is not None and kf.B is not None:
        if len(us) != len(rows):
            raise ValueError(f"us: expected {len(rows)} inputs, one for each measurement, got {len(us)}")
        inputs[:] = [control_term(kf.B, u, (n,)) for u in us]
    return _Data(data, inputs, x.ravel(), P, F, H, Q, noise_covariance(kf.R, None, m), kf._alpha_sq)


def _scaled(covariance: Array, logs: Array) -> Array:
    """Multiply variances by exp(logs) and keep correlations; logs may have leading axes."""
    root = np.exp(0.5 * logs)
    return np.asarray(root[..., :, None] * covariance * root[..., None, :])


def _log_likelihoods(data: _Data, logs_R: Array, logs_Q: Array, share: Array, ratio: Array) -> Array:
    """Return the log-likelihood of the recording for each of p candidates, which advance together.

    Each step merges two hypotheses, ordinary or outlier, by moments: the noise-matched filter of
    `robust_filterpy.filters.gaussian_sum`, for many noise models at once.
    """
    p = len(share)
    R, Q = _scaled(data.R, logs_R), _scaled(data.Q, logs_Q)
    x, P = np.tile(data.x, (p, 1)), np.tile(data.P, (p, 1, 1))
    with np.errstate(divide="ignore"):
        log_share = np.stack([np.log1p(-share), np.log(share)])
    extra = (ratio**2 - 1.0)[:, None, None] * R
    total = np.zeros(p)
    for z, w in zip(data.zs, data.inputs, strict=False):
        x = x @ data.F.T + w
        P = data.alpha_sq * (data.F @ P @ data.F.T) + Q
        part = np.flatnonzero(z == z)
        if part.size == 0:
            continue
        H = data.H[part]
        pick = np.ix_(np.arange(p), part, part)
        C = P @ H.T
        S = H @ C + R[pick]
        both = np.stack([S, S + extra[pick]])
        inverse = np.linalg.inv(both)
        y = z[part] - x @ H.T
        g = (inverse @ y[:, :, None])[..., 0]
        determinant = np.linalg.slogdet(both)[1] + part.size * np.log(2.0 * np.pi)
        logs = log_share - 0.5 * (determinant + (y * g).sum(axis=-1))
        top = logs.max(axis=0)
        weights = np.exp(logs - top)
        norm = weights.sum(axis=0)
        total += top + np.log(norm)
        weights /= norm
        score = (weights[..., None] * g).sum(axis=0)
        spread = g - score
        information = (weights[..., None, None] * (inverse - spread[..., :, None] * spread[..., None, :])).sum(axis=0)
        x = x + (C @ score[:, :, None])[..., 0]
        P = P - C @ information @ np.swapaxes(C, -1, -2)
        P = 0.5 * (P + np.swapaxes(P, -1, -2))
    return np.where(np.isfinite(total), total, -np.inf)
