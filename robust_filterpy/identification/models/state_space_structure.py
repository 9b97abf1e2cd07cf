"""Which states and signals a state-space model has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.identification.models.signals import are_several

__all__ = ["Signals", "StateSpace"]

_AUTO = range(1, 9)


@dataclass(frozen=True)
class StateSpace:
    """Order of a state-space model with several inputs and outputs, for `identify`.

    Parameters
    ----------
    n : int or "auto", default "auto"
        Number of states; "auto": as many, up to 8, as the evidence supports (Bayes' information criterion).
    feedthrough : bool, default False
        Whether inputs act on y at once: a D.
    disturbance : bool, default False
        Whether noise drives the states too: a K. Without, each sensor has noise of its own and the states have none.

    Raises
    ------
    ValueError, TypeError
        If n is no positive integer or "auto", or an option is not True or False.

    Examples
    --------
    >>> StateSpace(4)
    StateSpace(n=4, feedthrough=False, disturbance=False)
    """

    n: int | str = "auto"
    feedthrough: bool = False
    disturbance: bool = False

    def __post_init__(self) -> None:
        """Check the order."""
        if isinstance(self.n, str):
            _checks.option("n", self.n, ("auto",))
        else:
            object.__setattr__(self, "n", _checks.count("n", self.n, 1))
        for name in ("feedthrough", "disturbance"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise TypeError(f"{name}: expected True or False, got {getattr(self, name)!r}")

    @property
    def orders(self) -> Any:
        """Which orders are tried."""
        return _AUTO if isinstance(self.n, str) else (self.n,)


class Signals(NamedTuple):
    """How many inputs and outputs recordings have, for what is asked of a structure there.

    Attributes
    ----------
    n_inputs, n_outputs : int
        How many.
    takes_phi : bool
        No regressor comes from the caller.
    """

    n_inputs: int
    n_outputs: int
    takes_phi: bool = False

    def __str__(self) -> str:
        """Return what they are."""
        return f"a model of {self.n_inputs} input(s) and {self.n_outputs} output(s)"

    @property
    def inputs(self) -> Any:
        """A place for each input."""
        return range(self.n_inputs)

    @classmethod
    def of(cls, y: Any, u: Any) -> Signals:
        """Return those of recordings, or raise."""
        if u is None:
            raise ValueError("u: expected a recording of the inputs for a state-space model, got None")
        several = are_several(y, u)
        if several and not (isinstance(u, (list, tuple)) and len(u) == len(y)):
            got = len(u) if isinstance(u, (list, tuple)) else type(u).__name__
            raise ValueError(f"u: expected a list of {len(y)} recordings like y, got {got}")
        first, second = (y[0], u[0]) if several else (y, u)
        shapes = np.shape(first), np.shape(second)
        for name, shape in zip("yu", shapes, strict=True):
            if len(shape) not in (1, 2):
                raise ValueError(f"{name}: expected shape (N,) or (N, n), got {shape}")
        n_outputs, n_inputs = (int(shape[1]) if len(shape) == 2 else 1 for shape in shapes)
        return cls(n_inputs, n_outputs)
