"""False alarms and catches of `validate` on state-space and physical models.

    python tests/benchmarks/judging_study.py [states physics driven] [--runs 40] [--seed 50]

Right models, of plants drawn at random, are judged on their own recording and on a fresh one, with and without 10 % of
outliers ten times as large; at level .99 one verdict in a hundred of each test is false, and each verdict has two
tests. Wrong ones have an order too little, equations of another kind, or parameters of before the plant changed.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np

from robust_filterpy.identification import GreyBox, StateSpace, identify, validate

RIGHT = "nothing is left in the residuals"


def states(seed, change=0.0):
    """Return a function that draws recordings of a random plant of order 3 with two inputs and outputs."""
    rng = np.random.default_rng([seed, 1])
    size, angle = rng.uniform(0.6, 0.9), rng.uniform(0.3, 1.5)
    A = np.zeros((3, 3))
    A[:2, :2] = size * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    A[2, 2] = rng.uniform(0.3, 0.8)
    B, C = rng.normal(size=(3, 2)), rng.normal(size=(2, 3))
    A, B = A * (1.0 - 0.3 * change), B * (1.0 + change)

    def drawn(number, outliers, driven=0.0, samples=500):
        rng = np.random.default_rng([seed, 2, number])
        u, x, y = rng.choice([-1.0, 1.0], (samples, 2)), rng.normal(size=3), np.empty((samples, 2))
        for k in range(samples):
            y[k] = C @ x
            x = A @ x + B @ u[k] + driven * rng.normal(size=3)
        wild = np.where(rng.random(y.shape) < outliers, 10.0, 1.0)
        return y + 0.3 * wild * rng.normal(size=y.shape) + [5.0, -30.0], u, None

    return drawn


def outflow(x, u, p):
    """Torricelli's law."""
    return [p[0] * u[0] - p[1] * np.sqrt(np.maximum(x[0], 1e-9))]


def linear(x, u, p):
    """A lag."""
    return [p[0] * u[0] - p[1] * x[0]]


def tank(seed, change=0.0):
    """Return a function that draws recordings of a tank at irregular times."""
    rng = np.random.default_rng([seed, 3])
    inflow, outlet = rng.uniform(0.3, 0.5), rng.uniform(0.25, 0.35) * (1.0 + change)

    def drawn(number, outliers, samples=150):
        rng = np.random.default_rng([seed, 4, number])
        t, u = np.cumsum(rng.uniform(0.2, 2.0, samples)), np.repeat(rng.uniform(0.5, 2.0, samples // 5), 5)
        x, y = rng.uniform(0.5, 2.0), np.empty(samples)
        for k in range(samples):
            y[k] = x
            fine = (t[k + 1] - t[k] if k + 1 < samples else 0.0) / 30
            for _ in range(30):
                x += fine * (inflow * u[k] - outlet * np.sqrt(max(x, 0.0)))
        wild = np.where(rng.random(samples) < outliers, 10.0, 1.0)
        return y + 0.03 * wild * rng.normal(size=samples), u, t

    return drawn


def box(f=outflow):
    """Return equations with first guesses."""
    return GreyBox(f, {"inflow": 0.6, "outflow": 0.5}, x0=[1.0])


def judged(model, recording):
    """Tell whether the verdict finds something."""
    y, u, t = recording
    return validate(model, y, u, t=t).verdict != RIGHT


def identified(recording, structure):
    """Return the model of a recording."""
    y, u, t = recording
    return identify(y, u, structure, **({} if t is None else {"t": t}), progress=False)


def judged_plants(kind, seed, outliers):
    """Return what verdicts find, by what is judged, of a plant."""
    plant, right, name, wrong = {
        "states": (states, StateSpace(3), "an order too little", StateSpace(2)),
        "physics": (tank, box(), "linear equations", box(linear)),
    }[kind]
    own, fresh, changed = plant(seed)(0, outliers), plant(seed)(1, outliers), plant(seed, 0.2)(1, outliers)
    model, other = identified(own, right), identified(own, wrong)
    return {
        "right, own recording": judged(model, own),
        "right, fresh": judged(model, fresh),
        "plant changed by 20 %, fresh": judged(model, changed),
        f"{name}, fresh": judged(other, fresh),
    }


def driven(_, seed, outliers):
    """Return the same where noise drives the states."""
    own, fresh = states(seed)(0, outliers, 0.3), states(seed)(1, outliers, 0.3)
    model, plain = identified(own, StateSpace(3, disturbance=True)), identified(own, StateSpace(3))
    return {
        "right, own recording": judged(model, own),
        "right, fresh": judged(model, fresh),
        "disturbance not said, fresh": judged(plain, fresh),
    }


KINDS = {"states": judged_plants, "physics": judged_plants, "driven": driven}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], help="which models (default: all)")
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=50)
    given = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    for kind in given.kinds or KINDS:
        for outliers in (0.0, 0.1):
            found = [KINDS[kind](kind, given.seed + run, outliers) for run in range(given.runs)]
            for name in found[0]:
                share = sum(one[name] for one in found)
                print(f"{kind}, {100 * outliers:.0f} % outliers, {name}: {share} of {given.runs}", flush=True)
