"""Model structures: which past signals the regressor phi(k) is made of. No estimation here.

A structure is its orders. Each is A(q) y = B(q)/F(q) u + C(q)/D(q) v, that is y(k) = phi(k)' theta + v(k) with::

    theta  = [a_1 .. a_na, b_1 .. b_nb (first input), .., f_1 .. f_nf, c_1 .. c_nc, d_1 .. d_nd]        (paper 12)
    phi(k) = [-y(k-1) .., u(k-nk) .., -w(k-1) .., r(k-1) .., -d(k-1) .. -d(k-nd)]                       (13, 20)

where w = B/F u is what the inputs alone do (18), d = A y - w the disturbance, and r are the a-posteriori residuals.
`constructors` make the usual ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, described, numbers, option

Orders = int | tuple[int, ...]
# The arguments of each constructor, and of which order they are.
FORMS: Final[dict[str, dict[str, str]]] = {
    "Structure": {name: name for name in ("na", "nb", "nc", "nd", "nf", "nk")},
    "ARX": {"na": "na", "nb": "nb", "nk": "nk"},
    "OutputError": {"na": "nf", "nb": "nb", "nk": "nk"},
    "ARMAX": {"na": "na", "nb": "nb", "nc": "nc", "nk": "nk"},
    "FIR": {"nb": "nb", "nk": "nk"},
    "BoxJenkins": {"nb": "nb", "nc": "nc", "nd": "nd", "nf": "nf", "nk": "nk"},
    "ARMA": {"na": "na", "nc": "nc"},
    "AR": {"na": "na"},
    "LinearRegression": {"n": "n_theta"},
}
# Constructors with an argument ``integrated``: what they have no D for otherwise.
_INTEGRATED: Final = ("ARX", "OutputError", "ARMAX", "FIR", "ARMA", "AR")


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


@dataclass(frozen=True, repr=False)
class Structure:
    """Orders of A(q) y = B(q)/F(q) u + C(q)/D(q) v.

    Parameters
    ----------
    na : int, default 0
        Number of a's, >= 0.
    nb : int or tuple of int, default 0
        Number of b's, of each input if a tuple; 0 for a model without input.
    nc, nd, nf : int, default 0
        Number of c's, d's and f's, >= 0; all inputs share F.
    nk : int or tuple of int, default 1
        Delay of the first b in samples; 0 is direct feed-through. One for all inputs, or one for each.
    form : str, default "Structure"
        The constructor that it is shown as. An "OutputError" calls its f's a's and has them first in theta, the
        parameters of a "LinearRegression" are theta1, theta2 ..

    Attributes
    ----------
    inputs : tuple of (int, int)
        (nb, nk) of each input: how many coefficients, and the delay of the first.

    Raises
    ------
    ValueError
        If an order is negative, all are zero, nb and nk name different numbers of inputs, or there is an F without
        inputs.
    TypeError
        If an order is no integer.

    Examples
    --------
    >>> Structure(na=1, nb=(1, 2), nc=1).names
    ('a1', 'b1[0]', 'b1[1]', 'b2[1]', 'c1')
    >>> Structure(nb=2, nf=2, form="OutputError")
    OutputError(na=2, nb=2, nk=1)
    """

    na: int = 0
    nb: Orders = 0
    nc: int = 0
    nd: int = 0
    nf: int = 0
    nk: Orders = 1
    form: str = "Structure"
    inputs: tuple[tuple[int, int], ...] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        """Check the orders."""
        called = {order: name for name, order in FORMS[option("form", self.form, tuple(FORMS))].items()}
        orders: dict[str, Any] = {
            name: count(called.get(name, name), getattr(self, name)) for name in ("na", "nc", "nd", "nf")
        }
        orders |= {"nb": _input_orders("nb", self.nb), "nk": _input_orders("nk", self.nk)}
        orders["inputs"] = _inputs(orders["nb"], orders["nk"])
        for name, value in orders.items():
            object.__setattr__(self, name, value)
        if not any(nb for nb, _ in self.inputs) and (self.nf or self.form in ("OutputError", "BoxJenkins")):
            raise ValueError(
                f"nb: expected at least one b, without which there is no input and its output is zero, got {self.nb}; "
                "without input use ARMA"
            )
        if self.n_theta == 0:
            raise ValueError(f"{self}: expected at least one parameter, got orders that are all zero")

    def __repr__(self) -> str:
        """Show the constructor's call."""
        values = ", ".join(f"{name}={getattr(self, order)}" for name, order in FORMS[self.form].items())
        return f"{self.form}({values}{', integrated=True' if self.integrated else ''})"

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @cached_property
    def n_theta(self) -> int:
        """Length of theta."""
        return self.na + sum(nb for nb, _ in self.inputs) + self.nf + self.nc + self.nd

    @property
    def takes_phi(self) -> bool:
        """Whether the caller supplies phi in the place of u (`LinearRegression`)."""
        return self.form == "LinearRegression"

    @property
    def integrated(self) -> bool:
        """Whether the noise is summed up, d1 = -1, so that a model is of the first differences: an argument of most."""
        return self.nd == 1 and self.form in _INTEGRATED

    @cached_property
    def constant_place(self) -> int:
        """Where in theta a constant would stand, as one more input: after all b's."""
        return self.n_theta - self.nc - self.nd - (0 if self.form == "OutputError" else self.nf)

    def with_constant(self) -> Structure:
        """Return the structure with one more input, a constant that acts at once.

        Returns
        -------
        Structure
        """
        nb, nk = tuple(nb for nb, _ in self.inputs), tuple(nk for _, nk in self.inputs)
        return replace(self, nb=(*nb, 1), nk=(*nk, 0))

    @property
    def stable_parts(self) -> tuple[slice, ...]:
        """Which parts of theta feed back what the model computed itself and must be stable: F and C."""
        return tuple(part for part in (self.polynomials.f, self.polynomials.c) if part.stop > part.start)

    @cached_property
    def polynomials(self) -> Polynomials:
        """Which polynomial each parameter belongs to."""
        b = [nb for nb, _ in self.inputs]
        first = self.form == "OutputError"
        ends = list(accumulate((self.na, self.nf * first, *b, self.nf * (not first), self.nc, self.nd), initial=0))
        a, early, *places = (slice(start, stop) for start, stop in pairwise(ends))
        *inputs, late, c, d = places
        return Polynomials(a, tuple(inputs), early if first else late, c, d)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, as "a1", "b2" or, with several inputs, "b2[0]" for the first input's."""
        if self.takes_phi:
            return tuple(f"theta{j + 1}" for j in range(self.n_theta))
        places, names = self.polynomials, [""] * self.n_theta
        several = self.n_inputs > 1
        lettered = [("a", "", places.a), ("a" if self.form == "OutputError" else "f", "", places.f)]
        lettered += [("b", f"[{i}]" if several else "", place) for i, place in enumerate(places.b)]
        for letter, which, place in (*lettered, ("c", "", places.c), ("d", "", places.d)):
            names[place] = [f"{letter}{j + 1}{which}" for j in range(place.stop - place.start)]
        return tuple(names)

    def regressors(
        self, u: ArrayLike | None = None, y: ArrayLike | None = None, residual: ArrayLike | None = None
    ) -> Array:
        """Build phi of a whole recording that starts at rest, row k from the samples before k (paper 13, 20).

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs), optional
            Input; only needed if the structure has any.
        y : array_like, shape (N,), optional
            Output to be put in phi: measured, or the model's own for a model with nothing but B and F.
        residual : array_like, shape (N,), optional
            Residuals, for a model with a C.

        Returns
        -------
        ndarray, shape (N, n_theta)

        Raises
        ------
        ValueError
            If a signal that the structure needs is missing or has another length, or it needs what only a model with
            parameters computes: w and d.

        Examples
        --------
        >>> from robust_filterpy.identification import ARX
        >>> ARX(1, 2).regressors(u=[1.0, 2.0, 3.0], y=[4.0, 5.0, 6.0])
        array([[ 0.,  0.,  0.],
               [-4.,  1.,  0.],
               [-5.,  2.,  1.]])
        """
        if self.nd or (self.nf and self.na + self.nc):
            raise ValueError(f"{self}: its regressor holds w and d, which only a model has; use identify")
        signals: dict[str, Array] = {}
        for name, signal, is_needed in (
            ("u", u, self.n_inputs), ("y", y, self.na + self.nf), ("residual", residual, self.nc),
        ):  # fmt: skip
            if is_needed and signal is None:
                raise ValueError(f"{name}: expected a signal for {self}, got None")
            signals |= {name: numbers(name, signal)} if is_needed else {}
        length = len(next(iter(signals.values())))
        for name, signal in signals.items():
            if len(signal) != length:
                raise ValueError(f"{name}: expected {length} samples like the other signals, got {len(signal)}")
        places, phi = self.polynomials, np.zeros((self.n_theta, length))
        columns = input_columns("u", signals["u"], self.n_inputs).T if self.n_inputs else ()
        for place, column, (_, nk) in zip(places.b, columns, self.inputs, strict=True):
            fill_with_delays(phi[place], column, nk)
        for place in (places.a, places.f):
            fill_with_delays(phi[place], -signals.get("y", phi[:0]), 1)
        fill_with_delays(phi[places.c], signals.get("residual", phi[:0]), 1)
        return np.ascontiguousarray(phi.T)


