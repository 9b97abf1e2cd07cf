"""identify: from a recording with outliers, gaps and an offset, in any unit, to a model; nothing given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._progress import stages
from robust_filterpy._warning import warn
from robust_filterpy.identification.estimation.beside import TRENDS, Settled
from robust_filterpy.identification.estimation.estimate import Problem
from robust_filterpy.identification.estimation.grey_box import identified_grey_box
from robust_filterpy.identification.estimation.limits import Limits
from robust_filterpy.identification.estimation.polynomials import identified_polynomials
from robust_filterpy.identification.estimation.state_space import identified_state_space
from robust_filterpy.identification.models.grey_box import GreyBox, GreyBoxModel
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.recording import recorded, require_motion
from robust_filterpy.identification.models.results import said
from robust_filterpy.identification.models.signals import operating_point
from robust_filterpy.identification.models.state_space import StateSpace, StateSpaceModel
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.functions import Influence

__all__ = ["identify"]


@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: Structure, *, influence: Influence | None = None, offset: bool = True,
    R: float | None = None, trend: str | None = None, groups: ArrayLike | None = None,
    fixed: Mapping[str, float] | None = None, bounds: Mapping[str, Any] | None = None, sampled: bool = True,
    progress: bool | None = None,
) -> Model: ...  # fmt: skip
@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: StateSpace, *, influence: Influence | None = None,
    trend: str | None = None, groups: ArrayLike | None = None, progress: bool | None = None,
) -> StateSpaceModel: ...  # fmt: skip
@overload
def identify(
    y: ArrayLike, u: ArrayLike | None, structure: GreyBox, *, influence: Influence | None = None,
    trend: str | None = None, t: ArrayLike | None = None, progress: bool | None = None,
) -> GreyBoxModel: ...  # fmt: skip
def identify(
    y: Any, u: Any, structure: Structure | StateSpace | GreyBox, *, influence: Influence | None = None,
    offset: bool = True, R: float | None = None, trend: str | None = None, groups: ArrayLike | None = None,
    t: ArrayLike | None = None, fixed: Mapping[str, float] | None = None, bounds: Mapping[str, Any] | None = None,
    sampled: bool = True, progress: bool | None = None,
) -> Model | StateSpaceModel | GreyBoxModel:  # fmt: skip
    """Find the model of a recording with outliers, from nothing but the recording.

    Minimises the robust loss of the prediction errors from several starts that need no guess, the noise learned on the
    way::

        A(q) y = B(q)/F(q) u + offset + C(q)/D(q) v,   v ~ (1 - eps) N(0, R) + eps N(0, ratio^2 R)

    Parameters
    ----------
    y : array_like, shape (N,), or list of these
        Measured output; NaN where it is missing. A pandas Series has the index of u, in equal steps, which tell the
        sampling period. A list: several recordings of one plant, each with a level and a start of its own.
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
    groups : array_like, shape (N,), optional
        A label for each sample: those with the same one are a recording.
    t : array_like, shape (N,), optional
        Times in s, at any distance, of the samples for a GreyBox; else those of the index.
    fixed : dict of str to float, optional
        Parameters that are known, by their names as ``structure.names`` has them, such as ``{"a1": -1.5}``. They have
        no variance, and the others that of a model in which these are known.
    bounds : dict of str to (float, float), optional
        Between which numbers others are, None or inf for no limit: ``{"b1": (0, None)}``. A parameter that ends at a
        bound is named by ``warning``.
    sampled : bool, default True
        Whether P comes from models with poles at all places where the loss is not quadratic and a pole that a zero
        nearly cancels may be at others, which takes a second; False: from its profile, for a model that is one of many.
        For structures of polynomials.
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

    An outlier of y in an ARX or ARMAX stands in the regressor of the samples after it. Such samples are found by the
    pattern they leave, and taken for missing (`cleaning`).

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
            model = _of_outputs(y, u, structure, influence, trend, groups, t, {
                "offset": offset, "R": R, "fixed": fixed, "bounds": bounds, "sampled": sampled
            })  # fmt: skip
        else:
            if t is not None:
                raise ValueError(
                    f"t: expected None for {structure}, whose samples are equally far apart; take a GreyBox"
                )
            if not isinstance(structure, Structure):
                raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
            for name, value in (("offset", offset), ("sampled", sampled)):
                if not isinstance(value, (bool, np.bool_)):
                    raise TypeError(f"{name}: expected True or False, got {_checks.shown(value)}")
            limits = Limits.of(structure, fixed, bounds)
            model = _of_polynomials(y, u, structure, influence, bool(offset), R, trend, groups, limits, bool(sampled))
    for words in (said(model.findings), model.warning):
        if words:
            warn(f"identify: {words}")
    return model


def _of_polynomials(
    y: Any, u: Any, structure: Structure, influence: Any, offset: bool, R: Any, trend: Any, groups: Any, limits: Limits,
    sampled: bool,
) -> Model:  # fmt: skip
    """Return a model of one output."""
    if trend is not None and not isinstance(trend, Settled):
        _checks.option("trend", trend, TRENDS)
        if not offset and trend != "none":
            raise ValueError(f'trend: expected "none" with offset=False, got {_checks.shown(trend)}; leave offset out')
    recording = recorded(structure, y, u, groups)
    require_motion(recording.y, recording.u)
    signal = recording.u
    offset = offset and trend != "none"
    moves = offset and not structure.takes_phi
    problem = Problem(
        structure, signal, operating_point(signal) if moves else np.zeros(signal.shape[1]), influence, offset,
        None if R is None else _checks.positive("R", R), recording.axis.dt, limits=limits if limits.any else None,
        begins=tuple(part.start for part in recording.spans), sampled=sampled,
    )  # fmt: skip
    # Noise that is summed up has steps of its own.
    chosen = trend or ("breaks" if moves and not structure.integrated else "constant")
    model = identified_polynomials(problem, recording.y, recording.axis.index, chosen)
    return replace(model, findings=(*recording.findings, *model.findings))


def _of_outputs(
    y: Any, u: Any, structure: StateSpace | GreyBox, influence: Any, trend: Any, groups: Any, t: Any, given: Any
) -> StateSpaceModel | GreyBoxModel:
    """Return a state-space or physical model, or raise if it is asked for what it does not take."""
    physical, kind = isinstance(structure, GreyBox), type(structure).__name__
    own = "GreyBox(.., fixed=, bounds=) has its own" if physical else "its matrices have no names"
    only = {
        "offset": (True, "it says itself what y has"), "R": (None, "it learns the noise of each output"),
        "fixed": (None, own), "bounds": (None, own), "sampled": (True, "its P is the curvature at the minimum"),
    }  # fmt: skip
    for name, value in given.items():
        if value is not only[name][0]:
            expected, mend = only[name]
            raise ValueError(f"{name}: expected {expected} for a {kind}, got {_checks.shown(value)}; {mend}")
    # Outputs of states have levels; those of physics have none but what the equations say.
    levels = tuple(one for one in TRENDS if one != ("constant" if physical else "none"))
    trend = "breaks" if trend is None else _checks.option("trend", trend, levels)
    if isinstance(structure, GreyBox):
        if groups is not None:
            raise ValueError("groups: expected None for a GreyBox; give lists of y, u and t")
        return identified_grey_box(y, u, structure, t, influence, trend)
    if t is not None:
        raise ValueError("t: expected None for a StateSpace, whose samples are equally far apart; take a GreyBox")
    return identified_state_space(y, u, structure, influence, groups, trend)
