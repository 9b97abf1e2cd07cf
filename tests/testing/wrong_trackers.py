"""A right tracker, and wrong ones with one fault each."""

import math

import numpy as np


class LeastSquares:
    """Recursive least squares as a textbook has it, cut into the pieces that can be wrong."""

    def __init__(self, structure):
        n = structure.n_theta
        self.structure = structure
        self.theta, self.P = np.zeros(n), 100.0 * np.eye(n)
        self.R, self.Q = 1.0, np.zeros((n, n))
        self.outputs, self.residuals = [0.0] * (structure.na + structure.nf), [0.0] * structure.nc
        self.inputs = [[0.0] * (nb + nk) for nb, nk in structure.inputs]

    @property
    def std(self):
        return np.sqrt(np.diag(self.P))

    def phi(self, u):
        """The regressor of this sample; u is remembered."""
        for past, value in zip(self.inputs, np.atleast_1d(u), strict=True):
            past.insert(0, float(value))
            past.pop()
        return np.concatenate([self.past(), self.delayed(), np.array(self.residuals)])

    def past(self):
        return -np.array(self.outputs)

    def delayed(self):
        parts = [past[nk : nk + nb] for past, (nb, nk) in zip(self.inputs, self.structure.inputs, strict=True)]
        return np.concatenate([np.zeros(0), *map(np.array, parts)])

    def update(self, y, u):
        phi = self.phi(u)
        self.P = self.spread(self.P)
        predicted = phi @ self.theta
        known = self.is_known(y)
        if known:
            self.learn(phi, y - predicted)
        self.remember(y if known else predicted, phi, known)

    def is_known(self, y):
        return y is not None and not math.isnan(y)

    def spread(self, P):
        return P + self.Q

    def learn(self, phi, innovation):
        S = self.innovation_variance(phi)
        K = self.P @ phi / S
        self.theta = self.moved(self.theta, K, innovation, S)
        self.P = self.shrunk(self.P, K, phi, S, innovation)

    def innovation_variance(self, phi):
        return phi @ self.P @ phi + self.R

    def moved(self, theta, K, innovation, S):
        new = theta + K * innovation
        return self.stabilized(theta, new)

    def stabilized(self, old, new):
        if self.structure.nf:
            for _ in range(30):
                if np.abs(np.roots([1.0, *new[: self.structure.nf]])).max(initial=0.0) < 1.0:
                    return new
                new = old + 0.5 * (new - old)
            return old
        return new

    def shrunk(self, P, K, phi, S, innovation):
        P = P - np.outer(K, phi @ P)
        return (P + P.T) / 2

    def remember(self, y, phi, known):
        after = phi @ self.theta
        if self.outputs:
            self.outputs = [self.kept_output(float(y), after), *self.outputs[:-1]]
        if self.residuals:
            self.residuals = [self.kept_residual(float(y) - after), *self.residuals[:-1]]

    def kept_output(self, y, after):
        return float(after) if self.structure.nf else y

    def kept_residual(self, residual):
        return residual


class SignOfA(LeastSquares):
    """phi = [+y(k-1) ..]."""

    def past(self):
        return np.array(self.outputs)


class InputsOldestFirst(LeastSquares):
    """phi has the oldest input first."""

    def delayed(self):
        return super().delayed()[::-1]


class QForgotten(LeastSquares):
    """Parameters stand still."""

    def spread(self, P):
        return P
