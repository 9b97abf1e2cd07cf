"""Model structures: which past signals the regressor phi(k) is made of. No estimation here.

Every structure is y(k) = phi(k)' theta + v(k) with::

    theta = [a_1 .. a_na, b_1 .. b_nb (first input), b_1 .. (second input), .., c_1 .. c_nc]            (paper 12)
    phi(k) = [-s(k-1) .. -s(k-na), u(k-nk) .. u(k-nk-nb+1), .., r(k-1) .. r(k-nc)]                        (13, 20)

where s is the measured output for `ARX` and `ARMAX` and the model's own output for `OutputError` (18), and r are the
a-posteriori residuals. `noise_structures` has those whose noise has a model of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, described, numbers

__all__ = ["ARMAX", "ARX", "FIR", "LinearRegression", "OutputError", "Polynomials", "Structure"]

Orders = int | tuple[int, ...]


class Polynomials(NamedTuple):
    """Where the coefficients of A(q) y = B(q)/F(q) u + C(q)/D(q) v stand in theta, without the leading 1s.

    Attributes
    ----------
    a, f, c, d : slice
        Places of A, F, C and D; empty where a structure has no such polynomial.
    b : tuple of slice
        Places of B for each input.
    """

    a: slice
    b: tuple[slice, ...]
    f: slice
    c: slice
    d: slice


class Structure:
    """What the structures share: orders, names and the regressor.

    Attributes
    ----------
    na, nc, nd, nf : int
        Number of past outputs and of past residuals in phi, and of coefficients of D and F; 0 where a structure has
        none. The denominator of an OutputError counts as na.
    inputs : tuple of (int, int)
        (nb, nk) of each input: how many coefficients, and the delay of the first.
    """

    # No values here: dataclasses would take them for defaults.
    na: int
    nc: int
    nd: int
    nf: int
    inputs: tuple[tuple[int, int], ...]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @cached_property
    def n_theta(self) -> int:
        """Length of theta."""
        return self.constant_place + self.nc

    @cached_property
    def constant_place(self) -> int:
        """Where in theta a constant would stand, as one more input: after all b's."""
        return self.na + sum(nb for nb, _ in self.inputs)

    def with_constant(self) -> Structure:
        """Return the structure with one more input, a constant that acts at once.

        Returns
        -------
        Structure
        """
        nb, nk = tuple(nb for nb, _ in self.inputs), tuple(nk for _, nk in self.inputs)
        extended: Any = self
        return replace(extended, nb=(*nb, 1), nk=(*nk, 0))  # type: ignore[no-any-return]

    @cached_property
    def feeds_back(self) -> slice | None:
        """Which part of theta multiplies what the model computed itself: its polynomial must be stable."""
        return slice(self.n_theta - self.nc, self.n_theta) if self.nc else None

    @property
    def stable_parts(self) -> tuple[slice, ...]:
        """Which parts of theta are polynomials that must be stable."""
        return () if self.feeds_back is None else (self.feeds_back,)

    @property
    def uses_model_output(self) -> bool:
        """Whether phi holds the model's own outputs in place of the measured ones (paper 20)."""
        return False

    @cached_property
    def polynomials(self) -> Polynomials:
        """Which polynomial each parameter belongs to."""
        ends = list(accumulate((nb for nb, _ in self.inputs), initial=self.na))
        none = slice(self.n_theta, self.n_theta)
        b = tuple(slice(start, stop) for start, stop in pairwise(ends))
        return Polynomials(slice(0, self.na), b, none, slice(ends[-1], self.n_theta), none)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, as "a1", "b2" or, with several inputs, "b2[0]" for the first input's."""
        several = self.n_inputs > 1
        b = [f"b{j + 1}[{i}]" if several else f"b{j + 1}" for i, (nb, _) in enumerate(self.inputs) for j in range(nb)]
        return (*numbered("a", self.na), *b, *numbered("c", self.nc))

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the orders that the structure was made with, by scikit-learn's convention.

        Parameters
        ----------
        deep : bool, default True
            No difference; it belongs to the convention.

        Returns
        -------
        dict of str

        Examples
        --------
        >>> OutputError(2, 2).get_params()
        {'na': 2, 'nb': 2, 'nk': 1}
        """
        made: Any = self
        return {place.name: getattr(self, place.name) for place in fields(made)}

    def regressors(
        self, u: ArrayLike | None = None, y: ArrayLike | None = None, residual: ArrayLike | None = None
    ) -> Array:
        """Build phi of a whole recording that starts at rest, row k from the samples before k (paper 13, 20).

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs), optional
            Input; only needed if the structure has any.
        y : array_like, shape (N,), optional
            Output to be put in phi: measured for ARX and ARMAX, the model's own for OutputError.
        residual : array_like, shape (N,), optional
            Residuals, for ARMAX.

        Returns
        -------
        ndarray, shape (N, n_theta)

        Raises
        ------
        ValueError
            If a signal that the structure needs is missing or has another length.

        Examples
        --------
        >>> ARX(1, 2).regressors(u=[1.0, 2.0, 3.0], y=[4.0, 5.0, 6.0])
        array([[-0.,  0.,  0.],
               [-4.,  1.,  0.],
               [-5.,  2.,  1.]])
        """
        given = {"u": u, "y": y, "residual": residual}
        needed = {"u": self.n_inputs > 0, "y": self.na > 0, "residual": self.nc > 0}
        signals = {name: numbers(name, value) for name, value in given.items() if needed[name] and value is not None}
        for name in needed:
            if needed[name] and name not in signals:
                raise ValueError(f"{name}: expected a signal for {self}, got None")
        length = len(next(iter(signals.values())))
        for name, signal in signals.items():
            if len(signal) != length:
                raise ValueError(f"{name}: expected {length} samples like the other signals, got {len(signal)}")
        parts = [-_shifted(signals["y"], range(1, self.na + 1))] if self.na else []
        if self.n_inputs:
            columns = input_columns("u", signals["u"], self.n_inputs)
            for column, (nb, nk) in zip(columns.T, self.inputs, strict=True):
                parts.append(_shifted(column, range(nk, nk + nb)))
        if self.nc:
            parts.append(_shifted(signals["residual"], range(1, self.nc + 1)))
        return np.concatenate(parts, axis=1)


def numbered(letter: str, order: int) -> tuple[str, ...]:
    """Return the names of the coefficients of a polynomial."""
    return tuple(f"{letter}{j + 1}" for j in range(order))


def _shifted(signal: Array, lags: range) -> Array:
    """Return the signal delayed by each lag, one column each, 0 before the start."""
    columns = np.zeros((len(signal), len(lags)))
    for j, lag in enumerate(lags):
        columns[lag:, j] = signal[: max(len(signal) - lag, 0)]
    return columns


def input_columns(name: str, u: Any, n_inputs: int) -> Array:
    """Return a recorded input as shape (N, n_inputs) or raise."""
    signal = numbers(name, u)
    if signal.ndim == 1 and n_inputs == 1:
        return signal[:, None]
    if signal.ndim != 2 or signal.shape[1] != n_inputs:
        shapes = "(N,) or (N, 1)" if n_inputs == 1 else f"(N, {n_inputs})"
        mend = f"; use {name}.T" if signal.ndim == 2 and signal.shape[0] == n_inputs else ""
        raise ValueError(f"{name}: expected shape {shapes} for {n_inputs} input(s), got {described(signal)}{mend}")
    return signal


def input_orders(name: str, value: Any, least: int = 0) -> Orders:
    """Return an order, or one for each input, as int or tuple of int, or raise."""
    if isinstance(value, (list, tuple, np.ndarray)):
        if len(value) == 0:
            raise ValueError(f"{name}: expected at least one input's order, got {value!r}")
        return tuple(count(f"{name}[{i}]", entry, least) for i, entry in enumerate(value))
    return count(name, value, least)


def _inputs(nb: Orders, nk: Orders) -> tuple[tuple[int, int], ...]:
    """Pair the orders of each input with its delay; one nk serves every input."""
    if isinstance(nb, int):
        if isinstance(nk, tuple):
            if len(nk) != 1:
                raise ValueError(f"nk: expected one delay for nb={nb}, got {nk}; nb as a tuple means several inputs")
            nk = nk[0]
        return ((nb, nk),) if nb else ()
    delays = (nk,) * len(nb) if isinstance(nk, int) else nk
    if len(delays) != len(nb):
        raise ValueError(f"nk: expected {len(nb)} delays for nb={nb}, got {nk}")
    return tuple(zip(nb, delays, strict=True))


def set_orders(structure: Any, nb: Orders = 0, nk: Orders = 1, **orders: int) -> None:
    """Write the checked orders into a frozen dataclass, with the inputs that follow, and refuse an empty model."""
    values = {"na": 0, "nc": 0, "nd": 0, "nf": 0, "nb": nb, "nk": nk, **orders, "inputs": _inputs(nb, nk)}
    for name, value in values.items():
        object.__setattr__(structure, name, value)
    if structure.n_theta == 0:
        raise ValueError(f"{structure}: expected at least one parameter, got orders that are all zero")


@dataclass(frozen=True)
class ARX(Structure):
    """Autoregression with inputs: A(q) y = B(q) u + v.

    phi(k) = [-y(k-1) .. -y(k-na), u(k-nk) .. u(k-nk-nb+1)], with the measured y.

    Parameters
    ----------
    na : int
        Number of a's, >= 0.
    nb : int or tuple of int
        Number of b's, of each input if a tuple; 0 for a model without input.
    nk : int or tuple of int, default 1
        Delay of the first b in samples; 0 is direct feed-through.

    Raises
    ------
    ValueError
        If an order is negative, all are zero, or nb and nk name different numbers of inputs.
    TypeError
        If an order is no integer.

    Examples
    --------
    >>> ARX(2, 2).names
    ('a1', 'a2', 'b1', 'b2')
    """

    na: int
    nb: Orders
    nk: Orders = 1

    def __post_init__(self) -> None:
        """Check the orders."""
        set_orders(self, na=count("na", self.na), nb=input_orders("nb", self.nb), nk=input_orders("nk", self.nk))


@dataclass(frozen=True)
class OutputError(Structure):
    """Output-error model: y = B(q)/A(q) u + v, the noise outside the loop (paper 11-23).

    phi(k) = [-yhat(k-1) .. -yhat(k-na), u(k-nk) .. u(k-nk-nb+1)], with the model's own output
    yhat(k) = phi(k)' theta_hat(k) (18)-(21).

    Parameters
    ----------
    na : int
        Number of a's, >= 0.
    nb : int or tuple of int
        Number of b's, of each input if a tuple; at least one in all.
    nk : int or tuple of int, default 1
        Delay of the first b in samples; 0 is direct feed-through.

    Raises
    ------
    ValueError
        If an order is negative, there is no b, or nb and nk name different numbers of inputs.
    TypeError
        If an order is no integer.

    Notes
    -----
    In print (20) has v(k-1) where u(k-1) belongs.

    Examples
    --------
    >>> OutputError(2, (1, 2), nk=(1, 0)).names
    ('a1', 'a2', 'b1[0]', 'b1[1]', 'b2[1]')
    """

    na: int
    nb: Orders
    nk: Orders = 1

    def __post_init__(self) -> None:
        """Check the orders."""
        set_orders(self, na=count("na", self.na), nb=input_orders("nb", self.nb), nk=input_orders("nk", self.nk))
        if self.n_theta == self.na:
            raise ValueError(f"nb: expected at least one b, without which the output is zero, got {self.nb}")

    @cached_property
    def feeds_back(self) -> slice | None:
        """Which part of theta multiplies what the model computed itself: the a's."""
        return slice(0, self.na) if self.na else None

    @property
    def uses_model_output(self) -> bool:
        """Whether phi holds the model's own outputs: it does."""
        return True

    @cached_property
    def polynomials(self) -> Polynomials:
        """Which polynomial each parameter belongs to: the a's are the denominator of the input alone."""
        found = super().polynomials
        return found._replace(a=slice(0, 0), f=found.a)


