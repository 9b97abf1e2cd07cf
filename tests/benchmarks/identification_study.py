"""How good a model `identify` finds from nothing: cold starts, noise, slow sampling, offsets, units, time, regressors.

    python tests/benchmarks/identification_study.py [part ..] [--plants 100] [--orders 2 3 4 6] [--seed 0]

Parts: intervals, tracker, drifting, noise_scale, regressors, plants, noise, sampling, invariance, time, arx.

With it: the estimate that starts at the truth, the one that knows which samples are outliers, scipy's
`least_squares(loss="soft_l1")` from a naive start, filterpy's Kalman filter in the tracker, and padasip's recursive
least squares. Each target is printed with whether it is met. A table is printed
line by line as it comes, and every line can be had alone, by naming its part and one order. Fits are those of the free
run on fresh input without noise, in percent: median / 10 % quantile / worst.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
import scipy.optimize
import scipy.signal
from filterpy.kalman import KalmanFilter
from measuring import target
from padasip.filters import FilterRLS

from robust_filterpy import ARX, Huber, OutputError, ParameterTracker, identify
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.identification.estimation.prediction_error import minimised
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence import Linear
from robust_filterpy.plants import simulate_output_error

SAMPLES = 2000
SIGMA = 0.3
CONTAMINATIONS = (0.0, 0.1, 0.2, 0.3)
HUBER = Huber()
LEARNT_LIMITS = dict(zip(CONTAMINATIONS, (1.02, 1.07, 1.10, 1.15), strict=True))


# Plants, recordings and what is made of them.


def random_plant(rng, order):
    """Draw theta of a stable plant of unit gain from white noise, poles of .4 to .97 in size."""
    poles = [rng.uniform(-0.5, 0.95)] if order % 2 else []
    for _ in range(order // 2):
        pole = rng.uniform(0.4, 0.97) * np.exp(1j * rng.uniform(0.1, 2.5))
        poles += [pole, pole.conjugate()]
    a, b = np.real(np.poly(poles)), rng.normal(size=order)
    response = scipy.signal.lfilter(np.concatenate(([0.0], b)), a, np.eye(1, 1000)[0])
    return np.concatenate((a[1:], b / np.linalg.norm(response)))


def output_of(theta, u):
    """Return the output of a plant with as many b's as a's, from rest."""
    order = len(theta) // 2
    return scipy.signal.lfilter(np.concatenate(([0.0], theta[order:])), np.concatenate(([1.0], theta[:order])), u)


def outlying(rng, contamination, one_sided, sigma, size):
    """Return noise and which samples of it are outliers, 10 times as large."""
    labels, noise = rng.random(size) < contamination, rng.normal(size=size)
    noise[labels] = 10.0 * (np.abs(noise[labels]) if one_sided else noise[labels])
    return sigma * noise, labels


def fit(theta, truth, u):
    """Return the fit of the free run in percent; -100 for an unstable model."""
    order = len(truth) // 2
    if np.abs(np.roots(np.concatenate(([1.0], theta[:order])))).max() >= 1.0:
        return -100.0
    y = output_of(truth, u)
    return 100.0 * (1.0 - np.linalg.norm(output_of(theta, u) - y) / np.linalg.norm(y - y.mean()))


def from_truth(truth, y, u, influence=HUBER):
    """Return the estimate by Huber's loss, or another one, that starts at the truth, by the same search."""
    order = len(truth) // 2
    model = PolynomialModel(OutputError(order, order), y, u[:, None], True)
    start, rows = np.concatenate((truth, np.zeros(1 + order))), model.conditioned
    return minimised(model, start, Noise(influence, SIGMA**2, influence is not HUBER), rows).p[: 2 * order]


class KnownNoise:
    """The score of the noise as it is: no `Contaminated`, which would be learnt."""

    def __init__(self, contamination):
        mixture = Contaminated(contamination, 10.0) if contamination else Linear()
        self.rho, self.psi, self.psi_deriv, self.weights = mixture.rho, mixture.psi, mixture.psi_deriv, mixture.weights


