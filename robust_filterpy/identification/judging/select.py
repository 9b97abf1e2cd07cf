"""select_structure: the orders and the delay of a model, by a robust information criterion.

All structures are compared on the same samples: the recording is cut for each of them such that its first residual
belongs to the same sample. Steps and ramps of the level and outliers of the inputs are those that the largest structure
has beside it: what each looked for itself would be parameters that the criterion does not count. Their residuals have
the noise that `learnt_noise` learns from them, by the same rule:

    criterion = -2 log-likelihood + price n,   price = log(samples) for "bic", 2 for "aic"

An outlier costs a bounded number of units of log-likelihood, whichever model it is held against (Ronchetti 1985,
Machado 1993): a residual beyond all that y varies counts as one of that size, and an outlier that an ARX or ARMAX holds
in its regressor costs what `cleaning` asks of one.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._progress import progress_bar
from robust_filterpy._warning import warn
from robust_filterpy.identification.estimation.beside import Settled
from robust_filterpy.identification.estimation.cleaning import THRESHOLDS
from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.estimation.trend import PRICE, Trend
from robust_filterpy.identification.judging.grid import Candidate, Grid, ImpulseResponse, Kind, Orders, Selection
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import likelihood_of_mixture, ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.results import said
from robust_filterpy.identification.models.signals import measured_output, recorded_input
from robust_filterpy.identification.models.structures import FIR, OutputError, Structure
from robust_filterpy.identification.models.time_axis import recording
from robust_filterpy.identification.models.unmeasured import measurements
from robust_filterpy.influence.regression import mad_scale

_CRITERIA: Final = {"bic": math.log, "aic": lambda samples: 2.0}
# So many samples of the impulse response after the longest delay, and so many measured samples for each of them.
_TAIL: Final = 30
_SAMPLES_EACH: Final = 5
# Chance that noise alone leaves the band of the impulse response anywhere.
_FALSE_DELAY: Final = 0.05
# Share that is held out, of so many samples at least; and what a fit of these must not fall behind, in percent.
_HELD: Final = 0.25
_LEAST_HELD: Final = 400
_BEHIND: Final = 1.0
# A larger residual, in standard deviations of y, is as wild as this one.
_WILD: Final = 10.0


def select_structure(
    y: ArrayLike,
    u: ArrayLike | None,
    kind: Kind = OutputError,
    na: Iterable[int] | None = None,
    nb: Iterable[int] | None = None,
    nc: Iterable[int] | None = None,
    nd: Iterable[int] | None = None,
    nf: Iterable[int] | None = None,
    nk: Iterable[int] | None = None,
    criterion: str = "bic",
    held_out: float | None = None,
    progress: bool | None = None,
) -> Selection:
    """Find the orders and the delay of a recording with outliers.

    Parameters
    ----------
    y : array_like, shape (N,)
        Measured output; NaN where it is missing.
    u : array_like, shape (N,) or (N, n_inputs), or None
        Inputs, each with orders and a delay of its own; None for an AR or ARMA, or an ARX or ARMAX without input.
    kind : function, default OutputError
        OutputError, ARX, ARMAX, FIR, BoxJenkins, ARMA or AR.
    na, nf : iterable of int, optional
        Numbers of a's, of a BoxJenkins of f's, to try. Default: range(1, 5).
    nb, nc : iterable of int, optional
        Numbers of b's and c's to try. Default: as many as a's; of a BoxJenkins as many b's as f's, and range(3) for nc,
        of a FIR range(1, 5). Of several inputs each has a number of b's of its own, from this range.
    nd : iterable of int, optional
        Numbers of d's of a BoxJenkins to try. Default: range(3).
    nk : iterable of int, optional
        Delays to try. Default: range(9).
    criterion : {"bic", "aic"}, default "bic"
        "bic" finds the true structure of a long recording, "aic" prefers predictions to parsimony.
    held_out : float, optional
        Share of the recording, at its end, in [0, 0.5], that the structures are compared without: what fits it worse by
        more than 1 than another, by models of the part before, is not taken, whatever its criterion. Default: the
        criterion is of the whole recording, and the best of each size are tried again on the last quarter without it,
        and must stay the models that they are with it; of fewer than 400 samples, or with 0, the criterion alone
        decides.
    progress : bool, optional
        Show a progress bar (tqdm) on standard error: True always, False never, None from 2 s on; where that is no
        terminal, None writes a line now and then instead.

    Returns
    -------
    Selection
        What was tried, the best first, and the best model.

    Raises
    ------
    ValueError
        If a range is empty or of an order that the kind has not, kind or criterion is unknown, held_out is out of
        range, u is missing, or the recording is too short for the largest structure.
    TypeError
        If an order is no integer.
    ImportError
        If `progress` is True and tqdm is missing.

    Notes
    -----
    A robust impulse response tells the delay first: its first sample outside its band, and the first far outside.
    All orders are tried with these delays, then the neighbors of the best (an order or the delay one more or one
    less), until none is better. A first b too small for the band is found then, by the likelihood. A structure
    whose first b is 0 within the noise comes after all others: it has a longer delay. Where the input does not
    excite a long impulse response, all delays are tried with all orders.

    The criterion takes the plant for linear and the noise for one that the structure can have. Where they are not, it
    buys parameters that other samples do not confirm; so the part held out has the last word. It is simulated from
    where the part before ended. The model of the whole recording must not be further from the model of the part than
    that is from what was measured.

    References
    ----------
    .. [1] Ronchetti, E. Robust model selection in regression. Statistics & Probability Letters 3 (1985) 21-23.
    .. [2] Machado, J. A. F. Robust model selection and M-estimation. Econometric Theory 9 (1993) 478-493.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy import Contaminated
    >>> from robust_filterpy.plants import simulate_output_error
    >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 1000)
    >>> noise = Contaminated(0.1, 10.0, 0.3)
    >>> y = simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, noise=noise, rng=3, na=2, nb=2).y
    >>> y = np.concatenate((np.zeros(3), y[:-3]))
    >>> select_structure(y, u, na=range(1, 4)).best.structure
    OutputError(na=2, nb=2, nk=4)
    """
    _checks.option("criterion", criterion, _CRITERIA)
    grid = Grid.of(kind, {"na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk}, u is not None)
    axis, y, u = recording(None, y=y, u=u)
    output = measured_output(y)
    signal = np.zeros((output.size, 0)) if u is None else _inputs(u, output.size)
    measured, lies = measurements(output, signal)
    if lies:
        warn(f"select_structure: {said(lies)}")
    grid = grid.of_inputs(signal.shape[1])
    share = (0.0 if measured.size < _LEAST_HELD else _HELD) if held_out is None else _checks.real("held_out", held_out)
    if not 0.0 <= share <= 0.5:
        raise ValueError(f"held_out: expected a share in [0, 0.5], got {_checks.shown(held_out)}")
    fitted = measured.size - round(share * measured.size)
    bar = progress_bar(None, progress, " structures", "select_structure")
    responses = () if u is None else _impulse_responses(measured, signal, grid)
    beginning = list(grid.beginning([{one.delay, one.sure_delay} - {None} for one in responses]))
    largest = max((grid.structure(orders) for orders in beginning), key=lambda one: one.n_theta)
    compared = fitted if held_out else measured.size
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        inputs = signal[:compared] if largest.n_inputs else None
        settled = Settled.of(identify(measured[:compared], inputs, largest, sampled=False, progress=False), compared)
    comparison = _Comparison(grid, measured, signal, criterion, compared, bar, settled)
    comparison.try_all(beginning)
    best = None
    while best != comparison.best:
        best = comparison.best
        comparison.try_all(grid.neighbours(best))
    late = comparison.tried_on_rest(fitted) if share and held_out is None else {}
    bar.close()
    rows = _ranked(comparison.rows(), late)
    structure = rows[0].structure
    trend: Any = None if held_out else settled
    model = identify(measured, None if u is None else signal, structure, trend=trend, progress=False)
    missing = (one for one in lies if one.kind != "copy")
    model = replace(model, dt=axis.dt, findings=(*missing, *model.findings))
    return Selection(rows, model, criterion, comparison.samples, responses)


def _ranked(rows: tuple[Candidate, ...], late: dict[Structure, float]) -> tuple[Candidate, ...]:
    """Return the table with the fits of what was held out, first the best row that these do not speak against."""
    rows = tuple(row._replace(held_out_fit=late.get(row.structure, row.held_out_fit)) for row in rows)
    fits = [row.held_out_fit for row in rows if math.isfinite(row.held_out_fit)]
    if not fits:
        return rows
    chosen = next(row for row in rows if row.held_out_fit >= max(fits) - _BEHIND)
    if chosen is not rows[0]:
        warn(
            f"select_structure: the criterion would take {rows[0].structure}, of which a part of the recording tells "
            f"so little of the rest that it fits new samples by {rows[0].held_out_fit:.0f} %; {chosen.structure} fits "
            f"them by {chosen.held_out_fit:.0f} % and is taken: the plant is not linear, or changes, or has a noise "
            "that these structures have not; see validate"
        )
    return (chosen, *(row for row in rows if row is not chosen))


class _Tried(NamedTuple):
    """A row of the table without its fits, and the signals that these are computed from."""

    row: Candidate
    model: Model
    residual: Array
    output: Array
    held_out: tuple[Array, Array] | None
    """Residual of the part that was held out, and the output that goes on from where the part before ended."""


class _Comparison:
    """The structures that were tried, on the same samples."""

    def __init__(
        self, grid: Grid, y: Array, u: Array, criterion: str, fitted: int, bar: Any, settled: Settled
    ) -> None:  # fmt: skip
        """Keep the recording, and apart what comes after the samples that are fitted."""
        self.grid, self.criterion, self.bar, self.settled = grid, criterion, bar, settled
        self.rest = (y[fitted:], u[fitted:]) if fitted < y.size else None
        self.y, self.u = y, u = y[:fitted], u[:fitted]
        self.tried: dict[Orders, _Tried] = {}
        self.samples = int(np.isfinite(y[grid.first :]).sum())
        measured = y[~np.isnan(y)]
        # Without a limit where more than half of the samples are equal.
        self.wild = (_WILD * mad_scale(measured - np.median(measured)) if measured.size else 0.0) or np.inf

    @property
    def best(self) -> Orders:
        """The orders that come first."""
        return min(self.tried, key=lambda orders: self.tried[orders].row.rank)

    def try_all(self, many: Iterable[Orders]) -> None:
        """Try out those that were not."""
        new = [orders for orders in dict.fromkeys(many) if orders not in self.tried]
        self.bar.total = (self.bar.total or 0) + len(new)
        for orders in new:
            self.try_out(orders)

    def try_out(self, orders: Orders) -> None:
        """Identify a structure, and keep its criterion, log-likelihood, residuals and output."""
        structure, first = self.grid.structure(orders), self.grid.first
        acting = [(i, nb, nk) for i, (nb, nk) in enumerate(structure.inputs) if nb]
        before = max([structure.na, *(nk + nb - 1 for _, nb, nk in acting)])
        y, u = self.y[first - before :], self.u[first - before :] if acting else None
        with warnings.catch_warnings():
            # A structure with too many parameters leaves the model open; the best one warns again.
            warnings.simplefilter("ignore", UserWarning)
            trend: Any = self.settled.after(first - before)
            model = identify(y, u, structure, trend=trend, sampled=False, progress=False)
        residual, output = (signal[before:] for signal in _signals(model, y, u))
        likelihood = self._cleaned_likelihood(model) if structure.na + structure.nd else self._log_likelihood(residual)
        price = _CRITERIA[self.criterion](self.samples)
        breaks = PRICE * math.log(self.samples) * len(self.settled.trend.breaks)
        value = -2.0 * likelihood + price * (structure.n_theta + 1) + breaks
        b = [structure.polynomials.b[i].start for i, _, _ in acting]
        shows_delay = bool((model.theta[b] ** 2 > price * model.P.diagonal()[b]).all())
        row = Candidate(structure, value, float("nan"), likelihood, shows_delay)
        held_out = None
        if self.rest is not None:
            held_out = _signals(model, self.rest[0], self.rest[1] if acting else None)
            if acting:
                # Told its motion anew, a pole next to the unit circle would fit any drift.
                held_out = held_out[0], np.asarray(model.simulate(self.rest[1], start="continued"))
        self.tried[orders] = _Tried(row, model, residual, output, held_out)
        self.bar.update()

    def _log_likelihood(self, residual: Array) -> float:
        """Return the log-likelihood of residuals of which no outlier touches another one."""
        return likelihood_of_mixture(residual[~np.isnan(residual)], self.wild)

    def _cleaned_likelihood(self, model: Model) -> float:
        """Return the log-likelihood of residuals of the cleaned output, less what the outliers cost."""
        return model.log_likelihood - 0.5 * THRESHOLDS[1] ** 2 * int((model.weights == 0.0).sum())

    def tried_on_rest(self, fitted: int) -> dict[Structure, float]:
        """Return how the best structure of each number of parameters fits what it has not seen, in percent."""
        # The model of the first samples misses some of the others, and the model of all samples is another one. Where
        # it is further away than that, a part of the recording does not confirm it: it may fit all of it and nothing
        # else. What no part tells of another is no matter of orders: a trend is taken off as the best model of all
        # samples has it, and inputs that did not act as they were read tell nothing here.
        model, y = self.tried[self.best].model, self.y.copy()
        if any(one.kind == "input outliers" for one in model.findings):
            return {}
        if model.trend.size:
            y -= np.pad(model.trend, (y.size - model.trend.size, 0), mode="edge")
        flat = self.settled._replace(trend=Trend(np.zeros(fitted), ()))
        part = _Comparison(self.grid, y, self.u, self.criterion, fitted, self.bar, flat)
        ranked = sorted(self.tried, key=lambda orders: self.tried[orders].row.rank, reverse=True)
        best_of_size = {self.tried[orders].row.structure.n_theta: orders for orders in ranked}
        self.bar.total = (self.bar.total or 0) + len(best_of_size)
        for orders in reversed(best_of_size.values()):
            # A part may tell too little of a structure that the whole tells of.
            with suppress(ValueError):
                part.try_out(orders)
        fits = {}
        for row in part.rows() if part.tried else ():
            orders = next(orders for orders, one in part.tried.items() if one.row.structure == row.structure)
            apart = part.apart(self.tried[orders].model, part.tried[orders].model)
            if not math.isfinite(row.held_out_fit + apart):
                continue
            fits[row.structure] = min(row.held_out_fit, 100.0 - apart)
        return fits

    def apart(self, one: Model, other: Model) -> float:
        """Return how far two models are apart in the part held out, in percent of what y varies there."""
        if self.rest is None or not one.structure.n_inputs:
            return 0.0
        u = np.concatenate((self.u, self.rest[1]))
        difference = (one.simulate(u) - other.simulate(u))[self.y.size :]
        difference -= difference.mean()
        return 100.0 - ordinary_fit(self.rest[0], self.rest[0] - difference, self.late)

    @property
    def late(self) -> Any:
        """The ordinary samples of the part held out, by the model that misses them least."""
        residuals = [one.held_out[0] for one in self.tried.values() if one.held_out is not None]
        closest = min(residuals, key=lambda e: float(np.nanmedian(np.abs(e))))
        return ordinary_samples(closest, self.rest[0] if self.rest is not None else closest)

    def rows(self) -> tuple[Candidate, ...]:
        """Return the table; the ordinary samples are those of the best model."""
        best = self.tried[self.best]
        y = self.y[self.grid.first :]
        ordinary = ordinary_samples(best.residual, y)
        late, rows = None if self.rest is None else self.late, []
        for row, _, _, output, held_out in self.tried.values():
            row = row._replace(fit=ordinary_fit(y, output, ordinary))
            if self.rest is not None and held_out is not None:
                row = row._replace(held_out_fit=ordinary_fit(self.rest[0], held_out[1], late))
            rows.append(row)
        return tuple(sorted(rows, key=lambda row: row.rank))


def _signals(model: Model, y: Array, u: Array | None) -> tuple[Array, Array]:
    """Return the residuals of a model, and its output from inputs alone, or without any one step ahead."""
    residual = model.residuals(y, u)
    return residual, y - residual if u is None else model.free_run(y, u)


def _inputs(u: Any, length: int) -> Array:
    """Return recorded inputs, shape (N, n_inputs), or raise."""
    signal = np.asarray(u)
    count = signal.shape[1] if signal.ndim == 2 and 1 not in signal.shape else 1
    return recorded_input(FIR((1,) * count), u, length)


def _impulse_responses(y: Array, u: Array, grid: Grid) -> tuple[ImpulseResponse, ...]:
    """Return the robust impulse response to each input, none where the recording does not tell them."""
    present, count = int(np.isfinite(y).sum()), u.shape[1]
    start, last = grid.lags[0], grid.lags[-1]
    length = min(last - start + _TAIL, present // (_SAMPLES_EACH * count))
    if length < last - start + 1:
        return ()
    try:
        model = identify(y, u, FIR((length,) * count if count > 1 else length, start), progress=False)
    except ValueError:
        # The input does not excite so many samples, or y is not good for any model, which the first of them will say.
        return ()
    level = norm.ppf(1.0 - 0.5 * _FALSE_DELAY / length)
    lags = np.arange(start, start + length)
    parts = model.structure.polynomials.b
    return tuple(ImpulseResponse(lags, model.theta[part], level * model.std[part]) for part in parts)
