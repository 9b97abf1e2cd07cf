"""What stands in phi, what a recursion remembers of it, and what theta says: polynomials, stability, a simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import scipy.signal

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.structures import Structure

if TYPE_CHECKING:
    import control

#: What to do with a step of theta that leaves the stable region.
Guard: TypeAlias = Literal["none", "reject", "halve"]
GUARDS: Final[tuple[Guard, ...]] = ("none", "reject", "halve")
# 2^-30 of a step is no step worth taking.
MOST_HALVINGS: Final = 30
_LARGEST_RADIUS: Final = 0.995
# Beyond this the square of a signal, times P, leaves the range of floats.
LARGEST: Final = 1e100
# Standard deviations from which on an innovation makes its output one that a cleaned regressor replaces.
CLEANED_FROM: Final = 3.0


class Coefficients(NamedTuple):
    """Coefficients of A(q) y = B(q)/F(q) u + C(q)/D(q) v without the leading 1s, empty where there are none.

    Attributes
    ----------
    a : ndarray, shape (na,)
        a_1 .. a_na; of an `OutputError`, which calls them so, those of F.
    b : ndarray, shape (nb,), or tuple of ndarray
        b_1 .. b_nb; with several inputs one array for each.
    c, d, f : ndarray, shape (nc,), (nd,), (nf,)
        Those of C, D and F.
    """

    a: Array
    b: Array | tuple[Array, ...]
    c: Array
    d: Array
    f: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


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


def linear_parameters(system: control.TransferFunction, name: str = "system") -> LinearParameters:
    """Read theta and the orders from a discrete transfer function.

    Parameters
    ----------
    system : control.TransferFunction
        Discrete (``dt`` a period in s, or True), one input, one output, proper.
    name : str, default "system"
        What an error calls it.

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
            f"{name}: expected a control.TransferFunction or an array theta, got {type(system).__name__}; "
            "control.tf(system) converts python-control's other linear systems"
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise ValueError(
            f"{name}: expected one input and one output, got {system.ninputs} and {system.noutputs}; "
            "take one of them: system[output, input]"
        )
    if not system.isdtime(strict=True):
        raise ValueError(
            f"{name}: expected one in discrete time, got dt={system.dt}; "
            "use control.tf(num, den, dt) or control.sample_system(system, dt)"
        )
    den = np.trim_zeros(np.asarray(system.den[0][0], dtype=float), "f")
    num = np.trim_zeros(np.asarray(system.num[0][0], dtype=float), "f")
    if num.size > den.size:
        raise ValueError(
            f"{name}: expected a proper transfer function, got degree {num.size - 1} over {den.size - 1}: "
            "its output would come before its input"
        )
    na, nb = den.size - 1, num.size
    return LinearParameters(np.concatenate((den[1:], num)) / den[0], na, nb, den.size - max(nb, 1))


def is_stable(coefficients: Sequence[float]) -> bool:
    """Tell whether z^n + c_1 z^(n-1) + .. + c_n has all its roots strictly inside the unit circle.

    Parameters
    ----------
    coefficients : sequence of float
        c_1 .. c_n.

    Returns
    -------
    bool
        True for no coefficients at all, False for NaN.

    Notes
    -----
    By the step-down recursion of Schur and Cohn, as Jury's table has it: stable if and only if every reflection
    coefficient is inside (-1, 1).

    Examples
    --------
    >>> is_stable([-1.5, 0.7]), is_stable([-2.5, 1.0])
    (True, False)
    """
    c = list(coefficients)
    while c:
        k = c.pop()
        # False for NaN as well.
        if not -1.0 < k < 1.0:
            return False
        if c:
            d = 1.0 - k * k
            c = [(a - k * b) / d for a, b in zip(c, reversed(c), strict=True)]
    return True


def are_stable(theta: Array, parts: Sequence[slice]) -> bool:
    """Tell whether each of some parts of theta is a stable polynomial."""
    return all(is_stable(theta[part].tolist()) for part in parts)


def mirrored(roots: Any) -> Any:
    """Return roots, those outside a circle of radius .995 mirrored into it."""
    radius = np.maximum(np.abs(roots), np.finfo(float).tiny)
    return np.where(radius > _LARGEST_RADIUS, roots * np.minimum(_LARGEST_RADIUS, 1.0 / radius) / radius, roots)


def stabilised(f: Array) -> Array:
    """Return a polynomial, its leading 1 included, with its roots mirrored."""
    roots = np.roots(f)
    if (np.abs(roots) <= _LARGEST_RADIUS).all():
        return f
    stable = np.zeros(f.size)
    stable[: roots.size + 1] = np.real(np.poly(mirrored(roots)))
    return stable


def restrained(theta: Array, old: Array, parts: Sequence[slice], guard: str) -> tuple[Array, int]:
    """Return theta as far towards its new value as the guard lets it, and what the guard did."""
    if guard == "none" or are_stable(theta, parts):
        return theta, 0
    if guard == "halve":
        step = theta - old
        for halvings in range(1, MOST_HALVINGS + 1):
            step *= 0.5
            shorter = old + step
            if are_stable(shorter, parts):
                return shorter, halvings
    return old.copy(), -1


