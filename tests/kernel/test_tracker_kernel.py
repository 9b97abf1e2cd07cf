"""The kernel of ParameterTracker.run gives the numbers of `update` and hands back what is not ordinary."""

import itertools

import numpy as np
import pytest
import support

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight, kernel
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.correction.options import INFORMATIONS, SCALINGS
from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError
from robust_filterpy.identification.models.regressor import GUARDS
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import track
from robust_filterpy.identification.recursive.recursion import GRADIENTS
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.plants import simulate_output_error

pytestmark = pytest.mark.skipif(not kernel.available(), reason="the kernel was not built")

STRUCTURES = [
    ARX(2, 2), OutputError(2, 2), ARMAX(2, 2, 2), FIR(6), FIR(2, nk=0), ARX(1, 2, nk=3), ARMAX(0, 1, 1),
    OutputError(1, 1), ARX(2, 0), BoxJenkins(2, 1, 2, 2), Structure(2, 1, 1, 1, 1),
]  # fmt: skip
PLANT = [-1.5, 0.7, 1.0, 0.5]


@pytest.fixture(autouse=True)
def handed_back(monkeypatch):
    """Keep an account of the samples of a run that the kernel leaves to the definition."""
    samples = []
    stepwise = track._by_definition

    def counted(form, now, enabled, place, *others):
        if place(0, 0):
            samples.extend(range(others[-1].start, others[-1].stop))
        return stepwise(form, now, enabled, place, *others)

    monkeypatch.setattr(track, "_by_definition", counted)
    return samples


def recording(length=300, seed=1):
    """A contaminated recording of the plant with a gap, in full swing."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], length)
    y = simulate_output_error(PLANT, u, noise=Contaminated(0.1, 10.0, 0.5), rng=rng, na=2, nb=2).y
    y[[20, 21, 22, 60]] = np.nan
    return y, u


def pair(structure, **options):
    """Two trackers, the same; the second goes by the definition: a method of its filter is wrapped."""
    one, other = (support.paper_tracker(structure, **{"R": 0.25, "P": 1.0} | options) for _ in range(2))
    other.filter.predict = other.filter.predict
    return one, other


def assert_same_run(one, other, y, u, R=None, rtol=1e-10):
    """Hold a run by the kernel and the same by the definition together, in every column and in what is left behind."""
    result = one.run(y, u, R)
    u = np.zeros((len(y), 0)) if u is None else u
    for k in range(len(y)):
        sample = other.update(y[k], u[k], None if R is None else R[k])
        scale = max(1.0, np.abs(other.theta).max())
        np.testing.assert_allclose(result.theta[k], other.theta, rtol=rtol, atol=rtol * scale, err_msg=f"sample {k}")
        np.testing.assert_allclose(result.std[k], other.std, rtol=rtol, atol=0, err_msg=f"sample {k}")
        found = [column[k] for column in (result.prediction, result.residual, result.weights)]
        scale = max(1.0, abs(sample.prediction))
        np.testing.assert_allclose(found, sample[:3], rtol=rtol, atol=10 * rtol * scale, err_msg=f"sample {k}")
        assert result.guard[k] == sample.guard
    for name, value in other.state().items():
        size = np.abs(value).max(initial=1.0)
        np.testing.assert_allclose(one.state()[name], value, rtol=rtol, atol=10 * rtol * size, err_msg=name)
    return result


CASES = [
    (structure, gradient, guard)
    for structure, gradient, guard in itertools.product(STRUCTURES, GRADIENTS, GUARDS)
    # No difference for the others.
    if structure.stable_parts or (gradient, guard) == ("filtered", "halve")
]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("options", [{}, {"Q": 1e-4}, {"forgetting": 0.97}, {"influence": Hampel()}], ids=str)
@pytest.mark.parametrize(("structure", "gradient", "guard"), CASES, ids=str)
def test_the_kernel_gives_the_numbers_of_update(structure, gradient, guard, options, handed_back):
    y, u = recording()
    # What feeds on itself magnifies rounding at first; without a guard for as long as it is unstable.
    one, other = pair(structure, gradient=gradient, guard=guard, **options)
    assert_same_run(one, other, y, u if structure.n_inputs else None, rtol=1e-8 if guard == "none" else 1e-9)
    # A model that has run away has samples that tell very much.
    assert not handed_back or guard == "none"


@pytest.mark.pairwise
@pytest.mark.parametrize("influence", [Linear(), Huber(), Hampel(), TukeyBiweight(), StudentT()], ids=repr)
@pytest.mark.parametrize(("scaling", "information"), list(itertools.product(SCALINGS, INFORMATIONS)))
def test_every_choice_of_the_filter(scaling, information, influence, handed_back):
    y, u = recording()
    # Small enough for "unit" to be legal.
    one, other = pair(ARX(2, 2), P=1e-4, influence=influence, scaling=scaling, information=information)
    assert_same_run(one, other, y / 50, u / 50)
    assert not handed_back or scaling == "learnt"


OWN_F = np.array([[0.99, 0.01, 0, 0], [0, 0.98, 0, 0], [0, 0, 1, 0], [0.01, 0, 0, 0.97]])
RUNS = {
    "F": [(OutputError(2, 2), {"F": OWN_F, "Q": 1e-4, "guard": guard}) for guard in ("none", "halve")],
    "F, forgetting": [(OutputError(2, 2), {"F": OWN_F, "forgetting": 0.98})],
    "two inputs": [(ARX(2, (2, 1), nk=(1, 0)), {}), (OutputError(1, (1, 2), nk=(0, 2)), {}), (LinearRegression(2), {})],
    "cleaned outputs": [(one, {"regressor": "cleaned"}) for one in (ARX(2, 2), ARMAX(2, 2, 2), STRUCTURES[-1])],
    "a constant, and R learned": [(one, {"offset": True, "R": None}) for one in (ARX(2, 2), OutputError(2, 2))],
    "an R for each sample": [(structure, {}) for structure in STRUCTURES[:3]],
    "bounded, on both sides of one": [
        (ARX(2, 2), {"P": 0.01, "Q": 1e-4, "R": R, "scaling": "bounded"}) for R in (0.25, 0.9, 4.0)
    ],
}


@pytest.mark.parametrize("name", RUNS)
def test_what_else_a_tracker_may_be_given(name, handed_back):
    y, u = recording()
    R = np.where(np.arange(len(y)) % 7 == 0, 25.0, 0.25) if "for each sample" in name else None
    u = np.c_[u, np.roll(u, 5)] if name == "two inputs" else u
    for structure, options in RUNS[name]:
        result = assert_same_run(*pair(structure, **options), y, u, R)
        if R is not None:
            assert np.abs(result.theta - pair(structure)[0].run(y, u).theta).max() > 1e-3
    assert not handed_back


def test_growth_under_forgetting_stops(handed_back):
    y, u = recording()
    u[50:] = 0.0
    y[50:] = 0.0
    one, other = pair(ARX(1, 1), forgetting=0.8)
    result = assert_same_run(one, other, y, u)
    # The trace may pass 1e8 times its first value once.
    assert 1e8 < np.sum(result.std[-1] ** 2) / 2.0 <= 1e8 / 0.8


def test_sharp_samples_go_to_the_definition(handed_back):
    y, u = recording()
    y[[40, 90, 200]] = 1e9, 1e11, 1e90
    for structure in (ARX(2, 2), ARX(1, 2, nk=3)):
        handed_back.clear()
        # A spike costs P as many digits as it is large, in either way of counting.
        assert_same_run(*pair(structure), y, u, rtol=1e-3)
        assert {41, 91, 201} <= set(handed_back) and len(handed_back) < 30
    for structure in (OutputError(2, 2), FIR(6)):
        handed_back.clear()
        assert_same_run(*pair(structure), y, u, rtol=1e-9)
        assert not handed_back


@pytest.mark.parametrize("large, served", [(30.0, True), (2e4, False)])
def test_how_sharp_a_sample_is_is_measured_by_what_is_left_of_P(large, served, handed_back):
    """phi' phi tr(P) / R is 18, or 8e6, where P alone is next to nothing."""
    rng = np.random.default_rng(0)
    u, y = large * rng.choice([-1.0, 1.0], 40), rng.normal(size=40)
    assert_same_run(*pair(FIR(2), P=1e-6, R=2e-4), y, u, rtol=1e-6)
    assert (not handed_back) == served


