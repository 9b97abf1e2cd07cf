"""Copies of a filter that differ in how large they take the process noise to be (interacting multiple models)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._arrays import require_finite_prediction, state_of
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction.copies import Copies, Scales, collapse
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
    unseen: float = 0.0
    """Chance that the state has jumped since the last measurement."""

    @property
    def copies(self) -> Copies:
        """The copies alone."""
        return Copies(self.means, self.covariances, self.probabilities, self.unseen)


class InteractingFilter(MultipleHypothesisFilter):
    """Run copies with process noise scale Q; from one step to the next the scale stays with probability 1 - 1/dwell.

    A subclass's `_corrected` takes the copies from `_current` and sets ``_found`` to the log-likelihood, the corrected
    `Bank`, and what else `_settle` is to take over.
    """

    def _set_copies(self, process_scales: Sequence[float], dwell: float, jump: float = 0.0) -> None:
        """Check the scales and put all copies at x, P; called at the end of the constructor."""
        self._process = Scales(process_scales, dwell, jump)
        x, P = state_of(self)
        self._keep_copies(self._bank(side_by_side.start(x.ravel(), P, self._process)))
        self._found = (None,)

    @property
    def process_scales(self) -> Array:
        """Factors of Q, shape (q,)."""
        return np.array(self._process.scales)

    @property
    def dwell(self) -> float:
        """Mean number of steps that the process keeps a scale."""
        return self._process.dwell

    @property
    def process_probabilities(self) -> Array:
        """Probability of each process scale, shape (q,)."""
        shares = self._shares[: len(self._process.scales)]
        return np.asarray(shares / shares.sum())

    @property
    def process_scale(self) -> float:
        """Mean factor of Q, over the copies."""
        return float(self.process_probabilities @ self._process.scales)

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
        moved = side_by_side.predict(
            self._current().copies, F, noise, self._process, None if Bu is None else Bu.ravel(), self._alpha_sq
        )
        advanced = self._bank(moved)
        require_finite_prediction(advanced.x, advanced.P)
        return advanced

    def _bank(self, copies: Copies) -> Bank:
        """Return copies together with what they merge to."""
        return Bank(*copies[:3], *side_by_side.merged(copies, self._process), copies.unseen)

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
        copies["unseen"] = np.array(bank.unseen)
        return {**super()._moving(), **copies}

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of x, P and the copies."""
        q, n = self._process.count, self.dim_x
        return {**super()._needed(), "means": (q, n), "covariances": (q, n, n), "shares": (q,), "unseen": ()}

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state, if its probabilities are some."""
        shares = found["shares"]
        if (shares < 0.0).any() or not np.isclose(shares.sum(), 1.0):
            raise ValueError(f"state: expected shares >= 0 that sum to 1, got {shares}")
        unseen = float(found["unseen"])
        if not 0.0 <= unseen <= 1.0:
            raise ValueError(f"state: expected unseen in [0, 1], got {unseen}")
        super()._go_on(found)
        x, P = state_of(self)
        self._keep_copies(Bank(found["means"], found["covariances"], shares, x.ravel().copy(), P.copy(), unseen))
        self._found = (None,)

    def _take_over(self, bank: Bank) -> None:
        """Make these the copies, and x and P what they merge to."""
        self.x, self.P = bank.x.reshape(np.shape(self.x)).copy(), bank.P.copy()
        self._keep_copies(bank)

    def _keep_copies(self, bank: Bank) -> None:
        """Store the copies as plain arrays, which filterpy's Saver can stack."""
        self._means, self._covariances, self._shares, self._merged_x, self._merged_P, self._unseen = bank

    def _current(self) -> Bank:
        """Return the copies; all of them at x, P if these have been assigned from outside."""
        x, P = state_of(self)
        if x.tobytes() == self._merged_x.tobytes() and P.tobytes() == self._merged_P.tobytes():
            return Bank(self._means, self._covariances, self._shares, self._merged_x, self._merged_P, self._unseen)
        q, shares, scales = len(self._shares), self._shares.copy(), len(self._process.scales)
        if q > scales:
            # Where the program puts the state there is no candidate.
            shares[scales:] = 0.0
            shares /= shares.sum()
        x, P = x.ravel().copy(), P.copy()
        return Bank(np.tile(x, (q, 1)), np.tile(P, (q, 1, 1)), shares, x, P, self._unseen)


def merged_bank(means: Array, covariances: Array, probabilities: Array) -> Bank:
    """Return copies together with their overall mean and covariance."""
    return Bank(means, covariances, probabilities, *collapse(probabilities, means, covariances))
