"""Is the model good? The fit does not say, and outliers fool the usual tests.

A good model leaves nothing in its residuals e: they follow neither one another nor the input. `validate` tests psi(e),
which is bounded: with c the correlations of psi(e) with what came before, c' Cov(c)^-1 c has a chi-squared distribution
if the model is right, however large the outliers are. A model with a mode too few and the right one are held against a
recording that neither has seen.
"""

# %% A plant with a fast mode that hides behind a slow one; one reading in ten is ten times as bad.
import argparse
import warnings
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import validate

A, B = np.convolve([1.0, -0.95], [1.0, 0.4, 0.45]), [0.0, 0.05, 0.25, 0.25]
STEPS = 1500


def recording(rng):
    """Return y, u."""
    u = rng.choice([-1.0, 1.0], STEPS)
    noise = np.where(rng.random(STEPS) < 0.1, 1.0, 0.1) * rng.normal(size=STEPS)
    return 3.0 + lfilter(B, A, u) + noise, u


def main(argv=None):
    """Identify, validate, draw, conclude."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("examples/output"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    (y, u), (y_new, u_new) = recording(rng), recording(rng)

    # %% Each model is made from one recording and validated on another.
    found = {}
    for name, structure in {"one mode": OutputError(1, 1), "three modes": OutputError(3, 3)}.items():
        with warnings.catch_warnings():
            # identify warns of what it finds; here that is printed.
            warnings.simplefilter("ignore", UserWarning)
            model = identify(y, u, structure)
        found[name] = validate(model, y_new, u_new)
        print(f"{name}, {structure}: {found[name].verdict}")  # print(found[name]) has the tests and the fits
        print("".join(f"  identify had warned: {finding.text}\n" for finding in model.findings), end="")

    # %% A controller of low bandwidth needs a small model that is right where it acts: of signals cleaned and filtered.
    low = np.linspace(0.002, 0.1, 30)
    plant = np.polyval(B[::-1], np.exp(-1j * low)) / np.polyval(A[::-1], np.exp(-1j * low))
    off = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        model = identify(y, u, OutputError(3, 3))
        clean = np.where((model.weights < 0.5) | np.isnan(y), model.predict(y, u), y)
        sos = butter(2, 0.1 / np.pi, output="sos")
        for output, signal in ((y, u), (sosfilt(sos, clean - model.level)[200:], sosfilt(sos, u)[200:])):
            response = identify(output, signal, OutputError(1, 1)).frequency_response(low).response
            off.append(np.linalg.norm(response - plant) / np.linalg.norm(plant))
    print(f"one mode, up to .1 rad a sample: {100 * off[0]:.1f} % off, {100 * off[1]:.1f} % of filtered signals")

    draw(found, options.out)
    small, right = found.values()
    print(
        f"Conclusion: on all samples the free run of the small model fits to {small.fits[-1].all:.0f} %, that of the "
        f"right one to {right.fits[-1].all:.0f} %, which says how wild the outliers are; on ordinary samples to "
        f"{small.fits[-1].ordinary:.0f} % and {right.fits[-1].ordinary:.0f} %. That nothing more can be had, the "
        f"residuals say alone."
    )


def draw(found, out):
    """Draw the correlations that each model leaves."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(8.5, 7.6), layout="constrained")
    for part, (name, validation) in zip(figure.subfigures(2, 1), found.items(), strict=True):
        axes = validation.plot(axes=part.subplots(2, 1, sharex=True))
        part.suptitle(f"{name}: {validation.verdict}", fontsize=9)
        axes[0].tick_params(labelbottom=False)
    out.mkdir(parents=True, exist_ok=True)
    path = out.resolve() / "19_is_the_model_good.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"Figure: {path}")


if __name__ == "__main__":
    main()
