"""select_structure: the orders and the delay of a model, by a robust information criterion.

All structures are compared on the same samples: the recording is cut for each of them such that its first residual
belongs to the same sample. Steps and ramps of the level and outliers of the inputs are those that the largest structure
has besides it: what each looked for itself would be parameters that the criterion does not count:

    criterion = -2 log-likelihood + price n,   price = log(samples) for "bic", 2 for "aic"

An outlier costs a bounded number of units of log-likelihood, whichever model it is held against (Ronchetti 1985,
Machado 1993), and one that an ARX or ARMAX holds in its regressor what `missing` asks of an outlier.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm

from robust_filterpy import _checks
from robust_filterpy._brief import Pictured, tabulated
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage, stages
from robust_filterpy._warning import warn
from robust_filterpy.identification.estimation.disturbances import PRICE, Settled
from robust_filterpy.identification.estimation.estimate import near
from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.estimation.search import THRESHOLD
from robust_filterpy.identification.models import structures
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.recording import measurements
from robust_filterpy.identification.models.results import Report, said
from robust_filterpy.identification.models.signals import measured_output, recorded_input, recording
from robust_filterpy.identification.models.structures import FORMS, Structure

Kind = Callable[..., Structure]
_KINDS: Final[dict[str, Kind]] = {
    name: getattr(structures, name) for name in ("OutputError", "ARX", "ARMAX", "FIR", "BoxJenkins", "ARMA", "AR")
}
Orders = tuple[int, ...]
# Arguments that each input has its own of.
_OF_INPUTS: Final = ("nb", "nk")
# What lies so many times outside the band is no accident.
_SURE: Final = 2.0


class Grid(NamedTuple):
    """What may be tried: values of each argument of a constructor, None for as many as the first of them."""

    kind: Kind
    #: By argument, and number of the input that it is of: each has b's and a delay of its own.
    ranges: dict[tuple[str, int], tuple[int, ...] | None]

    @classmethod
    def of(cls, kind: Kind, given: dict[str, Any], count: int) -> Grid:
        """Return checked orders, of so many inputs a number of b's and a delay each; no b's and one delay of none."""
        if kind not in _KINDS.values():
            raise ValueError(f"kind: expected one of {', '.join(_KINDS)}, got {_checks.shown(kind)}")
        arguments = FORMS[kind.__name__]
        for name, values in given.items():
            if values is not None and name not in arguments:
                raise ValueError(f"{name}: expected none for {kind.__name__}, which has {', '.join(arguments)}")
        first = next(name for name in ("na", "nf", "nb") if name in arguments)
        usual = {first: range(1, 5), "nk": range(9), "nd": range(3)} | ({"nc": range(3)} if "nd" in arguments else {})
        ranges: dict[str, tuple[int, ...] | None] = {}
        for name in (first, *(other for other in arguments if other != first)):
            values = usual.get(name) if given[name] is None else given[name]
            absent = name in ("nb", "nk") and not count
            ranges[name] = (0,) if absent else None if values is None else _range(name, values, name == "nb")
        if count and "nb" not in arguments:
            raise ValueError(f"u: expected None for {kind.__name__}, which has no input; take ARX or ARMAX")
        if not count and "nb" in arguments and kind not in (structures.ARX, structures.ARMAX):
            raise ValueError(f"u: expected an input for {kind.__name__}, got None; without one take ARX or ARMAX")
        if "nb" in ranges and ranges["nb"] is None and 0 in (ranges[first] or ()):
            raise ValueError(
                f"nb: expected the numbers of b's to try where {first} holds 0, got None; say nb=range(1, 5)"
            )
        acting = tuple(value for value in ranges[first] or () if value)
        of_each = {
            (name, i): values or acting if count > 1 and name in _OF_INPUTS else values
            for name, values in ranges.items()
            for i in range(max(count, 1) if name in _OF_INPUTS else 1)
        }
        return cls(kind, of_each)

    def structure(self, orders: Orders) -> Structure:
        """Return the structure of these orders; those of several inputs are a tuple."""
        arguments: dict[str, Any] = {}
        for (name, _), order in zip(self.ranges, orders, strict=True):
            each = name in _OF_INPUTS and (name, 1) in self.ranges
            arguments[name] = (*arguments.get(name, ()), order) if each else order
        return self.kind(**arguments)

    def beginning(self, given: list[set[int]]) -> Iterator[Orders]:
        """Yield all orders with the first delays given for each input and with the last, or with all delays of one."""
        (_, first), *others = self.ranges.items()
        lags = self.lags
        delays = [sorted({min(lags, key=lambda lag: abs(lag - delay)) for delay in one}) for one in given]
        # Where none was found all of one input; of several inputs the least.
        delays = [one or ([lags[0]] if len(delays) > 1 else list(lags)) for one in delays]
        ends = {tuple(one[0] for one in delays), tuple(one[-1] for one in delays)}
        tried = [(lag,) for lag in delays[0]] if len(delays) == 1 else sorted(ends)
        for n in first or ():
            for each in tried:
                yield (n, *(self._nearest(*of, n, each) for of, _ in others))

    def _nearest(self, name: str, i: int, n: int, delays: tuple[int, ...]) -> int:
        """Return the value of an order that is next to the one that is wanted to begin with."""
        values, wanted = self.ranges[name, i], delays[i] if name == "nk" else n if name == "nb" else 0
        return n if values is None else min(values, key=lambda value: abs(value - wanted))

    @property
    def lags(self) -> tuple[int, ...]:
        """The delays of the first input that may be tried."""
        return self.ranges.get(("nk", 0)) or (0,)

    def neighbours(self, orders: Orders) -> Iterator[Orders]:
        """Yield the orders of which one is the next one up or down."""
        tied = [values is None for values in self.ranges.values()]
        for i, values in enumerate(self.ranges.values()):
            if values is None:
                continue
            place = values.index(orders[i])
            for value in values[max(place - 1, 0) : place + 2]:
                changed = (*orders[:i], value, *orders[i + 1 :])
                yield tuple(changed[0] if follows else order for follows, order in zip(tied, changed, strict=True))

    @property
    def first(self) -> int:
        """The first sample that every structure can predict."""
        most = {of: (values or next(iter(self.ranges.values())) or (0,))[-1] for of, values in self.ranges.items()}
        delayed = [lag + most.get(("nb", i), 1) - 1 for (name, i), lag in most.items() if name == "nk"]
        return max(most.get(("na", 0), 0), *delayed, 0)


def _range(name: str, values: Any, least: int) -> tuple[int, ...]:
    """Return sorted orders or raise."""
    if isinstance(values, (int, np.integer)):
        values = (values,)
    if not isinstance(values, Iterable) or isinstance(values, str):
        raise TypeError(f"{name}: expected integers to try such as range(1, 5), got {_checks.shown(values)}")
    orders = sorted({_checks.count(f"{name}[{i}]", value, least) for i, value in enumerate(values)})
    if not orders:
        raise ValueError(f"{name}: expected at least one integer to try, got an empty range")
    return tuple(orders)


class Candidate(NamedTuple):
    """One structure of the table.

    Structures whose first b is worth its price come before those whose first b is 0 within the noise.

    Attributes
    ----------
    structure : Structure
        The structure.
    criterion : float
        Its information criterion; the least is the best.
    fit : float
        Fit of the output from inputs alone, or without input of the prediction one step ahead, on ordinary samples.
    log_likelihood : float
        Of the prediction errors on the samples that all structures share.
    shows_delay : bool
        Whether the first b is as many standard deviations from 0 as the criterion asks of a further parameter. Without
        it the delay of the structure is shorter than the recording shows.
    held_out_fit : float
        Fit on the ordinary samples of the part that was held out, by the model of the part before; NaN where that was
        not tried. It is of the best structure of each size, and no better than the fit of the two
        models, that of the part and that of the whole recording, to each other.
    """

    structure: Structure
    criterion: float
    fit: float
    log_likelihood: float
    shows_delay: bool
    held_out_fit: float = math.nan

    @property
    def rank(self) -> tuple[bool, float]:
        """By which the table is sorted."""
        return not self.shows_delay, self.criterion


class ImpulseResponse(NamedTuple):
    """What the output does after a unit impulse of the input, by robust regression.

    Attributes
    ----------
    lags : ndarray of int, shape (n,)
        Samples after the impulse.
    values : ndarray, shape (n,)
        Response, in units of y over u.
    band : ndarray, shape (n,)
        Where the response is 0, the values of all lags lie within -+ band with a probability of 95 %.
    """

    lags: Any
    values: Array
    band: Array

    @property
    def delay(self) -> int | None:
        """The first lag outside the band, None if there is none."""
        return self._first_outside(1.0)

    @property
    def sure_delay(self) -> int | None:
        """The first lag far outside the band, None if there is none."""
        return self._first_outside(_SURE)

    def _first_outside(self, bands: float) -> int | None:
        """Return the first lag outside so many bands."""
        outside = np.abs(self.values) > bands * self.band
        return int(self.lags[outside.argmax()]) if outside.any() else None


@dataclass(frozen=True)
class Selection(Report, Pictured):
    """Structures of a recording, the best first.

    Attributes
    ----------
    rows : tuple of Candidate
        The structures that were tried: the one that was taken, then all others sorted by their criterion.
    best : Model
        The model of the first, identified from the whole recording.
    criterion : str
        "bic" or "aic".
    samples : int
        How many samples the structures were compared on.
    impulse_responses : tuple of ImpulseResponse
        What the search for the delay of each input began with; empty without input, or where it excites too little.
    """

    picture, row = "models.plot_structure_selection", "structure"

    rows: tuple[Candidate, ...]
    best: Model
    criterion: str
    samples: int
    impulse_responses: tuple[ImpulseResponse, ...]

    def _more(self) -> dict[str, list[Any]]:
        """Return further columns of the DataFrame."""
        above = [row.criterion - self.rows[0].criterion for row in self.rows]
        return {"above_best": above, "parameters": [row.structure.n_theta for row in self.rows]}

    def to_text(self, rows: int = 10) -> str:
        """Return the first rows as a table.

        Parameters
        ----------
        rows : int, default 10
            How many.

        Returns
        -------
        str
        """
        heads = {"structure": -38, self.criterion: 12, "above best": 12, "fit, %": 9, "log-likelihood": 16}
        if any(not math.isnan(row.held_out_fit) for row in self.rows):
            heads["held out, %"] = 13
        shown = []
        for row in self.rows[: _checks.count("rows", rows, 1)]:
            values = (row.criterion, row.criterion - self.rows[0].criterion, row.fit, row.log_likelihood)
            cells = [f"{one:.{places}f}" for one, places in zip(values, (1, 1, 2, 1), strict=True)]
            late = "-" if math.isnan(row.held_out_fit) else f"{row.held_out_fit:.2f}"
            whole = [str(row.structure), *cells, late]
            shown.append([*whole[: len(heads)], "" if row.shows_delay else "  first b is 0"])
        return tabulated(heads, shown)


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


def select_structure(
    y: ArrayLike, u: ArrayLike | None, kind: Kind = structures.OutputError, *, na: Iterable[int] | None = None,
    nb: Iterable[int] | None = None, nc: Iterable[int] | None = None, nd: Iterable[int] | None = None,
    nf: Iterable[int] | None = None, nk: Iterable[int] | None = None, criterion: str = "bic",
    progress: bool | None = None,
) -> Selection:  # fmt: skip
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
    progress : bool, optional
        Whether to say on standard error what it is at: by default after 2 s.

    Returns
    -------
    Selection
        What was tried, the best first, and the best model.

    Raises
    ------
    ValueError
        If a range is empty or of an order that the kind has not, kind or criterion is unknown, u is missing, or the
        recording is too short for the largest structure.
    TypeError
        If an order is no integer.

    Notes
    -----
    A robust impulse response tells the delay first: its first sample outside its band, and the first far outside.
    All orders are tried with these delays, then the neighbors of the best (an order or the delay one more or one
    less), until none is better; these are searched from the likeliest model whose poles they have too, the first from
    nothing. A first b too small for the band is found then, by the likelihood. A structure whose first b is 0 within
    the noise comes after all others: it has a longer delay. Where the input does not excite a long impulse response,
    all delays are tried with all orders.

    The criterion takes the plant for linear and the noise for one that the structure can have. Where they are not, it
    buys parameters that other samples do not confirm. So of 400 samples or more the last quarter has the last word: the
    best of each size are tried again without it, and what then fits it worse by more than 1 % than another is not
    taken. It is simulated from where the part before ended. The model of the whole recording must not be further from
    the model of the part than that is from what was measured.

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
    axis, y, u = recording(None, y=y, u=u)
    output = measured_output(y)
    signal = np.zeros((output.size, 0)) if u is None else _inputs(u, output.size)
    grid = Grid.of(kind, {"na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk}, signal.shape[1])
    measured, lies = measurements(output, signal)
    if lies:
        warn(f"select_structure: {said(lies)}")
    confirmed, fitted = measured.size >= _LEAST_HELD, round((1.0 - _HELD) * measured.size)
    responses = () if u is None else _impulse_responses(measured, signal, grid)
    delays: Any = [{one.delay, one.sure_delay} - {None} for one in responses]
    beginning = list(grid.beginning(delays or [set()] * max(signal.shape[1], 1)))
    largest = max((grid.structure(orders) for orders in beginning), key=lambda one: one.n_theta)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        inputs = signal if largest.n_inputs else None
        settled = Settled.of(identify(measured, inputs, largest, progress=False), measured.size)
    comparison = _Comparison(grid, measured, signal, criterion, settled)
    sizes = {grid.structure(orders).n_theta for orders in beginning} if confirmed else ()
    with stages("select_structure", progress):
        comparison.try_all(beginning, len(set(grid.neighbours(beginning[0]))) + len(sizes))
        comparison.near = True
        best = None
        while best != comparison.best:
            best = comparison.best
            comparison.try_all(grid.neighbours(best), len(sizes))
        late = comparison.tried_on_rest(fitted) if confirmed else {}
    rows = _ranked(comparison.rows(), late)
    structure = rows[0].structure
    trend: Any = settled
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


class _Comparison:
    """The structures that were tried, on the same samples."""

    def __init__(self, grid: Grid, y: Array, u: Array, criterion: str, settled: Settled) -> None:
        """Keep the recording."""
        self.grid, self.criterion, self.settled, self.y, self.u = grid, criterion, settled, y, u
        self.tried: dict[Orders, _Tried] = {}
        self.near = False
        self.samples = int(np.isfinite(y[grid.first :]).sum())

    @property
    def best(self) -> Orders:
        """The orders that come first."""
        return min(self.tried, key=lambda orders: self.tried[orders].row.rank)

    def try_all(self, many: Iterable[Orders], later: int) -> None:
        """Try out those that were not; some more come later."""
        new = [orders for orders in dict.fromkeys(many) if orders not in self.tried]
        total = len(self.tried) + len(new) + later
        for orders in new:
            self.try_out(orders)
            stage(f"{len(self.tried)} of {total} structures")

    def beginning(self, structure: Structure) -> Array | None:
        """Return the likeliest of the models whose noise and poles this structure has too, None to search anew."""
        if not self.near or not structure.nf + structure.nc + structure.nd:
            return None
        models = [one.model for one in self.tried.values() if not one.model.levels.size]
        sizes = ("na", "nf", "nc", "nd")
        within = [one for one in models if all(getattr(one.structure, n) <= getattr(structure, n) for n in sizes)]
        best = max(within, key=lambda one: one.log_likelihood, default=None)
        return None if best is None else near(best.structure, best.theta, best.offset, structure, self.u)

    def try_out(self, orders: Orders) -> None:
        """Identify a structure, and keep its criterion, log-likelihood, residuals and output."""
        structure, first = self.grid.structure(orders), self.grid.first
        acting = [(i, nb, nk) for i, (nb, nk) in enumerate(structure.inputs) if nb]
        before = max([structure.na, *(nk + nb - 1 for _, nb, nk in acting)])
        y, u = self.y[first - before :], self.u[first - before :] if acting else None
        with warnings.catch_warnings():
            # A structure with too many parameters leaves the model open; the best one warns again.
            warnings.simplefilter("ignore", UserWarning)
            trend: Any = self.settled.after(first - before)._replace(begin=self.beginning(structure))
            model = identify(y, u, structure, trend=trend, progress=False)
        residual, output = (signal[before:] for signal in _signals(model, y, u))
        # Outliers that stand in a regressor are in no residual.
        likelihood = model.log_likelihood - 0.5 * THRESHOLD**2 * int((model.weights == 0.0).sum())
        price = _CRITERIA[self.criterion](self.samples)
        breaks = PRICE * math.log(self.samples) * len(self.settled.trend.breaks)
        value = -2.0 * likelihood + price * (structure.n_theta + 1) + breaks
        b = [structure.polynomials.b[i].start for i, _, _ in acting]
        shows_delay = bool((model.theta[b] ** 2 > price * model.P.diagonal()[b]).all())
        row = Candidate(structure, value, float("nan"), likelihood, shows_delay)
        self.tried[orders] = _Tried(row, model, residual, output)

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
        part = _Comparison(self.grid, y[:fitted], self.u[:fitted], self.criterion, Settled(np.zeros(fitted)))
        ranked = sorted(self.tried, key=lambda orders: self.tried[orders].row.rank, reverse=True)
        best_of_size = {self.tried[orders].row.structure.n_theta: orders for orders in ranked}
        rest, signals, fits = y[fitted:], {}, {}
        for place, orders in enumerate(reversed(best_of_size.values()), len(self.tried) + 1):
            stage(f"{place} of {len(self.tried) + len(best_of_size)} structures")
            # A part may tell too little of a structure that the whole tells of.
            with suppress(ValueError):
                part.try_out(orders)
                model = part.tried[orders].model
                acts = any(nb for nb, _ in model.structure.inputs)
                residual, output = _signals(model, rest, self.u[fitted:] if acts else None)
                # With its motion found anew, a pole next to the unit circle would fit any drift.
                output = np.asarray(model.simulate(self.u[fitted:], start="continued")) if acts else output
                signals[orders] = residual, output
        if not signals:
            return {}
        # The ordinary samples are those of the model that misses them least.
        closest = min((e for e, _ in signals.values()), key=lambda e: float(np.nanmedian(np.abs(e))))
        late = ordinary_samples(closest, rest)
        for orders, (_, output) in signals.items():
            one, other, apart = self.tried[orders].model, part.tried[orders].model, 0.0
            if one.structure.n_inputs:
                difference = (one.simulate(self.u) - other.simulate(self.u))[fitted:]
                apart = 100.0 - ordinary_fit(rest, rest - difference + difference.mean(), late)
            fit = ordinary_fit(rest, output, late)
            if math.isfinite(fit + apart):
                fits[one.structure] = min(fit, 100.0 - apart)
        return fits

    def rows(self) -> tuple[Candidate, ...]:
        """Return the table; the ordinary samples are those of the best model."""
        best = self.tried[self.best]
        y = self.y[self.grid.first :]
        ordinary = ordinary_samples(best.residual, y)
        rows = [row._replace(fit=ordinary_fit(y, output, ordinary)) for row, _, _, output in self.tried.values()]
        return tuple(sorted(rows, key=lambda row: row.rank))


def _signals(model: Model, y: Array, u: Array | None) -> tuple[Array, Array]:
    """Return the residuals of a model, and its output from inputs alone, or without any one step ahead."""
    residual = model.residuals(y, u)
    return residual, y - residual if u is None else model.free_run(y, u)


def _inputs(u: Any, length: int) -> Array:
    """Return recorded inputs, shape (N, n_inputs), or raise."""
    signal = np.asarray(u)
    count = signal.shape[1] if signal.ndim == 2 and 1 not in signal.shape else 1
    return recorded_input(structures.FIR((1,) * count), u, length)


def _impulse_responses(y: Array, u: Array, grid: Grid) -> tuple[ImpulseResponse, ...]:
    """Return the robust impulse response to each input, none where the recording does not tell them."""
    present, count = int(np.isfinite(y).sum()), u.shape[1]
    start, last = grid.lags[0], grid.lags[-1]
    length = min(last - start + _TAIL, present // (_SAMPLES_EACH * count))
    if length < last - start + 1:
        return ()
    try:
        long = structures.FIR((length,) * count if count > 1 else length, start)
        model = identify(y, u, long, progress=False)
    except ValueError:
        # The input does not excite so many samples, or y is not good for any model, which the first of them will say.
        return ()
    level = norm.ppf(1.0 - 0.5 * _FALSE_DELAY / length)
    lags = np.arange(start, start + length)
    parts = ((model.theta[part], level * model.std[part]) for part in model.structure.polynomials.b)
    return tuple(ImpulseResponse(lags, *part) for part in parts)
