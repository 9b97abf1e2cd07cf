"""The usual structures, each by its orders. What they raise is what `Structure` raises."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import count
from robust_filterpy.identification.models.structures import Orders, Structure

__all__ = ["AR", "ARMA", "ARMAX", "ARX", "FIR", "BoxJenkins", "LinearRegression", "OutputError"]


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
