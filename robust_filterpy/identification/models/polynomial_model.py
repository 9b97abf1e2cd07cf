"""Residuals of A(q) y = B(q)/F(q) u + d + C(q)/D(q) v and their derivatives: every structure is a special case.

    w = B/F u + what was in motion when the recording began
    r = D/C (A y - w - d)

with a constant d, the offset of the equation (of y itself where A = 1). All derivatives are signals filtered by the
same polynomials (Ljung, System Identification, 2nd ed., 1999, section 10.3).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.regressor import is_stable
from robust_filterpy.identification.models.structures import Structure

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


class Input(NamedTuple):
    """One input that acts: its samples, its orders, and where its coefficients stand in theta."""

    u: Array
    nb: int
    nk: int
    place: slice


class PolynomialModel:
    """Residuals and their derivatives for one recording.

    The free parameters are [theta, offset if there is one, start]. Residual k belongs to sample ``first + k``: samples
    before ``first`` have regressors from before the recording.

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
        Whether something may have been in motion when the recording began; False: no start among the parameters.
    """

    def __init__(self, structure: Structure, y: Array, u: Array, offset: bool, moving: bool = True) -> None:
        """Keep the recording, and each input that acts as a contiguous row."""
        places = structure.polynomials
        self.structure, self.y, self.u, self.offset, self.moving = structure, y, u, offset, moving
        self.inputs = [
            Input(np.ascontiguousarray(column), nb, nk, place)
            for column, (nb, nk), place in zip(u.T, structure.inputs, places.b, strict=True)
            if nb
        ]
        self.na, self.nf, self.nd = (part.stop - part.start for part in (places.a, places.f, places.d))
        self.first = max([self.na, *(i.nk + i.nb - 1 for i in self.inputs)])
        self.n = structure.n_theta + offset + (self.nf if moving else 0)

    def with_output(self, y: Array) -> PolynomialModel:
        """Return the same model for another output."""
        return PolynomialModel(self.structure, y, self.u, self.offset, self.moving)

    @property
    def pieces(self) -> tuple[tuple[slice, slice], ...]:
        """Which residuals and which samples belong to each recording: all of them to one."""
        return ((slice(0, self.y.size - self.first), slice(0, self.y.size)),)

    @property
    def conditioned(self) -> Any:
        """Which residuals need nothing from before the recording, shape (N - first,)."""
        return np.arange(self.y.size - self.first) >= self.nd

    def parts(self, p: Array) -> Parts:
        """Take the free parameters apart."""
        places, n = self.structure.polynomials, self.structure.n_theta
        a, f, c, d = (np.concatenate(([1.0], p[part])) for part in (places.a, places.f, places.c, places.d))
        b = tuple(p[i.place] for i in self.inputs)
        return Parts(a, b, f, c, d, float(p[n]) if self.offset else 0.0, p[n + self.offset :])

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
        """Return r from sample ``first`` on."""
        parts, v = self.parts(p), self.equation_error(p)
        return v if parts.c.size == parts.d.size == 1 else np.asarray(lfilter(parts.d, parts.c, v))

    def equation_error(self, p: Array) -> Array:
        """Return A y - w - d from sample ``first`` on."""
        parts = self.parts(p)
        return self._equation_error(parts, self._undisturbed(parts))

    def undisturbed(self, p: Array) -> Array:
        """Return w, what the inputs and the start alone make of B/F, from sample ``first`` on."""
        return self._undisturbed(self.parts(p))

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the free parameters, shape (N - first, n)."""
        parts, places, n = self.parts(p), self.structure.polynomials, self.structure.n_theta
        length = self.y.size - self.first
        w = self._undisturbed(parts)
        rows = np.zeros((self.n, length))
        for j in range(1, parts.a.size):
            rows[places.a.start + j - 1] = self.y[self.first - j : self.y.size - j]
        for u, nb, nk, place in self.inputs:
            for j in range(nb):
                delay = self.first - nk - j
                rows[place.start + j] = -u[delay : delay + length]
        if self.offset:
            rows[n] = -1.0
        if self.nf:
            inputs = slice(self.inputs[0].place.start, self.inputs[-1].place.stop)
            rows[inputs] = lfilter([1.0], parts.f, rows[inputs])
            impulse = np.zeros(length)
            impulse[0] = -1.0
            _fill_with_delays(rows[n + self.offset :], lfilter([1.0], parts.f, impulse), 0)
            _fill_with_delays(rows[places.f], lfilter([1.0], parts.f, w), 1)
        if parts.c.size > 1 or parts.d.size > 1:
            rows = np.asarray(lfilter(parts.d, parts.c, rows))
            v = lfilter([1.0], parts.c, self._equation_error(parts, w))
            _fill_with_delays(rows[places.d], v, 1)
            _fill_with_delays(rows[places.c], -lfilter(parts.d, parts.c, v), 1)
        return rows.T

    def _undisturbed(self, parts: Parts) -> Array:
        """Return w."""
        w = np.zeros(self.y.size - self.first)
        for (u, nb, nk, _), b in zip(self.inputs, parts.b, strict=True):
            w += np.convolve(u[self.first - nk - nb + 1 : self.y.size - nk], b, "valid")
        if self.nf:
            start = parts.start[: w.size]
            w[: start.size] += start
            w = np.asarray(lfilter([1.0], parts.f, w))
        return w

    def _equation_error(self, parts: Parts, w: Array) -> Array:
        """Return A y - w - d."""
        y = np.convolve(self.y[self.first - parts.a.size + 1 :], parts.a, "valid")
        return np.asarray(y - w - parts.offset)