def by_scipy(y, u, start, weights=None):
    """Return scipy's estimate from a start; its soft_l1 loss with the scale of the start, or weighted squares."""
    root = 1.0 if weights is None else np.sqrt(weights)

    def residual(p):
        with np.errstate(over="ignore", invalid="ignore"):
            return np.clip(np.nan_to_num((y - output_of(p[:-1], u) - p[-1]) * root, nan=1e6), -1e6, 1e6)

    p = np.append(start, np.median(y))
    scale = 1.4826 * np.median(np.abs(residual(p)))
    loss = {"loss": "soft_l1", "f_scale": scale} if weights is None else {"xtol": 1e-12, "ftol": 1e-12}
    return scipy.optimize.least_squares(residual, p, x_scale="jac", max_nfev=200, **loss).x[:-1]


def naive_start(y, u, order):
    """Return the plain least-squares ARX model."""
    X = ARX(order, order).regressors(u, y)
    return np.linalg.lstsq(X, y, rcond=None)[0]


def by_padasip(y, u, order):
    """Return the ARX model of padasip's recursive least squares."""
    adaptive = FilterRLS(2 * order, mu=1.0)
    adaptive.run(y, ARX(order, order).regressors(u, y))
    return adaptive.w


def recording(seed, order, plant, contamination, one_sided=False):
    """Return the plant's theta, y, u, which samples are outliers, and fresh input."""
    rng = np.random.default_rng([seed, order, plant])
    truth = random_plant(rng, order)
    u = rng.choice([-1.0, 1.0], SAMPLES)
    noise, labels = outlying(rng, contamination, one_sided, SIGMA, SAMPLES)
    return truth, output_of(truth, u) + noise, u, labels, rng.choice([-1.0, 1.0], SAMPLES)


# Printing.


def spread(values):
    """Return median / 10 % quantile / worst."""
    return f"{np.median(values):6.2f} /{np.quantile(values, 0.1):6.2f} /{np.min(values):7.2f}"


# Parts.


def plants(arguments):
    """Compare Huber's estimate from nothing with the one from the truth."""
    for order in arguments.orders:
        for contamination, one_sided in ((0.0, False), (0.1, False), (0.2, False), (0.1, True), (0.2, True)):
            found = {"identify": [], "from the truth": [], "learnt": [], "scipy, naive": []}
            for plant in range(arguments.plants):
                truth, y, u, _, fresh = recording(arguments.seed, order, plant, contamination, one_sided)
                structure = OutputError(order, order)
                estimates = {
                    "identify": identify(y, u, structure, influence=Huber()).theta,
                    "from the truth": from_truth(truth, y, u),
                    "learnt": identify(y, u, structure).theta,
                    "scipy, naive": by_scipy(y, u, naive_start(y, u, order)),
                }
                for name, theta in estimates.items():
                    found[name].append(fit(theta, truth, fresh))
            where = f"order {order}, contamination {contamination}{', one-sided' if one_sided else ''}"
            print(f"{where}: " + "   ".join(f"{name} {spread(values)}" for name, values in found.items()), flush=True)
            ours, best = np.array(found["identify"]), np.array(found["from the truth"])
            target(f"points of fit below the estimate from the truth, median, {where}", *below(ours, best, 0.5), 0.1)
            target(f"points of fit below the estimate from the truth, q10, {where}", *below(ours, best, 0.1), 0.1)
            target(
                f"points of fit below the estimate from the truth, any plant, {where}", float((best - ours).max()), 1
            )


def below(ours, best, quantile):
    """Return how far a quantile of ours is below that of the best, as a list of one."""
    return [float(np.quantile(best, quantile) - np.quantile(ours, quantile))]


