"""How well output-error models are tracked through outliers: gradients, guards, and the paper's own example.

    python tests/benchmarks/output_error_study.py [gradients] [guards] [paper] [armax] [--runs N] [--jobs 2] [--seed 0]

prints the tables that the docstrings of `ParameterTracker` cite, and for each target whether it is met.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np
import scipy.signal
from measuring import target
from scipy.integrate import quad

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
from studies import monte_carlo, stacked

from robust_filterpy import Contaminated, Huber, StudentT
from robust_filterpy.identification import ARMAX, OutputError, ParameterTracker
from robust_filterpy.identification.models.regressor import GUARDS
from robust_filterpy.identification.recursive.tracker import GRADIENTS
from robust_filterpy.influence import Linear
from robust_filterpy.plants import THETA_BAR, simulate_output_error
from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary
from robust_filterpy.plants.linear import random_walk, stable

PLANT = np.array([-1.5, 0.7, 1.0, 0.5])
SIGMA = 0.5
WALKS = (0.0, 1e-6, 1e-5)
CONTAMINATIONS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)
INFLUENCES = {"robust": Huber(), "student": StudentT(4.0)}
TRACKERS = ("Kalman", "robust", "labels", "student")
SAMPLES = 1000


def tracked(kind, structure, y, u, labels, sigma, contamination, ratio=10.0, **options):
    """Run one kind of tracker on a recording and return its path of theta."""
    options = {"start": 0, **options}
    if kind in INFLUENCES:
        return ParameterTracker(structure, R=sigma**2, influence=INFLUENCES[kind], **options).run(y, u).theta
    mixture = sigma**2 * (1 - contamination + ratio**2 * contamination)
    variance = np.where(labels, (ratio * sigma) ** 2, sigma**2) if kind == "labels" else mixture
    return ParameterTracker(structure, influence=Linear(), **options).run(y, u, variance).theta


def late_error(path, theta):
    """Return the mean of ||theta_hat - theta|| over the second half."""
    return np.linalg.norm(path - theta, axis=1)[len(path) // 2 :].mean()


def gradient_trial(rng, contamination, walks, gradients=GRADIENTS, trackers=TRACKERS, **options):
    """Track the well-conditioned plant from theta = 0 in every way."""
    noise = Contaminated(contamination, 10.0, SIGMA).rvs_labelled(SAMPLES, rng)
    u = rng.choice([-1.0, 1.0], SAMPLES)
    y = simulate_output_error(PLANT, u, noise=noise.values, na=2, nb=2).y
    return {
        (gradient, Q, kind): late_error(
            tracked(
                kind, OutputError(2, 2), y, u, noise.is_outlier, SIGMA, contamination,
                P=1.0, Q=Q, gradient=gradient, **options,
            ),
            PLANT,
        )
        for gradient in gradients
        for Q in walks
        for kind in trackers
    }  # fmt: skip


def medians(trial, study, **arguments):
    """Return the median over seeds of every entry of a trial's result."""
    return {
        key: float(np.median(values))
        for key, values in stacked(monte_carlo(partial(trial, **arguments), **study)).items()
    }


def print_gradients(study):
    """Print the table of gradients with its targets."""
    table = {c: medians(gradient_trial, study, contamination=c, walks=WALKS) for c in CONTAMINATIONS}
    print(f"Output error, a = [-1.5, .7], b = [1, .5], median of the late ||theta_hat - theta||, {study['runs']} runs")
    print(
        f"{'Q':>7} {'cont.':>6}   "
        + "   ".join(f"{gradient + ': ' + ' '.join(TRACKERS):>46}" for gradient in GRADIENTS)
    )
    for Q in WALKS:
        for c, row in table.items():
            cells = [" ".join(f"{row[g, Q, kind]:7.4f}" for kind in TRACKERS) for g in GRADIENTS]
            print(f"{Q:7.0e} {c:6.2f}   " + "   ".join(f"{cell:>46}" for cell in cells))
    print("Targets: ratio of median errors")
    for kind in INFLUENCES:
        for Q in WALKS:
            for c, row in table.items():
                kalman, robust, labels = (row["filtered", Q, name] for name in ("Kalman", kind, "labels"))
                where = f"Q = {Q:.0e}, contamination {c}, filtered"
                if c == 0.0:
                    target(f"{kind} / Kalman, {where}", robust / kalman, 1.1)
                if c >= 0.1:
                    target(f"{kind} / Kalman, {where}", robust / kalman, 0.55)
                    target(f"{kind} / label-knowing, {where}", robust / labels, 1.35)
                if c in (0.1, 0.15):
                    kalman, robust = (row["pseudolinear", Q, name] for name in ("Kalman", kind))
                    target(f"{kind} / Kalman, Q = {Q:.0e}, contamination {c}, pseudolinear", robust / kalman, 0.65)


