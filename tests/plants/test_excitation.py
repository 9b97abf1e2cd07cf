"""Binary inputs with a prescribed autocovariance: against quadrature, exhaustive search and the steps as printed."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from statsmodels.tsa.stattools import acovf

from robust_filterpy.plants.excitation import (
    bandlimited_pink_autocovariance,
    bandlimited_pink_spectrum,
    prbs,
    receding_horizon_binary,
    sample_autocovariance,
)

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
        integral, error = integrate.quad(
            lambda w, k=k: float(bandlimited_pink_spectrum(w, *band)) * np.cos(k * w), *band, epsabs=1e-12
        )
        assert found == pytest.approx(integral, abs=1e-10 + 10 * error)


def test_equation_56_is_one_over_f_of_unit_variance_and_zero_outside_the_band():
    w = np.linspace(0, np.pi, 200_001)
    spectrum = bandlimited_pink_spectrum(w, *BAND)
    assert integrate.trapezoid(spectrum, w) == pytest.approx(1.0, abs=1e-4)
    inside = (w >= BAND[0]) & (w <= BAND[1])
    assert not spectrum[~inside].any() and (spectrum[inside] > 0).all() and np.ptp((spectrum * w)[inside]) < 1e-12
    assert bandlimited_pink_spectrum([0.0, -1.0], *BAND).tolist() == [0.0, 0.0]


# --- sample autocovariance, eq (54) ---


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.data())
def test_sample_autocovariance_equals_statsmodels(seed, size, data):
    s = np.random.default_rng(seed).normal(3.0, 2.0, size)
    lags = data.draw(st.integers(0, size - 1))
    for mean, demean in ((None, True), (0, False)):
        expected = acovf(s, demean=demean, fft=False, nlag=lags)
        np.testing.assert_allclose(sample_autocovariance(s, lags, mean=mean), expected, atol=1e-12)
    np.testing.assert_allclose(sample_autocovariance(s, lags, mean=3), sample_autocovariance(s - 3, lags, mean=0))


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


# --- pseudo-random binary sequence ---


@pytest.mark.parametrize("n_bits", range(2, 12))
def test_one_period_of_prbs_is_as_good_as_white(n_bits):
    period = 2**n_bits - 1
    s = prbs(period, n_bits=n_bits)
    for k in range(1, min(period, 8)):
        assert s @ np.roll(s, k) == -1
    assert s.sum() == 1
    np.testing.assert_array_equal(prbs(2 * period, n_bits=n_bits), np.tile(s, 2))


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 500), st.integers(1, 20), st.integers(0, 10**6))
def test_prbs_holds_its_levels_and_its_values(length, hold, seed):
    s = prbs(length, (2, 5), hold=hold, rng=seed)
    assert s.shape == (length,)
    assert set(s) <= {2.0, 5.0}
    assert not np.diff(s)[np.arange(1, length) % hold != 0].any()


def test_the_default_register_does_not_repeat():
    s = prbs(1000)
    assert all((s[lag:] != s[:-lag]).any() for lag in range(1, 500))


def test_prbs_from_another_state_is_the_same_cycle_shifted():
    s, t = prbs(31), prbs(31, rng=2)
    assert any((np.roll(s, k) == t).all() for k in range(31))
    assert (s != t).any()
    np.testing.assert_array_equal(t, prbs(31, rng=2))
