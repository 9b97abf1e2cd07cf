"""Going back to a state that was kept, or to the start: the same for a tracker and for a bank."""

from __future__ import annotations

from typing import Any, ClassVar

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.setup import say_replaced

__all__ = ["Returning"]


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
        The continuation is the same to the last bit, for filters that hold x and P themselves. What it has warned of is
        not in a state; a tracker's from before there was a watch in it is watched from here on. Q, F and forgetting are
        the state's; a warning says so where it was made with others.
        """
        before = self._set_by_hand()
        self._go_back(state)
        say_replaced(self._name, before, self._set_by_hand())

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when it was made."""
        self._go_back(self._initial)