def bounded(value: float) -> float:
    """Return value, at most LARGEST in size; NaN, which is inf - inf here, becomes 0."""
    if -LARGEST <= value <= LARGEST:
        return value
    return math.copysign(LARGEST, value) if value == value else 0.0


class Layout:
    """Where each signal stands in phi and in the memory of a structure."""

    # The inputs of all lags stand in one array, u(k), u(k-1), .. of the first input and then of the next, so that one
    # shift by one place makes them all a sample older.

    def __init__(self, structure: Structure, constant: int = -1) -> None:
        """Work out the places; constant: which input is 1 in every sample and not among those that are given."""
        self.constant = constant
        acting = [(i, nb, nk) for i, (nb, nk) in enumerate(structure.inputs) if nb]
        *starts, self.length = accumulate((nb + nk for _, nb, nk in acting), initial=0)
        self.ends = [*starts[1:], self.length][: len(acting)]
        picks = [end - nb + j for end, (_, nb, _) in zip(self.ends, acting, strict=True) for j in range(nb)]
        each = starts, picks, [i for i, _, _ in acting]
        self.starts, self.picks, self.used = (np.array(places, dtype=np.intp) for places in each)
        self.n = structure.n_theta
        self.stable, places = structure.stable_parts, structure.polynomials
        self.a, self.f, self.c, self.d = places.a, places.f, places.c, places.d
        self.na, self.nc, self.nd, self.nf = structure.na, structure.nc, structure.nd, structure.nf
        self.is_filtered = self.nc + self.nd + self.nf > 0
        where = np.arange(self.n)
        #: Where phi holds inputs, and what was measured: past outputs and disturbances.
        self.inputs_in_phi = np.concatenate([where[b] for b in places.b] or [where[:0]])
        self.outputs = np.concatenate((where[self.a], where[self.d]))
        #: What goes through B/F, and with A all that stands before the noise.
        self.through, self.before_noise = slice(self.na, self.c.start), slice(0, self.c.start)
        self.goes_through = np.isin(where, where[self.through]).astype(float)
        self.precedes_noise = np.isin(where, where[self.before_noise]).astype(float)

    @cached_property
    def numbers(self) -> np.ndarray:
        """The places as ``tracker.h`` wants them; an input that is the newest of its kind is -1 - its place."""
        newest = {int(place): -1 - i for i, place in enumerate(self.starts)}
        sources = [newest.get(int(pick), int(pick) - 1) for pick in self.picks]
        used = [-1 if i == self.constant else int(i) for i in self.used]
        first = int(self.inputs_in_phi[0]) if len(sources) else 0
        orders = (self.na, self.nc, self.nd, self.nf, self.a.start, self.c.start, self.d.start, self.f.start)
        sizes = (first, len(sources), self.length, len(used))
        return np.array([*orders, *sizes, *self.starts, *used, *sources], dtype=np.intc)

    def remembered(self, past: Array, y: float, before: float) -> Array:
        """Return -y and -d with those of one more sample; before: what stands before the noise in it."""
        return np.concatenate((pushed(past[: self.na], -y), pushed(past[self.na :], before - y)))

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array in the memory."""
        return {
            "outputs": (self.na + self.nd,),
            "inputs": (self.length,),
            "residuals": (self.nc,),
            "gradients": (self.nc, self.n),
            "measured": (self.na + self.nd,),
            "undisturbed": (self.nf,),
            "prefiltered": (max(self.nf, self.nd), self.n),
        }


class Memory(NamedTuple):
    """Past signals, newest first; those of many actuators have an axis in front.

    ``outputs`` holds -y and then -d, the disturbances, as they stand in phi, and ``measured`` the same with the outputs
    as they were measured. ``undisturbed`` is -w, what the inputs do, and ``inputs`` has the newest input too.
    ``prefiltered`` has a row phi(k-j) filtered by 1/F_hat for each past sample that the gradient needs, and
    ``gradients`` one that went through D_hat/C_hat too.
    """

    outputs: Array
    measured: Array
    inputs: Array
    residuals: Array
    undisturbed: Array
    prefiltered: Array
    gradients: Array

    @classmethod
    def at_rest(cls, layout: Layout, *axes: int) -> Memory:
        """Return the memory of what has seen nothing."""
        return cls(**{name: np.zeros((*axes, *shape)) for name, shape in layout.shapes().items()})

    def with_input(self, layout: Layout, u: Array) -> Array:
        """Return what ``inputs`` becomes with the next input."""
        inputs = np.empty_like(self.inputs)
        inputs[..., 1:] = self.inputs[..., :-1]
        inputs[..., layout.starts] = u[..., layout.used]
        return inputs

    def regressor(self, layout: Layout, inputs: Array) -> Array:
        """Return phi, shape (.., n)."""
        phi = np.empty((*inputs.shape[:-1], layout.n))
        phi[..., layout.outputs] = self.outputs
        phi[..., layout.inputs_in_phi] = inputs[..., layout.picks]
        phi[..., layout.f] = self.undisturbed
        phi[..., layout.c] = self.residuals
        return phi

    def regressors(self, layout: Layout, u: Array) -> tuple[Array, Array]:
        """Return phi of a recording, shape (N, n), with its inputs alone filled in, and ``inputs`` at its end."""
        length = len(u)
        phi = np.zeros((length, layout.n))
        inputs = self.inputs.copy()
        columns = iter(layout.inputs_in_phi)
        for i, start, end in zip(layout.used, layout.starts, layout.ends, strict=True):
            signal = np.concatenate((self.inputs[start:end][::-1], u[:, i]))
            inputs[start:end] = signal[: -(end - start) - 1 : -1]
            for lag in layout.picks[(layout.picks >= start) & (layout.picks < end)] - start:
                phi[:, next(columns)] = signal[end - start - lag : end - start - lag + length]
        return phi, inputs


def gradient(layout: Layout, phi: Array, theta: Array, memory: Memory) -> tuple[Array, Array]:
    """Return psi(k), the derivative of the prediction, and what of it goes through F alone."""
    # chi = phi/F for inputs and what they do, and phi for past outputs; C psi = D chi for these, = phi for the others.
    chi = phi
    if layout.nf:
        chi = _bounded(phi - theta[layout.f].dot(memory.prefiltered[: layout.nf]) * layout.goes_through)
    psi = chi + theta[layout.d].dot(memory.prefiltered[: layout.nd]) if layout.nd else chi
    if layout.nc:
        psi = psi - theta[layout.c].dot(memory.gradients)
    return _bounded(psi), chi * layout.precedes_noise


def _bounded(row: Array) -> Array:
    """Return a row of numbers that can be squared."""
    return row if row.dot(row) < LARGEST * LARGEST else np.clip(np.nan_to_num(row), -LARGEST, LARGEST)


def pushed(past: Array, newest: Array | float) -> Array:
    """Return past values with a new one in front and the oldest gone."""
    if len(past) == 0:
        return past
    moved = np.empty_like(past)
    moved[1:] = past[:-1]
    moved[0] = newest
    return moved


def coefficients(structure: Structure, theta: Array) -> Any:
    """Split theta, the last axis of an array."""
    if structure.takes_phi:
        raise ValueError(f"{structure}: expected a model with a, b, c; the coefficients of your regressor are theta")
    places = structure.polynomials
    b = tuple(theta[..., place] for place in places.b)
    first = b[0] if len(b) == 1 else b or theta[..., :0]
    a, f, c, d = (theta[..., place] for place in (places.a, places.f, places.c, places.d))
    return Coefficients(f if structure.form == "OutputError" else a, first, c, d, f)


def denominator(structure: Structure, theta: Array) -> Array:
    """Return A F, its leading 1 too."""
    a, f = (np.concatenate(([1.0], theta[part])) for part in (structure.polynomials.a, structure.polynomials.f))
    return np.convolve(a, f)


def poles(structure: Structure, theta: Array) -> Any:
    """Return the roots of A and F."""
    return np.concatenate(
        [np.roots([1.0, *theta[part]]) for part in (structure.polynomials.a, structure.polynomials.f)]
    )


def period(dt: Any, recorded: float | None) -> Any:
    """Return the sampling period that was asked for; for "recorded" that of the recording, True if it is unknown."""
    if not isinstance(dt, str) or dt != "recorded":
        return dt
    return True if recorded is None else recorded


def simulate(structure: Structure, layout: Layout, memory: Memory, theta: Array, u: Array) -> Array:
    """Run a model on its input alone, from what the memory holds; noise to come is 0."""
    phi, _ = memory.regressors(layout, u)
    forcing = phi.dot(theta)
    c, noise = theta[layout.c], np.zeros(len(u))
    # What noise is already in the memory goes on acting for nc samples.
    for k in range(min(c.size, len(u))):
        noise[k] = c[k:].dot(memory.residuals[: c.size - k])
    with np.errstate(over="ignore", invalid="ignore"):
        w = _fed_back(forcing, theta[layout.f], memory.undisturbed)
        disturbance = _fed_back(noise, theta[layout.d], memory.outputs[layout.na :])
        y = _fed_back(w + disturbance, theta[layout.a], memory.outputs[: layout.na])
    if not np.isfinite(y).all():
        k = int(np.argmin(np.isfinite(y)))
        raise ValueError(f"theta: the output overflows at sample {k}: the model as it stands is unstable")
    return y


def _fed_back(forcing: Array, coefficients: Array, past: Array) -> Array:
    """Return the output of 1/(1 + c_1 q^-1 + ..) that goes on from past outputs, with their minus sign."""
    a = np.concatenate(([1.0], coefficients))
    return np.asarray(scipy.signal.lfilter([1.0], a, forcing, zi=scipy.signal.lfiltic([1.0], a, -past))[0])
