"""Recordings whose residuals are no white noise: what `identify` makes of them by default.

    python tests/benchmarks/coloured_recordings.py [PART ..] [--draws 20] [--first 0]

Each part prints a line: fits to the plant's own output for fresh inputs, in percent, with those of
``trend="constant"`` and of an ARX by least squares; coverage of theta +- 2 std; or seconds of the processor.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import numpy as np
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, LinearRegression, OutputError, identify


def recorded(y: Any, u: Any, structure: Any, **options: Any) -> Any:
    """Return the model, nothing written."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return identify(y, u, structure, progress=False, **options)


def percent(y: Any, shown: Any) -> float:
    """Return the fit, of 0 at the least."""
    with np.errstate(all="ignore"):
        missed = np.linalg.norm(shown - y) / np.linalg.norm(y - y.mean())
    return 100.0 * max(1.0 - missed, 0.0) if np.isfinite(missed) else 0.0


def least_squares(y: Any, u: Any, fresh: Any, n: int = 2) -> Any:
    """Return what an ARX(n, n) by least squares makes of fresh inputs."""
    rows = [sign * one[n - j - 1 : -j - 1] for sign, one in ((-1.0, y), (1.0, u)) for j in range(n)]
    theta = np.linalg.lstsq(np.column_stack((*rows, np.ones(y.size - n))), y[n:], rcond=None)[0]
    return lfilter(np.concatenate(([0.0], theta[n:-1])), np.concatenate(([1.0], theta[:n])), fresh - u.mean())


def compared(y: Any, u: Any, structure: Any, clean: Any, fresh: Any) -> tuple[float, float, float]:
    """Return the fits of the default model, that with a constant, and least squares; levels left out."""
    shown = [recorded(y, u, structure, **o).simulate(fresh) for o in ({}, {"trend": "constant"})]
    shown.append(least_squares(y, u, fresh))
    a, b, c = (percent(clean - clean.mean(), one - one.mean()) for one in shown)
    return a, b, c


def slow_input(seed: int, **options: Any) -> tuple[float, float, float]:
    """A linear trend with a second input that wanders; truth .03 for its b: estimate, std, R (truth .0225)."""
    rng = np.random.default_rng([5101, seed])
    N = 1000
    u = np.column_stack((rng.choice([-1.0, 1.0], N).repeat(5)[:N], np.cumsum(rng.normal(size=N))))
    y = lfilter([0.0, 0.2], [1.0, -0.8], u[:, 0]) + lfilter([0.0, 0.03], [1.0, -0.8], u[:, 1])
    y += 0.01 * np.arange(N) + 0.15 * rng.normal(size=N)
    model = recorded(y, u, OutputError(1, (1, 1)), **options)
    return float(model.theta[2]), float(np.sqrt(model.P[2, 2])), float(model.R)


def motor(rng: Any, u: Any, noise: float) -> tuple[Any, Any]:
    """A motor with Coulomb and Stribeck friction, its speed as measured and as it is."""
    v, current, speed = 0.0, 0.0, np.zeros(u.size)
    for k, volts in enumerate(u):
        for _ in range(10):
            current += 0.002 * (volts - 1.0 * current - 0.5 * v) / 0.02
            friction = 0.15 + 0.15 * np.exp(-((v / 0.3) ** 2))
            drive = current - 0.05 * v
            if abs(v) < 1e-3 and abs(drive) < friction:
                v = 0.0
            else:
                v += 0.002 * (drive - friction * np.sign(v if v else drive)) / 0.1
        speed[k] = v
    return speed + noise * rng.normal(size=u.size), speed


def friction(seed: int) -> tuple[float, float, float]:
    """A motor with friction, steps of its voltage held for 20 to 60 samples."""
    rng = np.random.default_rng([5102, seed])
    stairs = [np.repeat(rng.uniform(-3.0, 3.0, 60), rng.integers(20, 60, 60))[:800] for _ in range(2)]
    y, _ = motor(rng, stairs[0], 0.02)
    return compared(y, stairs[0], OutputError(2, 2), motor(rng, stairs[1], 0.0)[1], stairs[1])


