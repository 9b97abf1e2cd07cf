"""Binary inputs with a prescribed autocovariance: against quadrature, exhaustive search and the steps as printed."""

from itertools import product

import numpy as np
import pytest
from scipy import integrate

from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary

BAND = (0.5, 2.5)


def zero_one_target(r, a, b):
    """Write the non-central autocovariance at {0, 1} from s = (b - a) s01 + a and s01^2 = s01."""
    variance = r[0] / (b - a) ** 2
    # The larger root of mean (1 - mean) = variance.
    mean = np.roots([1.0, -1.0, variance]).real.max()
    return np.asarray(r) / (b - a) ** 2 + mean**2


def lag_sums(s, n):
    """Evaluate the sums of (54) by their definition, with whole numbers."""
    s = np.asarray(s, dtype=int)
    return np.array([s[k:] @ s[: max(len(s) - k, 0)] if k < len(s) else 0 for k in range(n + 1)])


def steps_as_printed(r, length, m, a=-1, b=1):
    """Steps 1-7 of section 3.2, every lag sum computed afresh for every tuple."""
    n = len(r) - 1
    target = zero_one_target(r, a, b)
    chosen = []
    for t in range(1, length + 1):
        best = np.inf
        for candidate in product((0, 1), repeat=m):
            sampled = lag_sums(chosen + list(candidate), n) / (t + m - 1)
            distance = np.linalg.norm(sampled - target)
            if distance < best * (1 - 1e-12):
                best, first = distance, candidate[0]
        chosen.append(first)
    return (b - a) * np.array(chosen) + a


# --- eqs (56) and (57) ---


@pytest.mark.parametrize("band", [BAND, (0.01, np.pi), (1.0, 1.1)])
def test_equation_57_is_the_cosine_integral_of_equation_56(band):
    r = bandlimited_pink_autocovariance(*band, 12)
    for k, found in enumerate(r):
        width = np.log(band[1] / band[0])
        integral, error = integrate.quad(lambda w, k=k, width=width: np.cos(k * w) / (w * width), *band, epsabs=1e-12)
        assert found == pytest.approx(integral, abs=1e-10 + 10 * error)


# --- receding horizon, eqs (54)-(55) ---


@pytest.mark.parametrize(("r", "levels", "m", "length"), [
    (bandlimited_pink_autocovariance(*BAND, 40), (-1, 1), 1, 300), ([1.0], (-1, 1), 3, 40),
    (bandlimited_pink_autocovariance(*BAND, 40), (-1, 1), 3, 150), ([2.0, 0.7, 0.3, 0.1], (-2, 3), 4, 40),
    ([0.25, 0.1, 0.0, -0.1, 0.01], (0, 1), 2, 40), ([1.0, 0.0, 0.0, 0.0], (-1, 1), 7, 40),
    # Many tuples, and a horizon beyond the last lag.
    ([0.6, 0.5, 0.4], (-1, 1), 13, 3),
    # On the edge of the positive semidefinite ones: that of the alternating signal.
    ([(-1.0) ** k for k in range(9)], (-1, 1), 1, 100),
])  # fmt: skip
def test_identical_to_the_steps_as_printed(r, levels, m, length):
    found = receding_horizon_binary(r, length, m, levels)
    np.testing.assert_array_equal(found, steps_as_printed(r, length, m, *levels))


@pytest.mark.parametrize("size", range(1, 13))
def test_a_first_sample_drawn_among_equals_begins_a_best_signal_of_an_exhaustive_search(size):
    r = bandlimited_pink_autocovariance(*BAND, 5)
    target = zero_one_target(r, -1, 1)
    distance = {s: np.linalg.norm(lag_sums(s, 5) / size - target) for s in product((0, 1), repeat=size)}
    least = min(distance.values())
    starts = {2 * s[0] - 1 for s, d in distance.items() if d <= least + 1e-12}
    drawn = {receding_horizon_binary(r, 1, size, rng=seed)[0] for seed in range(30)}
    assert drawn <= starts and (size > 1 or drawn == {-1, 1})


def test_without_rng_the_signal_is_always_the_same_and_with_it_the_seed_decides():
    r = [1.0, 0.0, 0.0, 0.0, 0.0]
    for m in (1, 2):
        np.testing.assert_array_equal(receding_horizon_binary(r, 200, m), receding_horizon_binary(r, 200, m))
        drawn = receding_horizon_binary(r, 200, m, rng=3)
        np.testing.assert_array_equal(drawn, receding_horizon_binary(r, 200, m, rng=np.random.default_rng(3)))
        assert (drawn != receding_horizon_binary(r, 200, m, rng=4)).any()
        assert (drawn != receding_horizon_binary(r, 200, m)).any()
