"""identify: from a recording with outliers, gaps and an offset, in any unit, to a model; nothing given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage, stages
from robust_filterpy._warning import warn
from robust_filterpy.identification.estimation import disturbances
from robust_filterpy.identification.estimation.disturbances import TRENDS, Explanation, Search, Settled
from robust_filterpy.identification.estimation.estimate import Problem, estimated
from robust_filterpy.identification.estimation.outliers import cleaned
from robust_filterpy.identification.estimation.outputs import identified_grey_box, identified_state_space
from robust_filterpy.identification.estimation.prediction_error import Limits, colour_of
from robust_filterpy.identification.models.dependence import another_delay, driven, parts_of, wraps
from robust_filterpy.identification.models.grey_box import GreyBox, GreyBoxModel
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import ORDINARY
from robust_filterpy.identification.models.recording import Recording, recorded, require_motion
from robust_filterpy.identification.models.results import Finding, said
from robust_filterpy.identification.models.state_space import StateSpace, StateSpaceModel
from robust_filterpy.identification.models.structures import OutputError, Structure
from robust_filterpy.influence.functions import Influence

# A share of its response that the impulse response of `of_impulses` leaves out calls for a model of the differences.
_SLOW: Final = 0.7
# Motion counts if its size in the second half is this share of y's; it never dies if (1 - |pole|) N is below the other.
_SMALL: Final = 0.05
_ENDLESS: Final = 0.1
# What rows far outside make of y is off by so many deviations where they are wrong.
_LEVERAGE: Final = 5.0
# A part in which outliers leave less than this share clear is judged as it was measured; less is enough where the model
# is of other recordings too, of which one may be of another plant in all of its samples.
_LEAST_CLEAR: Final = 0.5
_LEAST_CLEAR_BESIDE: Final = 0.75


def identified_polynomials(
    problem: Problem, recording: Recording, trend: str | Settled, begin: Array | None = None
) -> Model:
    """Find the model of recordings of one output with whatever else these have."""
    y, spans = recording.y, recording.spans
    own = y[:, 0]

    def find(u: Array, levels: Array, columns: list[Array], end: Any) -> Explanation:
        at = np.hstack(columns) if columns else None
        estimate = estimated(problem._replace(u=u), (y - levels)[:, 0], at, begin if end is None else end)
        moved = levels if at is None else levels + (at @ estimate.sizes)[:, None]
        return Explanation(estimate.model, moved, u, estimate.model.evidence, end=estimate.p)

    def alone(model: Model, y: Array, u: Array) -> Array:
        return np.concatenate([model.simulate(u[part]) for part in spans])[:, None]

    def starts(u: Array, plain: Model) -> Iterator[Array]:
        yield disturbances.of_impulses(y, u, spans)
        acted = problem._replace(u=u)
        if _is_slow(plain, len(y)) and len(spans) == 1:
            try:
                model = estimated(acted._replace(u=np.diff(u, axis=0)), np.diff(own)).model
            except ValueError:
                return
            yield replace(model, operating_point=acted.rest).simulate(u)[:, None]

    def settled(best: Explanation) -> Explanation:
        return _without_endless_motion(problem._replace(u=best.u), own, best)

    search = Search(y, problem.u, spans, find, alone, starts, True, settled, recording.axis.index)
    # A row of the caller's regressor is no input that is held.
    best = _without_leverage(problem, own) if problem.structure.takes_phi else search.best(trend)
    model = search.concluded(best, (*recording.findings, *best.findings))
    left = _left(search, problem._replace(u=best.u), best, model)
    return replace(model, findings=(*model.findings, *left))


def _left(search: Search, problem: Problem, best: Explanation, model: Model) -> tuple[Finding, ...]:
    """Find what the model leaves of its recordings."""
    structure, y, several = model.structure, search.y[:, 0], len(search.spans) > 1
    if not structure.n_inputs:
        return ()
    predicted = [model.predict(y[part], problem.u[part]) for part in search.spans]
    residual = y - np.concatenate(predicted)
    if structure.takes_phi:
        return wraps(y, residual)
    output, clear = np.zeros(y.size), residual
    if not model.noise.is_rounding:
        signals = zip(search.spans, predicted, strict=True)
        judged = [_judged(model, y[part], problem.u[part], one, several) for part, one in signals]
        output, clear = (np.concatenate(each) for each in zip(*judged, strict=True))
    # Only a structure that models the noise can be right about what goes back to the input.
    meaning = (
        f"{structure} is unbiased only as far as its noise model is right: validate it, and try more c's and d's"
        if structure.na + structure.nc + structure.nd
        else f"{structure} is biased by that unless the noise is white: BoxJenkins or ARMAX model the noise"
    )
    acting = driven(structure, model.theta, output, problem.u)[:, None]
    direct = min(nk for _, nk in structure.inputs) == 0
    left = search.left(best, output[:, None], residual[:, None], problem.rest, direct, meaning, acting, clear[:, None])
    late = () if several or model.noise.is_rounding else another_delay(clear, problem.u - problem.rest)
    # What biases the model first: another plant may be no more than what that leaves.
    return (*_noise_of_sensor(model, problem, y - best.levels[:, 0], clear), *late, *left)


def _noise_of_sensor(model: Model, problem: Problem, y: Array, residual: Array) -> tuple[Finding, ...]:
    """Find out whether noise that y holds biases a model with measured outputs in its regressor."""
    seen, structure = ~np.isnan(residual), model.structure
    if not structure.na or model.noise.is_rounding:
        return ()
    gain = 2.0 * colour_of(np.where(seen, model.noise.psi(np.nan_to_num(residual)), np.nan)).gain
    other = OutputError(structure.na + structure.nf, structure.nb, structure.nk, integrated=structure.integrated)
    what = "leaves follows itself, and so does its regressor, which holds y"
    if gain < disturbances.PRICE * np.log(seen.sum()):
        explained = _explained_outliers(model, problem._replace(structure=other, limits=None), y)
        if explained <= 0.5:
            return ()
        what = f"takes for outliers is to {100 * explained:.0f} % what {other} makes of the inputs"
    text = (
        f"what {structure} {what}: its parameters are biased by that, further than their standard deviations say; "
        f"noise of the sensor does it, for which there is {other}; else BoxJenkins, or more a's"
    )
    return (Finding("noise that follows itself", text, gain, (0, seen.size)),)


def _explained_outliers(model: Model, problem: Problem, y: Array) -> float:
    """Return the share of a model's outliers that another explains, 0 where most of them do not stand together."""
    odd, span = np.nan_to_num(model.weights, nan=1.0) < 0.5, 2 * model.structure.n_theta
    together = maximum_filter1d(uniform_filter1d(odd.astype(float), span, mode="constant"), span)
    if len(problem.begins) > 1 or not odd.any() or np.median(together[odd]) <= 0.5:
        return 0.0
    with suppress(ValueError):
        left = y - estimated(problem, y).model.simulate(problem.u)
        return float((np.abs(left[odd]) < ORDINARY * model.R**0.5).mean())
    return 0.0