def fill_with_delays(rows: Array, signal: Array, least: int) -> None:
    """Write a signal into each row, one sample later in each than in the row before."""
    for delay, row in enumerate(rows, least):
        row[delay:] = signal[: max(signal.size - delay, 0)]


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


def _input_orders(name: str, value: Any) -> Orders:
    """Return an order, or one for each input, as int or tuple of int, or raise."""
    if isinstance(value, (list, tuple, np.ndarray)):
        if np.size(value) == 0 or np.ndim(value) == 0:
            raise ValueError(f"{name}: expected at least one input's order, got {value!r}")
        return tuple(count(f"{name}[{i}]", entry) for i, entry in enumerate(value))
    return count(name, value)


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


def ARX(na: int, nb: Orders, nk: Orders = 1, integrated: bool = False) -> Structure:
    """Autoregression with inputs: A(q) y = B(q) u + v, phi(k) = [-y(k-1) .. -y(k-na), u(k-nk) .. u(k-nk-nb+1)].

    Parameters
    ----------
    na, nb, nk : int or tuple of int
        As in `Structure`.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> ARX(2, 2).names
    ('a1', 'a2', 'b1', 'b2')
    """
    return Structure(na, nb, nd=_differences(integrated), nk=nk, form="ARX")


def OutputError(na: int, nb: Orders, nk: Orders = 1, integrated: bool = False) -> Structure:
    """Output-error model: y = B(q)/A(q) u + v, the noise outside the loop (paper 11-23).

    phi(k) = [-yhat(k-1) .. -yhat(k-na), u(k-nk) .. u(k-nk-nb+1)], with the model's own output
    yhat(k) = phi(k)' theta_hat(k) (18)-(21). It is BoxJenkins(nb, 0, 0, na) with the denominator first in theta.

    Parameters
    ----------
    na, nb, nk : int or tuple of int
        As in `Structure`, whose nf is na here.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Notes
    -----
    In print (20) has v(k-1) where u(k-1) belongs.

    Examples
    --------
    >>> OutputError(2, (1, 2), nk=(1, 0)).names
    ('a1', 'a2', 'b1[0]', 'b1[1]', 'b2[1]')
    """
    return Structure(0, nb, nd=_differences(integrated), nf=na, nk=nk, form="OutputError")


