"""Plants that no linear structure has, or large ones: tanks, damper, ball and beam, actuator, many parameters.

    python tests/benchmarks/hard_plants.py [tanks damper ball actuator large long condemned] [--runs 10] [--seed 0]

Each is simulated. The first three end in fits of a free run on a fresh recording, in percent, and what they are held to
is the same structure's fit by `identify` without outliers; the rest are held to numbers.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from measuring import target
from scipy.signal import lfilter

from robust_filterpy.identification import (
    ARMAX,
    ARX,
    OutputError,
    ParameterTracker,
    identify,
    select_structure,
    validate,
)

OUTLIERS = 0.1


def held(rng, samples, most, low=-1.0, high=1.0):
    """Return an input of random levels, each held for up to `most` samples."""
    times = rng.integers(1, most + 1, samples)
    return np.repeat(rng.uniform(low, high, samples), times)[:samples]


def wild(rng, y, sigma, share):
    """Return y with noise of sigma, and a share of outliers three times as large as y spreads."""
    far = np.where(rng.random(y.size) < share, 3.0 * np.std(y), 0.0)
    return y + sigma * rng.normal(size=y.size) + far * rng.normal(size=y.size)


def tanks(rng, samples=1024):
    """Return input and level of the lower of two tanks; the upper one overflows."""
    u, upper, lower, y = held(rng, samples, 40, 0.8, 4.0), 5.0, 5.0, np.empty(samples)
    for k in range(samples):
        y[k] = lower
        for _ in range(4):
            flow = np.sqrt(max(upper, 0.0))
            upper = min(upper + 0.05 * u[k] - 0.054 * flow, 10.0)
            lower = min(max(lower + 0.046 * flow - 0.054 * np.sqrt(lower), 0.0), 10.0)
    return u, y, 0.05


def damper(rng, samples=1750):
    """Return velocity and force of a damper with hysteresis, and a spring that keeps what was."""
    u, z, x, y = lfilter([0.1], [1.0, -0.9], held(rng, samples, 30, -3.0, 3.0)), 0.0, 0.0, np.empty(samples)
    for k in range(samples):
        y[k] = 8.0 * u[k] + 40.0 * z + 2.0 * x
        x = 0.999 * x + 0.05 * u[k]
        z += 0.3 * (u[k] - abs(u[k]) * z)
    return u, y, 1.0


def ball(rng, samples=1000):
    """Return angle and position of a ball on a beam, which a controller keeps on it."""
    u, y, x, v = np.empty(samples), np.empty(samples), rng.uniform(-0.05, 0.05), 0.0
    dither = held(rng, samples, 10, -0.02, 0.02)
    for k in range(samples):
        y[k], u[k] = x, dither[k] - 0.3 * x - 0.25 * v
        for _ in range(10):
            v += 0.01 * (7.0 * u[k] - 0.4 * v - 0.02 * np.tanh(50.0 * v))
            x += 0.01 * v
    return u, y, 0.002


def actuator(rng, samples=1024):
    """Return valve and pressure of an actuator that moves a springy arm; the valve has a dead zone and saturates."""
    u, p, x, v, y = held(rng, samples, 40), 0.0, 0.0, 0.0, np.empty(samples)
    for k in range(samples):
        y[k] = p
        opened = np.clip(np.sign(u[k]) * max(abs(u[k]) - 0.15, 0.0), -0.6, 0.6)
        for _ in range(5):
            p += 0.05 * (6.0 * opened * np.sqrt(max(4.0 - np.sign(opened) * p, 0.0)) - 6.0 * v - 0.4 * p)
            v += 0.05 * (p - 2.0 * x - 0.3 * v)
            x += 0.05 * v
    return u, y, 0.05


def by_identify(y, u):
    """Return theta of a model of third order."""
    return identify(y, u, OutputError(3, 3), progress=False).theta


def by_tracker(y, u):
    """Return theta of a tracker of third order at the end."""
    tracker = ParameterTracker(OutputError(3, 3))
    tracker.run(y, u)
    return tracker.theta


def free_run(method, plant, seed, share):
    """Return the fit of the free run on a fresh recording without noise; both are taken about their means."""
    u, y, sigma = plant(np.random.default_rng([seed, 1]))
    theta = method(wild(np.random.default_rng([seed, 3]), y, sigma, share), u)
    u, y, _ = plant(np.random.default_rng([seed, 2]))
    with np.errstate(all="ignore"):
        run = lfilter([0.0, *theta[3:]], [1.0, *theta[:3]], u - u.mean())
        missed = np.linalg.norm(run - run.mean() - (y - y.mean())) / np.linalg.norm(y - y.mean())
    return 100.0 * (1.0 - missed) if missed < 11.0 else -1000.0


def runs_of(plant, method):
    """Return a part that compares free runs with 10 % outliers with those without."""

    def part(arguments):
        seeds = range(arguments.seed, arguments.seed + arguments.runs)
        clean = [free_run(by_identify, plant, seed, 0.0) for seed in seeds]
        found = [free_run(method, plant, seed, OUTLIERS) for seed in seeds]
        name = f"{plant.__name__}, {method.__name__}, 10 % outliers: fit"
        print(f"{plant.__name__}: identify without outliers {np.round(clean, 1)}, found {np.round(found, 1)}")
        target(f"{name}, median", np.median(found), round(np.median(clean) - 5.0, 1), least=True)
        target(f"{name}, worst below that without", max(np.subtract(clean, found)), 10.0)

    return part


def choice(arguments):
    """How far what `select_structure` takes is below the best other structure, on the second half of a recording."""
    losses = []
    for seed in range(arguments.seed, arguments.seed + arguments.runs):
        u, y, sigma = actuator(np.random.default_rng([seed, 1]))
        y, half = wild(np.random.default_rng([seed, 3]), y, sigma, 0.0), y.size // 2
        found = select_structure(y[:half], u[:half], na=range(1, 5), nk=range(1, 4), progress=False)
        others = [OutputError(n, n) for n in (1, 2, 3, 4)]
        fits = {other: identify(y[:half], u[:half], other, progress=False).fit(y[half:], u[half:]) for other in others}
        best = max(fits, key=fits.get)
        losses.append(fits[best] - found.best.fit(y[half:], u[half:]))
        taken = found.best.structure
        print(f"actuator {seed}: {taken}, {losses[-1]:.1f} below {best} with {fits[best]:.1f}", flush=True)
    target("actuator, worst below the best on held-out data", max(losses), 1.0)


def knowing(y, u, order, wild):
    """Return theta of an ARX by least squares on the samples in whose regressor no outlier stands."""
    rows = np.flatnonzero(np.convolve(wild, np.ones(order + 1))[order : y.size] < 0.5) + order
    X = np.column_stack([signal[rows - j] for signal in (-y, u) for j in range(1, order + 1)])
    return np.linalg.lstsq(X, y[rows], rcond=None)[0]


def large(arguments):
    """Identify ARX(20, 20) plants of 1e4 samples, every other one with outliers, as one does who knows these."""
    errors, failed = [], []
    for seed in range(arguments.seed, arguments.seed + arguments.runs):
        rng = np.random.default_rng([seed, 4])
        poles = rng.uniform(0.3, 0.95, 10) * np.exp(1j * rng.uniform(0.1, 3.0, 10))
        a, b = np.real(np.poly([*poles, *poles.conj()])), rng.normal(size=20)
        u = rng.choice([-1.0, 1.0], 10_000)
        y = lfilter([0.0, *b], a, u) + lfilter([1.0], a, 0.3 * rng.normal(size=u.size))
        far = np.where(rng.random(u.size) < OUTLIERS * (seed % 2), np.std(y), 0.0) * rng.normal(size=u.size)
        y += far
        right = np.array([*a[1:], *b])
        least = np.linalg.norm(knowing(y, u, 20, far != 0.0) - right) / np.linalg.norm(right)
        try:
            theta = identify(y, u, ARX(20, 20), progress=False).theta
            errors.append(np.linalg.norm(theta - right) / np.linalg.norm(right))
            found = f"relative error {errors[-1]:.4f}, knowing the outliers {least:.4f}"
            print(f"ARX(20, 20), seed {seed}: {found}", flush=True)
        except Exception as error:  # whatever it is, it is what the row counts
            failed.append(f"{type(error).__name__}: {error}")
    print(f"ARX(20, 20): {failed or 'nothing raised'}")
    target("ARX(20, 20), errors raised", len(failed), 0)


def long(arguments):
    """Time ARX and OE of 1e4 and 1e5 samples of an ARX(2, 2) plant with 10 % outliers."""
    spent = {}
    for samples in (10_000, 100_000):
        rng = np.random.default_rng([arguments.seed, 5])
        u, a = rng.choice([-1.0, 1.0], samples), [1.0, -1.5, 0.7]
        y = lfilter([0.0, 1.0, 0.5], a, u) + lfilter([1.0], a, 0.3 * rng.normal(size=samples))
        y += np.where(rng.random(samples) < OUTLIERS, 5.0, 0.0) * rng.normal(size=samples)
        for structure in (ARX(2, 2), OutputError(2, 2)):
            start = time.process_time()
            identify(y, u, structure, progress=False)
            spent[samples, structure] = time.process_time() - start
            print(f"{structure}, {samples} samples: {spent[samples, structure]:.1f} s of the processor", flush=True)
    last = spent[100_000, ARX(2, 2)]
    target("ARX at 1e5 samples over 1e4", last / spent[10_000, ARX(2, 2)], 12.0)
    target("ARX over OE at 1e5 samples", last / spent[100_000, OutputError(2, 2)], 1.0)


def condemned(arguments):
    """Judge right ARMAX models on their own recordings of 1000 samples, 30 % of them with ten times the noise."""
    a, b, c = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, 0.7, 0.3]
    for whose in ("process", "measurement"):
        found = 0
        for seed in range(arguments.seed, arguments.seed + arguments.runs):
            rng = np.random.default_rng([seed, 6])
            u, e = rng.choice([-1.0, 1.0], 1000), 0.3 * rng.normal(size=1000)
            far = np.where(rng.random(1000) < 0.3, 3.0 * rng.normal(size=1000), 0.0)
            y = lfilter(b, a, u) + lfilter(c, a, e + far * (whose == "process")) + far * (whose == "measurement")
            verdict = validate(identify(y, u, ARMAX(2, 2, 2), progress=False), y, u).verdict
            found += verdict != "nothing is left in the residuals"
        name = f"right ARMAX condemned, 30 % outliers of the {whose}, of {arguments.runs}"
        target(name, found, 0.05 * arguments.runs)


PARTS = {
    "tanks": runs_of(tanks, by_tracker), "damper": runs_of(damper, by_identify), "ball": runs_of(ball, by_identify),
    "actuator": choice, "large": large, "long": long, "condemned": condemned,
}  # fmt: skip

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which plants (default: all)")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    for each in given.parts or PARTS:
        PARTS[each](given)