def _fill_with_delays(rows: Array, signal: Array, least: int) -> None:
    """Write a signal into each row, one sample later in each than in the row before."""
    for j, row in enumerate(rows):
        delay = least + j
        row[delay:] = signal[: max(signal.size - delay, 0)]


class SeveralRecordings(PolynomialModel):
    """Residuals and their derivatives for recordings that follow each other in ``y`` and ``u``."""

    def __init__(
        self, structure: Structure, y: Array, u: Array, offset: bool, moving: bool, begins: tuple[int, ...]
    ) -> None:
        """Make a model of each recording."""
        super().__init__(structure, y, u, offset, moving)
        self.begins = begins
        self.spans = tuple(slice(b, e) for b, e in zip(begins, ends_of(begins, y.size), strict=True))
        self._models = [PolynomialModel(structure, y[part], u[part], offset, moving) for part in self.spans]
        k, n = len(begins), structure.n_theta
        starts = n + offset * k + np.arange(k * self.nf * moving).reshape(k, -1)
        shared = np.arange(n)
        self._places = [np.concatenate((shared, np.full(int(offset), n + i), starts[i])).astype(int) for i in range(k)]
        self.n = n + k * (offset + self.nf * moving)

    def with_output(self, y: Array) -> SeveralRecordings:
        """Return the same model for other outputs."""
        return SeveralRecordings(self.structure, y, self.u, self.offset, self.moving, self.begins)

    @property
    def pieces(self) -> tuple[tuple[slice, slice], ...]:
        """Which residuals and which samples belong to each recording."""
        return tuple((slice(part.start, part.stop - self.first), part) for part in self.spans)

    @property
    def conditioned(self) -> Any:
        """Which residuals need nothing from before their recording."""
        flags = np.zeros(self.y.size - self.first, dtype=bool)
        for (rows, _), model in zip(self.pieces, self._models, strict=True):
            flags[rows] = model.conditioned
        return flags

    def of(self, i: int, p: Array) -> tuple[PolynomialModel, Array]:
        """Return the model of one recording, and its own free parameters."""
        return self._models[i], p[self._places[i]]

    def residuals(self, p: Array) -> Array:
        """Return the residuals of all recordings."""
        return self._together(lambda model, q: model.residuals(q), p)

    def equation_error(self, p: Array) -> Array:
        """Return A y - w - d of all recordings."""
        return self._together(lambda model, q: model.equation_error(q), p)

    def undisturbed(self, p: Array) -> Array:
        """Return what the inputs and the starts make of B/F."""
        return self._together(lambda model, q: model.undisturbed(q), p)

    def jacobian(self, p: Array) -> Array:
        """Return the derivatives of the residuals by the free parameters, shape (N - first, n)."""
        J = np.zeros((self.y.size - self.first, self.n))
        for i, (rows, _) in enumerate(self.pieces):
            model, q = self.of(i, p)
            J[rows, self._places[i]] = model.jacobian(q)
        return J

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
            q[n : n + len(self.begins)] = p[n]
        return q

    def _together(self, of: Any, p: Array) -> Array:
        """Return a signal of all recordings, 0 where a recording has none yet."""
        signal = np.zeros(self.y.size - self.first)
        for i, (rows, _) in enumerate(self.pieces):
            signal[rows] = of(*self.of(i, p))
        return signal


def ends_of(begins: tuple[int, ...], size: int) -> tuple[int, ...]:
    """Return the sample after the last of each recording."""
    return (*begins[1:], size)