@pytest.mark.parametrize("value", [1e99, 1e100, 1e200, 1e308])
def test_no_overflow(value, handed_back):
    y, u = recording()
    for structure, k in itertools.product(STRUCTURES[:3], (30, 31)):
        spiked = y.copy()
        spiked[k:] = value
        result = pair(structure)[0].run(spiked, u)
        assert np.isfinite(result.theta).all() and np.isfinite(result.prediction).all()


def test_a_model_that_was_made_unstable_by_hand(handed_back):
    y, u = recording(80)
    for guard, gradient in itertools.product(("none", "reject", "halve"), ("pseudolinear", "filtered")):
        one, other = pair(OutputError(2, 2), guard=guard, gradient=gradient)
        for tracker in (one, other):
            tracker._now = tracker._now.with_parts(theta=[-2.1, 1.3, 0.5, 0.0])
        assert_same_run(one, other, y, u, rtol=1e-6)


def test_a_refused_sample_is_named_and_changes_nothing(handed_back):
    y, u = recording()
    tracker = support.paper_tracker(ARX(2, 2), P=1e-4, R=0.25, scaling="unit")
    u[250:] *= 300.0
    before = tracker.state()
    with pytest.raises(NotPositiveDefiniteError, match=r"sample 264: scaling"):
        tracker.run(y, u)
    assert handed_back == [264]
    for name, value in before.items():
        np.testing.assert_array_equal(tracker.state()[name], value)


def test_a_psi_that_the_loop_does_not_know_and_a_crooked_p_are_not_for_it(handed_back):
    y, u = recording(80)
    support.paper_tracker(ARX(2, 2), filter=RobustKalmanFilter(4, 1, grouping="joint", influence=Odd())).run(y, u)
    assert handed_back == list(range(len(y)))
    handed_back.clear()
    crooked = support.paper_tracker(ARX(2, 2))
    crooked._now = crooked._now.with_parts(P=np.eye(4) + np.triu(np.full((4, 4), 1e-6), 1))
    crooked.run(y, u)
    assert handed_back[0] == 0


class Odd(Huber):
    """A function that the loops do not know."""

    def psi(self, e):
        """Return Huber's psi."""
        return super().psi(e)


def test_the_arrays_that_a_filter_held_before_a_run_are_left_alone(handed_back):
    y, u = recording()
    tracker = pair(OutputError(2, 2))[0]
    held = tracker.theta, tracker.P
    copies = [value.copy() for value in held]
    tracker.run(y, u)
    for value, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(value, copy)
