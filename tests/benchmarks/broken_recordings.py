"""Recordings that break assumptions at random: how often is the answer right, warned of, or wrong in silence?

    python tests/benchmarks/broken_recordings.py [--draws 1000] [--first 0] [--only identify] [--minutes 3]
        [--coloured | --plants]

Each draw takes a random plant, outliers or none, and one break or two at once: which, when and how large is random.
Right is a simulation of fresh inputs that fits the noise-free plant, as it is at the end, by at least 90,
or by 5 less than the same call makes of the recording without the break; warned is a warning, a
finding or a refusal. What is neither is silent and wrong: the target is 1 % of the draws at most. With ``--plants``
the plants are what few structures say: a trend beside a slow input, an integrator behind a coarse sensor, a motor with
friction, of which right is also what comes within 5 of least squares.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, OutputError, ParameterTracker, identify, select_structure, validate

RIGHT, NEAR = 90.0, 5.0
LENGTH = 1500


class Draw(NamedTuple):
    """A recording with and without its breaks, and the plant; ``times`` is its gain at the end over that before."""

    y: Any
    u: Any
    whole_y: Any
    whole_u: Any
    a: Any
    b: Any
    times: float
    structure: Any
    breaks: tuple[str, ...]
    motor: tuple[float, float] | None = None


def plant(rng: Any) -> tuple[Any, Any]:
    """Return a random stable plant of order 2 or 4."""
    poles = [rng.uniform(0.4, 0.95) * np.exp(1j * rng.uniform(0.2, 2.5)) for _ in range(rng.choice([1, 2]))]
    return np.real(np.poly([*poles, *np.conj(poles)])), np.concatenate(([0.0], rng.normal(size=2 * len(poles))))


def late(rng: Any) -> Any:
    """Return which samples come after a random time."""
    return np.arange(LENGTH) >= rng.integers(LENGTH // 5, 4 * LENGTH // 5)


def fill_value(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    return np.where(rng.random(LENGTH) < rng.uniform(0.01, 0.2), rng.choice([9999.0, 1e7, -1e8, 9.97e36]), y), u


def input_constant(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    return y, u + 10.0 ** rng.uniform(1, 8)


def step(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    return y + rng.choice([-1, 1]) * rng.uniform(0.5, 5.0) * np.std(clean) * late(rng), u


def ramp(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    return y + rng.choice([-1, 1]) * rng.uniform(1.0, 5.0) * np.std(clean) * np.arange(LENGTH) / LENGTH, u


def gross(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    wild = 10.0 ** rng.uniform(2, 8) * rng.normal(size=LENGTH)
    return np.where(rng.random(LENGTH) < rng.uniform(0.01, 0.1), wild, y), u


def stuck(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    y, begin, length = y.copy(), rng.integers(LENGTH // 5, LENGTH // 2), rng.integers(50, LENGTH // 3)
    y[begin : begin + length] = y[begin]
    return y, u


def input_outliers(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    return y, np.where(rng.random(LENGTH) < rng.uniform(0.01, 0.05), 10.0 * rng.normal(size=LENGTH), u)


def gain(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any, Any]:
    after = late(rng)
    change = rng.choice([-2.0, -0.5, 0.3, 1.0])
    return y + clean * after * change, u, 1.0 + change


def slow_noise(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    pole = rng.uniform(0.9, 0.99)
    noise = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.normal(size=LENGTH))
    return y + rng.uniform(0.1, 0.5) * np.std(clean) * noise, u


def bursts(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    begins = np.flatnonzero(rng.random(LENGTH) < 0.005)
    wild = np.zeros(LENGTH, dtype=bool)
    for begin, length in zip(begins, rng.integers(5, 40, begins.size), strict=True):
        wild[begin : begin + length] = True
    return y + np.where(wild, rng.uniform(0.5, 3.0) * np.std(clean) * rng.normal(size=LENGTH), 0.0), u


def coarse(rng: Any, y: Any, u: Any, clean: Any) -> tuple[Any, Any]:
    size = rng.uniform(0.2, 0.8) * np.std(clean)
    return size * np.round(y / size), u


BREAKS: tuple[Callable[..., Any], ...] = (fill_value, input_constant, step, ramp, gross, stuck, input_outliers, gain)
# Other draws, with ``--coloured``: what these leave follows itself, with a break of the others or none.
COLOURED: tuple[Callable[..., Any], ...] = (slow_noise, bursts, coarse, step, ramp, input_outliers)


def drawn(seed: int, breaks: tuple[Callable[..., Any], ...] = BREAKS) -> Draw:
    """Draw a recording."""
    rng = np.random.default_rng([2700, seed])
    a, b = plant(rng)
    u = rng.choice([-1.0, 1.0], LENGTH).repeat(rng.choice([1, 5]))[:LENGTH]
    noise = np.where(rng.random(LENGTH) < rng.choice([0.0, 0.1]), 10.0, 1.0) * rng.normal(size=LENGTH)
    clean = lfilter(b, a, u)
    noise *= 0.05 * np.std(clean)
    order = a.size - 1
    structure = (OutputError if rng.random() < 0.7 else ARX)(order, order)
    y = clean + noise if structure.nf else clean + lfilter([1.0], a, noise)
    chosen = rng.choice(len(breaks), rng.choice([1, 2]), replace=False)
    broken, signal, times = y, u, 1.0
    for i in chosen:
        broken, signal, *changed = breaks[i](rng, broken, signal, clean)
        times *= float(np.prod(changed))
    names = tuple(breaks[i].__name__ for i in chosen)
    return Draw(broken, signal, y, u, a, b, times, structure, names)


def with_slow_input(rng: Any) -> Draw:
    """Return a recording with a trend, of an input that wanders."""
    a, b = plant(rng)
    u = rng.choice([-1.0, 1.0], LENGTH).repeat(5)[:LENGTH] + rng.uniform(0.02, 0.2) * rng.normal(size=LENGTH).cumsum()
    clean = lfilter(b, a, u)
    y = clean + 0.05 * np.std(clean) * rng.normal(size=LENGTH)
    structure = OutputError(a.size - 1, a.size - 1)
    return Draw(ramp(rng, y, u, clean)[0], u, y, u, a, b, 1.0, structure, ("trend with a slow input",))


def of_integrator(rng: Any) -> Draw:
    """Return a recording of an integrator whose sensor has coarse steps."""
    a, b = np.convolve([1.0, -1.0], [1.0, -rng.uniform(0.2, 0.8)]), np.array([0.0, 1.0, rng.uniform(-0.5, 1.0)])
    u = rng.choice([-1.0, 0.0, 1.0], LENGTH).repeat(10)[:LENGTH]
    clean = lfilter(b, a, u) + rng.normal()
    size = rng.uniform(0.05, 0.5) * np.std(clean)
    y, fine = (size * np.round(clean / size), clean + 0.01 * size * rng.normal(size=LENGTH))
    return Draw(y, u, fine, u, a, b, 1.0, OutputError(2, 2), ("quantized integrator",))


def of_motor(rng: Any) -> Draw:
    """Return a recording of a motor with friction that depends on its speed."""
    kind = float(rng.uniform(0.05, 0.2)), float(rng.uniform(0.0, 0.2))
    u = np.repeat(rng.uniform(-3.0, 3.0, 60), rng.integers(20, 60, 60))[:LENGTH]
    y = motor(u, *kind) + 0.02 * rng.normal(size=u.size)
    return Draw(y, u, y, u, np.ones(1), np.ones(1), 1.0, OutputError(2, 2), ("friction",), kind)


def motor(u: Any, coulomb: float, stiction: float) -> Any:
    """Return the speed of a motor with Coulomb and Stribeck friction."""
    v, current, speed = 0.0, 0.0, np.zeros(u.size)
    for k, volts in enumerate(u):
        for _ in range(10):
            current += 0.1 * (volts - current - 0.5 * v)
            friction, drive = coulomb + stiction * np.exp(-((v / 0.3) ** 2)), current - 0.05 * v
            held = abs(v) < 1e-3 and abs(drive) < friction
            v = 0.0 if held else v + 0.02 * (drive - friction * np.sign(v or drive))
        speed[k] = v
    return speed


PLANTS: tuple[Callable[[Any], Draw], ...] = (with_slow_input, of_integrator, of_motor)


def fit_of(found: Any, draw: Draw, seed: int, times: float = 1.0) -> float:
    """Return how well what was found simulates fresh inputs of the plant, with its gain so many times, in percent."""
    n = found.structure.na + found.structure.nf
    theta, delay = found.theta, found.structure.inputs[0][1]
    return fit_of_polynomials(np.append(1.0, theta[:n]), np.append(np.zeros(delay), theta[n:]), draw, seed, times)


def fit_of_polynomials(a: Any, b: Any, draw: Draw, seed: int, times: float = 1.0) -> float:
    """Return the same for B/A."""
    rng = np.random.default_rng([2701, seed])
    u = rng.choice([-1.0, 1.0], 500) if draw.motor is None else rng.uniform(-3.0, 3.0, 20).repeat(25)
    clean = lfilter(times * draw.b, draw.a, u) if draw.motor is None else motor(u, *draw.motor)
    with np.errstate(all="ignore"):
        missed = np.linalg.norm(lfilter(b, a, u) - clean) / np.linalg.norm(clean - clean.mean())
    return 100.0 * (1.0 - missed) if np.isfinite(missed) else -np.inf


def least_squares(draw: Draw, seed: int) -> float:
    """Return the fit of ARX(2, 2) with a constant by least squares."""
    y, u, k = draw.y, draw.u, np.arange(2, draw.y.size)
    X = np.column_stack((-y[k - 1], -y[k - 2], u[k - 1], u[k - 2], np.ones(k.size)))
    theta = np.linalg.lstsq(X, y[k], rcond=None)[0]
    return fit_of_polynomials(np.append(1.0, theta[:2]), np.append(0.0, theta[2:4]), draw, seed)


def identified(draw: Draw, y: Any, u: Any) -> Any:
    return identify(y, u, draw.structure, progress=False)


def validated(draw: Draw, y: Any, u: Any) -> Any:
    model = identify(y, u, draw.structure, progress=False)
    verdict = validate(model, y, u).verdict
    if verdict != "nothing is left in the residuals":
        warnings.warn(verdict, stacklevel=1)
    return model


def tracked(draw: Draw, y: Any, u: Any) -> Any:
    tracker = ParameterTracker(draw.structure)
    tracker.run(y, u)
    return tracker


def selected(draw: Draw, y: Any, u: Any) -> Any:
    kind, order = (OutputError, draw.structure.nf) if draw.structure.nf else (ARX, draw.structure.na)
    return select_structure(y, u, kind=kind, na=range(1, order + 1), nk=range(1, 3), progress=False).best


CALLS: dict[str, Callable[..., Any]] = {
    "identify": identified, "tracker": tracked, "select_structure": selected, "identify and validate": validated,
}  # fmt: skip


def judged(call: Callable[..., Any], draw: Draw, seed: int) -> str:
    """Return "right", "warned" or "silent and wrong"."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            found = call(draw, draw.y, draw.u)
        except (ValueError, np.linalg.LinAlgError):
            return "warned"
    fit = fit_of(found, draw, seed, draw.times)
    if fit >= RIGHT:
        return "right"
    if any(issubclass(each.category, UserWarning) for each in said):
        return "warned"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        alone = draw.motor is not None
        reached = least_squares(draw, seed) if alone else fit_of(call(draw, draw.whole_y, draw.whole_u), draw, seed)
    return "right" if fit >= reached - NEAR else "silent and wrong"


