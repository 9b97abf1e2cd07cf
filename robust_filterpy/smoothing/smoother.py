"""Smooth whole recordings in which some measurements, or some steps of the process, are not to be believed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import without_fill_values
from robust_filterpy._warning import warn
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.correction.options import GROUPINGS, Grouping
from robust_filterpy.filters.series import series_arguments
from robust_filterpy.influence.functions import Influence, Linear
from robust_filterpy.smoothing.linear_pass import Recording, linear_recording, problem
from robust_filterpy.smoothing.nonlinear import is_nonlinear, nonlinear_trajectory
from robust_filterpy.smoothing.rules import Learnt, Psi, Rule, rule_of
from robust_filterpy.smoothing.sweeps import doubted_stretches, log_probability, misfits, reweighted

__all__ = ["Smoothed", "smooth", "smooth_series"]

# By how many nats another reading of a recording has to be more probable.
_CLEARLY = 0.5
# Of the largest variance of a state: one that is so far below zero is lost.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class Smoothed:
    """Hold what a smoother found; S series have an axis of length S in front of everything.

    Attributes
    ----------
    x : ndarray, shape (N, dim_x) or (N, dim_x, 1)
        Smoothed states, in the shape of the filter's x.
    P : ndarray, shape (N, dim_x, dim_x)
        Their covariances.
    weights : ndarray, shape (N, dim_z)
        How much each measurement was believed: 1 is full trust, NaN a missing component.
    process_weights : ndarray, shape (N,)
        The same of the step that leads to each state: small where the state jumped.
    contamination, scale_ratio : ndarray, shape (dim_z,)
        Share of outliers and their standard deviation over that of ordinary noise, where they were learned, else NaN.
    process_contamination, process_scale_ratio : float
        The same of the process noise.
    converged : bool
        Whether the estimate had come to rest.
    sweeps : int
        How many times the recording was smoothed.
    message : str
        Why the search ended, and what is odd about the result.
    """

    x: Array
    P: Array
    weights: Array
    process_weights: Array
    contamination: Array
    scale_ratio: Array
    process_contamination: Any
    process_scale_ratio: Any
    converged: Any
    sweeps: int
    message: str

    @property
    def noise(self) -> Contaminated | None:
        """What a filter takes as ``noise=``, of several sensors or series together; None if none was learned."""
        return _together(self.contamination, self.scale_ratio)

    @property
    def process(self) -> Contaminated | None:
        """The same of the process, for ``process=``."""
        return _together(self.process_contamination, self.process_scale_ratio)

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)


def smooth(
    kf: Any, zs: Any, *, influence: Influence | None = None, process: Influence | None = Linear(),
    grouping: Grouping | None = None, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None, Bs: Any = None,
    us: Any = None, dts: Any = None, HJacobian: Callable[..., ArrayLike] | None = None,
    Hx: Callable[..., ArrayLike] | None = None, args: Any = (), hx_args: Any = (),
    residual: Callable[[Any, Any], Any] = np.subtract, max_sweeps: int | None = None,
) -> Smoothed:  # fmt: skip
    """Estimate all states of a recording from all of its measurements, without believing outliers.

    The recording is smoothed, each measurement is weighed by how far it is from what all the others say, and so on
    until nothing moves. A filter decides about a sample once, from the past; the smoother has seen what came after.

    Parameters
    ----------
    kf : KalmanFilter
        Of filterpy or of this package, linear, extended, unscented or cubature, with x, P, Q, R and its model set; x
        and P are those before the first prediction. It is not changed. Its own psi plays no part, except that a
        nonlinear filter finds the trajectory to start from.
    zs : sequence of length N
        Measurements as `batch_filter` takes them: numbers, arrays, rows with NaN, None. A fill value (9999, 1e7: one
        that repeats exactly, far outside the rest) is taken for missing.
    influence : Influence, optional
        What to make of a residual z - H x in standard deviations of R. By default contamination and size of the
        outliers are learned from the recording: on clean data that costs nothing. `Huber` gives the optimum of the
        convex problem, `Linear` the smoother of Rauch, Tung and Striebel, a redescending psi or `StudentT` a local
        optimum that is reached from far away.
    process : Influence or None, default Linear()
        The same for the process noise, for states that jump: ``None`` learns how often and how far, `Linear` believes
        in Q.
    grouping : {"component", "joint"}, optional
        Whether sensors fail each on its own or all together; by default the filter's, or "component".
    Fs, Qs, Hs, Rs, Bs, us : sequence of length N, optional
        Matrices and control inputs for each step, otherwise the filter's own and no input. A nonlinear filter takes
        Rs, and us if it is an extended one.
    dts : sequence of length N, or float, optional
        Time before each step, for an unscented or cubature filter.
    HJacobian, Hx : callable
        For an extended filter: H at a state, and the measurement that belongs to it, as in its ``update``.
    args, hx_args : tuple
        Further arguments of HJacobian and Hx.
    residual : callable, default numpy.subtract
        ``residual(z, Hx(x))`` for an extended filter whose measurements do not subtract (angles).
    max_sweeps : int, optional
        How often to smooth at most: by default 300 times by a psi, 100 where noise is learned.

    Returns
    -------
    Smoothed
        x, P, weights, ..; with ``converged=False`` if the search was ended by ``max_sweeps``.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; it is named.

    Warns
    -----
    UserWarning
        If zs has fill values, which are named; if Q and R do not fit the recording: what is left of the measurements,
        or the process noise found, has a variance of less than .4 or more than 2.5 times what they say, beyond chance,
        or a stretch of samples is left out (Notes).

    Notes
    -----
    Where noise is learned and outliers come in rows, the recording is also smoothed without one stretch or another (a
    burst after a few good samples can be followed), and the most probable result is kept; for linear filters. A burst
    within the recording, a quarter of it at most, may have an offset of its own. A state that moves as Q does not
    allow, and comes back, looks the same: if it may, ``process=None`` lets it jump.

    Q and R are believed. Where they are guesses, ``kf = estimate_noise(kf, zs).apply(kf)`` fits them first.

    Singular Q and P (a known initial state) are legal: no predicted covariance is inverted. P is the covariance given
    the weights; with learned noise it includes the doubt whether a sample is an outlier.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> kf = KalmanFilter(dim_x=2, dim_z=1)
    >>> kf.F, kf.H, kf.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 1e-4 * np.eye(2)
    >>> zs = np.arange(50.0) + np.random.default_rng(0).normal(size=50)
    >>> zs[20:23] = 1e6
    >>> smoothed = smooth(kf, zs)
    >>> bool(abs(smoothed.x[21, 0, 0] - 21.0) < 1.0), bool(smoothed.weights[21, 0] < 1e-3), smoothed.converged
    (True, True, True)
    """
    grouping = getattr(kf, "grouping", "component") if grouping is None else grouping
    zs, filled = without_fill_values("zs", _checks.entries("zs", zs))
    if is_nonlinear(kf):
        for name, value in (("Fs", Fs), ("Qs", Qs), ("Hs", Hs), ("Bs", Bs)):
            if value is not None:
                raise TypeError(f"{name}: expected none for a {type(kf).__name__}, whose model is in its functions")
        trajectory = nonlinear_trajectory(kf, zs, Rs, us, dts, (HJacobian, Hx, args, hx_args, residual))
        smoothed = _smoothed(trajectory.recording(), influence, process, grouping, max_sweeps, trajectory)
    else:
        recording = linear_recording(kf, zs, Fs, Qs, Hs, Rs, Bs, us)
        smoothed = _smoothed(recording, influence, process, grouping, max_sweeps)
    if filled.any():
        smoothed.weights[0][filled] = 0.0
    arrays = {name: part for name, part in vars(smoothed).items() if isinstance(part, np.ndarray)}
    first = {name: part[0].item() if part.ndim == 1 else part[0] for name, part in arrays.items()}
    return replace(smoothed, **first | {"x": first["x"] if np.ndim(kf.x) == 1 else first["x"][..., None]})


def smooth_series(
    zs: ArrayLike, F: ArrayLike, H: ArrayLike, Q: ArrayLike, R: ArrayLike, x0: ArrayLike, P0: ArrayLike, *,
    influence: Influence | None = None, process: Influence | None = Linear(), grouping: Grouping = "component",
    max_sweeps: int | None = None,
) -> Smoothed:  # fmt: skip
    """Smooth S series of N measurements each: `smooth` for many recordings, with the arguments of `filter_series`.

    Parameters
    ----------
    zs : array_like, shape (S, N, dim_z)
        Measurements; NaN marks a missing component. Fill values are taken for missing, with a warning.
    F, Q : array_like, shape (dim_x, dim_x), (N, dim_x, dim_x) or (S or 1, N or 1, dim_x, dim_x)
        Transition matrix and process noise covariance: shared, one a step, or each series' own.
    H : array_like, shape (dim_z, dim_x), or with the same axes in front
        Measurement matrix.
    R : array_like, shape (dim_z, dim_z), or with the same axes in front
        Measurement noise covariance, positive definite.
    x0 : array_like, shape (dim_x,) or (S, dim_x)
        Mean before the first prediction.
    P0 : array_like, shape (dim_x, dim_x) or (S, dim_x, dim_x)
        Its covariance.
    influence, process, grouping, max_sweeps
        As in `smooth`.

    Returns
    -------
    Smoothed
        Every field but ``sweeps`` and ``message`` with an axis of length S in front.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; it is named.

    Notes
    -----
    Each series has its own noise and ends when it has converged, with the same numbers as if it were alone.

    Examples
    --------
    >>> zs = np.array([[[1.0], [2.0], [3e6], [4.0]], [[0.0], [np.nan], [0.5], [0.3]]])
    >>> F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> smoothed = smooth_series(zs, F, [[1.0, 0.0]], 0.01 * np.eye(2), np.eye(1), np.zeros(2), np.eye(2))
    >>> smoothed.x.shape, smoothed.converged
    ((2, 4, 2), array([ True,  True]))
    """
    if 0 in np.shape(zs):
        raise ValueError(f"zs: expected shape (series, steps, dim_z), none of them 0, got {np.shape(zs)}")
    given = series_arguments(zs, F, H, Q, R, x0, P0, keep="last", covariance="none", refused="raise")
    z = np.array([without_fill_values(f"zs[{i}]", each)[0] for i, each in enumerate(given.z)])
    F_, Q_, H_, R_ = given.model
    recording = problem(F_, Q_, np.zeros((1, 1, given.x.shape[1])), H_, R_, z, given.x, given.P)
    return _smoothed(recording, influence, process, grouping, max_sweeps)


def _smoothed(
    recording: Recording, influence: Any, process: Any, grouping: Any, max_sweeps: Any, trajectory: Any = None
) -> Smoothed:
    """Smooth with the rules that the options ask for, and say what does not fit."""
    joint = _checks.option("grouping", grouping, GROUPINGS) == "joint"
    usual = 100 if influence is None or process is None else 300
    options = influence, process, joint, usual if max_sweeps is None else _checks.count("max_sweeps", max_sweeps, 1)
    smoothed, odd = _searched(recording, *options, trajectory)
    if influence is None and trajectory is None:
        for s in range(len(smoothed.x)):
            _read_otherwise(recording, s, smoothed, odd, options)
    odd = [each for each in odd if each]
    if odd:
        where = "the recording" if len(smoothed.x) == 1 else f"{len(odd)} of {len(smoothed.x)} series; the first"
        message = f"Q and R do not fit {where}: {odd[0]}"
        jumps = ", or smooth with process=None if states jump" if process is not None and "process" in odd[0] else ""
        warn(f"smooth: {message}; fit them by estimate_noise{jumps}")
        smoothed = replace(smoothed, message=f"{smoothed.message}; {message}")
    return smoothed


def _read_otherwise(
    recording: Recording, s: int, smoothed: Smoothed, odd: list[str], options: tuple[Any, Any, bool, int]
) -> None:
    """Put what is found without a stretch in the place of series s, if it is more probable."""
    alone = _alone(recording, s)
    left_out = (np.nan_to_num(smoothed.weights[s], nan=1.0) < 0.5).any(axis=-1)
    stretches = doubted_stretches(alone, left_out)
    best = _probability(alone, smoothed, s) if stretches else np.inf
    for stretch in stretches:
        try:
            other, of_other = _searched(_without(alone, stretch), *options)
        except ValueError:
            # Without these samples the states are beyond what numbers hold; then they are needed.
            continue
        other.weights[0][stretch[:, None] & alone.observed[0]] = 0.0
        probability = _probability(alone, other, 0)
        if probability > best + _CLEARLY:
            other.contamination[0] += (1.0 - other.contamination[0]) * stretch.mean()
            out = stretch | (np.nan_to_num(other.weights[0], nan=1.0) < 0.5).any(axis=-1)
            ends = np.flatnonzero(np.diff(out, prepend=False, append=False))
            row = ends[np.searchsorted(ends, np.argmax(stretch), side="right") - 1 :]
            words = f"samples {row[0]} to {row[1] - 1} are left out, all in a row"
            best, odd[s] = probability, "; ".join([words, *filter(None, of_other)])
            for name, whole in vars(smoothed).items():
                if isinstance(whole, np.ndarray):
                    whole[s] = getattr(other, name)[0]


def _alone(recording: Recording, s: int) -> Recording:
    """Return one series as a recording of its own."""

    def one(a: Array) -> Array:
        return a[s : s + 1] if len(a) > 1 else a

    return Recording(type(recording.model)(*map(one, recording.model)), *map(one, recording[1:]))


def _without(alone: Recording, stretch: np.ndarray) -> Recording:
    """Return a recording of one series in which a stretch is missing."""
    there, model = ~stretch[:, None], alone.model
    return alone._replace(
        model=model._replace(z=model.z * there, H=model.H * there[..., None]), observed=alone.observed & there
    )


def _probability(alone: Recording, smoothed: Smoothed, s: int) -> float:
    """Return the log probability of what was found for series s."""
    outliers = np.nan_to_num(smoothed.weights[s], nan=1.0) < 0.5
    noise = np.stack([smoothed.contamination[s], smoothed.scale_ratio[s]])
    process = np.array([smoothed.process_contamination[s], smoothed.process_scale_ratio[s]])
    return log_probability(alone, outliers, smoothed.process_weights[s] < 0.5, noise, process)


def _searched(
    recording: Recording, influence: Any, process: Any, joint: bool, limit: int, trajectory: Any = None
) -> tuple[Smoothed, list[str]]:
    """Return what one search finds, and what of Q and R is odd."""
    measurement = rule_of("influence", influence, joint, recording.observed)
    # The parts of a step of the process are ordinary or large together.
    doubt = rule_of("process", process, True, recording.driven)
    fit = reweighted(recording.model, recording.observed, measurement, doubt, limit, trajectory)
    weights = np.where(recording.observed, 1.0, np.nan) if measurement is None else measurement.weights
    x = fit.smooth.x if trajectory is None else trajectory.x[None, 1:]
    if not np.isfinite(x).all():
        raise ValueError("F: expected a model whose states stay finite, got overflow; check F and the length of zs")
    variances = np.einsum("...ii->...i", fit.smooth.P)
    if (variances < -_ROUNDING * np.abs(variances).max(axis=(0, 1))).any():
        raise ValueError(
            "F: expected a model whose covariances numbers can hold, got negative variances: states grow out of sight, "
            "or P is far too wide; check F, the length of zs and P"
        )
    series, _, m = recording.observed.shape
    process_weights = np.ones(weights.shape[:2])
    if isinstance(doubt, Learnt):
        process_weights = np.nanmax(doubt.weights, axis=-1, initial=0.0)
    elif isinstance(doubt, Psi):
        process_weights = 1.0 / fit.weighting.process_scale
    c, ratio = (np.broadcast_to(a, (series, m)).copy() for a in _learnt(measurement, series))
    c_process, ratio_process = (a[:, 0].copy() for a in _learnt(doubt, series))
    message = "converged" if fit.converged.all() else f"the estimate still moved after {fit.sweeps} sweeps"
    smoothed = Smoothed(
        x, fit.smooth.P, weights, process_weights, c, ratio, c_process, ratio_process,
        fit.converged, fit.sweeps, message,
    )  # fmt: skip
    return smoothed, misfits(recording.model, fit, weights)


def _learnt(rule: Rule, series: int) -> tuple[Array, Array]:
    """Return contamination and ratio of a rule, (series, kinds), NaN if it learns none."""
    return rule.mixture if isinstance(rule, Learnt) else (np.full((series, 1), np.nan),) * 2


def _together(contamination: Any, ratio: Any) -> Contaminated | None:
    """Return one noise with the mean share of outliers, and their mean square."""
    shares, ratios = np.ravel(contamination), np.ravel(ratio)
    learnt = ~np.isnan(shares)
    if not learnt.any():
        return None
    shares, ratios = shares[learnt], ratios[learnt]
    return Contaminated(float(shares.mean()), float(np.sqrt(shares @ ratios**2 / shares.sum())))