def noise(arguments):
    """Compare the default, which learns the noise, with the estimate that knows which samples are outliers.

    Nobody who knows the noise but not the labels can do better than the score of that noise: "noise known" starts at
    the truth with R, share and size as they are. For long recordings its error is sqrt(labels' information over the
    mixture's) = 1.044/1.079/1.116 of the label-knowing one at contamination .1/.2/.3 (Fisher information by
    quadrature); for a hundred plants the ratio itself has a standard error, which is printed.
    """
    for order in arguments.orders:
        for contamination in CONTAMINATIONS:
            errors = {"learnt": [], "Huber": [], "noise known": [], "label-knowing": []}
            for plant in range(arguments.plants):
                truth, y, u, labels, fresh = recording(arguments.seed, order, plant, contamination)
                structure, clean = OutputError(order, order), output_of(truth, fresh)
                estimates = {
                    "learnt": identify(y, u, structure).theta,
                    "Huber": identify(y, u, structure, influence=Huber()).theta,
                    "noise known": from_truth(truth, y, u, KnownNoise(contamination)),
                    "label-knowing": by_scipy(y, u, truth, np.where(labels, 0.01, 1.0)),
                }
                for name, theta in estimates.items():
                    error = np.linalg.norm(output_of(theta, fresh) - clean) / np.linalg.norm(clean)
                    errors[name].append(error)
            rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
            where = f"order {order}, contamination {contamination}"
            print(f"{where}: relative error, root mean square: " + "  ".join(f"{n} {v:.4f}" for n, v in rms.items()))
            target(
                f"learnt over label-knowing, {where}",
                rms["learnt"] / rms["label-knowing"],
                LEARNT_LIMITS[contamination],
            )
            for name in ("learnt", "noise known"):
                error = standard_error(errors[name], errors["label-knowing"])
                print(f"    {name} over label-knowing {rms[name] / rms['label-knowing']:.3f} -+ {error:.3f}")
            print(f"    learnt over noise known {rms['learnt'] / rms['noise known']:.3f}", flush=True)


def standard_error(errors, others):
    """Return the standard error, over the plants, of the ratio of two root mean squares."""
    squares, other_squares = np.square(errors), np.square(others)
    ratio = np.sqrt(squares.mean() / other_squares.mean())
    each = 0.5 * ratio * (squares / squares.mean() - other_squares / other_squares.mean())
    return float(np.std(each) / np.sqrt(each.size))


