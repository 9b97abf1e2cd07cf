"""ParameterTracker as a program meets it: samples, recordings, its filter, missing data, interruption, bad input.

All by the definition, where one path has one set of bits; `test_tracker_compiled` holds the kernel to it.
"""

import copy
import pickle

import control
import numpy as np
import pandas as pd
import pytest
import support
from filterpy.kalman import InformationFilter, KalmanFilter, SquareRootKalmanFilter
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from interruption import interrupted
from recordings import assert_refused, same, unchanged

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, Huber, RobustKalmanFilter, TukeyBiweight
from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError, ParameterTracker
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.plants import simulate_output_error

PLANT = np.array([-1.5, 0.7, 1.0, 0.5])
STRUCTURES = [ARX(2, 2), OutputError(2, 2), ARMAX(2, 2, 2), FIR(6), FIR(2, nk=0), ARX(1, 2, nk=3), ARMAX(0, 1, 1)]
STRUCTURES += [BoxJenkins(2, 1, 1, 2), BoxJenkins(1, 0, 2, 0)]


@pytest.fixture(autouse=True)
def definition(monkeypatch):
    """Let the definition serve."""
    support.without_kernel(monkeypatch)


def recording(length=150, contamination=0.1, missing=True, seed=1):
    """A contaminated recording of the plant with a gap."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], length)
    y = simulate_output_error(PLANT, u, noise=Contaminated(contamination, 10.0, 0.5), rng=rng, na=2, nb=2).y
    if missing:
        y[[20, 21, 22, 60]] = np.nan
    return y, u


# One sample or a recording


def test_the_baseline_is_filterpys_kalman_filter():
    y, u = recording()
    structure, kf = FIR(3), KalmanFilter(3, 1)
    kf.P, kf.Q, kf.R = 3.0 * np.eye(3), 1e-4 * np.eye(3), np.array([[0.5]])
    before, options = copy.deepcopy(vars(kf)), {"P": 3.0, "Q": 1e-4, "R": 0.5}
    made = ({"influence": Linear(), **options}, {"filter": KalmanFilter, **options}, {"filter": kf})
    found = [support.paper_tracker(structure, **how).run(y, u) for how in made]
    # The object is copied.
    same(before.values(), vars(kf).values())
    for k, phi in enumerate(structure.regressors(u)):
        kf.predict()
        kf.update(None if np.isnan(y[k]) else y[k], H=phi[None])
        for result in found:
            np.testing.assert_allclose(result.theta[k], kf.x[:, 0], rtol=1e-7, atol=1e-9)
            np.testing.assert_allclose(result.std[k], np.sqrt(np.diag(kf.P)), rtol=1e-7)


def test_recordings_may_be_lists_or_pandas_columns():
    y, u = recording()
    frame = pd.DataFrame({"y": y, "u": u, "w": -u})
    two = ARX(2, (2, 1))
    expected, both = support.paper_tracker(ARX(2, 2)).run(y, u), support.paper_tracker(two).run(y, np.c_[u, -u])
    for given in ((frame["y"], frame["u"]), ([None if v != v else v for v in y], list(u)), (y[:, None], u[:, None])):
        same(expected, support.paper_tracker(ARX(2, 2)).run(*given))
    same(both, support.paper_tracker(two).run(frame["y"], frame[["u", "w"]]))


# The model


@pytest.mark.parametrize("nk", [0, 1, 3])
def test_transfer_function_answers_as_simulate_does(nk):
    u = np.random.default_rng(0).normal(size=(2, 80))
    theta = [-0.9, 0.4, 1.0, 0.5, 0.0, -2.0]
    tracker = support.paper_tracker(OutputError(2, (3, 1), nk=(nk, 2)), theta=theta)
    tf = tracker.transfer_function(0.1)
    assert (tf.ninputs, tf.noutputs, tf.dt) == (2, 1, 0.1)
    parts = [control.forced_response(tf[0, i], None, u[i]).outputs for i in range(2)]
    np.testing.assert_allclose(tracker.simulate(u.T), sum(np.ravel(p) for p in parts), atol=1e-10)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_continued_simulation_is_the_tracker_with_every_sample_missing(structure):
    y, u = recording()
    tracker = support.paper_tracker(structure, R=0.25, gradient="filtered")
    tracker.run(y[:100], u[:100])
    free = tracker.simulate(u[100:], continued=True)
    np.testing.assert_allclose(free, tracker.run(np.full(50, np.nan), u[100:]).prediction, rtol=1e-9, atol=1e-9)


def test_simulation_of_an_unstable_model_is_refused_when_it_overflows():
    tracker = support.paper_tracker(ARX(1, 1), theta=[-3.0, 1.0])
    assert np.isfinite(tracker.simulate(np.ones(20))).all()
    with pytest.raises(ValueError, match="unstable"):
        tracker.simulate(np.ones(2000))


def test_fit_and_intervals():
    assert ParameterTracker.fit([0.0, 2.0], [0.0, 2.0]) == 100.0
    assert ParameterTracker.fit([0.0, 2.0], [1.0, 1.0]) == pytest.approx(0.0)
    tracker = support.paper_tracker(FIR(2), theta=[1.0, 2.0], P=np.diag([4.0, 9.0]))
    lower, upper = tracker.confidence_intervals(0.95)
    same(tracker.confidence_intervals(), (lower, upper))
    np.testing.assert_allclose(lower, [1 - 1.959964 * 2, 2 - 1.959964 * 3], rtol=1e-6)
    np.testing.assert_allclose(upper - tracker.theta, tracker.theta - lower)
    result = tracker.run(np.ones(5), np.ones(5))
    same([band[-1] for band in result.confidence_intervals()], tracker.confidence_intervals(0.95))
    same([band[-1] for band in result.confidence_intervals(0.5)], tracker.confidence_intervals(0.5))
    with pytest.raises(ValueError, match="level"):
        tracker.confidence_intervals(95)


# Missing samples, freezing, forgetting


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_frozen_tracker_predicts_and_does_not_learn(structure):
    y, u = recording()
    tracker = support.paper_tracker(structure, R=0.25, Q=1e-3)
    tracker.run(y[:100], u[:100])
    theta, P = tracker.theta, tracker.P
    tracker.enabled = False
    result = tracker.run(y[100:], u[100:])
    same([tracker.theta, tracker.P], [theta, P])
    assert np.isnan(result.weights).all() and np.isfinite(result.residual).all() and np.ptp(result.prediction) > 0.1


def test_forgetting_is_recursive_least_squares():
    rng = np.random.default_rng(2)
    phi, y = rng.normal(size=(60, 3)), rng.normal(size=60)
    factor, P, theta = 0.9, 10.0 * np.eye(3), np.zeros(3)
    for row, value in zip(phi, y, strict=True):
        gain = P @ row / (factor + row @ P @ row)
        theta = theta + gain * (value - row @ theta)
        P = (P - np.outer(gain, row @ P)) / factor
    tracker = support.paper_tracker(LinearRegression(3), forgetting=factor, P=10.0, influence=Linear())
    tracker.run(y, phi)
    np.testing.assert_allclose(tracker.theta, theta, rtol=1e-10)
    np.testing.assert_allclose(tracker.P, P, rtol=1e-10)


# Bad input


class Moody(KalmanFilter):
    """A subclass, whose methods might do anything."""


def test_bad_arguments_are_refused_by_name():
    """Those that a bank has as well are in its table."""
    assert_refused(support.paper_tracker, {"structure": OutputError(2, 2)}, {
        "structure": [4],
        "theta": [[1.0, 2.0], [np.nan, 0, 0, 0], [-2.0, 1.5, 1.0, 1.0]],
        "filter": [KalmanFilter(3, 1), KalmanFilter(4, 2), object(), InformationFilter, SquareRootKalmanFilter(4, 1),
                   Moody, Moody(4, 1), lambda dim_x, dim_z: 3],
    })  # fmt: skip
    with pytest.raises(ValueError, match="influence: expected only without"):
        support.paper_tracker(OutputError(2, 2), filter=KalmanFilter, influence=Huber())


@pytest.mark.parametrize(("call", "words"), [
    (lambda t: t.run([], []), "y: expected"),
    (lambda t: t.run([1.0, 2.0], [1.0]), "u: expected"),
    (lambda t: t.run([1.0, 2.0], [1.0, np.nan]), r"sample 1; .*u.ffill\(\)"),
    (lambda t: t.run([1.0, 2.0], [1.0, 1.0], [1.0, 0.0]), "R: expected variances > 0, got 0.0 in sample 1"),
    (lambda t: t.run([1.0, 2.0], [1.0, 1.0], [1.0, np.inf]), "R: expected variances > 0, got inf in sample 1"),
    (lambda t: t.update(1.0, 1e200), r"the order is y, u\), got 1e\+200"),
    (lambda t: t.update(1.0, [1.0, 2.0]), "u: expected"),
    (lambda t: t.update(1.0, 1.0, -1.0), "R: expected"),
    (lambda t: t.simulate([]), "u: expected"),
    (lambda t: t.simulate([np.inf]), "u: expected"),
    (lambda t: support.paper_tracker(FIR(2, nk=0)).predict(), "next input"),
    (lambda t: support.paper_tracker(FIR(4), P=np.ones(4)), r"P: expected shape \(4, 4\).*np.diag\(P\)"),
])  # fmt: skip
def test_what_helps_is_said_and_nothing_changes(call, words):
    """The table of a bank has what else its samples cannot be."""
    tracker = support.paper_tracker(OutputError(2, 2))
    tracker.run(*recording())
    with unchanged(tracker), pytest.raises(ValueError, match=words):
        call(tracker)


class Failing(AdaptiveKalmanFilter):
    """A filter with copies that refuses a sample after they have moved."""

    fails = False

    def update(self, z, R=None):
        super().update(z, R)
        if self.fails:
            raise ValueError("enough")


@pytest.mark.parametrize("call", ["run", "update"])
def test_what_a_filter_is_made_of_is_undone_too(call):
    y, u = recording(60, missing=False)
    tracker, twin = (support.paper_tracker(ARX(2, 2), filter=Failing) for _ in range(2))
    for one in (tracker, twin):
        one.run(y[:20], u[:20])
    tracker.form.filter.fails = True
    with pytest.raises(ValueError, match="enough"):
        tracker.run(y[20:], u[20:]) if call == "run" else tracker.update(y[20], u[20])
    tracker.form.filter.fails = False
    np.testing.assert_array_equal(tracker.run(y[20:], u[20:]).theta, twin.run(y[20:], u[20:]).theta)


# What a filter holds before, while and after


@pytest.mark.parametrize("length", [1, 40, 300])
def test_nothing_but_gaps_and_a_whole_number_as_theta(length):
    y, u = np.full(length, np.nan), np.ones(length)
    tracker = support.paper_tracker(ARX(1, 1), theta=[-0.5, 1.0])
    np.testing.assert_array_equal(tracker.run(y, u).theta[-1], [-0.5, 1.0])
    y, u = recording(length, missing=False)
    for x in (np.zeros(2, dtype=int), np.zeros(2, dtype=np.float32), np.zeros((2, 1)), [0.0, 0.0]):
        kf = RobustKalmanFilter(2, 1, scaling="innovation")
        kf.x, kf.P = x, 100.0 * np.eye(2)
        tracker, plain = support.paper_tracker(ARX(1, 1), filter=kf, Q=0.0), support.paper_tracker(ARX(1, 1), R=1.0)
        plain.R = 1.0
        np.testing.assert_allclose(tracker.run(y, u).theta, plain.run(y, u).theta, rtol=1e-9)


def test_predict_knows_that_a_wound_up_tracker_stands_still():
    tracker = support.paper_tracker(ARX(1, 1), forgetting=0.5, F=1.5 * np.eye(2), theta=[-0.5, 1.0])
    for k in range(40):
        tracker.update(np.nan, 0.0 if k < 39 else 1.0)
        assert tracker.predict() == tracker.update(np.nan, 0.0).prediction


def test_matrices_are_the_filters():
    y, u = recording()
    one = support.paper_tracker(ARX(2, 2), R=0.25)
    other = support.paper_tracker(ARX(2, 2), R=4.0, Q=1e-3, forgetting=0.9)
    one.R, one.Q, one.forgetting = 4.0, 1e-3, 0.9
    assert one.R == one.filter.R.item() == 4.0 and one.forgetting == pytest.approx(0.9)
    same([one.Q, one.F], [1e-3 * np.eye(4), np.eye(4)])
    same(one.run(y, u), other.run(y, u))
    one.F = 0.5 * np.eye(4)
    same([one.filter.F], [0.5 * np.eye(4)])
    # What is written into the copy is the copy's.
    one.filter.x[:], one.filter.R[:] = 9.0, 9.0
    assert one.R == 4.0 and one.theta.max() < 9.0
    for name, value in {"R": -1.0, "Q": -1.0, "F": np.eye(3), "forgetting": 1.5}.items():
        with unchanged(one), pytest.raises(ValueError, match=f"{name}: expected"):
            setattr(one, name, value)


@pytest.mark.parametrize("R", [np.nan, -1.0, None, np.array([[np.nan]]), np.array([[-1.0]])])
def test_a_bad_variance_in_the_filter_is_named(R):
    kf = RobustKalmanFilter(4, 1)
    kf.R = R
    with pytest.raises((ValueError, TypeError), match="R: expected a variance > 0"):
        ParameterTracker(OutputError(2, 2), filter=kf, Q=0.0)


class Called(RobustKalmanFilter):
    """A filter that can be called too, which says nothing of how it is made."""

    def __call__(self):
        raise AssertionError


def test_what_updates_is_a_filter_even_if_it_can_be_called():
    kf = Called(2, 1)
    kf.Q[:] = 0.0
    assert type(ParameterTracker(FIR(2), filter=kf).filter) is Called


# Any sequence of calls of a tracker: what must hold whatever a user does, and wherever an interrupt falls.


ANY_STRUCTURE = [ARX(2, 2), OutputError(2, 2), ARMAX(1, 1, 1), FIR(2, nk=0), ARX(1, 2, nk=3), BoxJenkins(1, 1, 1, 1)]
ANY_OPTIONS = st.fixed_dictionaries({
    "offset": st.booleans(), "R": st.sampled_from([None, 0.25]), "forgetting": st.sampled_from([None, 0.98]),
    "regressor": st.sampled_from(["measured", "cleaned"]), "gradient": st.sampled_from(["filtered", "pseudolinear"]),
    "guard": st.sampled_from(["halve", "reject", "none"]), "scaling": st.sampled_from([None, "bounded"]),
    "influence": st.sampled_from([None, Hampel(), Linear(), TukeyBiweight()]),
})  # fmt: skip
values = st.one_of(st.floats(-50.0, 50.0), st.sampled_from([0.0, np.nan, 1e6, -1e12, 1e300]))


class Calls(RuleBasedStateMachine):
    """Draw calls of a tracker, and of a twin that takes the same samples one by one."""

    @initialize(structure=st.sampled_from(ANY_STRUCTURE), start=st.sampled_from([0, 0, 40]), options=ANY_OPTIONS)
    def begin(self, structure, start, options):
        self.options = {"start": start, **options}
        self.structure = structure
        self.tracker, self.twin = (ParameterTracker(structure, **self.options) for _ in range(2))

    @rule(y=values, u=st.sampled_from([-1.0, 0.3, 1.0]))
    def update(self, y, u):
        ahead = self.tracker.predict(u)
        one, other = self.tracker.update(y, u), self.twin.update(y, u)
        np.testing.assert_array_equal(one, other)
        assert np.clip(one.prediction, -1e100, 1e100) == pytest.approx(ahead, rel=1e-12, abs=1e-12)

    @rule(seed=st.integers(0, 1000), length=st.integers(1, 30))
    def run_some(self, seed, length):
        rng = np.random.default_rng(seed)
        u, y = rng.choice([-1.0, 1.0], length), rng.normal(size=length)
        self.tracker.run(y, u)
        for k in range(length):
            self.twin.update(y[k], u[k])

    @rule(line=st.integers(1, 400), y=st.floats(-5.0, 5.0), length=st.integers(1, 4))
    def interrupt(self, line, y, length):
        before = self.tracker.state()

        def call():
            if length == 1:
                self.tracker.update(y, 1.0)
            else:
                self.tracker.run([y] * length, [1.0] * length)

        if interrupted(call, line):
            same(before, self.tracker.state())
        else:
            for _ in range(length):
                self.twin.update(y, 1.0)

    @rule(call=st.sampled_from([(np.inf, 1.0), (0.0, np.nan), (0.0, [1.0, 2.0]), ("a", 1.0)]))
    def refused(self, call):
        before = self.tracker.state()
        with pytest.raises((ValueError, TypeError)):
            self.tracker.update(*call)
        same(before, self.tracker.state())

    @rule(way=st.sampled_from(["pickle", "deepcopy", "state"]))
    def copied(self, way):
        if way == "pickle":
            self.tracker = pickle.loads(pickle.dumps(self.tracker))
        elif way == "deepcopy":
            self.tracker = copy.deepcopy(self.tracker)
        else:
            other = ParameterTracker(self.structure, **self.options)
            other.restore(self.tracker.state())
            self.tracker = other

    @rule(q=st.sampled_from([0.0, 1e-4, 0.1]))
    def let_it_drift(self, q):
        self.tracker.Q = self.twin.Q = q

    @rule()
    def freeze_or_thaw(self):
        self.tracker.enabled = self.twin.enabled = not self.twin.enabled

    @invariant()
    def parameters_are_finite_and_covariances_are_covariances(self):
        if not hasattr(self, "tracker"):
            return
        tracker = self.tracker
        assert np.isfinite(tracker.theta).all() and np.isfinite(tracker.R) and tracker.R > 0.0
        P = tracker.P
        assert np.isfinite(P).all()
        scale = np.abs(P).max()
        assert np.abs(P - P.T).max() <= 1e-10 * scale and np.linalg.eigvalsh(P)[0] >= -1e-8 * scale
        assert np.isfinite(tracker.predict(0.0))
        same(tracker.state(), self.twin.state())


@pytest.mark.filterwarnings("ignore::robust_filterpy.identification.LostTrackerWarning")
@pytest.mark.parametrize(
    "examples", [pytest.param(15, id="some"), pytest.param(1500, id="many", marks=pytest.mark.slow)]
)
def test_any_sequence_of_calls(examples):
    machine = Calls.TestCase
    machine.settings = settings(max_examples=examples, stateful_step_count=15, deadline=None)
    machine().runTest()