def integrator(seed: int) -> tuple[float, float, float]:
    """An integrator whose sensor has steps of 55.9."""
    rng = np.random.default_rng([5103, seed])
    u, fresh = (np.repeat(rng.choice([-1.0, 0.0, 1.0], 200), 10)[:1500] for _ in range(2))
    plant = lambda v: lfilter([0.0, 2.0, 1.6], [1.0, -1.5, 0.5], v)  # noqa: E731
    y = 55.9 * np.round((plant(u) + rng.normal()) / 55.9)
    return compared(y, u, OutputError(2, 2), plant(fresh), fresh)


def ball(seed: int) -> tuple[float, float, float]:
    """A ball in a tube that a controller keeps near where it should be, with gusts that last."""
    rng = np.random.default_rng([5104, seed])
    N, y, u, wanted = 1000, np.zeros(1000), np.zeros(1000), np.repeat(rng.choice([-1.0, 1.0], 25), 40)
    gust = lfilter([0.03], [1.0, -0.985], rng.normal(size=N))
    for k in range(2, N):
        y[k] = 1.85 * y[k - 1] - 0.86 * y[k - 2] + 0.02 * u[k - 1] + 0.018 * u[k - 2]
        y[k] += 0.1 * (gust[k] - 0.85 * gust[k - 1])
        u[k] = 1.2 * (wanted[k] - y[k]) - 4.0 * (y[k] - y[k - 1]) + 0.1 * rng.normal()
    fresh = np.repeat(rng.choice([-1.0, 1.0], 50), 20)
    clean = lfilter([0.0, 0.02, 0.018], [1.0, -1.85, 0.86], fresh)
    return compared(y + 0.01 * rng.normal(size=N), u, OutputError(2, 2), clean, fresh)


PLANT = np.array([-1.5, 0.7, 1.0, 0.5])


def of_noise(seed: int, kind: str) -> tuple[Any, Any]:
    """A recording of an order-2 plant with noise of a kind."""
    rng = np.random.default_rng([5105, seed])
    N = 1500
    u = rng.choice([-1.0, 1.0], N).repeat(3)[:N]
    clean, white = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u), rng.normal(size=N)
    if kind == "coloured":
        return clean + lfilter([0.2], [1.0, -0.95], white), u
    if kind == "process":
        return clean + lfilter([0.3], [1.0, -1.5, 0.7], white), u
    wild, run = np.zeros(N, dtype=bool), False
    for k in range(N):
        run = rng.random() < (0.95 if run else 0.005)
        wild[k] = run
    if kind == "bursts":
        return clean + np.where(wild, 10.0, 1.0) * 0.5 * white, u
    begins = np.flatnonzero(np.diff(wild.astype(int), prepend=0) == 1)
    level = rng.normal(size=N)[begins[np.maximum(np.searchsorted(begins, np.arange(N), "right") - 1, 0)]]
    return clean + 0.5 * white + np.where(wild, 5.0 * level, 0.0), u


def coverage(seed: int, kind: str) -> tuple[float, float, float]:
    """Share of theta within two of its deviations, largest distance in deviations, said or not."""
    model = recorded(*of_noise(seed, kind), OutputError(2, 2))
    z = np.abs(model.theta - PLANT) / model.std
    return float(np.mean(z < 2.0)), float(z.max()), float(bool(model.findings or model.warning))


def spikes(seed: int) -> tuple[float, float, float]:
    """A linear regression with 3 % of its rows spoilt: both parameters (truth .25 and -.1), said or not."""
    rng = np.random.default_rng([5106, seed])
    phi = rng.normal(size=(800, 2))
    y = phi @ [0.25, -0.1] + 0.05 * rng.normal(size=800)
    phi[rng.random(800) < 0.03, 0] = 1e3 * rng.normal()
    model = recorded(y, phi, LinearRegression(2))
    return float(model.theta[0]), float(model.theta[1]), float(bool(model.findings))


def wild(seed: int) -> tuple[float, float, float]:
    """One reading of 1e9, 1e100 or 1e300 for an ARX: distance of theta from that with NaN there, R, said or not."""
    rng = np.random.default_rng([5107, seed])
    u = rng.choice([-1.0, 1.0], 600)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + lfilter([0.1], [1.0, -1.5, 0.7], rng.normal(size=600))
    y[300] = np.nan
    as_nan = recorded(y, u, ARX(2, 2)).theta
    y[300] = (1e9, 1e100, 1e300)[seed % 3]
    model = recorded(y, u, ARX(2, 2))
    return float(np.abs(model.theta - as_nan).max()), float(model.R), float(bool(model.findings))


