"""Figures 5-7: band-limited 1/f noise, and a binary signal that has nearly its autocovariance (54)-(57)."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import scipy.signal
from report import Claim, Options, Part, markdown_table

from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary

BAND = (0.5, 2.5)
LAGS, LENGTH = 40, 10_000
HORIZONS, LAG_COUNTS = (1, 2, 3, 5), (20, 40, 80)


def binary_input(length: int = LENGTH, rng: np.random.Generator | None = None) -> np.ndarray:
    """Design the paper's input: +-1, band 0.5 .. 2.5 rad/sample, n = 40, m = 1."""
    return receding_horizon_binary(bandlimited_pink_autocovariance(*BAND, LAGS), length, rng=rng)


def sample_autocovariance(s: np.ndarray, lags: int) -> np.ndarray:
    """Return the autocovariance of a signal about its mean, lags 0 .. lags."""
    s = s - s.mean()
    return np.array([s[k:] @ s[: s.size - k] for k in range(lags + 1)]) / s.size


def discrepancy(lags: int, horizon: int, rng: int | None = None) -> float:
    """Return the root-mean-square error of lags 0..40 of a signal designed with n lags and m samples ahead."""
    s = receding_horizon_binary(bandlimited_pink_autocovariance(*BAND, lags), LENGTH, horizon, rng=rng)
    common = min(lags, LAGS)
    error = sample_autocovariance(s, common) - bandlimited_pink_autocovariance(*BAND, common)
    return float(np.sqrt(np.mean(error**2)))


def make(options: Options) -> Part:
    """Draw figures 5-7 and test what the paper says of them."""
    part = Part("Figures 5-7: the input signal")
    s = binary_input()
    if options.wants(5):
        part.save(spectrum_figure(s), "fig05.png", "The ideal spectrum (56) and that of the binary signal.", options)
    if options.wants(6):
        caption = "Desired autocovariance (57), and that of the binary signal; N = 10000, n = 40, m = 1."
        part.save(autocovariance_figure(s), "fig06.png", caption, options)
    if options.wants(7):
        part.save(sequence_figure(s), "fig07.png", "The first 200 samples of the binary signal.", options)
    if options.wants(6):
        table = {(n, m): discrepancy(n, m) for n in LAG_COUNTS for m in HORIZONS}
        rows = [[f"n = {n}", *(f"{table[n, m]:.4f}" for m in HORIZONS)] for n in LAG_COUNTS]
        part.text.append(
            f"Root-mean-square discrepancy of the autocovariance over lags 0 to min(n, 40), N = {LENGTH}:\n\n"
            + markdown_table(["", *(f"m = {m}" for m in HORIZONS)], rows)
        )
        desired = bandlimited_pink_autocovariance(*BAND, LAGS)[1:]
        share = table[LAGS, 1] / float(np.sqrt(np.mean(desired**2)))
        part.claims.append(
            Claim(
                "6",
                "The algorithm makes a binary signal with nearly the autocovariance (57).",
                "root-mean-square discrepancy at m = 1, n = 40 at most a tenth of the desired autocovariance's size",
                f"{share:.3f} (deterministic: no interval)",
                share <= 0.1,
                "No binary signal has exactly this spectrum.",
            )
        )
        base, best = table[LAGS, 1], min(table[n, m] for n in LAG_COUNTS if n >= LAGS for m in HORIZONS)
        part.claims.append(
            Claim(
                "6",
                "The discrepancies do not shrink with larger m and n.",
                "no (m, n) with n >= 40 has less than 0.8 of the discrepancy of m = 1, n = 40",
                f"{base:.4f} at m = 1, n = 40; least {best:.4f} = {best / base:.2f} of it (deterministic: no interval)",
                best >= 0.8 * base,
                "A longer horizon or more lags find a better signal.",
            )
        )
    return part


def spectrum_figure(s: np.ndarray) -> plt.Figure:
    """Draw figure 5, with the signal's own spectrum beside the ideal one."""
    figure, axis = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    w = np.linspace(1e-3, np.pi, 2000)
    ideal = np.where((w >= BAND[0]) & (w <= BAND[1]), 1.0 / (w * np.log(BAND[1] / BAND[0])), 0.0)
    f, density = scipy.signal.welch(s, nperseg=512)
    # welch's density is over cycles per sample, the paper's over radians per sample.
    axis.plot(2 * np.pi * f, density / (2 * np.pi), color="0.6", linewidth=1.2, label="binary signal (Welch)")
    axis.plot(w, ideal, color="black", linewidth=2, label="ideal, eq (56)")
    axis.set(xlabel="angular frequency / (rad/sample)", ylabel="density / (1/(rad/sample))", xlim=(0, np.pi))
    axis.set_title("Band-limited 1/f noise, 0.5 to 2.5 rad/sample")
    axis.legend()
    return figure


def autocovariance_figure(s: np.ndarray) -> plt.Figure:
    """Draw figure 6."""
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(6.4, 4.8), height_ratios=(2, 1), sharex=True, layout="constrained"
    )
    desired, achieved = bandlimited_pink_autocovariance(*BAND, LAGS), sample_autocovariance(s, LAGS)
    k = np.arange(LAGS + 1)
    top.plot(k, desired, "o", color="black", markerfacecolor="none", label="desired, eq (57)")
    top.plot(k, achieved, "-x", color="0.45", linewidth=1, label="achieved")
    top.set(ylabel="autocovariance", title="Receding-horizon binary signal, m = 1, n = 40, N = 10000")
    top.legend()
    bottom.stem(k, achieved - desired, linefmt="k-", markerfmt="k.", basefmt="k-")
    bottom.set(xlabel="lag k / samples", ylabel="achieved - desired")
    return figure


def sequence_figure(s: np.ndarray) -> plt.Figure:
    """Draw figure 7."""
    figure, axis = plt.subplots(figsize=(6.4, 2.6), layout="constrained")
    axis.step(np.arange(200), s[:200], where="post", color="black", linewidth=1, label="s(k)")
    axis.set(xlabel="sample k", ylabel="s(k)", ylim=(-1.3, 1.6), yticks=(-1, 1))
    axis.legend(loc="upper right")
    axis.set_title("Binary input, first 200 of 10000 samples")
    return figure
