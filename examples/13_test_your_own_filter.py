"""My filter follows the target: is it right? A bug that no plot of the track shows, and the check that names it.

Twenty lines of a Kalman filter, with one slip. A plot of its track looks as good as that of the right one. But a filter
also says how far it may be off, P, and with a right P the squared error in units of P is chi-square:

    (x - truth)' P^-1 (x - truth) ~ chi2(n)

`check_filter` tests that, and forty more promises, each with a name; the first that is broken is where to look.
"""

# %% The filter. Can you see it?
import argparse
from pathlib import Path

import numpy as np
from scipy import stats

from robust_filterpy.testing import ChecksFailed, assert_consistent, check_filter, draw, run_filter

RUNS, STEPS = 60, 80


class MyFilter:
    """A Kalman filter, written on a Friday."""

    def __init__(self, dim_x, dim_z):
        self.x, self.P, self.F, self.Q = np.zeros(dim_x), np.eye(dim_x), np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)

    def predict(self):
        """Move the state and its covariance on by a step."""
        self.x = self.F @ self.x
        self.P = self.F @ self.P @ self.F.T + self.Q

    def update(self, z):
        """Correct both by a measurement."""
        if z is None:
            return
        K = self.P @ self.H.T @ np.linalg.inv(self.H @ self.P @ self.H.T + self.R)
        self.x = self.x + K @ (np.asarray(z) - self.H @ self.x)
        self.P = self.corrected(np.eye(len(self.x)) - K @ self.H, K)

    def corrected(self, I_KH, K):
        """Return P after the correction, in the form that stays symmetric."""
        return I_KH @ self.P @ I_KH.T


class Mended(MyFilter):
    """The same, after the check has named the line."""

    def corrected(self, I_KH, K):
        """Return P after the correction, all of Joseph's form."""
        return I_KH @ self.P @ I_KH.T + K @ self.R @ K.T


FILTERS = {"my filter": MyFilter, "mended": Mended}
NOT_CLAIMED = ("robust", "nan", "validates")


def main(argv=None):
    """Run, draw, check, conclude."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    # %% The same targets for both, with the truth known.
    scenarios = [draw("constant velocity", STEPS, rng=options.seed + k) for k in range(RUNS)]
    runs = {
        name: [run_filter(scenario.load(cls(4, 2)), scenario) for scenario in scenarios]
        for name, cls in FILTERS.items()
    }
    rms = {name: float(np.sqrt(np.mean([run.error[:, [0, 2]] ** 2 for run in found]))) for name, found in runs.items()}
    # %% What the eye sees, and what a test says.
    named = []
    for name, cls in FILTERS.items():
        print(f"{name}: root-mean-square error of the position {rms[name]:.2f} m")
        try:
            assert_consistent(runs[name])
        except AssertionError as error:
            print(f"  assert_consistent: {error}")
        try:
            check_filter(cls, not_claimed=NOT_CLAIMED)
            print("  check_filter: every promise is kept")
        except ChecksFailed as error:
            failed = [result for result in error.results if result.status == "failed"]
            named.append(failed[0].name)
            print(f"  check_filter: {len(failed)} of {len(error.results)} checks fail, the first one is")
            print(f"    {failed[0].message}")
    draw_figure(scenarios[0], runs, options.out)
    print(
        f"Conclusion: the position errs by {rms['my filter']:.2f} m instead of {rms['mended']:.2f} m, which no plot "
        f"of a track shows; P is half of what it should be, and {named[0]} names the line."
    )


def draw_figure(scenario, runs, out):
    """Draw one track with both filters, and the squared error in units of P over all runs."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.4), layout="constrained")
    ax, looks = axes[0], {"my filter": ("C3", "-."), "mended": ("0.3", "-")}
    ax.plot(scenario.z[:, 0], scenario.z[:, 1], ".", color="0.75", label="measurement")
    ax.plot(scenario.x[:, 0], scenario.x[:, 2], "k", lw=1, label="truth")
    for name, (color, style) in looks.items():
        ax.plot(runs[name][0].x[:, 0], runs[name][0].x[:, 2], color=color, ls=style, label=name)
    ax.set(xlabel="position east, m", ylabel="position north, m", title="One track does not tell which filter is wrong")
    ax.legend(fontsize=8)
    ax = axes[1]
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], 4 * len(runs["mended"])) / len(runs["mended"])
    ax.axhspan(low, high, color="0.88", label="a right filter, but for one chance in a million")
    for name, (color, style) in looks.items():
        nees = [np.mean([np.sum(run.standardized_error(k) ** 2) for run in runs[name]]) for k in range(STEPS)]
        ax.plot(nees, color=color, ls=style, label=name)
    title = f"{len(runs['mended'])} tracks do: mine is surer than it may be"
    ax.set(xlabel="step", ylabel="squared error in units of P", title=title, ylim=(0, None))
    ax.legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "13_test_your_own_filter.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
