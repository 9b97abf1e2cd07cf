"""Any sequence of calls, and any writes into arrays: what must hold whatever a user does."""

import copy
import pickle

import numpy as np
import pytest
import support
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS
from robust_filterpy.influence import Hampel, Linear

PSIS = [Huber(), Huber(3.0), Linear(), Hampel(), TukeyBiweight(), StudentT()]
numbers = st.one_of(
    st.floats(-100.0, 100.0), st.sampled_from([0.0, 1e6, -1e12, 1e150, -1e300, np.nan]), st.floats(-1e-3, 1e-3)
)


class Calls(RuleBasedStateMachine):
    """Draw calls of a filter with two sensors."""

    @initialize(seed=st.integers(0, 10**6), dim_x=st.integers(1, 4), flat=st.booleans())
    def start(self, seed, dim_x, flat):
        self.problem = support.random_problem(seed, dim_x, 2)
        self.kf = support.make(RobustKalmanFilter, self.problem, ndim=1 if flat else 2)
        self.dim_x = dim_x

    @rule()
    def predict(self):
        self.kf.predict()

    @rule(z=st.lists(numbers, min_size=2, max_size=2))
    def update(self, z):
        x, P = self.kf.get_update(z)
        self.kf.update(z)
        np.testing.assert_array_equal(self.kf.x, x)
        np.testing.assert_array_equal(self.kf.P, P)

    @rule(z=st.lists(numbers, min_size=2, max_size=2), seed=st.integers(0, 10**6))
    def update_by_another_sensor(self, z, seed):
        other = support.random_problem(seed, self.dim_x, 2)
        self.kf.update(z, R=other.R, H=other.H)

    @rule(z=st.lists(numbers, min_size=2, max_size=2))
    def update_in_parts(self, z):
        for i, number in enumerate(z):
            self.kf.update_sequential(i, number)

    @rule(rows=st.lists(st.lists(numbers, min_size=2, max_size=2), min_size=1, max_size=6), data=st.data())
    def batch(self, rows, data):
        """Any split of a recording gives the numbers of one run, and of a loop."""
        whole, parts, loop = (copy.deepcopy(self.kf) for _ in range(3))
        at = data.draw(st.integers(0, len(rows)))
        expected = whole.batch_filter(rows)[0]
        found = np.concatenate([parts.batch_filter(part)[0] for part in (rows[:at], rows[at:])])
        support.through(loop, rows)
        size = max(np.abs(expected).max(), 1e-300)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * size)
        for other in (parts, loop):
            support.assert_close(other.x, whole.x, 1e-9, "x", size)
            support.assert_close(other.P, whole.P, 1e-9, "P")
        self.kf = whole

    @rule(how=st.sampled_from(["copy", "deepcopy", "pickle"]))
    def go_on_with_a_copy(self, how):
        copies = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda kf: pickle.loads(pickle.dumps(kf))}
        other = copies[how](self.kf)
        for kf in (other, self.kf):
            support.predict_and_update(kf, [0.5, -0.5])
        np.testing.assert_array_equal(other.x, self.kf.x)
        np.testing.assert_array_equal(other.P, self.kf.P)
        self.kf = other

    @rule(psi=st.sampled_from(PSIS), information=st.sampled_from(INFORMATIONS), grouping=st.sampled_from(GROUPINGS))
    def change_options(self, psi, information, grouping):
        self.kf.influence, self.kf.information, self.kf.grouping = psi, information, grouping

    @rule(scaling=st.sampled_from(["innovation", "bounded"]), alpha=st.sampled_from([1.0, 1.02]))
    def change_scaling(self, scaling, alpha):
        self.kf.scaling, self.kf.alpha = scaling, alpha

    @invariant()
    def holds(self):
        """P is a covariance, x finite, and a weight a share."""
        if not hasattr(self, "kf"):
            return
        kf = self.kf
        np.testing.assert_allclose(kf.P, kf.P.T, rtol=1e-12, atol=0)
        unit = np.sqrt(np.diag(kf.P))
        assert np.linalg.eigvalsh(kf.P / np.outer(unit, unit))[0] > -1e-9
        assert np.isfinite(kf.x).all()
        weights = kf.weights[~np.isnan(kf.weights)]
        assert ((weights >= 0.0) & (weights <= 1.0 + 1e-12)).all()
        assert np.isfinite(kf.log_likelihood)


Calls.TestCase.settings = settings(max_examples=40, stateful_step_count=20, deadline=None)
TestCalls = Calls.TestCase


@pytest.mark.slow
class TestManyCalls(Calls.TestCase):
    settings = settings(max_examples=4000, stateful_step_count=40, deadline=None)


# What a program writes into an array of a filter where it stands counts as what it assigns, in every class.


F = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.0, 0.0, 0.95]])
H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2]])


MAKERS = support.of_every_kind(F, H)
MAKERS.pop("ensemble")
SHOWN = "x P x_prior P_prior x_post P_post y S K weights log_likelihood".split()


def drawn(rng, kf):
    """Draw what is done to a filter next: a step, or a change of one of its arrays."""
    kind = rng.integers(7)
    if kind < 2:
        u = None if getattr(kf, "B", None) is None or not isinstance(kf.B, np.ndarray) else rng.normal(size=1)
        return (lambda one: one.predict(u)) if u is not None else lambda one: one.predict()
    if kind < 4:
        z = 3.0 * rng.normal(size=2) * (100.0 if rng.random() < 0.1 else 1.0)
        # A sigma-point filter corrects by the points of its prediction, as often as there is one.
        return lambda one: (hasattr(kf, "sigmas_f") and one.predict(), one.update(z))
    name = rng.choice([name for name in "xPFHQRBM" if isinstance(getattr(kf, name, None), np.ndarray)])
    factor = float(rng.choice([0.5, 2.0, 1000.0])) if name in "PQR" else 1.0
    add = rng.normal(size=np.shape(getattr(kf, name))) * (0.01 if name in "FHBM" else 0.0 if name in "PQR" else 5.0)
    place = slice(None) if name in "PQR" else slice(0, int(rng.integers(1, 3)))
    return name, lambda array: array[place].__imul__(factor).__iadd__(add[place])


def done(kf, change, assigns):
    """Do it, a change by assignment or in place."""
    if callable(change):
        return change(kf)
    name, write = change
    array = getattr(kf, name)
    array = array.copy() if assigns else array
    write(array)
    return setattr(kf, name, array) if assigns else None


@pytest.mark.parametrize("name", MAKERS)
def test_a_write_in_place_is_an_assignment(name):
    for seed in range(5):
        rng, one, other = np.random.default_rng(seed), MAKERS[name](), MAKERS[name]()
        for kf in (one, other):
            kf.B = 0.1 * np.ones((3, 1))
        for _ in range(40):
            change = drawn(rng, one)
            done(one, change, False)
            done(other, change, True)
            reads = SHOWN if rng.random() < 0.5 else SHOWN[:2]
            for shown in reads:
                found = np.asarray(getattr(one, shown, np.nan), dtype=float)
                np.testing.assert_array_equal(found, np.asarray(getattr(other, shown, np.nan), dtype=float), shown)
