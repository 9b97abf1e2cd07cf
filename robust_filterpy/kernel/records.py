"""What goes into the kernel over series and comes out of it."""

from __future__ import annotations

from typing import NamedTuple

from robust_filterpy._checks import Array


class Model(NamedTuple):
    """Matrices with the axes (series, step) in front, of length 1 where one serves all."""

    F: Array
    Q: Array
    H: Array
    R: Array
    Bu: Array
    """(series, step, n)"""


class Output(NamedTuple):
    """What a run writes into: arrays over (series, kept step, ..), of length 0 where nothing is wanted."""

    means: Array
    covariances: Array
    """(.., n, n), or (.., 1, n) for the diagonals."""
    means_p: Array
    """Predicted, as covariances_p."""
    covariances_p: Array
    weights: Array
    log_likelihood: Array
    """(series,)"""


class State(NamedTuple):
    """Where one recording stands; arrays that a run changes in place. Under psi x, P and learnt alone move."""

    means: Array
    """(q, n)"""
    covariances: Array
    """(q, n, n)"""
    belief: Array
    """(q + 2, n)"""
    learnt: Array
    """(m, ..)"""
    x: Array
    """Mean of all, (n,)."""
    P: Array
    """Its covariance, (n, n)."""


class Kept(NamedTuple):
    """What a run writes into, a row for each kept step; None where nothing is wanted."""

    means: Array | None = None
    covariances: Array | None = None
    """(rows, n n) or, for the diagonals, (rows, n); as covariances_p."""
    means_p: Array | None = None
    covariances_p: Array | None = None
    weights: Array | None = None
    outlying: Array | None = None
    """(rows, m), as weights."""
    scale: Array | None = None
    """(rows, n)"""
    log_likelihood: Array | None = None
    """(1,), added to."""
