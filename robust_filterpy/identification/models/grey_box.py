"""The equations of a plant in continuous time: x' = f(x, u, p), y = h(x, u, p) + noise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.grey_box_residuals import GreyRecording, GreyResiduals, Scale

__all__ = ["GreyBox"]


@dataclass(frozen=True, eq=False)
class GreyBox:
    """Equations of a plant whose parameters are to be found by `identify`.

    Parameters
    ----------
    f : function
        f(x, u, p) gives x', the derivatives of the states in 1/s: x of shape (n,), u of shape (m,), p of shape (k,) in
        the order of p0. Where it also takes columns, x of shape (n, j) and p of shape (k, j), it is many times as fast.
    p0 : dict of str to float, or array_like, shape (k,)
        Names and first guesses of the parameters.
    x0 : array_like, shape (n,)
        First guess of the states in the first sample.
    h : function, optional
        h(x, u, p) gives the outputs. Default: the states themselves.
    fixed : iterable of str, optional
        Parameters that stay as they are.
    bounds : dict of str to (float, float), optional
        Least and largest value of some parameters; None or infinity for no bound.
    start : {"free", "fixed"}, default "free"
        Whether the states in the first sample are estimated too.
    between : {"held", "lines"}, default "held"
        What inputs do between samples.

    Raises
    ------
    ValueError, TypeError
        If a name is unknown, a guess is outside its bounds, or an argument is of the wrong kind.

    Examples
    --------
    >>> box = GreyBox(lambda x, u, p: [(p[0] * u[0] - x[0]) / p[1]], {"gain": 1.0, "T": 2.0}, x0=[0.0])
    >>> box.names
    ('gain', 'T')
    """

    f: Callable[..., Any]
    p0: Any
    x0: Any
    h: Callable[..., Any] | None = None
    fixed: Iterable[str] = ()
    bounds: Mapping[str, Any] = field(default_factory=dict)
    start: str = "free"
    between: str = "held"

    def __post_init__(self) -> None:
        """Check everything but the functions, which only data can."""
        for name, function in (("f", self.f), ("h", self.h)):
            if function is not None and not callable(function):
                raise TypeError(f"{name}: expected a function {name}(x, u, p), got {_checks.shown(function)}")
        named = self.p0 if isinstance(self.p0, Mapping) else {
            f"p{j + 1}": value for j, value in enumerate(np.atleast_1d(_checks.numbers("p0", self.p0)))
        }  # fmt: skip
        object.__setattr__(
            self, "p0", {str(name): _checks.real(f"p0[{name!r}]", value) for name, value in named.items()}
        )
        object.__setattr__(self, "x0", np.atleast_1d(_checks.numbers("x0", self.x0)))
        object.__setattr__(self, "fixed", tuple(self.fixed))
        _checks.option("start", self.start, ("free", "fixed"))
        _checks.option("between", self.between, ("held", "lines"))
        for name in (*self.fixed, *self.bounds):
            if name not in self.p0:
                raise ValueError(f"p0: expected a parameter {name!r}, got {', '.join(self.p0)}")
        if not self.free_names:
            raise ValueError("fixed: expected at least one parameter that is free, got all of them")
        values = np.array([*self.p0.values(), *self.x0])
        if not np.isfinite(values).all():
            raise ValueError("p0: expected finite first guesses, got NaN or inf")
        for name, (low, high) in self.limits.items():
            if not low < self.p0[name] < high:
                raise ValueError(f"p0: expected {name} between {low:.6g} and {high:.6g}, got {self.p0[name]:.6g}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(self.p0)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of those that are estimated."""
        return tuple(name for name in self.p0 if name not in self.fixed)

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters that have some, as numbers."""
        found = {}
        for name, (low, high) in self.bounds.items():
            found[name] = (-np.inf if low is None else float(low), np.inf if high is None else float(high))
        return found

    @property
    def scales(self) -> tuple[Scale, Scale]:
        """Free numbers of the parameters that are estimated, and of the states."""
        p = np.array([self.p0[name] for name in self.free_names])
        bounds = np.array([self.limits.get(name, (-np.inf, np.inf)) for name in self.free_names])
        size, wide = np.where(p == 0.0, 1.0, np.abs(p)), np.full(self.x0.size, np.inf)
        states = Scale(self.x0, np.where(self.x0 == 0.0, 1.0, np.abs(self.x0)), -wide, wide)
        return Scale(p, size, bounds[:, 0], bounds[:, 1]), states

    def residuals_of(self, recordings: list[GreyRecording], starts: Array, free_start: bool) -> GreyResiduals:
        """Return what gives the residuals of recordings.

        Parameters
        ----------
        recordings : list of GreyRecording
            What was recorded.
        starts : ndarray, shape (n_recordings, n)
            States in the first samples.
        free_start : bool
            Whether these are free.

        Returns
        -------
        GreyResiduals
        """
        at = [self.names.index(name) for name in self.free_names]
        values = np.array([*self.p0.values()])
        h = self.h

        def whole(p: Array) -> Array:
            found = np.repeat(values[:, None], p.shape[1], axis=1) if p.ndim == 2 else values.copy()
            found[at] = p
            return found

        def f(x: Array, u: Array, p: Array) -> Any:
            return self.f(x, u, whole(p))

        def outputs(x: Array, u: Array, p: Array) -> Any:
            return x if h is None else h(x, u, whole(p))

        return GreyResiduals(f, outputs, recordings, *self.scales, starts, free_start, self.between == "lines")