def arm(seed: int) -> tuple[float, float, float]:
    """A flexible arm of order 4, 512 samples of a sweep, 10 % outliers: fit on fresh inputs, that without outliers."""
    rng = np.random.default_rng([5108, seed])
    a = np.real(np.poly([0.995 * np.exp(0.25j), 0.995 * np.exp(-0.25j), 0.97 * np.exp(0.8j), 0.97 * np.exp(-0.8j)]))
    b = np.concatenate(([0.0], rng.normal(size=4)))
    u = np.sin(0.1 * np.arange(512) + 0.9 / 512 * np.arange(512) ** 2 / 1.0) + 0.3 * rng.normal(size=512)
    clean, fresh = lfilter(b, a, u), rng.normal(size=512)
    y = clean + 0.02 * np.std(clean) * rng.normal(size=512)
    bad = np.where(rng.random(512) < 0.1, y + 3.0 * np.std(clean) * rng.normal(size=512), y)
    fits = [percent(lfilter(b, a, fresh), recorded(one, u, OutputError(4, 4)).simulate(fresh)) for one in (bad, y)]
    return fits[0], fits[1], 0.0


def seconds(case: str) -> float:
    """Processor time of one call."""
    rng = np.random.default_rng(5109)
    N = 762 if case == "stairs" else 2000
    u = rng.choice([-1.0, 1.0], N).repeat(2)[:N]
    if case == "stairs":
        u = np.repeat(rng.uniform(-3.0, 3.0, 40), 20)[:N]
    a = np.real(np.poly([0.9 * np.exp(0.4j), 0.9 * np.exp(-0.4j), 0.8 * np.exp(1.5j), 0.8 * np.exp(-1.5j)]))
    plant = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7] if case in ("order 2", "stairs", "beyond") else a, u)
    noise = 0.05 * np.std(plant) * rng.normal(size=N)
    if case == "outliers":
        noise *= np.where(rng.random(N) < 0.1, 10.0, 1.0)
    if case == "stairs":
        plant = motor(rng, u, 0.0)[1]
        noise = 0.02 * rng.normal(size=N)
    order = 2 if case in ("order 2", "stairs") else 4
    begin = time.process_time()
    recorded(plant + noise, u, OutputError(order, order))
    return time.process_time() - begin


PARTS: dict[str, Any] = {
    "slow input": (slow_input, "b, truth .03; its std; R, truth .0225"),
    "slow input, line": (lambda seed: slow_input(seed, trend="line"), "the same with trend=line"),
    "integrator": (integrator, "fit; trend=constant; ARX by least squares"),
    "friction": (friction, "fit; trend=constant; ARX by least squares"),
    "ball": (ball, "fit; trend=constant; ARX by least squares"),
    "coloured": (lambda seed: coverage(seed, "coloured"), "coverage; largest deviation; share that is said"),
    "process": (lambda seed: coverage(seed, "process"), "coverage; largest deviation; share that is said"),
    "bursts": (lambda seed: coverage(seed, "bursts"), "coverage; largest deviation; share that is said"),
    "runs": (lambda seed: coverage(seed, "runs"), "coverage; largest deviation; share that is said"),
    "spikes": (spikes, "theta, truth .25 and -.1; share that is said"),
    "wild": (wild, "distance from theta with NaN; R; share that is said"),
    "arm": (arm, "fit with 10 % outliers; without"),
}


def main() -> None:
    """Print each part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    for name, (part, words) in PARTS.items():
        if options.parts and name not in options.parts:
            continue
        begin = time.process_time()
        found = np.array([part(seed) for seed in range(options.first, options.first + options.draws)])
        used = time.process_time() - begin
        shown = "  ".join(f"{m:.4g} ({least:.4g} .. {most:.4g})" for m, least, most in
                          zip(found.mean(axis=0), found.min(axis=0), found.max(axis=0), strict=True))  # fmt: skip
        if name.startswith("slow"):
            inside = np.abs(found[:, 0] - 0.03) < 2.0 * found[:, 1]
            shown += f"  within 2 std: {inside.sum()} of {inside.size}"
        print(f"{name:<17}{shown}  [{words}; {used:.0f} s]", flush=True)
    for case in ("order 2", "beyond", "clean", "outliers", "stairs"):
        if not options.parts or "seconds" in options.parts:
            print(f"seconds, {case:<9}{seconds(case):.2f}", flush=True)


if __name__ == "__main__":
    main()
