"""Residuals of a state-space model and their derivatives by all entries of its matrices.

    x(k+1) = A x + B u + K w(k) e(k),   yhat = C x + D u + level,   e = y - yhat

w are weights of the residuals, 0 where y is missing: an outlier does not enter the state. The matrices are those of one
basis of the state; the derivatives along a change of basis are 0, and a search by least squares of least length leaves
the basis where it is (McKelvey, Helmersson and Ribarits, Automatica 40, 2004).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

# Derivatives of so many samples at a time.
_CHUNK: Final = 4096


class Matrices(NamedTuple):
    """A state-space model of one recording.

    Attributes
    ----------
    A, B, C, D, K : ndarray
        Its matrices; D and K are 0 where the structure has none.
    start : ndarray, shape (n,)
        State in the first sample.
    level : ndarray, shape (p,)
        What is added to y.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    start: Array
    level: Array


class StateSpaceResiduals:
    """Residuals of recordings of several outputs, one row of y after the other.

    The free parameters are [A, B, C, D if any, K if any, level of each recording, start of each].

    Parameters
    ----------
    n : int
        Number of states.
    recordings : list of (ndarray, shape (N, p); ndarray, shape (N, m))
        y, any number where it is missing, and u.
    feedthrough, disturbance : bool
        Whether there is a D, and a K.
    """

    def __init__(self, n: int, recordings: list[tuple[Array, Array]], feedthrough: bool, disturbance: bool) -> None:
        """Find the place of each matrix among the parameters."""
        self.recordings, self.order = recordings, n
        p, m = recordings[0][0].shape[1], recordings[0][1].shape[1]
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m * feedthrough), "K": (n, p * disturbance)}
        self.shapes, self.places, end = shapes, {}, 0
        for name, (rows, columns) in shapes.items():
            self.places[name] = slice(end, end + rows * columns)
            end += rows * columns
        self.outputs, self.inputs, self.shared = p, m, end
        self.n = end + len(recordings) * (p + n)
        self.weights = [np.ones(y.shape) for y, _ in recordings]

    def matrices(self, q: Array, i: int = -1) -> Matrices:
        """Return the matrices among free parameters, with level and start of one recording.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Free parameters.
        i : int, default -1
            Which recording.

        Returns
        -------
        Matrices
        """
        matrices = {name: q[self.places[name]].reshape(shape) for name, shape in self.shapes.items()}
        if not matrices["D"].size:
            matrices["D"] = np.zeros((self.outputs, self.inputs))
        if not matrices["K"].size:
            matrices["K"] = np.zeros((self.order, self.outputs))
        own = q[self.shared :].reshape(len(self.recordings), -1)[i]
        return Matrices(**matrices, start=own[self.outputs :], level=own[: self.outputs])

    def packed(self, matrices: Matrices, levels: Array, starts: Array) -> Array:
        """Return free parameters.

        Parameters
        ----------
        matrices : Matrices
            Common to all recordings.
        levels : ndarray, shape (n_recordings, p)
            Of each.
        starts : ndarray, shape (n_recordings, n)
            Of each.

        Returns
        -------
        ndarray, shape (n,)
        """
        parts = [getattr(matrices, name).ravel() for name, (r, c) in self.shapes.items() if r * c]
        return np.concatenate((*parts, np.column_stack((levels, starts)).ravel()))

    def is_stable(self, q: Array) -> bool:
        """Tell whether the prediction is stable; without disturbance it is the model."""
        one = self.matrices(q)
        return bool(np.abs(np.linalg.eigvals(one.A - one.K @ one.C)).max(initial=0.0) < 1.0)

    def residuals(self, q: Array) -> Array:
        """Return e of all recordings, shape (sum of N p,)."""
        return np.concatenate([self._own(q, i)[1].ravel() for i in range(len(self.recordings))])

    def jacobian(self, q: Array) -> Array:
        """Return the derivatives of the residuals, shape (sum of N p, n)."""
        return np.concatenate([self._derivatives(q, i) for i in range(len(self.recordings))])

    def states(self, q: Array, i: int) -> Array:
        """Return the states of a recording, one after the last sample too.

        Parameters
        ----------
        q : ndarray, shape (n,)
            Free parameters.
        i : int
            Which recording.

        Returns
        -------
        ndarray, shape (N + 1, n)
        """
        return self._own(q, i)[0]

    def _own(self, q: Array, i: int) -> tuple[Array, Array]:
        """Return states and residuals of a recording."""
        one, (y, u) = self.matrices(q, i), self.recordings[i]
        x, states = one.start, np.empty((len(y) + 1, self.order))
        forcing, measured = u @ one.B.T, y - u @ one.D.T - one.level
        with np.errstate(over="ignore", invalid="ignore"):
            if one.K.any():
                weights = self.weights[i]
                for k in range(len(y)):
                    states[k] = x
                    x = one.A @ x + forcing[k] + one.K @ (weights[k] * (measured[k] - one.C @ x))
            else:
                for k in range(len(y)):
                    states[k] = x
                    x = one.A @ x + forcing[k]
            states[-1] = x
            return states, measured - states[:-1] @ one.C.T

    def _derivatives(self, q: Array, i: int) -> Array:
        """Return the derivatives of the residuals of a recording."""
        one, (y, u) = self.matrices(q, i), self.recordings[i]
        states, e = self._own(q, i)
        n, p, columns = self.order, self.outputs, self._columns(i)
        S = np.zeros((n, columns.size))
        S[:, -n:] = np.eye(n)
        weighted = self.weights[i] * e
        J = np.zeros((len(y), p, self.n))
        for start in range(0, len(y), _CHUNK):
            part = slice(start, min(start + _CHUNK, len(y)))
            direct = self._direct(states[:-1][part], u[part])
            forced = self._forced(states[:-1][part], u[part], weighted[part])
            moved = np.empty((len(direct), n, columns.size))
            for k in range(len(direct)):
                moved[k] = S
                S = one.A @ S + forced[k]
                if one.K.any():
                    gain = one.K * self.weights[i][part][k]
                    S = S - gain @ (one.C @ moved[k] + direct[k])
            J[part][:, :, columns] = -(one.C @ moved + direct)
        return J.reshape(-1, self.n)

    def _columns(self, i: int) -> Any:
        """Return which free parameters a recording depends on."""
        own = self.shared + i * (self.outputs + self.order)
        return np.concatenate((np.arange(self.shared), np.arange(own, own + self.outputs + self.order)))

    def _direct(self, x: Array, u: Array) -> Array:
        """Return what the parameters do to yhat at once, shape (N, p, columns)."""
        p, n, m = self.outputs, self.order, self.inputs
        direct = np.zeros((len(x), p, self.shared + p + n))
        for j in range(p):
            direct[:, j, self.places["C"].start + n * j + np.arange(n)] = x
            if self.shapes["D"][1]:
                direct[:, j, self.places["D"].start + m * j + np.arange(m)] = u
            direct[:, j, self.shared + j] = 1.0
        return direct

    def _forced(self, x: Array, u: Array, e: Array) -> Array:
        """Return what they do to the next state, shape (N, n, columns)."""
        n, m, p = self.order, self.inputs, self.outputs
        forced = np.zeros((len(x), n, self.shared + p + n))
        for j in range(n):
            forced[:, j, self.places["A"].start + n * j + np.arange(n)] = x
            forced[:, j, self.places["B"].start + m * j + np.arange(m)] = u
            if self.shapes["K"][1]:
                forced[:, j, self.places["K"].start + p * j + np.arange(p)] = e
        return forced
