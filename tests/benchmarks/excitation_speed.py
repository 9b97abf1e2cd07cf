"""Time `receding_horizon_binary` against the steps of section 3.2 as the paper prints them, in one run.

The printed steps recompute every lag sum for every candidate, O(2^m n N^2); they are timed at N = 1000 and scaled to
N = 10000 by (10000/1000)^2, and also by 10000/1000 alone, which favours them.

Run ``python tests/benchmarks/excitation_speed.py``.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from measuring import least_time

from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary

LAGS, HORIZON, LENGTH, LENGTH_PRINTED = 40, 1, 10_000, 1_000


def steps_as_printed(r, length, m):
    """Generate a +-1 signal by steps 1-7, each sum of (54) as one product of slices."""
    n = len(r) - 1
    target = (np.asarray(r) + 1) / 4
    s = np.zeros(length + m - 1)
    for t in range(1, length + 1):
        end = t + m - 1
        best, first = np.inf, 0.0
        for candidate in product((0.0, 1.0), repeat=m):
            s[t - 1 : end] = candidate
            sampled = np.array([s[k:end] @ s[: end - k] if k < end else 0.0 for k in range(n + 1)]) / end
            distance = np.linalg.norm(sampled - target)
            if distance < best * (1 - 1e-12):
                best, first = distance, candidate[0]
        s[t - 1] = first
    return 2 * s[:length] - 1


def main():
    """Print the ratio of durations at equal length."""
    r = bandlimited_pink_autocovariance(0.5, 2.5, LAGS)
    signal, reference = receding_horizon_binary(r, LENGTH, HORIZON), steps_as_printed(r, LENGTH_PRINTED, HORIZON)
    if (signal[:LENGTH_PRINTED] != reference).any():
        raise SystemExit("the two do not give the same signal")
    ours = least_time(lambda: receding_horizon_binary(r, LENGTH, HORIZON))
    printed = least_time(lambda: steps_as_printed(r, LENGTH_PRINTED, HORIZON))
    factor = LENGTH / LENGTH_PRINTED
    print(f"receding_horizon_binary, N={LENGTH}, n={LAGS}, m={HORIZON}: {ours * 1e3:.0f} ms")
    print(f"steps as printed, N={LENGTH_PRINTED}: {printed * 1e3:.0f} ms")
    print(f"ratio, printed steps scaled by N^2: {ours / (printed * factor**2):.5f} (target: below 0.1)")
    print(f"ratio, printed steps scaled by N:   {ours / (printed * factor):.4f}")


if __name__ == "__main__":
    main()