def ARMAX(na: int, nb: Orders, nc: int, nk: Orders = 1, integrated: bool = False) -> Structure:
    """ARX with a moving average of the noise: A(q) y = B(q) u + C(q) v, by extended least squares.

    phi(k) = [-y(k-1) .., u(k-nk) .., r(k-1) .. r(k-nc)], with the a-posteriori residuals r(k) = y(k) - phi(k)'
    theta_hat(k) in the place of the unknown v.

    Parameters
    ----------
    na, nb, nc, nk : int or tuple of int
        As in `Structure`.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> ARMAX(1, 1, 1).names
    ('a1', 'b1', 'c1')
    """
    return Structure(na, nb, nc, _differences(integrated), nk=nk, form="ARMAX")


def FIR(nb: Orders, nk: Orders = 1, integrated: bool = False) -> Structure:
    """Finite impulse response: y = B(q) u + v, phi(k) = [u(k-nk) .. u(k-nk-nb+1)].

    Parameters
    ----------
    nb, nk : int or tuple of int
        As in `Structure`.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> FIR(2, nk=0).regressors(u=[1.0, 2.0, 3.0])
    array([[1., 0.],
           [2., 1.],
           [3., 2.]])
    """
    return Structure(0, nb, nd=_differences(integrated), nk=nk, form="FIR")


