"""Going back to a state that was kept, or to the start: the same for a tracker and for a bank."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.regressor import are_stable
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.state import READINGS, Form, require_plausible

__all__ = ["Returning", "checked"]

# What a user sets, by its name in a state, and as the user gave it.
_BY_HAND = {"Q": "Q", "F": "F", "alpha_sq": "forgetting"}


class Returning:
    """What can go back to a state: it has `_go_back`, which takes one over or raises, and `_set_by_hand`."""

    structure: Structure
    _name: ClassVar[str]
    _initial: dict[str, Array]

    def _go_back(self, state: Any) -> None:
        """Take over a state, or raise; nothing has changed then."""
        raise NotImplementedError

    def _set_by_hand(self) -> dict[str, Any]:
        """Return what the user may have set of Q, F and forgetting."""
        raise NotImplementedError

    @property
    def kind(self) -> str:
        """What a state belongs to."""
        return f"{self._name} of {self.structure}"

    def restore(self, state: Any) -> None:
        """Go back to a state of this one, or of another with the same structure, number and kind of filter.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If it is of another structure or a newer format, an array is missing, does not fit or is not finite, a
            variance is not positive, P not positive semidefinite, or a model unstable that the guard keeps stable;
            nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit. What it has warned of is not in a state; a tracker's from before
        there was a watch in it is watched from here on. Q, F and forgetting are the state's; a warning says which
        values they replace where it was made with others.
        """
        before = self._set_by_hand()
        self._go_back(state)
        after = self._set_by_hand()
        other = [
            f"{word} of the state, {_given(key, after[key])}, took the place of what was set, "
            f"{_given(key, before[key])}"
            for key, word in _BY_HAND.items()
            if key in before and not np.array_equal(before[key], after[key])
        ]
        if other:
            warn(f"{self._name}.restore: {'; '.join(other)}; set it again after restore if yours is to hold")

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when it was made."""
        self._go_back(self._initial)


def _given(key: str, value: Any) -> str:
    """Return a setting on a line as a user gives it: a number, which may multiply the unit matrix, or an array."""
    number = 1.0 / np.asarray(value) if key == "alpha_sq" else np.asarray(value)
    if number.ndim == 2 and np.array_equal(number, number[0, 0] * np.eye(len(number))):
        number = number[0, 0]
    return f"{number:.6g}" if number.ndim == 0 else " ".join(_checks.shown(number).split())


def checked(
    state: Any, form: Form, axes: tuple[int, ...], needed: Mapping[str, Any], optional: Mapping[str, Any]
) -> dict[str, Array]:
    """Return the arrays of a state, copied, or raise."""
    d, signals = form.layout.n, form.n_signals
    shapes: dict[str, Any] = {"theta": (d,), "P": (d, d), **form.layout.shapes(), "enabled": (), "recursion": (7,)}
    shapes |= {"start": (None, signals)} if "start" in state else {}
    if "watch" in state or "followed" in state:
        shapes |= {"watch": (None,), "followed": (None, 1 + signals)}
    shapes |= {"readings": (READINGS,)} if "readings" in state else {}
    whole = {name: (*axes, *shape) for name, shape in shapes.items()}
    found = _state.checked(state, None, {**whole, **needed}, optional, ("start", "followed"))
    for name, least in (("R", "> 0"), ("alpha_sq", ">= 1")):
        if name in found and not (found[name] > 0.0 if name == "R" else found[name] >= 1.0).all():
            raise _state.StateError(f"state: expected {name} {least}, got {_checks.shown(found[name])}")
    require_plausible(found)
    kept = form.guard != "none"
    if not all(are_stable(row, form.layout.stable) for row in np.atleast_2d(found["theta"])[kept]):
        raise _state.StateError(
            "state: expected theta of a stable model, got coefficients that feed back with roots outside the unit "
            "circle"
        )
    found.setdefault("start", np.zeros((*axes, 0, signals)))
    return {**found, "enabled": found["enabled"].astype(bool)}
