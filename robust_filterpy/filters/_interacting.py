"""Copies of a filter that differ in how large they take the process noise to be (interacting multiple models)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import require_finite_prediction, state_of
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.merging import collapse
from robust_filterpy.filters._hypotheses import MultipleHypothesisFilter


class Bank(NamedTuple):
    """The copies, and the x and P merged from them."""

    means: Array
    """Shape (q, n)."""
    covariances: Array
    """Shape (q, n, n)."""
    probabilities: Array
    """Shape (q,)."""
    x: Array
    """Shape (n,)."""
    P: Array
    """Shape (n, n)."""


class InteractingFilter(MultipleHypothesisFilter):
    """Run copies with process noise scale Q; from one step to the next the scale stays with probability 1 - 1/dwell.

    A subclass's `_corrected` takes the copies from `_current` and sets ``_found`` to the log-likelihood, the corrected
    `Bank`, and what else `_settle` is to take over.
    """

    def _set_copies(self, process_scales: Sequence[float], dwell: float) -> None:
        """Check the scales and put all copies at x, P; called at the end of the constructor."""
        scales = _checks.numbers("process_scales", process_scales)
        if scales.ndim != 1 or not scales.size or not (np.isfinite(scales) & (scales > 0.0)).all():
            raise ValueError(f"process_scales: expected one or more finite numbers > 0, got {process_scales!r}")
        if not _checks.positive("dwell", dwell) > 1.0:
            raise ValueError(f"dwell: expected a number of steps > 1, got {dwell!r}")
        self._scales, self._dwell = scales.copy(), float(dwell)
        # The ordinary scale is where a process starts, the others have the chance of one change.
        probabilities = np.full(scales.size, 1.0 / dwell)
        probabilities[0] = 1.0
        self._keep_copies(self._copies(probabilities / probabilities.sum()))
        self._found = (None,)

    @property
    def process_scales(self) -> Array:
        """Factors of Q, shape (q,)."""
        return self._scales.copy()

    @property
    def dwell(self) -> float:
        """Mean number of steps that the process keeps a scale."""
        return self._dwell

    @property
    def process_probabilities(self) -> Array:
        """Probability of each process scale, shape (q,)."""
        return self._shares.copy()

    @property
    def process_scale(self) -> float:
        """Mean factor of Q, over the copies."""
        return float(self._shares @ self._scales)

    def predict(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> None:
        """Predict the next state with every process scale.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar, optional
            Control input.
        B : array_like, shape (dim_x, dim_u), optional
            Control matrix for this call.
        F : array_like, shape (dim_x, dim_x), optional
            Transition matrix for this call.
        Q : array_like, shape (dim_x, dim_x), or scalar, optional
            Process noise covariance for this call; a scalar here means Q I.

        Raises
        ------
        ValueError
            If a shape does not fit; nothing has changed then.
        """
        self._take_over(self._advanced(u, B, F, Q))
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def _predicted(self, u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array]:
        """Return the predicted mean, in the shape of x, and covariance."""
        bank = self._advanced(u, B, F, Q)
        return bank.x.reshape(np.shape(self.x)), bank.P

    def _advanced(self, u: Any, B: Any, F: Any, Q: Any) -> Bank:
        """Return the copies after a prediction: mixed as the scale may have changed, then moved."""
        x, _ = state_of(self)
        F, noise, Bu = self._transition(x.shape, u, B, F, Q)
        bank = self._current()
        q, n = bank.means.shape
        Bu = np.zeros(n) if Bu is None else Bu.ravel()
        stay = 1.0 - 1.0 / self._dwell if q > 1 else 1.0
        kernels = dispatch.adaptive()
        if kernels is not None:
            advanced = Bank(*(a.copy() for a in bank))
            fine = kernels.advance(
                *advanced, dispatch.usable(F), dispatch.usable(noise), dispatch.usable(Bu), self._scales, stay,
                self._alpha_sq,
            )  # fmt: skip
            if not fine:
                require_finite_prediction(advanced.x, advanced.P)
            return advanced
        moves = np.full((q, q), (1.0 - stay) / max(q - 1, 1))
        np.fill_diagonal(moves, stay)
        probabilities = bank.probabilities @ moves
        # Row j: where copy j starts from.
        origin = (bank.probabilities[:, None] * moves / probabilities).T
        mixed, P = collapse(origin, bank.means[None], bank.covariances[None])
        covariances = self._alpha_sq * (F @ P @ F.T) + self._scales[:, None, None] * noise
        # B u moves every copy as it moves the mean.
        advanced = merged_bank(F.dot(bank.x) + Bu + (mixed - bank.x) @ F.T, covariances, probabilities)
        require_finite_prediction(advanced.x, advanced.P)
        return advanced

    def _settle(self) -> None:
        """Take over the corrected copies."""
        self._take_over(self._found[1])
        self._found = (self._found[0],)

    def _skip(self) -> None:
        """Leave the copies as they are."""
        self._found = (None,)
        super()._skip()

    def _moving(self) -> dict[str, Any]:
        """Return x, P and the copies."""
        bank = self._current()
        copies = {"means": bank.means, "covariances": bank.covariances, "shares": bank.probabilities}
        return {**super()._moving(), **copies}

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of x, P and the copies."""
        q, n = len(self._scales), self.dim_x
        return {**super()._needed(), "means": (q, n), "covariances": (q, n, n), "shares": (q,)}

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state, if its probabilities are some."""
        shares = found["shares"]
        if (shares < 0.0).any() or not np.isclose(shares.sum(), 1.0):
            raise ValueError(f"state: expected shares >= 0 that sum to 1, got {shares}")
        super()._go_on(found)
        x, P = state_of(self)
        self._keep_copies(Bank(found["means"], found["covariances"], found["shares"], x.ravel().copy(), P.copy()))
        self._found = (None,)

    def _take_over(self, bank: Bank) -> None:
        """Make these the copies, and x and P what they merge to."""
        self.x, self.P = bank.x.reshape(np.shape(self.x)).copy(), bank.P.copy()
        self._keep_copies(bank)

    def _keep_copies(self, bank: Bank) -> None:
        """Store the copies as plain arrays, which filterpy's Saver can stack."""
        self._means, self._covariances, self._shares, self._merged_x, self._merged_P = bank

    def _current(self) -> Bank:
        """Return the copies; all of them at x, P if these have been assigned from outside."""
        x, P = state_of(self)
        if x.tobytes() == self._merged_x.tobytes() and P.tobytes() == self._merged_P.tobytes():
            return Bank(self._means, self._covariances, self._shares, self._merged_x, self._merged_P)
        return self._copies(self._shares)

    def _copies(self, probabilities: Array) -> Bank:
        """Return copies that are all at x, P."""
        x, P = state_of(self)
        q = len(probabilities)
        return Bank(np.tile(x.ravel(), (q, 1)), np.tile(P, (q, 1, 1)), probabilities, x.ravel().copy(), P.copy())


def merged_bank(means: Array, covariances: Array, probabilities: Array) -> Bank:
    """Return copies together with their overall mean and covariance."""
    kernels = dispatch.adaptive()
    if kernels is not None:
        x, P = np.empty(means.shape[1]), np.empty(covariances.shape[1:])
        kernels.merge(means, covariances, probabilities, x, P)
        return Bank(means, covariances, probabilities, x, P)
    return Bank(means, covariances, probabilities, *collapse(probabilities, means, covariances))
