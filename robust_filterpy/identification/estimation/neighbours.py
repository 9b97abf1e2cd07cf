"""Equations that couple neighbours: solved, and the inverse of their matrix where it couples neighbours too.

A symmetric matrix whose rows are coupled to a few of those after them falls into chains that know nothing of each
other, and each chain into blocks of which one is coupled to the next. The inverse is full within a chain, but near the
diagonal it follows from the blocks alone, from the last to the first (Takahashi, Fagan and Chin 1973). So the work is
linear in the number of rows. Blocks at the same place in their chains are taken together.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["Neighbours"]


class Neighbours:
    """A symmetric matrix G that couples each row to those up to ``reach`` - 1 after it."""

    def __init__(self, band: Array, begins: Any) -> None:
        """Eliminate block after block, from the first of each chain on."""
        self._reach, rows = len(band), np.arange(begins.size)
        place = rows - np.maximum.accumulate(np.where(begins, rows, 0))
        self._slot, self._chain = place % self._reach, np.cumsum(begins)
        self._block = np.cumsum(self._slot == 0) - 1
        turn = place[self._slot == 0] // self._reach
        self._turns = [np.flatnonzero(turn == t) for t in range(int(turn.max()) + 1)]
        # Where a block is not full, the rest of it is a matrix of its own.
        own = np.tile(np.eye(self._reach), (turn.size, 1, 1))
        beside = np.zeros_like(own)
        for d, i, j, within in self._pairs():
            g, a, b, values = self._block[i], self._slot[i], self._slot[j], band[d, i]
            own[g[within], a[within], b[within]] = own[g[within], b[within], a[within]] = values[within]
            beside[g[~within], a[~within], b[~within]] = values[~within]
        self._inverse, self._gain = np.empty_like(own), np.empty_like(own)
        for t, at in enumerate(self._turns):
            if t:
                own[at] -= beside[at - 1].transpose(0, 2, 1) @ self._gain[at - 1]
            self._inverse[at] = np.linalg.inv(own[at])
            self._gain[at] = self._inverse[at] @ beside[at]

    def solve(self, right: Array) -> Array:
        """Return G^-1 times a vector or some columns."""
        x = np.zeros((len(self._inverse), self._reach, right[0].size))
        x[self._block, self._slot] = right.reshape(len(right), -1)
        for at in self._turns[1:]:
            x[at] -= self._gain[at - 1].transpose(0, 2, 1) @ x[at - 1]
        x = self._inverse @ x
        for at in self._turns[:0:-1]:
            x[at - 1] -= self._gain[at - 1] @ x[at]
        return x[self._block, self._slot].reshape(right.shape)

    @property
    def log_det(self) -> float:
        """log |det G|."""
        return -float(np.linalg.slogdet(self._inverse)[1].sum())

    @cached_property
    def inverse(self) -> Array:
        """G^-1[i, i + d] in row d, column i, shape (reach, m); 0 where i + d is in another chain."""
        whole, across = self._inverse.copy(), np.zeros_like(self._inverse)
        for at in self._turns[:0:-1]:
            gain = self._gain[at - 1]
            across[at - 1] = -gain @ whole[at]
            whole[at - 1] -= across[at - 1] @ gain.transpose(0, 2, 1)
        found = np.zeros((self._reach, self._slot.size))
        for d, i, j, within in self._pairs():
            g, a, b = self._block[i], self._slot[i], self._slot[j]
            found[d, i] = np.where(within, whole[g, a, b], across[g, a, b])
        return found

    def _pairs(self) -> Iterator[tuple[int, Any, Any, Any]]:
        """Yield rows of one chain that are d apart, and which of them are in the same block."""
        for d in range(self._reach):
            i = np.flatnonzero(self._chain[d:] == self._chain[: max(self._chain.size - d, 0)])
            yield d, i, i + d, self._block[i + d] == self._block[i]
