"""Any sequence of calls of a tracker: what must hold whatever a user does, and wherever an interrupt falls."""

import copy
import pickle

import numpy as np
import pytest
import support
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from interruption import interrupted

from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, OutputError, ParameterTracker
from robust_filterpy.influence import Hampel

STRUCTURES = [ARX(2, 2), OutputError(2, 2), ARMAX(1, 1, 1), FIR(2, nk=0), ARX(1, 2, nk=3), BoxJenkins(1, 1, 1, 1)]
values = st.one_of(st.floats(-50.0, 50.0), st.sampled_from([0.0, np.nan, 1e6, -1e12, 1e150]))


def assert_same_state(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)


class Calls(RuleBasedStateMachine):
    """Draw calls of a tracker, and of a twin that takes the same samples one by one."""

    @initialize(
        structure=st.sampled_from(STRUCTURES),
        start=st.sampled_from([0, 0, 40]),
        options=st.fixed_dictionaries(
            {
                "offset": st.booleans(),
                "R": st.sampled_from([None, 0.25]),
                "regressor": st.sampled_from(["measured", "cleaned"]),
                "forgetting": st.sampled_from([None, 0.98]),
                "gradient": st.sampled_from(["filtered", "pseudolinear"]),
                "guard": st.sampled_from(["halve", "reject"]),
                "influence": st.sampled_from([None, Hampel()]),
                "scaling": st.sampled_from([None, "bounded"]),
            }
        ),
    )
    def begin(self, structure, start, options):
        self.options = {"start": start, **options}
        self.structure = structure
        self.tracker, self.twin = (ParameterTracker(structure, **self.options) for _ in range(2))

    @rule(y=values, u=st.sampled_from([-1.0, 0.3, 1.0]))
    def update(self, y, u):
        ahead = self.tracker.predict(u)
        one, other = self.tracker.update(y, u), self.twin.update(y, u)
        np.testing.assert_array_equal(one, other)
        assert one.prediction == pytest.approx(ahead, rel=1e-12, abs=1e-12)

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
            assert_same_state(before, self.tracker.state())
        else:
            for _ in range(length):
                self.twin.update(y, 1.0)

    @rule(call=st.sampled_from([(np.inf, 1.0), (0.0, np.nan), (0.0, [1.0, 2.0]), ("a", 1.0)]))
    def refused(self, call):
        before = self.tracker.state()
        with pytest.raises((ValueError, TypeError)):
            self.tracker.update(*call)
        assert_same_state(before, self.tracker.state())

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
        P = tracker.filter.P
        assert np.isfinite(P).all()
        scale = np.abs(P).max()
        assert np.abs(P - P.T).max() <= 1e-10 * scale and np.linalg.eigvalsh(P)[0] >= -1e-8 * scale
        assert np.isfinite(tracker.predict(0.0))
        assert_same_state(tracker.state(), self.twin.state())


@pytest.fixture(autouse=True)
def definition(monkeypatch):
    """One path, one set of bits."""
    support.without_kernel(monkeypatch)


@pytest.mark.filterwarnings("ignore::robust_filterpy.identification.LostTrackerWarning")
@pytest.mark.parametrize(
    "examples", [pytest.param(15, id="some"), pytest.param(1500, id="many", marks=pytest.mark.slow)]
)
def test_any_sequence_of_calls(examples):
    machine = Calls.TestCase
    machine.settings = settings(max_examples=examples, stateful_step_count=15, deadline=None)
    machine().runTest()
