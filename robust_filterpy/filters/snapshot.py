"""Calls undone: what a filter holds is put back where a call is refused or interrupted."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar, cast

import numpy as np

from robust_filterpy import kernel

#: What a robust filter keeps outside __dict__, which filterpy's Saver copies at every epoch and turns into arrays.
SLOTS: Final = (
    *"_K _S _SI _last _updates _window _y".split(),
    *"_kept _memory _named_sensors _other_sensors _policy _process_scales".split(),
)
_Method = TypeVar("_Method", bound=Callable[..., Any])


def _copied(attributes: dict[str, Any]) -> tuple[list[Any], bytes]:
    """Return the writable arrays of a dictionary, each with a copy of its contents; the kernel returns arrays alone,
    and what they hold one after another, or None where it does not serve.
    """
    arrays = [value for value in attributes.values() if type(value) is np.ndarray]
    return [(array, array.copy()) for array in arrays if array.flags.writeable], b""


def _put_back_arrays(copied: tuple[list[Any], bytes]) -> None:
    """Let arrays hold again what was found in them."""
    arrays, contents = copied
    if sum(array.nbytes for array in arrays if type(array) is np.ndarray) != len(contents):
        raise ValueError("a filter's array was given another shape during a call")
    at = 0
    for array in arrays:
        if type(array) is tuple:
            array[0][...] = array[1]
        else:
            array.ravel("K")[:] = np.frombuffer(contents, array.dtype, array.size, at)
            at += array.nbytes


# An array of a few numbers is copied in a tenth of the time that it takes to ask Python for that.
_copied_arrays = getattr(kernel.extension(), "copied_arrays", _copied)
_in_slots = operator.attrgetter(*SLOTS)


def snapshot(kf: Any) -> tuple[Any, ...]:
    """Return what a filter holds, contents of arrays too: a user's function may write into one that is still held."""
    attributes = kf.__dict__.copy()
    # Not an object of a class of its own, which takes as long to make as all the rest.
    contents = _copied_arrays(attributes) or _copied(attributes)
    return attributes, _in_slots(kf), contents, "rng" in attributes and _drawn(attributes["rng"])


def put_back(kf: Any, held: tuple[Any, ...]) -> None:
    """Let a filter hold again what `snapshot` found in it."""
    attributes, slots, contents, drawn = held
    kf.__dict__.clear()
    kf.__dict__.update(attributes)
    for name, value in zip(SLOTS, slots, strict=True):
        setattr(kf, name, value)
    _put_back_arrays(contents)
    if drawn:
        source, state = drawn
        source.state = state


def _drawn(rng: Any) -> tuple[Any, Any] | None:
    """Return where an ensemble's random numbers come from, and how far; numpy's older generator hides it."""
    source = getattr(rng, "bit_generator", getattr(rng, "_bit_generator", None))
    return None if source is None else (source, source.state)


@contextmanager
def unchanged_if_refused(kf: Any) -> Iterator[None]:
    """Put a filter back as it was if the block raises anything, an interrupt too."""
    before = snapshot(kf)
    try:
        yield
    except BaseException:
        put_back(kf, before)
        raise


def whole(method: _Method) -> _Method:
    """Make a call that is refused or interrupted one that has not happened."""

    @functools.wraps(method)
    def called(self: Any, *arguments: Any, **named: Any) -> Any:
        """Call, and put the filter back if that raises."""
        # Not the context manager, which costs as much as a step of the kernel.
        before = snapshot(self)
        try:
            return method(self, *arguments, **named)
        except BaseException:
            put_back(self, before)
            raise

    return cast(_Method, called)
