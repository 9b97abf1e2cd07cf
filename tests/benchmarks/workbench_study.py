"""The workbench: delay and orders of random plants, and false alarms of the residual tests.

    python tests/benchmarks/workbench_study.py [part ..] [--plants 100] [--recordings 400] [--seed 0]

Parts: selection, alarms. Beside select_structure: a plain least-squares ARX by Akaike's criterion, over the same grid.
Beside validate: the Ljung-Box test of statsmodels on the same residuals. Fits are those of the free run on fresh input
without noise, in percent. Each target is printed with whether it is met.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from identification_study import SAMPLES, SIGMA, outlying, output_of, random_plant, target
from scipy.signal import lfilter
from statsmodels.stats.diagnostic import acorr_ljungbox

from robust_filterpy import ARX, OutputError, identify, select_structure, validate

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
        orders.append(best.structure.na == order)
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


PARTS = {"selection": selection, "alarms": alarms}

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
