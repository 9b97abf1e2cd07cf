"""Time `TrackerBank`, per tracker and sample, against a loop over `ParameterTracker.update`, in one run.

Run ``python -m tests.benchmarks.bank_speed`` (or the file itself). That the numbers agree is checked first. The target
is a ratio of at most 0.1 with 1000 OutputError(4, 4) trackers. With ROBUST_FILTERPY_KERNEL=off in the environment both
run by the definition.
The second table shows how the ratio depends on the number of trackers.
"""

from __future__ import annotations

import time

import numpy as np

from robust_filterpy.identification import ARX, OutputError, ParameterTracker, TrackerBank

TARGET, SAMPLES, ROUNDS, ALONE = 0.1, 60, 7, 10
CASES = {
    "OE(4,4), filtered": (OutputError(4, 4), {"Q": 1e-6}),
    "OE(4,4), pseudolinear": (OutputError(4, 4), {"Q": 1e-6, "gradient": "pseudolinear"}),
    "OE(4,4), forgetting": (OutputError(4, 4), {"forgetting": 0.99}),
    "ARX(4,4), filtered": (ARX(4, 4), {"Q": 1e-6}),
}
SIZES = (1, 10, 100, 1000, 10_000)


def recordings(n, rng):
    """Return y and u, shape (SAMPLES, n): second-order plants, one reading in ten wrong, one in ten missing."""
    u = rng.choice([-1.0, 1.0], (SAMPLES, n))
    y = np.zeros((SAMPLES, n))
    for k in range(2, SAMPLES):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2]
    y += rng.normal(size=y.shape) * np.where(rng.random(y.shape) < 0.1, 5.0, 0.5)
    y[rng.random(y.shape) < 0.1] = np.nan
    return y, u


def duration(advance):
    """Return how long a call takes, in s."""
    start = time.perf_counter()
    advance()
    return time.perf_counter() - start


def measured(structure, options, n, rng):
    """Return s per tracker and sample of the bank and of the loop, after a check that they agree."""
    options = {"P": 1.0, "R": 0.25, **options}
    y, u = recordings(n, rng)
    alone = min(n, ALONE)

    def by_bank():
        bank = TrackerBank(n, structure, **options)
        for k in range(SAMPLES):
            bank.update(y[k], u[k])
        return bank.theta

    def by_loop():
        trackers = [ParameterTracker(structure, **options) for _ in range(alone)]
        for k in range(SAMPLES):
            for i, tracker in enumerate(trackers):
                tracker.update(y[k, i], u[k, i])
        return np.array([tracker.theta for tracker in trackers])

    np.testing.assert_allclose(by_bank()[:alone], by_loop(), rtol=1e-9, atol=1e-9)
    rounds = ROUNDS if n <= 1000 else 2
    times = np.array([(duration(by_bank) / n, duration(by_loop) / alone) for _ in range(rounds)])
    return times.min(axis=0) / SAMPLES


def main():
    """Print the ratios, and whether the target is met."""
    rng = np.random.default_rng(0)
    print(f"{'1000 trackers':24}{'bank':>12}{'loop':>12}{'ratio':>9}   per tracker and sample")
    for name, (structure, options) in CASES.items():
        bank, loop = measured(structure, options, 1000, rng)
        verdict = f"target {TARGET}: {'met' if bank / loop <= TARGET else 'NOT MET'}" if "OE" in name else ""
        print(f"{name:24}{bank * 1e6:9.2f} us{loop * 1e6:9.2f} us{bank / loop:9.3f}   {verdict}")
    print(f"\n{'OE(4,4), trackers':24}{'bank':>12}{'loop':>12}{'ratio':>9}")
    for n in SIZES:
        bank, loop = measured(*CASES["OE(4,4), filtered"], n, rng)
        print(f"{n:<24}{bank * 1e6:9.2f} us{loop * 1e6:9.2f} us{bank / loop:9.3f}")


if __name__ == "__main__":
    main()
