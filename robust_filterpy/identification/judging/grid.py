"""Which orders and delays may be tried, which come first, and which are neighbours."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.identification.models.constructors import AR, ARMA, ARMAX, ARX, FIR, BoxJenkins, OutputError
from robust_filterpy.identification.models.structures import FORMS, Structure

Kind = Callable[..., Structure]
_KINDS: Final[tuple[Kind, ...]] = (OutputError, ARX, ARMAX, FIR, BoxJenkins, ARMA, AR)

Orders = tuple[int, ...]


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
        found: dict[str, Any] = {}
        for name, order in zip(self.ranges, orders, strict=True):
            whole, _, each = name.partition("[")
            found[whole] = (*found.get(whole, ()), order) if each else order
        return found

    def structure(self, orders: Orders) -> Structure:
        """Return the structure of these orders."""
        return self.kind(**self.named(orders))

    def beginning(self, found: list[set[int | None]]) -> Iterator[Orders]:
        """Yield all orders with the delays that were found for each input, or with all delays."""
        (_, first), *others = self.ranges.items()
        lags = self.lags
        sets = [
            sorted({min(lags, key=lambda lag: abs(lag - delay)) for delay in one if delay is not None}) for one in found
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
        known = [one or [self.lags[0]] for one in (sets or [[]] * count)]
        return sorted({tuple(one[0] for one in known), tuple(one[-1] for one in known)})

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
                found = (*orders[:i], value, *orders[i + 1 :])
                yield tuple(found[0] if follows else order for follows, order in zip(tied, found, strict=True))

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
