"""Which orders and delays may be tried, which are neighbors, and the table of those that were tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._pictures import Pictured
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.structures import (
    AR,
    ARMA,
    ARMAX,
    ARX,
    FIR,
    FORMS,
    BoxJenkins,
    OutputError,
    Structure,
)
from robust_filterpy.identification.models.time_axis import table

Kind = Callable[..., Structure]
_KINDS: Final[tuple[Kind, ...]] = (OutputError, ARX, ARMAX, FIR, BoxJenkins, ARMA, AR)
Orders = tuple[int, ...]
# What lies so many times outside the band is no accident.
_SURE: Final = 2.0


class Grid(NamedTuple):
    """What may be tried: values of each argument of a constructor, None for as many as the first of them."""

    kind: Kind
    ranges: dict[str, tuple[int, ...] | None]

    @classmethod
    def of(cls, kind: Kind, given: dict[str, Any], has_input: bool) -> Grid:
        """Return checked orders; no b's and one delay without input."""
        if kind not in _KINDS:
            names = ", ".join(one.__name__ for one in _KINDS)
            raise ValueError(f"kind: expected one of {names}, got {_checks.shown(kind)}")
        arguments = FORMS[kind.__name__]
        for name, values in given.items():
            if values is not None and name not in arguments:
                raise ValueError(f"{name}: expected none for {kind.__name__}, which has {', '.join(arguments)}")
        first = next(name for name in ("na", "nf", "nb") if name in arguments)
        leading = _range(first, _or(given[first], range(1, 5)), first == "nb")
        ranges: dict[str, tuple[int, ...] | None] = {first: leading}
        if has_input and "nb" not in arguments:
            raise ValueError(f"u: expected None for {kind.__name__}, which has no input; take ARX or ARMAX")
        if not has_input and "nb" in arguments and kind not in (ARX, ARMAX):
            raise ValueError(f"u: expected an input for {kind.__name__}, got None; without one take ARX or ARMAX")
        for name in arguments:
            if name in ("nb", "nk") and not has_input:
                ranges[name] = (0,)
            elif name == "nk":
                ranges[name] = _range(name, _or(given[name], range(9)), 0)
            elif name == "nd" or (name == "nc" and kind is BoxJenkins):
                ranges[name] = _range(name, _or(given[name], range(3)), 0)
            elif name != first:
                ranges[name] = None if given[name] is None else _range(name, given[name], name == "nb")
        if "nb" in ranges and ranges["nb"] is None and 0 in leading:
            raise ValueError(
                f"nb: expected the numbers of b's to try where {first} holds 0, got None; say nb=range(1, 5)"
            )
        return cls(kind, ranges)

    def of_inputs(self, count: int) -> Grid:
        """Return the grid with a number of b's and a delay for each of several inputs."""
        if count < 2:
            return self
        ranges: dict[str, tuple[int, ...] | None] = {}
        for name, values in self.ranges.items():
            if name not in ("nb", "nk"):
                ranges[name] = values
                continue
            if values is None:
                values = tuple(value for value in next(iter(self.ranges.values())) or () if value)
            ranges |= {f"{name}[{i}]": values for i in range(count)}
        return self._replace(ranges=ranges)

    def named(self, orders: Orders) -> dict[str, Any]:
        """Return orders by their names; those of several inputs as a tuple."""
        by_name: dict[str, Any] = {}
        for name, order in zip(self.ranges, orders, strict=True):
            whole, _, each = name.partition("[")
            by_name[whole] = (*by_name.get(whole, ()), order) if each else order
        return by_name

    def structure(self, orders: Orders) -> Structure:
        """Return the structure of these orders."""
        return self.kind(**self.named(orders))

    def beginning(self, given: list[set[int | None]]) -> Iterator[Orders]:
        """Yield all orders with the delays given for each input, or with all delays."""
        (_, first), *others = self.ranges.items()
        lags = self.lags
        sets = [
            sorted({min(lags, key=lambda lag: abs(lag - delay)) for delay in one if delay is not None}) for one in given
        ]
        single = "nk" in self.ranges or not any(name.startswith("nk") for name in self.ranges)
        # All delays of one input where none was found; of several inputs the least.
        tried = [(lag,) for lag in ((sets[0] if sets else []) or lags)] if single else self._together(sets)
        for n in first or ():
            for delays in tried:
                yield (n, *(self._nearest(name, values, n, delays) for name, values in others))

    @property
    def lags(self) -> tuple[int, ...]:
        """The delays of the first input that may be tried."""
        return self.ranges.get("nk") or self.ranges.get("nk[0]") or (0,)

    def _together(self, sets: list[list[int]]) -> list[tuple[int, ...]]:
        """Return the first delays of all inputs, and the last ones."""
        count = sum(name.startswith("nk[") for name in self.ranges)
        delays = [one or [self.lags[0]] for one in (sets or [[]] * count)]
        return sorted({tuple(one[0] for one in delays), tuple(one[-1] for one in delays)})

    def _nearest(self, name: str, values: tuple[int, ...] | None, n: int, delays: tuple[int, ...]) -> int:
        """Return the value of an order that is next to the one that is wanted to begin with."""
        if values is None:
            return n
        whole, _, each = name.partition("[")
        wanted = {"nk": delays[int(each[:-1]) if each else 0], "nb": n}.get(whole, 0)
        return min(values, key=lambda value: abs(value - wanted))

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
        most = {name: (values or next(iter(self.ranges.values())) or (0,))[-1] for name, values in self.ranges.items()}
        delayed = [lag + most.get(name.replace("nk", "nb"), 1) - 1 for name, lag in most.items() if name[:2] == "nk"]
        return max(most.get("na", 0), most.get("nb", 1) - 1 if not delayed else 0, *delayed, 0)