def _judged(model: Model, y: Array, u: Array, predicted: Array, several: bool) -> tuple[Array, Array]:
    """Return what a model makes of the inputs of a recording, and what it leaves, NaN where outliers spoil it."""
    whole, trend = cleaned(model, y, u), model.trend if model.trend.size else np.zeros(y.size)
    parts, residual = parts_of(y.size, several), y - predicted
    if whole is None:
        # A prediction follows a level that wanders, and after a jump of it both are off together for a while.
        output = model.simulate(u) if model.structure.nd else predicted - trend
        return np.nan_to_num(output - model.level), residual
    # A part that is nearly all outliers is of another plant, whatever replaces them.
    measured = ~np.isnan(y) & (np.arange(y.size) >= whole.prepared.first)
    clear = whole.clear & measured
    least = _LEAST_CLEAR_BESIDE if several else _LEAST_CLEAR
    own = parts[clear[parts].sum(axis=1) < least * measured[parts].sum(axis=1)].ravel()
    clear[own] = False
    left, output = np.where(clear, whole.residual, np.nan), whole.prepared.y - whole.residual
    if own.size:
        left[own] = residual[own]
        # Predictions from outputs as measured carry their outliers to the residuals: what u alone makes does not.
        output[own] = model.simulate(u)[own]
    return np.nan_to_num(output - model.level), left


