"""`print` of a result fits a screen, however long the recording was; that of a filter, however many states it has."""

import numpy as np
import pytest
from support import POLICIES, by_night, of_matrices, through

from robust_filterpy import ARX, ParameterTracker, RobustKalmanFilter, diagnose, estimate_noise, filter_series, smooth
from robust_filterpy.fleet import TrackerModel
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.fusion.recording import Recording
from robust_filterpy.fusion.verdicts import described
from robust_filterpy.identification import BoxJenkins, StateSpace, TrackerBank, identify
from robust_filterpy.smoothing import FixedLagSmoother
from robust_filterpy.testing import draw

Y = np.cumsum(np.random.default_rng(10_001).normal(size=300))
Y[7] = np.nan
U = np.sign(np.random.default_rng(10_002).normal(size=300))
MODEL = (np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.zeros(1), np.eye(1))


def walk():
    kf = RobustKalmanFilter(1, 1)
    kf.H = np.eye(1)
    return kf


@pytest.mark.parametrize("structure", [ARX(2, (1, 2)), BoxJenkins(1, 1, 1, 1)])
def test_coefficients_print_a_line_for_each_polynomial(structure):
    coefficients = ParameterTracker(structure, start=0).coefficients
    lines = str(coefficients).splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(coefficients._fields) and "array" not in str(coefficients)


@pytest.mark.parametrize("structure", by_night([BoxJenkins(2, 2, 2, 2), ARX(4, 4), StateSpace(4)], StateSpace(4)))
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_model_fits_a_screen_and_says_no_less(structure):
    model = identify(Y, U, structure)
    assert len(repr(model)) > 100 >= max(map(len, str(model).splitlines()))
    assert " ".join(str(model).split()) == " ".join(repr(model).split())


def smoother():
    found = FixedLagSmoother(1, 1, 3)
    for z in (0.1, 0.2, 500.0, 0.3, 0.1):
        found.smooth(z)
    return found


def watched():
    fusion = Fusion(constant_velocity(dim=1, q=0.1), {name: Sensor([1.0, 0.0], R=1.0) for name in "ab"}, window=2.0)
    for k in range(40):
        fusion.observe("ab"[k % 2], 0.1 * k, float(k))
    return fusion


def fused():
    fusion = Fusion(constant_velocity(dim=1, q=0.1), {"left": Sensor([1.0, 0.0])}, window=2.0)
    fusion.observe("left", 0.0, 1.0)
    return fusion


def recorded():
    """A fusion's recording in which somebody departs, and is biased."""
    said = [(float(t), "left", described("departs" if t < 4 else "biased", since=3.0)) for t in range(20)]
    shapes = ((500, 2), (500, 2, 2), (500, 1))
    return Recording(np.arange(500.0), *map(np.ones, shapes), 0, ("p", "v"), tuple(said))


def six():
    """A filter of six sensors of one place."""
    return of_matrices(RobustKalmanFilter, [[1.0, 0.5], [0.0, 1.0]], np.eye(1, 2).repeat(6, axis=0), 0.01)


LABELED = draw("constant velocity", 300, rng=0, contamination="mixture")


# What it is made of, and a word that its text has to have: of recordings their first field, in the second line.
SHOWN = {
    "filter_series": (lambda: filter_series(Y[None, :, None], *MODEL), "FilteredSeries\n  x "),
    "smooth": (lambda: smooth(walk(), Y), "\n  x "),
    "estimate_noise": (lambda: estimate_noise(walk(), Y), "\n  Q "),
    "tracker": (lambda: ParameterTracker(ARX(1, 1), start=0).run(Y, U), "TrackingResult\n  theta "),
    "run of a bank": (
        lambda: TrackerBank(3, ARX(1, 1), start=0).run(np.tile(Y[:, None], 3), np.tile(U[:, None], 3)),
        "\n  theta ",
    ),
    "labels": (lambda: LABELED, f"is_outlier   shape (300, 2), {LABELED.is_outlier.sum()} of 600 true"),
    "intervals": (lambda: identify(Y, U, ARX(2, 2)).confidence_intervals(), "upper"),
    "response": (lambda: identify(Y, U, ARX(2, 2)).frequency_response(np.linspace(0.1, 3.0, 40)), "magnitude_lower"),
    "poles": (lambda: identify(Y, U, ARX(2, 2)).poles(), "+-"),
    "step": (lambda: identify(Y, U, ARX(2, 2)).step_response(), " ("),
    "spectrum": (lambda: identify(Y, U, ARX(2, 2)).noise_spectrum(np.linspace(0.1, 3.0, 40)), "density"),
    "sample": (lambda: ParameterTracker(ARX(1, 1), start=0).update(1 / 3, 1.0), "0.333333"),
    "bank": (lambda: TrackerBank(3, ARX(1, 1), start=0), "theta"),
    "fleet": (lambda: TrackerModel(ARX(1, 1), {"start": 0}, measurements=["y"], inputs=["u"], time="t"), "ARX"),
    "motion": (lambda: constant_velocity(dim=2), "4 states"),
    "sensor": (lambda: Sensor([1.0, 0.0], R=1.0), "delay"),
    "fusion": (fused, "Fusion(left; window 2 s; readings: 1 taken, 0 refused)"),
    "estimate": (lambda: watched().estimate(4.0), "a 0.2, b 0.1"),
    "forecast": (lambda: watched().forecast([4.0, 5.0]), "a, b"),
    "smoother": (smoother, "x, 3 steps before"),
    "recording of a fusion": (recorded, "  left biased, since 3.0, first said at 4.0; before that departs"),
    "diagnosis": (lambda: diagnose(six(), 9.0 * np.random.default_rng(6).normal(size=(200, 6))), "\nRemedies: "),
    "diagnosis of nothing": (lambda: diagnose(six(), np.full((30, 6), np.nan)), "Nothing was measured"),
    "verdict": (lambda: described("biased", since=3.0, size=5.0), "calibrate"),
}


@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_whatever_is_returned_fits_a_screen_and_says_what_it_is(name):
    make, word = SHOWN[name]
    text = str(make())
    # Only what has a field for each kind of label takes more than 15 lines.
    most = 25 if "\n" in word or "is_outlier" in word else 15
    assert word in text and len(text.splitlines()) <= most and max(map(len, text.splitlines())) <= 100


def test_a_value_of_many_lines_is_named_by_its_type():
    with pytest.raises(TypeError, match="got a RobustKalmanFilter"):
        FixedLagSmoother(walk(), 5)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("n", [2, 40])
def test_a_filter_fits_a_screen_and_says_what_it_has_learnt(policy, n):
    kf = RobustKalmanFilter(n, 2, **POLICIES[policy])
    kf.H = np.eye(2, n)
    assert "weights" not in str(kf)
    through(kf, 3.0 * np.random.default_rng(10_003).normal(size=(50, 2)))
    lines = str(kf).splitlines()
    assert len(lines) <= 15 and max(map(len, lines)) <= 100
    assert f"{n} states, 2 measured" in lines[0] and "its weights" in str(kf)
    assert ("learned" in str(kf)) == (policy not in ("innovation", "given"))
    assert "SI = " in repr(kf)
