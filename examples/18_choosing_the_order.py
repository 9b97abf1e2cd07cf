"""How many parameters does a recording with outliers pay for, and how long is the delay?

Every parameter makes the fit to the recording better, and after some of them only to its noise. `select_structure`
takes the structure with the least -2 log L + n log N, L the likelihood under a density that counts an outlier as one
bounded cost whichever model it is held against; least squares, of an ARX model, count its square. Both choose from the
same orders and delays here, and fresh data without noise say who was right.
"""

# %% A plant of second order with a delay of 4 samples; one reading in ten is ten times as bad.
import argparse
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from robust_filterpy import ARX
from robust_filterpy.identification import select_structure
from robust_filterpy.testing import fit_percent

A, B = [1.0, -1.5, 0.7], [0.0, 0.0, 0.0, 0.0, 1.0, 0.5]
STEPS, ORDERS, DELAYS = 1200, range(1, 5), range(1, 9)


def recording(rng):
    """Return y, u."""
    u = rng.choice([-1.0, 1.0], STEPS)
    noise = np.where(rng.random(STEPS) < 0.1, 6.0, 0.6) * rng.normal(size=STEPS)
    return lfilter(B, A, u) + noise, u


def least_squares(y, u):
    """Return numerator and denominator of the ARX model with the least information criterion of Schwarz."""
    found = (np.inf, None, None)
    for order in ORDERS:
        for delay in DELAYS:
            X = ARX(order, order, delay).regressors(u, y)[ORDERS[-1] + DELAYS[-1] :]
            target = y[ORDERS[-1] + DELAYS[-1] :]
            theta, squares, *_ = np.linalg.lstsq(X, target, rcond=None)
            criterion = target.size * np.log(squares[0]) + 2 * order * np.log(target.size)
            model = np.r_[np.zeros(delay), theta[order:]], np.r_[1.0, theta[:order]]
            found = min(found, (criterion, f"ARX({order}, {order}, nk={delay})", model), key=lambda one: one[0])
    return found[1:]


def main(argv=None):
    """Choose, draw, tabulate, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    y, u = recording(rng)

    # %% One call tries orders and delays; its table, its picture, and its model.
    selection = select_structure(y, u, na=ORDERS, nk=DELAYS)
    print(selection.to_text(rows=6))
    model = selection.best

    fresh = rng.choice([-1.0, 1.0], STEPS)
    clean = lfilter(B, A, fresh)
    name, (numerator, denominator) = least_squares(y, u)
    fits = [fit_percent(clean, output) for output in (model.simulate(fresh), lfilter(numerator, denominator, fresh))]
    draw(selection, options.out)
    print(
        f"Conclusion: the plant has order 2 and delay 4. The robust criterion chooses {model.structure}, which fits "
        f"fresh data without noise to {fits[0]:.1f} %; least squares choose {name}: {fits[1]:.1f} %."
    )


def draw(selection, out):
    """Draw fit and criterion against the number of parameters, and the impulse response."""
    import matplotlib.pyplot as plt

    axes = selection.plot()
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "18_choosing_the_order.png"
    axes[0].figure.savefig(path, dpi=110)
    plt.close(axes[0].figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
