"""Calls undone: what a filter holds is put back where a call is refused or interrupted."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar, cast

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array

#: What a robust filter keeps outside __dict__, which filterpy's Saver copies at every epoch and turns into arrays.
SLOTS: Final = (
    *"_K _S _SI _last _share _updates _y".split(),
    *"_kept _memory _other_sensors _outlier_probability _policy _process_scales".split(),
)
_Method = TypeVar("_Method", bound=Callable[..., Any])


def _copied(attributes: dict[str, Any]) -> list[tuple[Array, Array]]:
    """Return the writable arrays of a dictionary, each with a copy of its contents."""
    arrays = [value for value in attributes.values() if type(value) is np.ndarray]
    return [(array, array.copy()) for array in arrays if array.flags.writeable]


def _put_back(copied: list[tuple[Array, Array]]) -> None:
    """Let arrays hold again what `_copied` found in them."""
    for array, content in copied:
        array[...] = content


# An array of a few numbers is copied in a tenth of the time that it takes to ask Python for that.
_copied_arrays = getattr(kernel.extension(), "copied_arrays", _copied)
_put_back_arrays = getattr(kernel.extension(), "put_back_arrays", _put_back)
_in_slots = operator.attrgetter(*SLOTS)


class Snapshot:
    """What a filter holds, to put it back."""

    __slots__ = ("_attributes", "_contents", "_drawn", "_slots", "_source")

    def __init__(self, kf: Any) -> None:
        """Keep the attributes, and the contents of arrays: a user's function may write into one that is still held."""
        self._attributes = kf.__dict__.copy()
        self._slots = _in_slots(kf)
        self._contents = _copied_arrays(self._attributes)
        # An ensemble's random numbers; numpy's older generator hides where they come from.
        self._source = None
        if "rng" in self._attributes:
            rng = self._attributes["rng"]
            self._source = getattr(rng, "bit_generator", getattr(rng, "_bit_generator", None))
            self._drawn = None if self._source is None else self._source.state

    def put_back(self, kf: Any) -> None:
        """Put the filter back as it was."""
        kf.__dict__.clear()
        kf.__dict__.update(self._attributes)
        for name, value in zip(SLOTS, self._slots, strict=True):
            setattr(kf, name, value)
        _put_back_arrays(self._contents)
        if self._source is not None:
            self._source.state = self._drawn


@contextmanager
def unchanged_if_refused(kf: Any) -> Iterator[None]:
    """Put a filter back as it was if the block raises anything, an interrupt too."""
    before = Snapshot(kf)
    try:
        yield
    except BaseException:
        before.put_back(kf)
        raise


def whole(method: _Method) -> _Method:
    """Make a call that is refused or interrupted one that has not happened."""

    @functools.wraps(method)
    def called(self: Any, *arguments: Any, **named: Any) -> Any:
        """Call, and put the filter back if that raises."""
        # Not the context manager, which costs as much as a step of the kernel.
        before = Snapshot(self)
        try:
            return method(self, *arguments, **named)
        except BaseException:
            before.put_back(self)
            raise

    return cast(_Method, called)
