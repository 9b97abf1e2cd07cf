"""identify: from a recording with outliers, gaps and an offset, in any unit, to a model; nothing told."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification._recording import require_informative
from robust_filterpy.identification._signals import recorded_input, recorded_output
from robust_filterpy.identification._threads import one_thread
from robust_filterpy.identification.learnt_noise import Noise, mad_scale
from robust_filterpy.identification.model import Ending, Model, filled_memory
from robust_filterpy.identification.polynomial_model import PolynomialModel
from robust_filterpy.identification.prediction_error import sandwich
from robust_filterpy.identification.search import End, ends, known_part
from robust_filterpy.identification.structures import Structure
from robust_filterpy.identification.time_axis import recording
from robust_filterpy.identification.validation import ordinary_fit, ordinary_samples
from robust_filterpy.influence.functions import Influence

__all__ = ["identify"]

# Two ends as close in log-likelihood, and so far apart in output (percent, and twice what the noise explains), leave
# the model open.
_CLOSE: Final = 3.0
_APART: Final = 5.0

# In units of its scale, a larger output is as wild as this one; its loss would hide all others in rounding.
_LARGEST: Final = 1e10


def identify(
    y: ArrayLike,
    u: ArrayLike | None,
    structure: Structure,
    *,
    influence: Influence | None = None,
    offset: bool = True,
    R: float | None = None,
) -> Model:
    """Find the model of a recording with outliers, from nothing but the recording.

    Minimises the robust loss of the prediction errors from several starts that need no guess, the noise learnt on the
    way::

        A(q) y = B(q)/F(q) u + offset + C(q)/D(q) v,   v ~ (1 - eps) N(0, R) + eps N(0, ratio^2 R)

    Parameters
    ----------
    y : array_like, shape (N,)
        Measured output; NaN where it is missing. A pandas Series has the index of u, in equal steps, which tell the
        sampling period.
    u : array_like, shape (N,) or (N, n_inputs), or None
        Input; the rows phi(k) for a LinearRegression; None for a structure without input.
    structure : ARX, OutputError, ARMAX, BoxJenkins, FIR, AR, ARMA or LinearRegression
        Which polynomials there are, and their orders.
    influence : influence function, optional
        Loss of the prediction errors, in units of their robust scale. Default: the noise is learnt, as a mixture of two
        normal distributions whose share, ratio and R are fitted with the model.
    offset : bool, default True
        Whether there is a constant, for outputs that are not measured from their rest.
    R : float, optional
        Variance of the ordinary noise, in the unit of y squared, if it is known.

    Returns
    -------
    Model

    Raises
    ------
    ValueError
        If the recording is too short for the structure or for its delay, y is all missing or constant, u does not
        excite the parameters (the message names the order of excitation), or the indexes of pandas objects differ or
        are not uniform.
    TypeError
        If an argument is of the wrong kind.

    Warns
    -----
    UserWarning
        If models that differ much explain the recording almost equally well; ``warning`` of the model says the same.

    Notes
    -----
    Starts, search and choice are described in the modules `starts`, `prediction_error` and `search`. Nothing depends on
    the units of y and u, nor, with ``offset=True``, on where y has its zero. What was in motion when the recording
    began is estimated with the parameters of an OutputError; an ARX or ARMAX begins where its regressor does.

    An outlier of y in an ARX or ARMAX stands in the regressor of the samples after it. Such samples are found by the
    pattern they leave, and taken for missing (`cleaning`).

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import OutputError
    >>> from robust_filterpy.noise import EpsilonContaminated
    >>> from robust_filterpy.plants import simulate_output_error
    >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 1000)
    >>> noise = EpsilonContaminated(0.1, 0.3, 3.0)
    >>> y = 20.0 + simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, noise=noise, rng=2, na=2, nb=2).y
    >>> model = identify(y, u, OutputError(2, 2))
    >>> model.theta.round(1), round(model.offset)
    (array([-1.5,  0.7,  1. ,  0.5]), 20)
    """
    if not isinstance(structure, Structure):
        raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
    if influence is not None and not isinstance(influence, Influence):
        raise TypeError(f"influence: expected an influence function such as Huber(), got {influence!r}")
    if not isinstance(offset, (bool, np.bool_)):
        raise TypeError(f"offset: expected True or False, got {offset!r}")
    axis, y, u = recording(structure, y=y, u=u)
    measured = recorded_output(y)
    signal = recorded_input(structure, u, measured.size)
    known = None if R is None else _checks.positive("R", R)
    missing = np.isnan(measured)
    units = _Units.of(measured, signal, bool(offset))
    model = PolynomialModel(structure, units.normal_output(measured), signal / units.u, bool(offset))
    require_informative(model, missing)
    with one_thread():
        ranked = ends(model, missing, influence, None if known is None else known / units.y**2)
    best = ranked[0].end
    output = _output(model, best)
    endings = tuple(Ending(end.starts, excess, _apart(output, _output(model, end))) for end, excess in ranked)
    # What the noise makes of the output of any model with so many parameters.
    unsure = 100.0 * np.sqrt(structure.n_theta * best.noise.R / best.rows.sum()) / np.std(output)
    doubt = _doubt(best, endings, max(_APART, 2.0 * unsure))
    if doubt:
        warnings.warn(f"identify: {doubt}", stacklevel=2)
    recorded = PolynomialModel(structure, best.y * units.y + units.centre, signal, bool(offset))
    # Where an outlier stood in the regressor: what was measured, less what stands there now.
    replaced = np.where(best.outliers.wrong & ~missing, measured - recorded.y, 0.0)
    found = _as_model(recorded, units.back(model, best.p), best, missing, replaced, units.y, known, endings, doubt)
    return replace(found, dt=axis.dt)


class _Units(NamedTuple):
    """Where y has its zero, and how large y and each input are."""

    centre: float
    y: float
    u: Array

    @classmethod
    def of(cls, y: Array, u: Array, offset: bool) -> _Units:
        """Return the units of a recording, 1 for a signal that is always 0."""
        values = y[~np.isnan(y)]
        if values.size == 0:
            values = np.zeros(1)
        centre = float(np.median(values)) if offset else 0.0
        scale = mad_scale(values - centre) or float(np.abs(values - centre).mean())
        size = np.sqrt(np.mean(np.square(u), axis=0))
        return cls(centre, scale or 1.0, np.where(size > 0.0, size, 1.0))

    def normal_output(self, y: Array) -> Array:
        """Return y from its centre in its scale, 0 where it is missing."""
        return np.clip(np.nan_to_num((y - self.centre) / self.y, nan=0.0), -_LARGEST, _LARGEST)

    def back(self, model: PolynomialModel, p: Array) -> Array:
        """Return the free parameters for the recording as it was measured."""
        places, n = model.structure.polynomials, model.structure.n_theta
        p = p.copy()
        for place, size in zip(places.b, self.u, strict=True):
            p[place] *= self.y / size
        p[n:] *= self.y
        if model.offset:
            p[n] += self.centre * (1.0 + p[places.a].sum())
        return p


def _as_model(
    model: PolynomialModel,
    p: Array,
    end: End,
    missing: Any,
    replaced: Array,
    unit: float,
    R: float | None,
    endings: tuple[Ending, ...],
    doubt: str,
) -> Model:
    """Return what was found, for the recording as it was measured, its outliers and gaps interpolated."""
    structure, n, rows = model.structure, model.structure.n_theta, end.rows
    residual = model.residuals(p)
    # One parameter more is one residual less to tell of the noise.
    samples = int(rows.sum())
    found = end.noise.R * unit**2
    noise = replace(end.noise, R=found)
    P = sandwich(*known_part(model, end._replace(p=p)), noise)
    weights = np.full(missing.size, np.nan)
    weights[model.first :] = noise.weights(residual)
    weights[end.outliers.wrong] = 0.0
    weights[missing] = np.nan
    offset = float(p[n]) if model.offset else 0.0
    total = R or found * samples / (samples - model.n)
    return Model(
        structure=structure,
        theta=p[:n],
        offset=offset,
        P=P[:n, :n],
        offset_std=float(np.sqrt(max(P[n, n], 0.0))) if model.offset else 0.0,
        offset_covariance=P[:n, n] if model.offset else np.zeros(n),
        has_offset=model.offset,
        own_fit=_own_fit(model.y[model.first :], residual, rows),
        noise=_as_measured(replace(noise, R=total), residual, replaced[model.first :], ~missing[model.first :]),
        weights=weights,
        log_likelihood=noise.log_likelihood(residual[rows]),
        endings=endings,
        warning=doubt,
        memory=filled_memory(model, p),
    )


def _as_measured(noise: Noise, residual: Array, replaced: Array, known: Any) -> Noise:
    """Return the noise that the prediction will meet: of y as it was measured, outliers and all."""
    if not replaced.any():
        return noise
    told = replace(noise, known=True).settled((residual + replaced)[known])
    return replace(told, known=noise.known)


def _own_fit(y: Array, residual: Array, rows: Any) -> float:
    """Return the fit of the prediction on the ordinary samples among those that count."""
    return ordinary_fit(y, y - residual, ordinary_samples(np.where(rows, residual, np.nan)))


def _apart(best: Array, other: Array) -> float:
    """Return how far another output is from the best one, in percent of that one's variation."""
    with np.errstate(over="ignore", invalid="ignore"):
        difference = float(100.0 * np.std(other - best) / np.std(best))
    return difference if np.isfinite(difference) else np.inf


def _output(model: PolynomialModel, end: End) -> Array:
    """Return what a model makes of the inputs alone, or without any what it predicts."""
    if not model.inputs:
        return end.y[model.first :] - end.residual
    p = end.p.copy()
    p[model.structure.n_theta :] = 0.0
    return np.asarray(lfilter([1.0], model.parts(p).a, model.undisturbed(p)))


def _doubt(best: End, endings: tuple[Ending, ...], apart: float) -> str:
    """Say what makes the estimate doubtful, or nothing."""
    for starts, excess, difference in endings[1:]:
        if excess < _CLOSE and difference > apart:
            return (
                f"two models explain the recording almost equally well (log-likelihoods {excess:.1f} apart), and their "
                f"outputs differ by {difference:.0f} %; a longer recording, a more exciting input or a smaller "
                f"structure would decide. The other was found from: {', '.join(starts)}"
            )
    if not best.converged:
        return "the search did not settle; the structure may have more parameters than the recording tells of"
    return ""