def _or(values: Any, default: range) -> Any:
    """Return values, or the default of those that were not given."""
    return default if values is None else values


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
        not tried. Without ``held_out=`` it is of the best structure of each size, and no better than the fit of the two
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
class Selection(Pictured):
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

    picture = "workbench.plot_structure_selection"

    rows: tuple[Candidate, ...]
    best: Model
    criterion: str
    samples: int
    impulse_responses: tuple[ImpulseResponse, ...]

    @property
    def impulse_response(self) -> ImpulseResponse | None:
        """That of the first input, None if there is none."""
        return self.impulse_responses[0] if self.impulse_responses else None

    def to_frame(self) -> Any:
        """Return the whole table as a pandas DataFrame, the best first.

        Returns
        -------
        pandas.DataFrame
            A row for each structure: criterion, above_best, fit, log_likelihood, shows_delay, held_out_fit, parameters.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        fields = ("criterion", "fit", "log_likelihood", "shows_delay", "held_out_fit")
        columns: dict[str, Any] = {name: [getattr(row, name) for row in self.rows] for name in fields}
        columns["above_best"] = [row.criterion - self.rows[0].criterion for row in self.rows]
        columns["parameters"] = [row.structure.n_theta for row in self.rows]
        return table(columns, [str(row.structure) for row in self.rows], "structure")

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
        held_out = any(not math.isnan(row.held_out_fit) for row in self.rows)
        lines = [f"{'structure':<38}{self.criterion:>12}{'above best':>12}{'fit, %':>9}{'log-likelihood':>16}"]
        lines[0] += f"{'held out, %':>13}" if held_out else ""
        for row in self.rows[: _checks.count("rows", rows, 1)]:
            above = row.criterion - self.rows[0].criterion
            values = f"{row.criterion:>12.1f}{above:>12.1f}{row.fit:>9.2f}{row.log_likelihood:>16.1f}"
            late = "-" if math.isnan(row.held_out_fit) else f"{row.held_out_fit:.2f}"
            values += f"{late:>13}" if held_out else ""
            lines.append(f"{row.structure!s:<38}{values}{'' if row.shows_delay else '  first b is 0'}")
        return "\n".join(lines)

    __str__ = to_text