@dataclass(frozen=True)
class ARMAX(Structure):
    """ARX with a moving average of the noise: A(q) y = B(q) u + C(q) v, by extended least squares.

    phi(k) = [-y(k-1) .., u(k-nk) .., r(k-1) .. r(k-nc)], with the a-posteriori residuals r(k) = y(k) - phi(k)'
    theta_hat(k) in the place of the unknown v.

    Parameters
    ----------
    na : int
        Number of a's, >= 0.
    nb : int or tuple of int
        Number of b's, of each input if a tuple; 0 for a model without input.
    nc : int
        Number of c's, >= 0.
    nk : int or tuple of int, default 1
        Delay of the first b in samples; 0 is direct feed-through.

    Raises
    ------
    ValueError
        If an order is negative, all are zero, or nb and nk name different numbers of inputs.
    TypeError
        If an order is no integer.

    Examples
    --------
    >>> ARMAX(1, 1, 1).names
    ('a1', 'b1', 'c1')
    """

    na: int
    nb: Orders
    nc: int
    nk: Orders = 1

    def __post_init__(self) -> None:
        """Check the orders."""
        orders = {"na": count("na", self.na), "nc": count("nc", self.nc)}
        set_orders(self, **orders, nb=input_orders("nb", self.nb), nk=input_orders("nk", self.nk))


