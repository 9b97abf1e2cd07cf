"""The workbench: delay and orders, false alarms of the residual tests, models of the noise, bands, drift by likelihood.

    python tests/benchmarks/workbench_study.py [part ..] [--plants 100] [--recordings 400] [--seed 0]

Parts: selection, alarms, structures, coverage, tuned, sippy. With select_structure: a plain least-squares ARX by the
criterion of Akaike, over the same grid. With validate: the Ljung-Box test of statsmodels on the same residuals;
with ARMA its exact likelihood. Fits are those of the free run on fresh input without noise, in percent. Each target
is printed with whether it is met. sippy: the choice of SIPPY (``pip install sippy_unipi``, 1.0.1) on every tenth of the
plants, a quarter of a minute each.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import time
import warnings

import numpy as np
from identification_study import SAMPLES, SIGMA, outlying, output_of, random_plant, target
from scipy.signal import lfilter
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.tsa.arima.model import ARIMA

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import ARMA, BoxJenkins, select_structure, validate
from robust_filterpy.plants import simulate_output_error
from robust_filterpy.plants.linear import random_walk, stable

ORDERS, DELAYS = (1, 2, 3, 4), range(1, 9)


def late(signal, delay):
    """Return the output of a plant whose delay is not 1."""
    return np.concatenate((np.zeros(delay - 1), signal[: signal.size - delay + 1]))


def recording(seed, plant, samples=SAMPLES, contamination=0.1):
    """Return the orders and delay of a random plant, y, u, fresh input and the output that belongs to it."""
    order = ORDERS[plant % len(ORDERS)]
    rng = np.random.default_rng([seed, order, plant])
    truth, u, delay = random_plant(rng, order), rng.choice([-1.0, 1.0], samples), int(rng.choice(DELAYS))
    y = late(output_of(truth, u), delay) + outlying(rng, contamination, False, SIGMA, samples)[0]
    fresh = rng.choice([-1.0, 1.0], samples)
    return order, delay, y, u, fresh, late(output_of(truth, fresh), delay)


def free_fit(output, clean):
    """Return the fit of a free run in percent."""
    return 100.0 * (1.0 - np.linalg.norm(output - clean) / np.linalg.norm(clean - clean.mean()))


def least_squares(y, u):
    """Return the orders of the plain ARX with the least AIC, and theta."""
    first, best = DELAYS[-1] + ORDERS[-1], (np.inf,)
    for n in ORDERS:
        for nk in range(9):
            X = ARX(n, n, nk).regressors(u, y)[first:]
            theta = np.linalg.lstsq(X, y[first:], rcond=None)[0]
            error = y[first:] - X @ theta
            best = min(best, (error.size * np.log(error @ error) + 4 * n, nk, n, theta), key=lambda one: one[0])
    return best[1:]


def selection(arguments):
    """Find the delay and the orders of random plants with 10 % outliers."""
    delays, same, orders, peers, losses, peer_losses, walls = [], [], [], [], [], [], []
    for plant in range(arguments.plants):
        order, delay, y, u, fresh, clean = recording(arguments.seed, plant)
        start = time.process_time()
        best = select_structure(y, u).best
        walls.append(time.process_time() - start)
        true = identify(y, u, OutputError(order, order, delay))
        fits = [free_fit(model.simulate(fresh) - model.level, clean) for model in (best, true)]
        delays.append(best.structure.nk == delay)
        orders.append(best.structure.nf == order)
        losses.append(fits[1] - fits[0])
        same.append(losses[-1] <= 0.2)
        nk, n, theta = least_squares(y, u)
        peers.append(nk == delay)
        peer_losses.append(fits[1] - free_fit(lfilter([*[0.0] * nk, *theta[n:]], [1.0, *theta[:n]], fresh), clean))
    share = 100.0 / arguments.plants
    target("delays found, of 100 plants", share * sum(delays), 95, least=True)
    target("fit within .2 points of the true structure's, of 100 plants", share * sum(same), 95, least=True)
    print(f"  order found {share * sum(orders):.0f} %; points below the true structure, worst {max(losses):.2f}")
    print(f"  least-squares AIC: delay {share * sum(peers):.0f} %, points below, median {np.median(peer_losses):.1f}")
    print(f"  processor time of one choice, median {np.median(walls):.1f} s")


def sippy(arguments):
    """Let SIPPY choose among the same orders and delays, by its criterion of Bayes, and count as for `selection`."""
    try:
        from sippy_unipi import system_identification
    except ImportError:
        print("  SIPPY is not installed")
        return
    found = {"delay": [], "SIPPY's": [], "select_structure's": []}
    for plant in range(0, arguments.plants, 10):
        # Plants in tens would all have one order in common.
        order, delay, y, u, fresh, clean = recording(arguments.seed, plant + (plant // 10) % 4)
        orders = [ORDERS[0], ORDERS[-1]]
        with contextlib.redirect_stdout(None):
            # Its delay comes on top of the one sample that every B has.
            chosen = system_identification(y, u, "ARX", IC="BIC", na_ord=orders, nb_ord=orders, delays=[0, 8])
        numerator, denominator = chosen.G.num[0][0], chosen.G.den[0][0]
        numerator = np.concatenate((np.zeros(len(denominator) - len(numerator)), numerator))
        first = int(np.flatnonzero(np.abs(numerator) > 1e-12)[0])
        true, best = identify(y, u, OutputError(order, order, delay)), select_structure(y, u).best
        fit = free_fit(true.simulate(fresh) - true.level, clean)
        found["delay"].append(first == delay)
        found["SIPPY's"].append(fit - free_fit(lfilter(numerator, denominator, fresh), clean))
        found["select_structure's"].append(fit - free_fit(best.simulate(fresh) - best.level, clean))
    print(f"  SIPPY's ARX by BIC, {len(found['delay'])} plants: delay {100 * np.mean(found['delay']):.0f} %")
    for name in ("SIPPY's", "select_structure's"):
        middle, worst = np.median(found[name]), max(found[name])
        print(f"  {name} points below the true structure: median {middle:.1f}, worst {worst:.1f}")


def alarms(arguments):
    """Count the alarms of the tests at 5 % for right models, on their own recording and on a fresh one."""
    for contamination in (0.0, 0.1, 0.2):
        p_values = {"whiteness, own": [], "input, own": [], "whiteness, fresh": [], "input, fresh": []}
        peer = []
        for k in range(arguments.recordings):
            plant = 4 * k + 1
            _, delay, y, u, _, _ = recording(arguments.seed, plant, 600, contamination)
            model = identify(y[:300], u[:300], OutputError(2, 2, delay))
            for name, part in (("own", slice(0, 300)), ("fresh", slice(300, 600))):
                found = validate(model, y[part], u[part], level=0.95, steps=1)
                p_values[f"whiteness, {name}"].append(found.whiteness.p_value)
                p_values[f"input, {name}"].append(found.independence.p_value)
            residual = model.residuals(y[300:], u[300:])
            peer.append(float(acorr_ljungbox(residual[~np.isnan(residual)], lags=[20]).lb_pvalue.iloc[0]))
        error = 5.0 * np.sqrt(0.05 * 0.95 / arguments.recordings)
        for name, values in p_values.items():
            rate = float(np.mean(np.array(values) < 0.05))
            target(
                f"distance from .05 of the rate of alarms {rate:.3f}, {name}, contamination {contamination}",
                abs(rate - 0.05),
                round(error, 4),
            )
        print(f"  Ljung-Box of statsmodels, fresh, contamination {contamination}: {np.mean(np.array(peer) < 0.05):.3f}")


def tuned(arguments):
    """Choose Q of a tracker for plants that drift, 10 % outliers, and compare with the best Q in hindsight."""
    # Two steps are the factor of the target.
    steps, samples = 1e-9 * 3.0 ** (0.5 * np.arange(30)), 3000
    within, losses, peers = [], [], []
    for plant in range(arguments.plants):
        rng = np.random.default_rng([arguments.seed, 14, plant])
        order, drift = 1 + plant % 2, 10.0 ** rng.uniform(-7.0, -4.0)
        truth = random_plant(rng, order)
        path = random_walk(truth, drift, samples, rng, accept=stable(order, 0.99))
        u = rng.choice([-1.0, 1.0], samples)
        clean = simulate_output_error(path, u, na=order, nb=order, nk=1).y
        y = clean + outlying(rng, 0.1, False, SIGMA, samples)[0]
        started, runs, late = ParameterTracker(OutputError(order, order)), {}, slice(40 * order, None)
        # No Q changes what the start makes of its samples.
        started.run(y[:400], u[:400])
        for Q in steps:
            one = copy.deepcopy(started)
            one.Q = Q
            runs[Q] = one.run(y[400:], u[400:])
        errors = {Q: np.sqrt(np.mean((run.prediction - clean[400:])[late] ** 2)) for Q, run in runs.items()}
        best = min(errors, key=errors.get)
        chosen = max(runs, key=lambda Q: runs[Q].log_likelihood())
        squares = min(runs, key=lambda Q: np.mean(runs[Q].residual[late] ** 2))
        within.append(max(chosen / best, best / chosen) < 3.1)
        peers.append(max(squares / best, best / squares) < 3.1)
        losses.append(100.0 * (errors[chosen] / errors[best] - 1.0))
    share = 100.0 / arguments.plants
    target("Q within a factor 3 of the best in hindsight, of 100 plants", share * sum(within), 90, least=True)
    print(f"  error above the best one's, percent: median {np.median(losses):.1f}, worst {max(losses):.1f}")
    print(f"  by the least mean square of the residuals, outliers and all: {share * sum(peers):.0f}")


def wandering(seed, contamination, samples=SAMPLES):
    """Return a recording of a plant of order 2 whose noise is an AR(1) of .98, with outliers of the sensor."""
    rng = np.random.default_rng([seed, 98])
    u = rng.choice([-1.0, 1.0], samples)
    noise = lfilter([1.0], [1.0, -0.98], SIGMA * rng.normal(size=samples + 500))[500:]
    wild = rng.random(samples) < contamination
    return lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + noise + wild * 10.0 * SIGMA * rng.normal(size=samples), u


def structures(arguments):
    """Compare the errors of b and f by models with and without one of the noise."""
    theta = np.array([1.0, 0.5, -1.5, 0.7])
    for contamination in (0.0, 0.1):
        errors = {"output error": [], "Box-Jenkins": [], "output error, prewhitened": [], "Box-Jenkins, tracker": []}
        for k in range(arguments.plants):
            y, u = wandering(arguments.seed + k, contamination)
            differences = [lfilter([1.0, -0.98], [1.0], signal)[1:] for signal in (y, u)]
            tracker = ParameterTracker(BoxJenkins(2, 0, 1, 2))
            tracker.run(y, u)
            found = {
                "output error": identify(y, u, OutputError(2, 2)).theta[[2, 3, 0, 1]],
                "Box-Jenkins": identify(y, u, BoxJenkins(2, 0, 1, 2)).theta[:4],
                "output error, prewhitened": identify(*differences, OutputError(2, 2)).theta[[2, 3, 0, 1]],
                "Box-Jenkins, tracker": tracker.theta[:4],
            }
            for name, values in found.items():
                errors[name].append(np.linalg.norm(values - theta))
        medians = {name: np.median(values) for name, values in errors.items()}
        target(
            f"error of Box-Jenkins over that of output error, contamination {contamination}",
            medians["Box-Jenkins"] / medians["output error"],
            0.6,
        )
        print("  median errors: " + ", ".join(f"{name} {value:.4f}" for name, value in medians.items()))
    apart, robust, plain = [], [], []
    for k in range(arguments.plants):
        rng = np.random.default_rng([arguments.seed + k, 21])
        y = lfilter([1.0, 0.5], [1.0, -1.5, 0.7], rng.normal(size=SAMPLES + 500))[500:]
        spoilt = y + 10.0 * rng.normal(size=SAMPLES) * (rng.random(SAMPLES) < 0.05)
        exact, deceived = (exact_arma(signal) for signal in (y, spoilt))
        model = identify(y, None, ARMA(2, 1))
        apart.append(np.abs(model.theta - exact) / model.std)
        robust.append(np.linalg.norm(identify(spoilt, None, ARMA(2, 1)).theta - [-1.5, 0.7, 0.5]))
        plain.append(np.linalg.norm(deceived - [-1.5, 0.7, 0.5]))
    print(f"  ARMA(2, 1) from the exact likelihood, clean, median {np.median(apart):.2f} standard deviations")
    print(f"  with 5 % outliers, median error: identify {np.median(robust):.3f}, statsmodels {np.median(plain):.3f}")


def exact_arma(y):
    """Return a and c of an ARMA(2, 1) by statsmodels' exact likelihood."""
    found = ARIMA(y, order=(2, 0, 1)).fit()
    return np.concatenate((-found.arparams, found.maparams))


