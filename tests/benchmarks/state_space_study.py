"""How near `StateSpace` comes to a refinement that begins at the truth and knows which readings are outliers.

    python tests/benchmarks/state_space_study.py --draws 30

Random plants of order 4 with two inputs and two outputs, 1000 samples, noise of a tenth of each output's size, one
reading in ten ten times as bad. Printed: the error of the step responses over that of the label-knowing refinement,
how often bands of 95 % hold the truth, and which order the evidence finds.
"""

import argparse
import time
import warnings

import numpy as np

from robust_filterpy.identification import StateSpace, identify
from robust_filterpy.identification.estimation.prediction_error import minimised
from robust_filterpy.identification.models.noise import Noise, Noises
from robust_filterpy.identification.models.state_space import Matrices, StateSpaceResiduals
from robust_filterpy.influence import Linear

ORDER, INPUTS, OUTPUTS, STEPS = 4, 2, 2, 40


def plant(rng):
    """Draw a stable plant with a resonance, or with four real poles."""
    A = np.zeros((ORDER, ORDER))
    for i in (0, 2):
        if rng.random() < 0.6:
            r, w = rng.uniform(0.6, 0.96), rng.uniform(0.1, 1.5)
            A[i : i + 2, i : i + 2] = r * np.array([[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]])
        else:
            A[i : i + 2, i : i + 2] = np.diag(rng.uniform(0.2, 0.95, 2))
    return A, rng.normal(size=(ORDER, INPUTS)), rng.normal(size=(OUTPUTS, ORDER))


def output(A, B, C, u):
    """Return what the plant does from rest."""
    x, y = np.zeros(len(A)), np.empty((len(u), len(C)))
    for k, now in enumerate(u):
        y[k] = C @ x
        x = A @ x + B @ now
    return y


def steps(A, B, C):
    """Return the step responses, shape (outputs, inputs, STEPS)."""
    return np.stack([output(A, B, C, np.eye(INPUTS)[[i] * STEPS]).T for i in range(INPUTS)], axis=1)


def label_knowing(A, B, C, y, u, wrong):
    """Return the step responses of the least squares of what is no outlier, from the truth."""
    model = StateSpaceResiduals(ORDER, [(y, u)], False, False)
    q = model.packed(Matrices(A, B, C, 0, 0, 0, 0), np.zeros(OUTPUTS + ORDER))
    rows = ~wrong.ravel()
    which = np.tile(np.arange(OUTPUTS), len(y))[rows]
    noise = Noises(tuple(Noise(Linear(), 1.0) for _ in range(OUTPUTS)), which)
    found = model.matrices(minimised(model, q, noise, rows).p)
    return steps(found.A, found.B, found.C)


def main():
    """Draw, identify, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--contamination", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=100)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    ratios, inside, orders, seconds = [], [], [], []
    for draw in range(options.draws):
        rng = np.random.default_rng([options.seed, draw])
        A, B, C = plant(rng)
        u = rng.choice([-1.0, 1.0], (options.samples, INPUTS))
        clean = output(A, B, C, u)
        wrong = rng.random(clean.shape) < options.contamination
        y = clean + 0.1 * clean.std(axis=0) * np.where(wrong, 10.0, 1.0) * rng.normal(size=clean.shape)
        truth, size = steps(A, B, C), clean.std(axis=0)[:, None, None]
        begun = time.perf_counter()
        model = identify(y, u, StateSpace(ORDER))
        seconds.append(time.perf_counter() - begun)
        best = label_knowing(A, B, C, y, u, wrong)
        errors = [np.sqrt(np.mean(((s - truth) / size) ** 2)) for s in (steps(model.A, model.B, model.C), best)]
        ratios.append(errors)
        for j in range(OUTPUTS):
            found = model.step_response(STEPS, output=j)
            inside.append(np.mean((found.lower <= truth[j] + 1e-12) & (truth[j] <= found.upper + 1e-12)))
        if draw < 10:
            orders.append(len(identify(y, u, StateSpace()).A))
    ours, theirs = np.array(ratios).T
    together = np.sqrt(np.mean(ours**2) / np.mean(theirs**2))
    each = ours / theirs
    print(
        f"error over the label-knowing one: {together:.3f} of all, {np.median(each):.3f} median, {each.max():.2f} worst"
    )
    print(f"step responses inside bands of 95 %: {100 * np.mean(inside):.1f} %")
    print(f"orders found of {ORDER}: {orders}; {np.median(seconds):.2f} s each")


if __name__ == "__main__":
    main()