def BoxJenkins(nb: Orders, nc: int, nd: int, nf: int, nk: Orders = 1) -> Structure:
    """Box and Jenkins' model: y = B(q)/F(q) u + C(q)/D(q) v, plant and noise each with dynamics of their own.

    phi(k) = [u(k-nk) .., -w(k-1) .. -w(k-nf), r(k-1) .. r(k-nc), -d(k-1) .. -d(k-nd)].

    Parameters
    ----------
    nb, nc, nd, nf, nk : int or tuple of int
        As in `Structure`.

    Returns
    -------
    Structure

    Notes
    -----
    With nc = nd = 0 it is the model of an `OutputError`, in which an outlier of y touches no other sample.

    Examples
    --------
    >>> BoxJenkins(2, 1, 1, 2).names
    ('b1', 'b2', 'f1', 'f2', 'c1', 'd1')
    """
    return Structure(0, nb, nc, nd, nf, nk, "BoxJenkins")


def ARMA(na: int, nc: int, integrated: bool = False) -> Structure:
    """Autoregression with a moving average of the noise, without input: A(q) y = C(q) v.

    Parameters
    ----------
    na, nc : int
        As in `Structure`.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> ARMA(2, 1).names
    ('a1', 'a2', 'c1')
    """
    return Structure(na, nc=nc, nd=_differences(integrated), form="ARMA")


def AR(na: int, integrated: bool = False) -> Structure:
    """Autoregression without input: A(q) y = v, phi(k) = [-y(k-1) .. -y(k-na)].

    Parameters
    ----------
    na : int
        As in `Structure`, >= 1.
    integrated : bool, default False
        Whether the noise is summed up, v/(1 - q^-1): theta ends with d1, which `identify` has at -1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> AR(2).names
    ('a1', 'a2')
    """
    return Structure(count("na", na, 1), nd=_differences(integrated), form="AR")


def LinearRegression(n: int) -> Structure:
    """Regression on what the caller supplies: y(k) = phi(k)' theta + v(k), phi in the place of u.

    Parameters
    ----------
    n : int
        Length of theta, >= 1.

    Returns
    -------
    Structure

    Examples
    --------
    >>> LinearRegression(2).regressors(u=[[1.0, 0.5], [1.0, 0.7]])
    array([[1. , 0.5],
           [1. , 0.7]])
    """
    return Structure(nb=(1,) * count("n", n, 1), nk=0, form="LinearRegression")


def _differences(integrated: Any) -> int:
    """Return the order of D for noise that is summed up, or raise."""
    if not isinstance(integrated, (bool, np.bool_)):
        raise TypeError(f"integrated: expected True or False, got {integrated!r}")
    return int(integrated)
