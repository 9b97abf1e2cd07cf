"""One correction under learnt noise by the kernel, where that serves, and by the definition."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.adaptive import AdaptiveStep, NoiseClasses, correct_adaptively
from robust_filterpy.correction.whitening import Inverse


@lru_cache(maxsize=32)
def _begin(scales: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the scales and what is known before the first sample, as arrays."""
    return np.array(scales), adaptive_noise.start(len(scales))


def corrected(
    means: Array, covariances: Array, probabilities: Array, learnt: Array, z: Array, H: Array, R: Array,
    noise: NoiseClasses, M: Array | None = None, inv: Inverse | None = None,
) -> AdaptiveStep:  # fmt: skip
    """Return what `correct_adaptively` returns."""
    kernels = dispatch.adaptive()
    if kernels is not None and M is None and inv is None and len(learnt) == len(z):
        variances = R.diagonal().copy()
        if np.count_nonzero(R) == np.count_nonzero(variances) == len(z):
            x, P, p, known = (np.array(a, order="C") for a in (means, covariances, probabilities, learnt))
            weights, outlying = np.empty(len(z)), np.empty(len(z))
            log_density = kernels.correct(
                x, P, p, known, dispatch.usable(z), dispatch.usable(H), variances, *_begin(noise.scales), noise.memory,
                noise.r_memory, weights, outlying,
            )  # fmt: skip
            if log_density == log_density:
                return AdaptiveStep(x, P, p, known, log_density, weights, outlying)
    return correct_adaptively(means, covariances, probabilities, learnt, z, H, R, noise, M, inv)