def main() -> None:
    """Print how often each call is right, warned of, or silent and wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=CALLS)
    parser.add_argument("--coloured", action="store_true", help="slow noise, bursts, coarse steps of the sensor")
    parser.add_argument("--plants", action="store_true", help="trend with a slow input, integrator, friction")
    parser.add_argument("--minutes", type=float, default=np.inf, help="of processor time for each call")
    options = parser.parse_args()
    for name, call in CALLS.items():
        if options.only not in (None, name):
            continue
        counts: Counter[str] = Counter()
        end = time.process_time() + 60.0 * options.minutes
        for seed in range(options.first, options.first + options.draws):
            if time.process_time() > end:
                break
            of_plant = PLANTS[seed % len(PLANTS)] if options.plants else None
            draw = drawn(seed, COLOURED if options.coloured else BREAKS)
            draw = draw if of_plant is None else of_plant(np.random.default_rng([2702, seed]))
            verdict = judged(call, draw, seed)
            counts[verdict] += 1
            if verdict == "silent and wrong":
                print(
                    f"    {name}, draw {seed}: {' and '.join(draw.breaks)}, {draw.structure}",
                    file=sys.stderr,
                    flush=True,
                )
        shares = ", ".join(f"{verdict} {count}" for verdict, count in sorted(counts.items()))
        print(f"{name:<24}{shares} of {counts.total()}", flush=True)


if __name__ == "__main__":
    main()