@dataclass(frozen=True)
class FIR(Structure):
    """Finite impulse response: y = B(q) u + v, phi(k) = [u(k-nk) .. u(k-nk-nb+1)].

    Parameters
    ----------
    nb : int or tuple of int
        Number of b's, of each input if a tuple; at least one in all.
    nk : int or tuple of int, default 1
        Delay of the first b in samples; 0 is direct feed-through.

    Raises
    ------
    ValueError
        If an order is negative, all are zero, or nb and nk name different numbers of inputs.
    TypeError
        If an order is no integer.

    Examples
    --------
    >>> FIR(2, nk=0).regressors(u=[1.0, 2.0, 3.0])
    array([[1., 0.],
           [2., 1.],
           [3., 2.]])
    """

    nb: Orders
    nk: Orders = 1

    def __post_init__(self) -> None:
        """Check the orders."""
        set_orders(self, nb=input_orders("nb", self.nb), nk=input_orders("nk", self.nk))


@dataclass(frozen=True)
class LinearRegression(Structure):
    """Regression on what the caller supplies: y(k) = phi(k)' theta + v(k), phi in the place of u.

    Parameters
    ----------
    n : int
        Length of theta, >= 1.

    Raises
    ------
    ValueError
        If n < 1.
    TypeError
        If n is no integer.

    Examples
    --------
    >>> LinearRegression(2).regressors(u=[[1.0, 0.5], [1.0, 0.7]])
    array([[1. , 0.5],
           [1. , 0.7]])
    """

    n: int

    def __post_init__(self) -> None:
        """Check n: each entry of phi is an input with one coefficient and no delay."""
        set_orders(self, n=count("n", self.n, 1), nb=(1,) * self.n, nk=0)

    def with_constant(self) -> LinearRegression:
        """Return the regression with one more column.

        Returns
        -------
        LinearRegression
        """
        return LinearRegression(self.n + 1)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: "theta1", "theta2" .."""
        return tuple(f"theta{j + 1}" for j in range(self.n))