def guard_trial(rng, W, theta0, order, sigma, contamination):
    """Track a drifting plant with every guard and gradient."""
    path = random_walk(theta0, W, SAMPLES, rng, accept=stable(order))
    noise = Contaminated(contamination, 10.0, sigma)
    u = rng.choice([-1.0, 1.0], SAMPLES)
    data = simulate_output_error(path, u, noise=noise, rng=rng, na=order, nb=order)
    result = {}
    for gradient in GRADIENTS:
        for guard in GUARDS:
            tracker = ParameterTracker(
                OutputError(order, order), theta=0.0, P=1.0, Q=W, R=sigma**2, gradient=gradient, guard=guard
            )
            result[gradient, guard] = late_error(tracker.run(data.y, u).theta, path)
    return result


def print_guards(study):
    """Print the table of guards."""
    print(f"Guards, drifting plants, contamination 0.1, median of the late ||theta_hat - theta||, {study['runs']} runs")
    for name, theta0, order, sigma in (
        ("a = [-1.5, .7]", PLANT, 2, SIGMA),
        ("theta-bar of section 4", THETA_BAR, 4, 0.1**0.5),
    ):
        for W in (1e-6, 1e-5, 1e-4):
            row = medians(
                guard_trial, study, W=W, theta0=theta0, order=order, sigma=sigma, contamination=0.1
            )  # fmt: skip
            cells = (f"{g}: " + " ".join(f"{guard} {row[g, guard]:6.3f}" for guard in GUARDS) for g in GRADIENTS)
            print(f"{name:>23} W = {W:.0e}  " + "   ".join(cells))


def sensitivity(theta, u, na):
    """Return the derivative of the noise-free output by theta, shape (N, n)."""
    a = np.concatenate(([1.0], theta[:na]))
    y = scipy.signal.lfilter(np.concatenate(([0.0], theta[na:])), a, u)
    phi = OutputError(na, theta.size - na).regressors(u, y)
    return scipy.signal.lfilter([1.0], a, phi, axis=0)


def paper_trial(rng, contamination, pink):
    """Track theta-bar of section 4, W = 1e-6 I, with the noise of the paper."""
    sigma, W = 0.1**0.5, 1e-6
    path = random_walk(THETA_BAR, W, SAMPLES, rng, accept=stable(4))
    noise = Contaminated(contamination, 10.0, sigma)
    labelled = noise.rvs_labelled(SAMPLES, rng)
    if pink:
        u = receding_horizon_binary(bandlimited_pink_autocovariance(0.5, 2.5, 40), SAMPLES, rng=rng)
    else:
        u = rng.choice([-1.0, 1.0], SAMPLES)
    data = simulate_output_error(path, u, noise=labelled.values, na=4, nb=4)
    structure, w = OutputError(4, 4), np.linspace(0.05, np.pi, 200)
    information = np.linalg.inv(sensitivity(THETA_BAR, u, 4).T @ sensitivity(THETA_BAR, u, 4))
    score = 2.0 * quad(lambda v: noise.score(v) ** 2 * noise.pdf(v), 0.0, 50.0 * noise.scale)[0]
    result = {("bound", "theta"): np.sqrt(np.trace(information) / score)}
    true = response(path[-1], w)
    for gradient in GRADIENTS:
        for kind in TRACKERS[:3]:
            theta = tracked(
                kind, structure, data.y, u, labelled.is_outlier, sigma, contamination, P=0.1, Q=W, gradient=gradient
            )
            model = ParameterTracker(structure, theta=theta[-1]).simulate(u)
            clean = ParameterTracker(structure, theta=path[-1]).simulate(u)
            result[gradient, kind] = np.array(
                [
                    np.linalg.norm(theta[-1] - path[-1]),
                    np.linalg.norm(model - clean) / np.linalg.norm(clean),
                    np.linalg.norm(response(theta[-1], w) - true) / np.linalg.norm(true),
                ]
            )
    return result


