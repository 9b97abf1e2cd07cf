"""Filters that learn their noise, a step or a recording at a time: by the kernel, where that serves."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.compiled.records import Copies, Noise, Output
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.adaptive import NoiseClasses, correct_adaptively
from robust_filterpy.correction.whitening import Inverse
from robust_filterpy.filters._hypotheses import finite_product
from robust_filterpy.filters._interacting import Bank, merged_bank
from robust_filterpy.filters._recording import CompiledLoop


class Corrected(NamedTuple):
    """The filters and the noise after a correction, and what has become of each component."""

    bank: Bank
    learnt: Array
    """What is known of the noise, shape (g, ...)."""
    log_density: float
    """log p(z)."""
    weights: Array
    """Expected precision of each component over that of ordinary noise, NaN where it tells nothing, shape (m,)."""
    outlying: Array
    """Probability that each component was an outlier, 0 where it tells nothing, shape (m,)."""


@lru_cache(maxsize=32)
def _told(scales: tuple[float, ...], memory: float, r_memory: float) -> Noise:
    """Return what the kernel is told of measurement noise; a correction looks at nothing else."""
    return Noise(np.ones(1), 1.0, np.array(scales), adaptive_noise.start(len(scales)), memory, r_memory)


def told(noise: NoiseClasses, process_scales: Array, dwell: float) -> Noise:
    """Return what the kernel is told of the noises."""
    stay = 1.0 - 1.0 / dwell if len(process_scales) > 1 else 1.0
    classes = _told(noise.scales, noise.memory, noise.r_memory)  # type: ignore[arg-type]
    return classes._replace(process_scales=process_scales, stay=stay)


def corrected(
    bank: Bank, learnt: Array, z: Array, H: Array, R: Array, noise: NoiseClasses, M: Array | None = None,
    inv: Inverse | None = None,
) -> Corrected | None:  # fmt: skip
    """Return what `correct_adaptively` makes of the components that tell something; None if none does.

    z is NaN where missing; learnt has a row for each sensor, or one.
    """
    kernels = dispatch.adaptive()
    if kernels is not None and M is None and inv is None and noise.grouping == "component":
        known, weights, outlying = learnt.copy(), np.empty(len(z)), np.empty(len(z))
        means, covariances, probabilities, x, P = (a.copy() for a in bank)
        count, log_density = kernels.correct(
            means, covariances, probabilities, known, x, P, dispatch.usable(z), dispatch.usable(H), dispatch.usable(R),
            *_told(noise.scales, noise.memory, noise.r_memory)[2:], weights, outlying,  # type: ignore[arg-type]
        )  # fmt: skip
        if count > 0:
            return Corrected(Bank(means, covariances, probabilities, x, P), known, log_density, weights, outlying)
        if count == 0:
            return None
    # What H does not see says nothing about the state, and nothing is learnt from it.
    part = np.flatnonzero(~np.isnan(z - finite_product(H, bank.x)) & H.any(axis=1))
    if part.size == 0:
        return None
    rows = part if noise.grouping == "component" else np.zeros(1, dtype=int)
    step = correct_adaptively(
        *bank[:3], learnt[rows], z[part], H[part], R[np.ix_(part, part)], noise, None if M is None else M[:, part], inv
    )
    learnt, weights, outlying = learnt.copy(), np.full(len(z), np.nan), np.zeros(len(z))
    learnt[rows], weights[part], outlying[part] = step.learnt, step.weights, step.outlier_probabilities
    return Corrected(merged_bank(*step[:3]), learnt, step.log_density, weights, outlying)


class AdaptiveLoop(CompiledLoop):
    """Steps of an `AdaptiveKalmanFilter` by the kernel."""

    def __init__(self, kf: Any, process_scale: list[float]) -> None:
        """Keep the filter, and where the mean factor of Q of each step is noted."""
        super().__init__(kf)
        self._process_scale = process_scale

    def _serves(self, n: int, m: int, steps: int) -> bool:
        """Return whether the kernel serves so many states, sensors and steps."""
        self._size = dispatch.adaptive_size(n, m, steps)
        return self._size is not None

    def prepare(
        self, zs: Any, Fs: Any, Qs: Any, Hs: Any, Rs: Any, Bs: Any, us: Any, kept: Output, update_first: bool
    ) -> bool:
        """Return whether the kernel serves a recording; if not, the call is for the filter's own methods."""
        if not (super().prepare(zs, Fs, Qs, Hs, Rs, Bs, us, kept, update_first) and uncorrelated(self._model.R)):
            return False
        # To this kernel an infinite measurement is a wild one.
        if np.isinf(self._zs).any():
            return False
        shape = self._zs.shape
        self._kept, self._outlying = kept._replace(weights=np.empty(shape)), np.empty(shape[:2])
        self._scale = np.empty(shape[:2])
        return True

    def _run(self, k: int, last: int) -> int:
        """Take steps from k to last - 1 as far as the kernel can, and return the next."""
        kf, m = self._kf, self._zs.shape[2]
        bank, learnt = kf._current(), kf._known(m)
        arrays = (bank.means, bank.covariances, bank.probabilities, learnt[:m], bank.x, bank.P)
        series = Copies(*(a[None].copy() for a in arrays))
        taken = int(
            dispatch.adaptive_series(
                self._size, self._zs[:, :last], self._model, series, told(kf._classes, kf._scales, kf._dwell),  # type: ignore[arg-type]
                self._kept, self._outlying, self._scale, start=k, **self._options,
            )[0]
        )  # fmt: skip
        if taken > k:
            means, covariances, probabilities, known, x, P = (a[0] for a in series)
            # What else a step leaves in the filter, the filter's own next step sets anew.
            kf._take_over(Bank(means, covariances, probabilities, x, P))
            kf._learnt = np.concatenate([known, learnt[m:]])
            self._process_scale.extend(self._scale[0, k:taken].tolist())
        return taken


def uncorrelated(R: Array) -> bool:
    """Return whether every matrix of a stack is diagonal and positive definite, as the kernel needs it."""
    variances = np.diagonal(R, axis1=-2, axis2=-1)
    return bool((variances > 0.0).all() and np.count_nonzero(R) == variances.size)
