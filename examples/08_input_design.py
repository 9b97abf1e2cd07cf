"""Which input tells most about a plant, if the actuator only knows two positions?

A binary signal has the most power its amplitude allows. Here its autocovariance is that of band-limited 1/f noise,
r_k = [Ci(k w_hi) - Ci(k w_lo)]/ln(w_hi/w_lo) (57), approached by receding horizon (54)-(55). Compared with white +-1
and a slow square wave by the Cramer-Rao bound of an ARX model, the covariance s^2 (sum phi phi')^-1 that no unbiased
estimate beats.
"""

# %% Three inputs of the same amplitude and length.
import argparse
from pathlib import Path

import numpy as np
from scipy.signal import max_len_seq

from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary

BAND, LAGS, LENGTH = (0.1, 1.0), 40, 2000
A, B = np.array([-1.7, 0.8]), np.array([0.05, 0.05])


def inputs():
    """Return the inputs, each (LENGTH,), and the autocovariance asked of the designed one, (LAGS + 1,)."""
    target = bandlimited_pink_autocovariance(*BAND, LAGS)
    designed = receding_horizon_binary(target, LENGTH)
    white = 2.0 * max_len_seq(11, length=LENGTH)[0] - 1.0
    square = np.where(np.arange(LENGTH) // 100 % 2 == 0, 1.0, -1.0)
    return {"designed, 1/f": designed, "white (PRBS)": white, "slow square": square}, target


def sample_autocovariance(s, lags):
    """Return the autocovariance of a signal about its mean, (lags + 1,)."""
    s = s - s.mean()
    return np.array([s[k:] @ s[: s.size - k] for k in range(lags + 1)]) / s.size


# %% What each tells about y(k) = -a1 y(k-1) - a2 y(k-2) + b1 u(k-1) + b2 u(k-2) + v(k), v of variance 0.1^2.
def bound(u, sigma=0.1):
    """Return the Cramer-Rao bound of the standard deviation of each parameter, (4,)."""
    rng, y = np.random.default_rng(0), np.zeros(u.size)
    phi = np.zeros((u.size, 4))
    for k in range(2, u.size):
        phi[k] = -y[k - 1], -y[k - 2], u[k - 1], u[k - 2]
        y[k] = phi[k] @ [*A, *B] + sigma * rng.standard_normal()
    return sigma * np.sqrt(np.diag(np.linalg.inv(phi.T @ phi)))


def main(argv=None):
    """Design, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    options = parser.parse_args(argv)
    signals, target = inputs()
    bounds = {name: bound(u) for name, u in signals.items()}
    draw(signals["designed, 1/f"], target, options.out)
    print("Cramer-Rao bound (standard deviation)   a1      a2      b1      b2")
    for name, row in bounds.items():
        print(f"{name:36}" + "".join(f"{value:8.4f}" for value in row))
    achieved = sample_autocovariance(signals["designed, 1/f"], LAGS)
    gain = {name: np.linalg.norm(row) / np.linalg.norm(bounds["designed, 1/f"]) for name, row in bounds.items()}
    miss = np.sqrt(np.mean((achieved - target) ** 2))
    print(
        f"Conclusion: the designed binary input meets its autocovariance to {miss:.3f} (rms); with it the bound of all "
        f"four parameters together is {gain['white (PRBS)']:.2f} times smaller than with white +-1 and "
        f"{gain['slow square']:.2f} times smaller than with a slow square wave."
    )


def draw(u, target, out):
    """Draw the signal, its autocovariance and its spectrum."""
    import matplotlib.pyplot as plt
    from scipy.signal import welch

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
    left.step(np.arange(150), u[:150], "k-", lw=1.0, where="post")
    left.set(xlabel="sample", ylabel="input u", title="Two positions only ...")
    middle.plot(target, "k-", lw=2.0, label="desired (57)")
    middle.plot(sample_autocovariance(u, LAGS), "o", color="C0", ms=3, label="achieved")
    middle.set(xlabel="lag [samples]", ylabel="autocovariance", title="... with the correlations asked for ...")
    middle.legend(fontsize=8)
    w, power = welch(u, fs=2 * np.pi, nperseg=512)
    right.semilogy(w, power, color="C0", label="achieved")
    fine = np.linspace(1e-3, np.pi, 2000)
    ideal = np.where((fine >= BAND[0]) & (fine <= BAND[1]), 1.0 / (fine * np.log(BAND[1] / BAND[0])), np.nan)
    right.semilogy(fine, ideal, "k-", lw=2.0, label="desired (56)")
    right.set(xlabel="frequency [rad/sample]", ylabel="power density", ylim=(1e-4, 20))
    right.set_title("... and the power in the band")
    right.legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "08_input_design.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