def response(theta, w):
    """Return the frequency response of B/A with four a's, at w in rad per sample."""
    return scipy.signal.freqz(np.concatenate(([0.0], theta[4:])), np.concatenate(([1.0], theta[:4])), w)[1]


def print_paper(study):
    """Print section 4: what 1000 samples tell about theta-bar, and about the plant."""
    print(f"Section 4, theta-bar, from theta = 0, P0 = 0.1 I, W = 1e-6 I, last sample, medians of {study['runs']} runs")
    print("  theta: ||theta_hat - theta||; output, response: relative errors of B/A u and B/A, noise-free")
    for pink in (True, False):
        for c in (0.05, 0.1, 0.15):
            result = stacked(monte_carlo(partial(paper_trial, contamination=c, pink=pink), **study))
            bound = np.median(result.pop(("bound", "theta")))
            print(
                f"{'1/f input' if pink else 'white +-1'}, contamination {c}: Cramer-Rao bound of ||theta_hat - theta|| "
                f"{bound:.3f}, ||theta-bar|| {np.linalg.norm(THETA_BAR):.3f}"
            )
            for (gradient, kind), errors in result.items():
                theta, output, frequency = np.median(errors, axis=0)
                print(f"    {gradient:>12} {kind:>7}: theta {theta:.3f}  output {output:.3f}  response {frequency:.3f}")


def armax_trial(rng, contamination, Q):
    """Track A = [-1.5, .7], B = [1, .5], C = [-1, .2] from 0."""
    true = np.array([-1.5, 0.7, 1.0, 0.5, -1.0, 0.2])
    v = Contaminated(contamination, 10.0, SIGMA).rvs(size=SAMPLES, random_state=rng)
    u = rng.choice([-1.0, 1.0], SAMPLES)
    a = np.concatenate(([1.0], true[:2]))
    y = scipy.signal.lfilter([0.0, 1.0, 0.5], a, u) + scipy.signal.lfilter([1.0, -1.0, 0.2], a, v)
    return {
        (gradient, guard): late_error(
            ParameterTracker(ARMAX(2, 2, 2), P=1.0, Q=Q, R=SIGMA**2, gradient=gradient, guard=guard).run(y, u).theta,
            true,
        )
        for gradient in GRADIENTS
        for guard in GUARDS
    }


def print_armax(study):
    """Print both gradients on an ARMAX plant."""
    print(f"ARMAX, a = [-1.5, .7], b = [1, .5], c = [-1, .2], median late ||theta_hat - theta||, {study['runs']} runs")
    for c in (0.0, 0.1):
        row = medians(armax_trial, study, contamination=c, Q=1e-6)
        cells = (f"{g}: " + " ".join(f"{guard} {row[g, guard]:6.3f}" for guard in GUARDS) for g in GRADIENTS)
        print(f"  contamination {c}  " + "   ".join(cells))


PARTS = {"gradients": print_gradients, "guards": print_guards, "paper": print_paper, "armax": print_armax}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which tables (default: all)")
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for part in arguments.parts or PARTS:
        PARTS[part]({"runs": arguments.runs, "n_jobs": arguments.jobs, "seed": arguments.seed})