PLANTS = {
    "ordinary": ([1.0, -1.5, 0.7], [1.0, 0.5]),
    "lightly damped": (np.poly([0.985 * np.exp(0.6j), 0.985 * np.exp(-0.6j)]).real, [1.0, 0.3]),
    "slow": ([1.0, -0.98], [0.2]),
}


def coverage(arguments):
    """Count how often the bands of 95 % hold the truth: responses at all frequencies and times, poles, parameters."""
    omega = np.linspace(0.05, 3.1, 25)
    at = np.exp(-1j * omega)
    for contamination in (0.0, 0.1):
        inside = {}
        for name, (a, b) in PLANTS.items():
            n, m = len(a) - 1, len(b)
            truth = np.polyval(b[::-1], at) * at / np.polyval(a[::-1], at)
            step = lfilter([0.0, *b], a, np.ones(60))
            for k in range(arguments.recordings // 2):
                rng = np.random.default_rng([arguments.seed, k])
                u = rng.choice([-1.0, 1.0], 500)
                y = lfilter([0.0, *b], a, u) + outlying(rng, contamination, False, SIGMA, 500)[0]
                model = identify(y, u, OutputError(n, m))
                found, rise = model.frequency_response(omega, rng=rng), model.step_response(60, rng=rng)
                poles = model.poles(rng=rng)
                apart = np.angle(truth / found.response)
                true_poles = np.roots(a)
                order = np.argmin(np.abs(poles.values[:, None] - true_poles), axis=1)
                size = np.abs(truth)
                interval = model.confidence_intervals()
                theta = np.concatenate((a[1:], b))
                checks = {
                    "parameters": (interval.lower <= theta) & (theta <= interval.upper),
                    "magnitude": (found.magnitude_lower <= size) & (size <= found.magnitude_upper),
                    "phase": (found.phase_lower - found.phase <= apart) & (apart <= found.phase_upper - found.phase),
                    "step": ((rise.lower <= step) & (step <= rise.upper))[1:],
                    "poles": poles.contains(true_poles[order]),
                }
                for kind, good in checks.items():
                    inside.setdefault((name, kind), []).append(np.mean(good))
                inside.setdefault((name, "sampled share"), []).append(np.mean(found.sampled))
        for (name, kind), shares in inside.items():
            share = 100.0 * np.mean(shares)
            if kind == "sampled share":
                print(f"  {name}: {share:.0f} % of the frequencies by sampling")
                continue
            print(
                f"  {'met   ' if 90.0 <= share <= 98.0 else 'MISSED'} {share:.1f} % in 90 .. 98 %: "
                f"{kind} of the {name} plant, contamination {contamination}"
            )


PARTS = {
    "selection": selection,
    "alarms": alarms,
    "structures": structures,
    "coverage": coverage,
    "tuned": tuned,
    "sippy": sippy,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="which tables (default: all)")
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--recordings", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    # Doubtful models count like the others.
    warnings.simplefilter("ignore", UserWarning)
    for part in given.parts or PARTS:
        PARTS[part](given)