def _without_endless_motion(problem: Problem, y: Array, best: Explanation) -> Explanation:
    """Find the model again from rest if what was in motion when the recording began would outlast it."""
    model, own = best.model, y - best.levels[:, 0]
    slowest = float(np.abs(np.roots(model.parts.f)).max(initial=0.0))
    longest = max(part.stop - part.start for part in problem.spans)
    if not model.structure.n_inputs or abs(1.0 - slowest) * longest >= _ENDLESS:
        return best
    if len(problem.spans) == 1:
        late = slice(y.size // 2, None)
        motion = model.free_run(own, problem.u)[late] - model.simulate(problem.u)[late]
        if np.sqrt(np.mean(np.square(motion))) < _SMALL * np.nanstd(y):
            return best
    stage("the model from rest")
    still = estimated(problem._replace(moving=False), own).model
    text = (
        f"a pole at {slowest:.6g} would keep what was in motion when y began beyond its {y.size} samples, which cannot "
        "tell it from none: the model begins at rest"
    )
    finding = Finding("slow start", text, 2.0 * (still.log_likelihood - model.log_likelihood), (0, y.size))
    return best._replace(model=still, evidence=still.evidence, findings=(*best.findings, finding))


def _is_slow(model: Model, samples: int) -> bool:
    """Tell whether much of a model's response comes later than the lags of `of_impulses`."""
    parts, impulse = model.parts, np.eye(1, samples).ravel()
    with np.errstate(all="ignore"):
        sizes = [np.abs(lfilter(b, np.convolve(parts.a, parts.f), impulse)) for b in parts.b]
        return any(size[disturbances.LAGS_OF_IMPULSES :].sum() > _SLOW * size.sum() for size in sizes)


def _without_leverage(problem: Problem, y: Array) -> Explanation:
    """Find the linear regression on the caller's rows, without those far outside that y does not follow."""

    def without(wrong: Any) -> Explanation:
        model = estimated(problem, np.where(wrong, np.nan, y)).model
        return Explanation(model, np.zeros((y.size, 1)), problem.u)

    far = np.column_stack([disturbances.far_outside(column) for column in problem.u.T]).any(axis=1)
    if not far.any():
        return without(far)
    try:
        model = without(far).model
    except ValueError:
        return without(False)
    sure = model.R + np.einsum("ij,jk,ik->i", problem.u, model.P, problem.u)
    left = y - problem.u @ model.theta - model.offset
    places = np.flatnonzero(far & (np.abs(left) > _LEVERAGE * np.sqrt(sure)))
    # Outliers of y hit these as often as any other.
    if places.size <= 2.0 * getattr(model.noise.influence, "contamination", 0.0) * far.sum():
        return without(False)
    text = (
        f"u has {places.size} rows far outside the others that y does not follow: they do not count; what was "
        "measured wrongly there is u"
    )
    place = (int(places[0]), int(places[-1]) + 1)
    finding = Finding("input outliers", text, float(np.sum(left[places] ** 2 / sure[places])), place)
    return without(np.isin(np.arange(y.size), places))._replace(findings=(finding,))


@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: Structure, *, influence: Influence | None = None, offset: bool = True,
    R: float | None = None, trend: str | None = None, fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, Any] | None = None, progress: bool | None = None,
) -> Model: ...  # fmt: skip
@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: StateSpace, *, influence: Influence | None = None,
    trend: str | None = None, progress: bool | None = None,
) -> StateSpaceModel: ...  # fmt: skip
@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: GreyBox, *, influence: Influence | None = None,
    trend: str | None = None, t: ArrayLike | None = None, progress: bool | None = None,
) -> GreyBoxModel: ...  # fmt: skip
def identify(
    y: Any, u: Any, structure: Structure | StateSpace | GreyBox, *, influence: Influence | None = None,
    offset: bool = True, R: float | None = None, trend: str | None = None, t: ArrayLike | None = None,
    fixed: Mapping[str, float] | None = None, bounds: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> Model | StateSpaceModel | GreyBoxModel:  # fmt: skip
    """Find the model of a recording with outliers, from nothing but the recording.

    Minimises the robust loss of the prediction errors from several starts that need no guess, the noise learned on the
    way::

        A(q) y = B(q)/F(q) u + offset + C(q)/D(q) v,   v ~ (1 - eps) N(0, R) + eps N(0, ratio^2 R)

    Parameters
    ----------
    y : array_like, shape (N,), or list of these
        Measured output; NaN where it is missing. A pandas Series has the index of u, in equal steps, which tell the
        sampling period. A list: several recordings of one plant, each with a level and a start of its own; of a table
        ``[part["y"] for _, part in table.groupby("batch")]``.
    u : array_like, shape (N,) or (N, n_inputs), list of these, or None
        Input; the rows phi(k) for a LinearRegression; None for a structure without input. NaN where it is missing: up
        to 10 samples in a row are held at the value before, longer gaps make two recordings of one.
    structure : Structure, StateSpace or GreyBox
        Which polynomials there are, and their orders; states for y of shape (N, p); equations of physics.
    influence : influence function, optional
        Loss of the prediction errors, in units of their robust scale. Default: the noise is learned: a mixture of two
        normal distributions whose share, ratio and R are fitted with the model.
    offset : bool, default True
        Whether there is a constant, for outputs that are not measured from their rest.
    R : float, optional
        Variance of the ordinary noise, in the unit of y squared, if it is known.
    trend : {"none", "constant", "line", "breaks"}, optional
        What level y has besides the model: none (as ``offset=False``), a constant, a straight line, or a constant with
        steps and ramps wherever the recording shows them. Default: "breaks", for a structure with inputs. Outputs of
        states have a constant at least, those of physics none besides their equations.
    t : array_like, shape (N,), optional
        Times in s, at any distance, of the samples for a GreyBox; else those of the index.
    fixed : dict of str to float, optional
        Parameters that are known, by their names as ``structure.names`` has them, such as ``{"a1": -1.5}``. They have
        no variance, and the others that of a model in which these are known.
    bounds : dict of str to (float, float), optional
        Between which numbers others are, None or inf for no limit: ``{"b1": (0, None)}``. A parameter that ends at a
        bound is named by ``warning``.
    progress : bool, optional
        Write on standard error, less and less often, what the search is at: True from the beginning, False never, None
        from 2 s on.

    Returns
    -------
    Model, StateSpaceModel or GreyBoxModel

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
        If y has fill values, or anything else is found in the recording; ``findings`` of the model say the same.

    Notes
    -----
    Starts, search and choice are described in the modules `starts`, `prediction_error` and `search`. Nothing depends on
    the units of y and u, nor, with ``offset=True``, on where y has its zero. What was in motion when the recording
    began is estimated with the parameters of an OutputError; an ARX or ARMAX begins where its regressor does.

    An outlier of y in an ARX or ARMAX stands in the regressor of the samples after it. Which samples these are, and
    what stands in their place and in that of missing ones, is drawn: theta is the mean over all that they may be, and
    its covariance counts it (`outliers`).

    What the model does not explain, but repeats, lasts or never dies, is a finding: fill values are taken for missing,
    steps and ramps of the level are taken off (`trend`; each must explain 6 log N in units of twice the log-likelihood
    of residuals with their color, see `colour`), and a motion from the beginning that would outlast the recording is
    left out. The level is that at the end. Methods of the model that are given the same y take the trend off it and put
    it back.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import OutputError
    >>> from robust_filterpy import Contaminated
    >>> from robust_filterpy.plants import simulate_output_error
    >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 1000)
    >>> noise = Contaminated(0.1, 10.0, 0.3)
    >>> y = 20.0 + simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, noise=noise, rng=2, na=2, nb=2).y
    >>> model = identify(y, u, OutputError(2, 2))
    >>> model.theta.round(1), round(model.offset)
    (array([-1.5,  0.7,  1. ,  0.5]), 20)
    """
    model: Model | StateSpaceModel | GreyBoxModel
    if influence is not None and not isinstance(influence, Influence):
        raise TypeError(f"influence: expected an influence function such as Huber(), got {_checks.shown(influence)}")
    with stages("identify", progress):
        if isinstance(structure, (StateSpace, GreyBox)):
            model = _of_outputs(y, u, structure, influence, trend, t, {
                "offset": offset, "R": R, "fixed": fixed, "bounds": bounds
            })  # fmt: skip
        else:
            if t is not None:
                raise ValueError(
                    f"t: expected None for {structure}, whose samples are equally far apart; take a GreyBox"
                )
            if not isinstance(structure, Structure):
                raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
            if not isinstance(offset, (bool, np.bool_)):
                raise TypeError(f"offset: expected True or False, got {_checks.shown(offset)}")
            limits = Limits.of(structure, fixed, bounds)
            model = _of_polynomials(y, u, structure, influence, bool(offset), R, trend, limits)
    for words in (said(model.findings), model.warning):
        if words:
            warn(f"identify: {words}")
    return model


def _of_polynomials(
    y: Any, u: Any, structure: Structure, influence: Any, offset: bool, R: Any, trend: Any, limits: Any
) -> Model:  # fmt: skip
    """Return a model of one output."""
    if trend is not None and not isinstance(trend, Settled):
        _checks.option("trend", trend, TRENDS)
        if not offset and trend != "none":
            raise ValueError(f'trend: expected "none" with offset=False, got {_checks.shown(trend)}; leave offset out')
    recording = recorded(structure, y, u)
    require_motion(recording.y, recording.u)
    offset = offset and trend != "none"
    problem = Problem(
        structure, recording.u, influence, offset, None if R is None else _checks.positive("R", R), recording.axis.dt,
        limits=limits,
        begins=tuple(part.start for part in recording.spans), draws=not isinstance(trend, Settled) or trend.draws,
    )  # fmt: skip
    begin = trend.begin if isinstance(trend, Settled) else None
    if isinstance(trend, Settled) and not trend.values.size:
        trend = None
    # Noise that is summed up has steps of its own.
    chosen = trend or ("breaks" if offset and not (structure.takes_phi or structure.integrated) else "constant")
    return identified_polynomials(problem, recording, chosen, begin)


def _of_outputs(
    y: Any, u: Any, structure: StateSpace | GreyBox, influence: Any, trend: Any, t: Any, given: Any
) -> StateSpaceModel | GreyBoxModel:
    """Return a state-space or physical model, or raise if it is asked for what it does not take."""
    physical, kind = isinstance(structure, GreyBox), type(structure).__name__
    own = "GreyBox(.., fixed=, bounds=) has its own" if physical else "its matrices have no names"
    only = {
        "offset": (True, "it says itself what y has"), "R": (None, "it learns the noise of each output"),
        "fixed": (None, own), "bounds": (None, own),
    }  # fmt: skip
    for name, value in given.items():
        if value is not only[name][0]:
            expected, mend = only[name]
            raise ValueError(f"{name}: expected {expected} for a {kind}, got {_checks.shown(value)}; {mend}")
    # Outputs of states have levels; those of physics have none but what the equations say.
    levels = tuple(one for one in TRENDS if one != ("constant" if physical else "none"))
    trend = "breaks" if trend is None else _checks.option("trend", trend, levels)
    if isinstance(structure, GreyBox):
        return identified_grey_box(y, u, structure, t, influence, trend)
    if t is not None:
        raise ValueError("t: expected None for a StateSpace, whose samples are equally far apart; take a GreyBox")
    return identified_state_space(y, u, structure, influence, trend)
