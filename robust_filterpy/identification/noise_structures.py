"""Model structures with a model of the noise: AR and ARMA without input, and Box and Jenkins' with one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count
from robust_filterpy.identification.structures import (
    ARMAX,
    ARX,
    Orders,
    Polynomials,
    Structure,
    input_orders,
    numbered,
    set_orders,
)

__all__ = ["AR", "ARMA", "BoxJenkins"]


@dataclass(frozen=True)
class AR(Structure):
    """Autoregression without input: A(q) y = v, phi(k) = [-y(k-1) .. -y(k-na)].

    Parameters
    ----------
    na : int
        Number of a's, >= 1.

    Raises
    ------
    ValueError
        If na < 1.
    TypeError
        If na is no integer.

    Examples
    --------
    >>> AR(2).names
    ('a1', 'a2')
    """

    na: int

    def __post_init__(self) -> None:
        """Check the order."""
        set_orders(self, na=count("na", self.na, 1))

    def with_constant(self) -> ARX:
        """Return the autoregression with a constant as its input.

        Returns
        -------
        ARX
        """
        return ARX(self.na, (1,), (0,))


@dataclass(frozen=True)
class ARMA(Structure):
    """Autoregression with a moving average of the noise, without input: A(q) y = C(q) v.

    phi(k) = [-y(k-1) .. -y(k-na), r(k-1) .. r(k-nc)], with the residuals r in the place of the unknown v.

    Parameters
    ----------
    na, nc : int
        Number of a's and of c's, >= 0.

    Raises
    ------
    ValueError
        If an order is negative, or both are zero.
    TypeError
        If an order is no integer.

    Examples
    --------
    >>> ARMA(2, 1).names
    ('a1', 'a2', 'c1')
    """

    na: int
    nc: int

    def __post_init__(self) -> None:
        """Check the orders."""
        set_orders(self, na=count("na", self.na), nc=count("nc", self.nc))

    def with_constant(self) -> ARMAX:
        """Return the model with a constant as its input.

        Returns
        -------
        ARMAX
        """
        return ARMAX(self.na, (1,), self.nc, (0,))


@dataclass(frozen=True)
class BoxJenkins(Structure):
    """Box and Jenkins' model: y = B(q)/F(q) u + C(q)/D(q) v, plant and noise each with dynamics of their own.

    With w = B/F u, what the input alone does, and the disturbance d = y - w::

        theta = [b_1 .. b_nb (first input), .., f_1 .. f_nf, c_1 .. c_nc, d_1 .. d_nd]
        phi(k) = [u(k-nk) .., -w(k-1) .. -w(k-nf), r(k-1) .. r(k-nc), -d(k-1) .. -d(k-nd)]

    Parameters
    ----------
    nb : int or tuple of int
        Number of b's, of each input if a tuple; at least one in all.
    nc : int
        Number of c's, >= 0.
    nd : int
        Number of d's, >= 0.
    nf : int
        Number of f's, >= 0, of the denominator that all inputs share.
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
    With nc = nd = 0 it is the model of an `OutputError`, in which an outlier of y touches no other sample.

    Examples
    --------
    >>> BoxJenkins(2, 1, 1, 2).names
    ('b1', 'b2', 'f1', 'f2', 'c1', 'd1')
    """

    nb: Orders
    nc: int
    nd: int
    nf: int
    nk: Orders = 1

    def __post_init__(self) -> None:
        """Check the orders."""
        orders = {"nc": count("nc", self.nc), "nd": count("nd", self.nd), "nf": count("nf", self.nf)}
        set_orders(self, input_orders("nb", self.nb), input_orders("nk", self.nk), **orders)
        if self.constant_place == 0:
            raise ValueError(
                f"nb: expected at least one b, without which there is no input, got {self.nb}; without input use ARMA"
            )

    @cached_property
    def n_theta(self) -> int:
        """Length of theta."""
        return self.constant_place + self.nf + self.nc + self.nd

    @property
    def feeds_back(self) -> slice | None:
        """Which part of theta multiplies what the model computed itself: the f's and c's, two polynomials."""
        f, c = self.polynomials.f, self.polynomials.c
        return slice(f.start, c.stop) if c.stop > f.start else None

    @property
    def stable_parts(self) -> tuple[slice, ...]:
        """Which parts of theta are polynomials that must be stable: F and C."""
        return tuple(part for part in (self.polynomials.f, self.polynomials.c) if part.stop > part.start)

    @cached_property
    def polynomials(self) -> Polynomials:
        """Which polynomial each parameter belongs to."""
        f = self.constant_place
        c, d = f + self.nf, f + self.nf + self.nc
        b = super().polynomials.b
        return Polynomials(slice(0, 0), b, slice(f, c), slice(c, d), slice(d, d + self.nd))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, as "b1", "f2" or, with several inputs, "b2[0]" for the first input's."""
        b = super().names[: self.constant_place]
        return (*b, *numbered("f", self.nf), *numbered("c", self.nc), *numbered("d", self.nd))

    def regressors(
        self, u: ArrayLike | None = None, y: ArrayLike | None = None, residual: ArrayLike | None = None
    ) -> Array:
        """Refuse: the regressor holds what a model with parameters computed, not recorded signals alone.

        Parameters
        ----------
        u, y, residual : array_like, shape (N,), optional
            Not used.

        Returns
        -------
        ndarray
            Never.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(f"{self}: its regressor holds w and d, which only a model with parameters has; use identify")
