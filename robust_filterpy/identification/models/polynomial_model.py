"""Residuals of A(q) y = B(q)/F(q) u + d + C(q)/D(q) v and their derivatives: every structure is a special case.

    w = B/F u + what was in motion when the recording began
    r = D/C (A y - w - d)

with a constant d, the offset of the equation (of y itself where A = 1). All derivatives are signals filtered by the
same polynomials (Ljung, System Identification, 2nd ed., 1999, section 10.3).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.regressor import is_stable
from robust_filterpy.identification.models.structures import Structure, fill_with_delays

# Samples without output between two recordings, where a start is looked for in all of them as one.
_BETWEEN: Final = 30


class Parts(NamedTuple):
    """Free parameters, taken apart; polynomials with their leading 1.

    Attributes
    ----------
    a, f, c, d : ndarray
        Coefficients of A, F, C, D.
    b : tuple of ndarray
        Coefficients of B for each input that has any.
    offset : float
        Constant of the equation.
    start : ndarray, shape (nf,), or (0,) for a model from rest
        What drives 1/F in its first samples in the place of the unknown past.
    """

    a: Array
    b: tuple[Array, ...]
    f: Array
    c: Array
    d: Array
    offset: float
    start: Array

    @classmethod
    def of(cls, structure: Structure, p: Array, offset: bool) -> Parts:
        """Take free parameters apart."""
        places, n = structure.polynomials, structure.n_theta
        a, f, c, d = (np.concatenate(([1.0], p[part])) for part in (places.a, places.f, places.c, places.d))
        b = tuple(p[place] for place in places.b if place.stop > place.start)
        return cls(a, b, f, c, d, float(p[n]) if offset else 0.0, p[n + offset :])

    def pattern(self, length: int) -> Array:
        """Return A D/C, what one unit more in an output adds to its residual and to those after it."""
        return np.asarray(lfilter(np.convolve(self.a, self.d), self.c, np.eye(1, length).ravel()))


class Input(NamedTuple):
    """One input that acts: its samples, its orders, and where its coefficients stand in theta."""

    u: Array
    nb: int
    nk: int
    place: slice


class PolynomialModel:
    """Residuals and their derivatives for recordings that follow each other in ``y`` and ``u``, usually one.

    The free parameters are [theta, constant of each recording if there is one, start of each, size of each level that y
    has besides]. Residual k belongs to sample ``first + k``: those before have regressors from before the recording.

    Parameters
    ----------
    structure : Structure
        Which polynomials there are.
    y : ndarray, shape (N,)
        Output, without gaps.
    u : ndarray, shape (N, n_inputs)
        Input.
    offset : bool
        Whether there is a constant.
    moving : bool, default True
        Whether something may have been in motion when a recording began; False: no start among the parameters.
    begins : tuple of int, default (0,)
        First sample of each recording.
    """

    def __init__(
        self, structure: Structure, y: Array, u: Array, offset: bool, moving: bool = True,
        begins: tuple[int, ...] = (0,),
    ) -> None:  # fmt: skip
        """Keep the recordings, and each input that acts as a contiguous row."""
        places, n, k = structure.polynomials, structure.n_theta, len(begins)
        self.structure, self.y, self.u, self.offset, self.moving = structure, y, u, offset, moving
        self.spans = spans_of(begins, y.size)
        self.inputs = [
            Input(np.ascontiguousarray(column), nb, nk, place)
            for column, (nb, nk), place in zip(u.T, structure.inputs, places.b, strict=True)
            if nb
        ]
        self.na, self.nf, self.nd = (part.stop - part.start for part in (places.a, places.f, places.d))
        self.first = max([self.na, *(i.nk + i.nb - 1 for i in self.inputs)])
        self._own = n + k * (offset + self.nf * moving)
        self.columns = np.zeros((y.size, 0))
        starts = np.arange(n + offset * k, self._own).reshape(k, -1)
        # The free parameters of each recording.
        self._places = [np.array([*range(n), *[n + i] * offset, *own], dtype=int) for i, own in enumerate(starts)]

    @property
    def is_linear(self) -> bool:
        """Whether residuals are linear in the free parameters."""
        return not (self.nf or self.structure.nc or self.nd)

    @property
    def remembers(self) -> bool:
        """Whether a residual depends on outputs that were measured before its own."""
        return bool(self.na or self.structure.nc or self.nd)

    @property
    def n(self) -> int:
        """How many free parameters there are."""
        return self._own + self.columns.shape[1]

    def with_output(self, y: Array, columns: Array | None = None) -> PolynomialModel:
        """Return the same model for another output, or one with levels, shape (N, k), whose sizes are free."""
        other = copy.copy(self)
        other.y, other.columns = y, self.columns if columns is None else columns
        return other

    def levelled(self, p: Array) -> PolynomialModel:
        """Return the model of the output less its levels."""
        if not self.columns.size:
            return self
        return self.with_output(self.y - self.columns @ p[self._own :], self.columns[:, :0])

    @property
    def pieces(self) -> tuple[tuple[slice, slice], ...]:
        """Which residuals and which samples belong to each recording."""
        return tuple((slice(part.start, part.stop - self.first), part) for part in self.spans)

    @property
    def conditioned(self) -> Any:
        """Which residuals need nothing from before their recording, shape (N - first,)."""
        flags = np.zeros(self.y.size - self.first, dtype=bool)
        for rows, _ in self.pieces:
            flags[rows.start + self.nd : rows.stop] = True
        return flags

    def of(self, i: int, p: Array) -> tuple[PolynomialModel, Array]:
        """Return the model of one recording, and its own free parameters."""
        part = self.spans[i]
        one = PolynomialModel(self.structure, self.levelled(p).y[part], self.u[part], self.offset, self.moving)
        return one, p[self._places[i]]

    def parts(self, p: Array) -> Parts:
        """Take the free parameters apart."""
        return Parts.of(self.structure, p, self.offset)

    def from_output_error(self, parts: Parts) -> Array:
        """Return the free parameters that have the dynamics of an output-error model; its noise is not theirs."""
        p, places = np.zeros(self.n), self.structure.polynomials
        p[places.a], p[places.f] = parts.f[1 : self.na + 1], parts.f[1 : self.nf + 1]
        for acting, b in zip(self.inputs, parts.b, strict=True):
            p[acting.place] = b
        if self.offset:
            p[self.structure.n_theta] = parts.offset * (parts.f.sum() if self.na else 1.0)
        start = p[self.structure.n_theta + self.offset :]
        start[: parts.start.size] = parts.start[: start.size]
        return p

    def is_stable(self, p: Array) -> bool:
        """Tell whether the filters 1/F and 1/C are stable."""
        places = self.structure.polynomials
        return is_stable(p[places.f].tolist()) and is_stable(p[places.c].tolist())

    def residuals(self, p: Array) -> Array:
        """Return r of each recording from its sample ``first`` on, 0 where it has none yet."""
        return self._signal(p, PolynomialModel._residuals)

    def equation_error(self, p: Array) -> Array:
        """Return A y - w - d."""
        return self._signal(p, lambda one, parts, span: one._equation_error(parts, span, one._undisturbed(parts, span)))

    def undisturbed(self, p: Array) -> Array:
        """Return w, what the inputs and the starts alone make of B/F."""
        return self._signal(p, PolynomialModel._undisturbed)

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the free parameters, shape (N - first, n)."""
        J, model = np.zeros((self.y.size - self.first, self.n)), self.levelled(p)
        for (rows, span), places in zip(self.pieces, self._places, strict=True):
            J[rows, places] = model._derivatives(self.parts(p[places]), span, places.size).T
        if self.columns.size:
            none, *each = (model.with_output(y).residuals(p) for y in (np.zeros(self.y.size), *self.columns.T))
            J[:, self._own :] = none[:, None] - np.column_stack(each)
        return J

    def _signal(self, p: Array, of: Callable[[PolynomialModel, Parts, slice], Array]) -> Array:
        """Return a signal of all recordings."""
        signal, model = np.zeros(self.y.size - self.first), self.levelled(p)
        for (rows, span), places in zip(self.pieces, self._places, strict=True):
            signal[rows] = of(model, self.parts(p[places]), span)
        return signal

    def _undisturbed(self, parts: Parts, span: slice) -> Array:
        """Return w of a recording."""
        w = np.zeros(span.stop - span.start - self.first)
        for (u, nb, nk, _), b in zip(self.inputs, parts.b, strict=True):
            w += np.convolve(u[span.start + self.first - nk - nb + 1 : span.stop - nk], b, "valid")
        if self.nf:
            start = parts.start[: w.size]
            w[: start.size] += start
            w = np.asarray(lfilter([1.0], parts.f, w))
        return w

    def _equation_error(self, parts: Parts, span: slice, w: Array) -> Array:
        """Return A y - w - d of a recording."""
        y = np.convolve(self.y[span.start + self.first - parts.a.size + 1 : span.stop], parts.a, "valid")
        return np.asarray(y - w - parts.offset)

    def _residuals(self, parts: Parts, span: slice) -> Array:
        """Return r of a recording."""
        v = self._equation_error(parts, span, self._undisturbed(parts, span))
        return v if parts.c.size == parts.d.size == 1 else np.asarray(lfilter(parts.d, parts.c, v))

    def _derivatives(self, parts: Parts, span: slice, count: int) -> Array:
        """Return the derivatives of the residuals of a recording by its free parameters, a row for each."""
        places, n, w = self.structure.polynomials, self.structure.n_theta, self._undisturbed(parts, span)
        begin, rows = span.start + self.first, np.zeros((count, w.size))
        for j in range(1, parts.a.size):
            rows[places.a.start + j - 1] = self.y[begin - j : span.stop - j]
        for u, nb, nk, place in self.inputs:
            for j in range(nb):
                rows[place.start + j] = -u[begin - nk - j : span.stop - nk - j]
        if self.offset:
            rows[n] = -1.0
        if self.nf:
            inputs = slice(self.inputs[0].place.start, self.inputs[-1].place.stop)
            rows[inputs] = lfilter([1.0], parts.f, rows[inputs])
            impulse = np.zeros(w.size)
            impulse[0] = -1.0
            fill_with_delays(rows[n + self.offset :], lfilter([1.0], parts.f, impulse), 0)
            fill_with_delays(rows[places.f], lfilter([1.0], parts.f, w), 1)
        if parts.c.size > 1 or parts.d.size > 1:
            rows = np.asarray(lfilter(parts.d, parts.c, rows))
            v = lfilter([1.0], parts.c, self._equation_error(parts, span, w))
            fill_with_delays(rows[places.d], v, 1)
            fill_with_delays(rows[places.c], -lfilter(parts.d, parts.c, v), 1)
        return rows

    def joined(self, missing: Any) -> tuple[PolynomialModel, Any]:
        """Return all recordings as one, with gaps between them, and where its output is missing."""
        space = max(_BETWEEN, self.first + 1)
        y, u, gaps = [], [], []
        for part in self.spans:
            y += [self.y[part], np.zeros(space)]
            u += [self.u[part], np.zeros((space, self.u.shape[1]))]
            gaps += [missing[part], np.ones(space, dtype=bool)]
        whole = PolynomialModel(self.structure, np.concatenate(y), np.concatenate(u), self.offset, self.moving)
        return whole, np.concatenate(gaps)

    def shared(self, p: Array) -> Array:
        """Return free parameters with the theta and offset of another model of the same structure, without motion."""
        n, q = self.structure.n_theta, np.zeros(self.n)
        q[:n] = p[:n]
        if self.offset:
            q[n : n + len(self.spans)] = p[n]
        return q


def spans_of(begins: tuple[int, ...], size: int) -> tuple[slice, ...]:
    """Return the samples of each recording."""
    return tuple(slice(a, b) for a, b in pairwise((*begins, size)))
