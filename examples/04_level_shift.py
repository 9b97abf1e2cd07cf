"""A true jump of the state, or a run of outliers? What does each choice make of the two, and how does it come back?

At the first sample the two look alike. The default learns how large a sensor's innovations usually are: after a few
that agree in being large it calls them usual, and follows. If thresholds are in units of S = H P H' + R, which
scaling="innovation" says, it depends on D: with D = psi'(e) ("realized") P grows while innovations are clipped,
P+ = P - C T' D T C', so the following ones count for more, and a filter that is wrong returns; with D = E[psi']
("expected") or a gate it may never.
"""

# %% A level, watched every second: once it really jumps by 30 sigma, once the sensor is wrong for 10 samples.
import argparse
import warnings
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter, TukeyBiweight
from robust_filterpy.filters import OutlierShareWarning
from robust_filterpy.plotting import LOOKS

JUMP, START, RUN, STEPS = 30.0, 100, 10, 300
DEFAULT = "Huber, the default"
# A filter that does not believe the jump clips all that comes after it, and says so: here that is drawn.
warnings.simplefilter("ignore", OutlierShareWarning)


class GatedKalmanFilter(KalmanFilter):
    """What many programs do: drop a measurement that is more than 3 sigma away."""

    def update(self, z, R=None, H=None):
        """Correct unless the innovation is too long."""
        S = self.H @ self.P @ self.H.T + self.R
        super().update(None if abs(z - (self.H @ self.x).item()) > 3.0 * np.sqrt(S.item()) else z, R, H)


CHOICES = {
    "KalmanFilter": lambda: KalmanFilter(1, 1),
    "3-sigma gate": lambda: GatedKalmanFilter(1, 1),
    DEFAULT: lambda: RobustKalmanFilter(1, 1),
    "Huber, realized": lambda: RobustKalmanFilter(1, 1, scaling="innovation"),
    "Huber, expected": lambda: RobustKalmanFilter(1, 1, scaling="innovation", information="expected"),
    "Tukey, realized": lambda: RobustKalmanFilter(1, 1, scaling="innovation", influence=TukeyBiweight()),
}


def level(make, zs):
    """Return the filtered level (steps,)."""
    kf = make()
    kf.H = np.eye(1)
    kf.Q *= 0.05**2
    return kf.batch_filter(zs)[0].ravel()


def settled_after(estimate, truth, start):
    """Return after how many samples the error stays below 2 sigma, None if it never does."""
    wrong = np.flatnonzero(np.abs(estimate - truth)[start:] > 2.0)
    return 0 if wrong.size == 0 else None if wrong[-1] == estimate.size - start - 1 else int(wrong[-1]) + 1


# %% Both recordings through every filter.
def main(argv=None):
    """Run, draw, tabulate, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    noise = np.random.default_rng(options.seed).standard_normal(STEPS)
    shift = np.where(np.arange(STEPS) >= START, JUMP, 0.0)
    run = np.where((np.arange(STEPS) >= START) & (np.arange(STEPS) < START + RUN), JUMP, 0.0)
    jumped = {name: level(make, list(shift + noise)) for name, make in CHOICES.items()}
    fooled = {name: level(make, list(run + noise)) for name, make in CHOICES.items()}
    print(f"{'':18} samples to follow a jump of {JUMP:.0f} sigma    worst error in a run of {RUN} outliers")
    back = {name: settled_after(estimate, shift, START) for name, estimate in jumped.items()}
    worst = {name: float(np.abs(estimate).max()) for name, estimate in fooled.items()}
    for name in CHOICES:
        print(f"{name:18} {'not yet' if back[name] is None else back[name]!s:>12} {worst[name]:>40.1f} sigma")
    draw(noise, shift, run, jumped, fooled, (back[DEFAULT], worst[DEFAULT]), options.out)
    never = [name for name, samples in back.items() if samples is None]
    print(
        f"Conclusion: {'; '.join(never)}: not back at the level {STEPS - START} samples after a true jump. The default "
        f"is back after {back[DEFAULT]} samples, since it learns what is usual, and for the same reason follows {RUN} "
        f"outliers in a row all the way: {worst[DEFAULT]:.1f} sigma (KalmanFilter: {worst['KalmanFilter']:.1f}). "
        f"Against runs take scaling='innovation': Huber, realized, is then wrong by {worst['Huber, realized']:.1f} "
        f"sigma, and back after {back['Huber, realized']} samples. If the longest run of outliers is known, "
        f"patience= has both."
    )


LINES = {
    "KalmanFilter": LOOKS["Kalman"],
    "3-sigma gate": {**LOOKS["gate"], "linewidth": 4.0},  # another line lies on it
    DEFAULT: LOOKS["Huber"],
    "Huber, realized": {**LOOKS["Huber"], "linestyle": "--"},
    "Huber, expected": {**LOOKS["Huber"], "linestyle": ":"},
    "Tukey, realized": LOOKS["Tukey"],
}


def draw(noise, shift, run, jumped, fooled, huber, out):
    """Draw both stories side by side."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    titles = (
        f"After a jump of {JUMP:.0f} sigma a gate never returns;\nthe default is back after {huber[0]} samples",
        f"{RUN} outliers in a row carry\nit by {huber[1]:.1f} sigma",
    )
    for ax, title, signal, estimates in zip(axes, titles, (shift, run), (jumped, fooled), strict=True):
        ax.plot(signal + noise, ".", color="0.7", ms=3, label="measurement")
        for name, estimate in estimates.items():
            ax.plot(estimate, label=name, **LINES[name])
        ax.set(xlabel="step", title=title, xlim=(START - 20, START + 130))
    axes[0].set_ylabel("level [standard deviations of the sensor]")
    axes[1].legend(fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "04_level_shift.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