def sampled(seed, period, plant):
    """Return a second-order plant's theta, y with 5 % noise and 10 % outliers, and u."""
    rng = np.random.default_rng([seed, period, plant])
    damping, hold, size = rng.uniform(0.2, 1.2), max(1, period // 8), 3000
    b, a, _ = scipy.signal.cont2discrete(([1.0], [1.0, 2 * damping, 1.0]), 2 * np.pi / period)
    truth = np.concatenate((a[1:], b.ravel()[1:]))
    u = np.repeat(rng.choice([-1.0, 1.0], size // hold + 1), hold)[:size]
    clean = output_of(truth, u)
    return truth, clean + outlying(rng, 0.1, False, 0.05 * clean.std(), size)[0], u


def sampling(arguments):
    """Identify second-order plants sampled ever faster, with 5 % noise and 10 % outliers."""
    for period in (15, 30, 60, 100):
        fits = []
        for plant in range(arguments.plants):
            truth, y, u = sampled(arguments.seed, period, plant)
            fits.append(fit(identify(y, u, OutputError(2, 2)).theta, truth, u))
        print(f"{period} samples per period, 5 % noise, 10 % outliers: {spread(fits)}")
        target(f"worst fit, {period} samples per period", min(fits), 99, least=True)


def invariance(arguments):
    """Move and scale y and u: the model must be the same."""
    apart = {"offset": 0.0, "unit of y": 0.0, "unit of u": 0.0}
    for plant in range(min(arguments.plants, 20)):
        _, y, u, _, _ = recording(arguments.seed, 4, plant, 0.1)
        one = identify(y, u, OutputError(4, 4)).theta
        for offset in (5.0, 50.0):
            apart["offset"] = max(apart["offset"], relative(identify(y + offset, u, OutputError(4, 4)).theta, one))
        for unit in (1e-3, 1e3):
            size = np.repeat((1.0, unit), 4)
            of_y, of_u = identify(unit * y, u, OutputError(4, 4)), identify(y, unit * u, OutputError(4, 4))
            apart["unit of y"] = max(apart["unit of y"], relative(of_y.theta / size, one))
            apart["unit of u"] = max(apart["unit of u"], relative(of_u.theta * size, one))
    for what, value in apart.items():
        target(f"relative difference of theta, {what}", value, 1e-6)


def relative(theta, other):
    """Return the largest difference over the size of theta."""
    return float(np.abs(theta - other).max() / np.abs(other).max())


def seconds(arguments):
    """Time 2000 samples of order 4."""
    walls, cpus = [], []
    for plant in range(min(arguments.plants, 40)):
        _, y, u, _, _ = recording(arguments.seed, 4, plant, 0.1)
        wall, cpu = time.perf_counter(), time.process_time()
        identify(y, u, OutputError(4, 4))
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    print(f"2000 samples of order 4: median {np.median(walls):.2f} s, of the processor {np.median(cpus):.2f} s")
    target("median time in s", float(np.median(walls)), 1.0)


def measured_badly(rng, truth, contamination):
    """Return input, output and labels of an ARX(2, 2) plant of whose outputs some are measured with gross errors."""
    u, a = rng.choice([-1.0, 1.0], SAMPLES), np.concatenate(([1.0], truth[:2]))
    y = output_of(truth, u) + scipy.signal.lfilter([1.0], a, 0.5 * rng.normal(size=SAMPLES))
    labels = rng.random(SAMPLES) < contamination
    y[labels] += 5.0 * rng.normal(size=labels.sum())
    return u, y, labels


def arx(arguments):
    """Identify an ARX(2, 2) plant whose measurements have outliers, which its regressor holds."""
    truth = np.array([-1.5, 0.7, 1.0, 0.5])
    for contamination in (0.0, 0.02, 0.1, 0.2):
        errors = {"identify": [], "Huber, measured": [], "label-knowing": [], "label-knowing, rows left out": []}
        for plant in range(arguments.plants):
            u, y, labels = measured_badly(np.random.default_rng([arguments.seed, 22, plant]), truth, contamination)
            X, good = ARX(2, 2).regressors(u, y), np.convolve(labels, np.ones(3))[:SAMPLES] == 0
            measured = PolynomialModel(ARX(2, 2), y, u[:, None], True)
            estimates = {
                "identify": identify(y, u, ARX(2, 2)).theta,
                "Huber, measured": minimised(
                    measured, np.zeros(5), Noise(Huber(), 1.0), measured.conditioned
                ).p[:4],
                "label-knowing": identify(np.where(labels, np.nan, y), u, ARX(2, 2)).theta,
                "label-knowing, rows left out": np.linalg.lstsq(X[good], y[good], rcond=None)[0],
            }
            for name, theta in estimates.items():
                errors[name].append(np.linalg.norm(theta - truth))
        rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
        print(f"ARX(2, 2), contamination {contamination}: error of theta, root mean square and median: ", end="")
        print("   ".join(f"{name} {value:.4f} {np.median(errors[name]):.4f}" for name, value in rms.items()))
        if contamination == 0.1:
            target(
                "identify over label-knowing, ARX(2, 2), contamination 0.1", rms["identify"] / rms["label-knowing"], 1.3
            )


def tracker(arguments):
    """Track OE(4, 4) plants by default, nothing given, and compare with the batch estimate that starts at the truth."""
    found = {"tracker": [], "given R, start=0": [], "filterpy's Kalman": [], "padasip": [], "from the truth": []}
    for plant in range(arguments.plants):
        truth, y, u, _, fresh = recording(arguments.seed, 4, plant, 0.1)
        structure = OutputError(4, 4)
        for name, one in (
            ("tracker", ParameterTracker(structure)),
            ("given R, start=0", ParameterTracker(structure, R=SIGMA**2, start=0)),
            ("filterpy's Kalman", ParameterTracker(structure, filter=KalmanFilter)),
        ):
            one.run(y, u)
            found[name].append(fit(one.theta, truth, fresh))
        found["padasip"].append(fit(by_padasip(y, u, 4), truth, fresh))
        found["from the truth"].append(fit(from_truth(truth, y, u), truth, fresh))
    print("OE(4, 4), contamination 0.1: " + "   ".join(f"{name} {spread(values)}" for name, values in found.items()))
    ours, best = np.array(found["tracker"]), np.array(found["from the truth"])
    target("points of fit below the estimate from the truth, median", *below(ours, best, 0.5), 0.8)
    target("points of fit below the estimate from the truth, q10", *below(ours, best, 0.1), 1.5)
    target("worst fit of the tracker", float(ours.min()), 90, least=True)
    fits = [fit(tracked.theta, truth, u) for tracked, truth, u in slowly_sampled(arguments, 60)]
    print(f"60 samples per period: {spread(fits)}")
    target("worst fit, 60 samples per period", min(fits), 98, least=True)


def drifting(arguments):
    """Follow parameters that wander, or jump, after the start: given nothing but Q, with the recursion given all."""
    for name, jump in (("wander by Q = 1e-5 I", 0.0), ("jump by .3 in b", 0.3)):
        errors = {"given nothing but Q": [], "given R, theta, P and Q": [], "filterpy's Kalman, given Q only": []}
        for plant in range(arguments.plants):
            rng = np.random.default_rng([arguments.seed, 41, plant])
            steps = np.sqrt(1e-5) * rng.normal(size=(SAMPLES, 4)) * (jump == 0.0)
            steps[:500] = 0.0
            steps[1200, 2:] += jump
            path = np.array([-1.5, 0.7, 1.0, 0.5]) + np.cumsum(steps, axis=0)
            # A pole pair inside the unit circle, whatever the walk does.
            path[:, 1] = np.clip(path[:, 1], 0.4, 0.9)
            path[:, 0] = np.clip(path[:, 0], -1.65, -1.2)
            u = rng.choice([-1.0, 1.0], SAMPLES)
            noise = outlying(rng, 0.1, False, SIGMA, SAMPLES)[0]
            y = simulate_output_error(path, u, noise=noise, na=2, nb=2).y
            given = dict(theta=path[0], P=0.01, R=SIGMA**2)
            for kind, options in zip(errors, ({}, given, {"filter": KalmanFilter}), strict=True):
                found = ParameterTracker(OutputError(2, 2), Q=1e-5, **options).run(y, u).theta
                errors[kind].append(np.linalg.norm(found - path, axis=1)[600:].mean())
        means = {kind: float(np.mean(values)) for kind, values in errors.items()}
        print(f"{name}: mean error of theta: " + "   ".join(f"{kind} {value:.4f}" for kind, value in means.items()))
        nothing, everything = list(means.values())[:2]
        target(f"given nothing but Q, over given everything, {name}", nothing / everything, 1.0)


def slowly_sampled(arguments, period):
    """Yield trackers after recordings of second-order plants, their truth and input."""
    for plant in range(arguments.plants):
        truth, y, u = sampled(arguments.seed, period, plant)
        tracked = ParameterTracker(OutputError(2, 2))
        tracked.run(y, u)
        yield tracked, truth, u


def noise_scale(arguments):
    """Follow an R that is not given: errors with the true R, coverage of the intervals, a step of the noise."""
    truth = np.array([-1.5, 0.7, 1.0, 0.5])
    for contamination in (0.0, 0.1):
        errors, inside = {"given R": [], "followed": [], "from 1e-4 R": [], "from 1e4 R": []}, []
        for plant in range(arguments.plants):
            rng = np.random.default_rng([arguments.seed, 31, plant])
            u = rng.choice([-1.0, 1.0], SAMPLES)
            y = output_of(truth, u) + outlying(rng, contamination, False, SIGMA, SAMPLES)[0]
            model = identify(y[:400], u[:400], OutputError(2, 2))
            trackers = {
                "given R": ParameterTracker(model, R=SIGMA**2),
                "followed": ParameterTracker(model),
                "from 1e-4 R": ParameterTracker(model),
                "from 1e4 R": ParameterTracker(model),
            }
            for name, factor in (("from 1e-4 R", 1e-4), ("from 1e4 R", 1e4)):
                # As if nothing had been seen of the noise before.
                trackers[name].filter.R = np.array([[factor * SIGMA**2]])
                now = trackers[name]._now
                trackers[name]._now = now.with_parts(scale=now.scale * [1.0, 0.0, 1.0, 1.0])
            for name, one in trackers.items():
                one.run(y[400:], u[400:])
                errors[name].append(np.linalg.norm(one.theta - truth))
            low, high = trackers["followed"].confidence_intervals()
            inside.append((low <= truth) & (truth <= high))
        rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
        print(f"contamination {contamination}: " + "  ".join(f"{name} {value:.4f}" for name, value in rms.items()))
        for name in list(rms)[1:]:
            target(
                f"error over that with the true R, {name}, contamination {contamination}",
                rms[name] / rms["given R"],
                1.1,
            )
        coverage = float(np.mean(inside))
        target(f"coverage of 95 % intervals, contamination {contamination}", coverage, 0.9, least=True)
        target(f"coverage of 95 % intervals, contamination {contamination}", coverage, 0.98)
    rng = np.random.default_rng([arguments.seed, 32])
    u = rng.choice([-1.0, 1.0], SAMPLES)
    size = SIGMA * np.where(np.arange(SAMPLES) < 1000, 1.0, 3.0)
    y = output_of(truth, u) + size * rng.normal(size=SAMPLES)
    one = ParameterTracker(OutputError(2, 2))
    one.run(y[:1000], u[:1000])
    path = [one.R / SIGMA**2]
    for k in range(1000, SAMPLES, 50):
        one.run(y[k : k + 50], u[k : k + 50])
        path.append(one.R / SIGMA**2)
    print("R over the first R, every 50 samples, while it steps by 9: " + " ".join(f"{value:.1f}" for value in path))
    target("share of the step that is followed after 150 samples, the memory", path[3] / 9.0, 0.63, least=True)


def regressors(arguments):
    """Compare measured and cleaned outputs in the regressor of an ARX(2, 2) tracker, both from the same start."""
    truth = np.array([-1.5, 0.7, 1.0, 0.5])
    for contamination in (0.0, 0.02, 0.1, 0.2):
        errors = {"measured": [], "cleaned": [], "label-knowing": []}
        for plant in range(arguments.plants):
            u, y, labels = measured_badly(np.random.default_rng([arguments.seed, 22, plant]), truth, contamination)
            for regressor in ("measured", "cleaned"):
                one = ParameterTracker(ARX(2, 2), regressor=regressor)
                one.run(y, u)
                errors[regressor].append(np.linalg.norm(one.theta - truth))
            given = identify(np.where(labels, np.nan, y), u, ARX(2, 2)).theta
            errors["label-knowing"].append(np.linalg.norm(given - truth))
        rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
        print(f"ARX(2, 2), contamination {contamination}: " + "  ".join(f"{n} {v:.4f}" for n, v in rms.items()))
        if contamination == 0.1:
            target("tracker, cleaned, over label-knowing", rms["cleaned"] / rms["label-knowing"], 1.3)


def intervals(arguments):
    """How often intervals of 95 % hold a parameter, and bands the magnitude; how many are found in which way."""
    omega = np.linspace(0.05, 3.0, 40)
    for order, share in ((order, share) for order in arguments.orders for share in arguments.shares):
        inside, banded, walls, bent = [], [], [], 0
        for plant in range(arguments.plants):
            truth, y, u, _, _ = recording(arguments.seed, order, plant, share)
            wall = time.perf_counter()
            model = identify(y, u, OutputError(order, order), progress=False)
            walls.append(time.perf_counter() - wall)
            inside.append(np.mean(np.abs(model.theta - truth) < 1.96 * model.std))
            whole = np.append(0.0, truth[order:]), np.append(1.0, truth[:order])
            magnitude, found = np.abs(scipy.signal.freqz(*whole, omega)[1]), model.frequency_response(omega, dt=1.0)
            banded.append(np.mean((found.magnitude_lower <= magnitude) & (magnitude <= found.magnitude_upper)))
            bent += model.profiled
        means = [f"{np.mean(each):.3f} +- {np.std(each) / len(each) ** 0.5:.3f}" for each in (inside, banded)]
        print(
            f"order {order}, contamination {share}: parameters {means[0]}, bands {means[1]}; "
            f"profile {bent} of {len(inside)}; median time {np.median(walls):.1f} s",
            flush=True,
        )


PARTS = {
    "intervals": intervals,
    "tracker": tracker,
    "drifting": drifting,
    "noise_scale": noise_scale,
    "regressors": regressors,
    "plants": plants,
    "noise": noise,
    "sampling": sampling,
    "invariance": invariance,
    "time": seconds,
    "arx": arx,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which tables (default: all)")
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--orders", type=int, nargs="*", default=[2, 3, 4, 6])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.0, 0.1], help="contaminations of `intervals`")
    given = parser.parse_args()
    # Doubtful models count like the others.
    warnings.simplefilter("ignore", UserWarning)
    for part in given.parts or PARTS:
        PARTS[part](given)
