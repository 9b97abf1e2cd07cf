"""What stands for a linear plant: a transfer function, a parameter vector, or a path of them; and its orders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, numbers

if TYPE_CHECKING:
    import control

#: A discrete transfer function, or theta of shape (na + nb,), or a path of it of shape (N, na + nb).
System: TypeAlias = "control.TransferFunction | ArrayLike"


class LinearParameters(NamedTuple):
    """A transfer function as a parameter vector and its orders.

    Attributes
    ----------
    theta : ndarray, shape (na + nb,)
        [a_1 .. a_na, b_1 .. b_nb].
    na, nb, nk : int
        Number of a's, number of b's, delay of b_1 in samples.
    """

    theta: Array
    na: int
    nb: int
    nk: int


def linear_parameters(system: control.TransferFunction) -> LinearParameters:
    """Read theta and the orders from a discrete transfer function.

    Parameters
    ----------
    system : control.TransferFunction
        Discrete (``dt`` a period in s, or True), one input, one output, proper.

    Returns
    -------
    LinearParameters
        theta, na, nb, nk: na is the degree of the denominator, nk what the numerator's degree is below it.

    Raises
    ------
    TypeError
        If system is not a control.TransferFunction.
    ValueError
        If it is not discrete, not single-input single-output, or not proper.

    Examples
    --------
    >>> import control
    >>> linear_parameters(control.tf([1.0, 0.5], [1.0, -1.5, 0.7], dt=1))
    LinearParameters(theta=array([-1.5,  0.7,  1. ,  0.5]), na=2, nb=2, nk=1)
    """
    import control

    if not isinstance(system, control.TransferFunction):
        raise TypeError(
            f"system: expected a control.TransferFunction or an array theta, got {type(system).__name__}; "
            "control.tf(system) converts python-control's other linear systems"
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ValueError(
            f"system: expected one input and one output, got {system.ninputs} and {system.noutputs}; "
            "take one of them: system[output, input]"
        )
    if not system.isdtime(strict=True):
        raise ValueError(
            f"system: expected a discrete transfer function, got dt={system.dt}; "
            "use control.tf(num, den, dt) or control.sample_system(system, dt)"
        )
    den = np.trim_zeros(np.asarray(system.den[0][0], dtype=float), "f")
    num = np.trim_zeros(np.asarray(system.num[0][0], dtype=float), "f")
    if num.size > den.size:
        raise ValueError(
            f"system: expected a proper transfer function, got degree {num.size - 1} over {den.size - 1}: "
            "its output would come before its input"
        )
    na, nb = den.size - 1, num.size
    return LinearParameters(np.concatenate((den[1:], num)) / den[0], na, nb, den.size - max(nb, 1))


def orders_of(system: Any, na: int | None, nb: int | None, nk: int | None) -> LinearParameters:
    """Return theta, constant or a path, and the orders that belong to it."""
    if hasattr(system, "ninputs"):
        if not (na is nb is nk is None):
            raise ValueError("na, nb, nk: expected none with a transfer function (it tells them); give them with theta")
        return linear_parameters(system)
    theta = numbers("system", system)
    if na is None or nb is None:
        raise ValueError("na, nb: expected both with theta, which does not tell where the a's end")
    na, nb, nk = count("na", na), count("nb", nb), count("nk", 1 if nk is None else nk)
    if na + nb == 0:
        raise ValueError("na, nb: expected at least one parameter, got na = nb = 0")
    if theta.ndim not in (1, 2) or theta.shape[-1] != na + nb:
        raise ValueError(
            f"theta: expected shape ({na + nb},) or (N, {na + nb}) for na={na}, nb={nb}, got {theta.shape}"
        )
    if not np.isfinite(theta).all():
        raise ValueError("theta: expected finite numbers, got NaN or infinity among them")
    return LinearParameters(theta, na, nb, nk)
