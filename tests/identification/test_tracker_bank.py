"""A bank of trackers is a loop over trackers."""

import io
import pickle

import numpy as np
import pytest
import support

from robust_filterpy import Contaminated, Huber
from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError
from robust_filterpy.identification.models.regressor import GUARDS
from robust_filterpy.identification.recursive import bank as bank_module
from robust_filterpy.identification.recursive import track
from robust_filterpy.identification.recursive.recursion import GRADIENTS
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.plants import simulate_output_error

N, LENGTH = 5, 90
PLANTS = np.array([-1.5, 0.7, 1.0, 0.5]) * np.linspace(0.7, 1.0, N)[:, None] ** [1, 2, 1, 1]
STRUCTURES = [
    ARX(2, 2), ARX(2, 0), ARX(1, 2, nk=3), ARX(2, (1, 0, 2), nk=(0, 1, 2)), OutputError(2, 2), OutputError(4, 4),
    OutputError(1, (2, 1), nk=(1, 0)), OutputError(0, 3), ARMAX(2, 2, 2), ARMAX(0, 1, 1), ARMAX(1, 0, 2), FIR(6),
    BoxJenkins((2, 1), 2, 1, 1, nk=(0, 2)), FIR(2, nk=0), LinearRegression(3),
]  # fmt: skip
MIXED = [ARX(2, (1, 0, 2), nk=(0, 1, 2)), ARMAX(2, 2, 2), BoxJenkins((2, 1), 2, 1, 1, nk=(0, 2)), LinearRegression(3)]


def recording(structure, seed=1, missing=True):
    """Contaminated recordings of N plants, with gaps: y (LENGTH, N) and u (LENGTH, N, n_inputs)."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (LENGTH, N, max(structure.n_inputs, 1)))
    noise = Contaminated(0.1, 10.0, 0.5)
    plants = [simulate_output_error(PLANTS[i], u[:, i, 0], noise=noise, rng=rng, na=2, nb=2) for i in range(N)]
    y = np.column_stack([plant.y for plant in plants])
    if missing:
        y[rng.random(y.shape) < 0.1] = np.nan
        y[30] = np.nan
    return y, u[:, :, : structure.n_inputs]


#: What has a leading axis of actuators when each has its own, by the number of axes it then has.
AXES = {"theta": (2,), "P": (1, 3), "Q": (1, 3), "R": (1,), "F": (3,), "forgetting": (1,)}


def of(options, i):
    """The options of actuator i."""
    own = {}
    for name, value in options.items():
        shared = not isinstance(value, list) and not (name in AXES and np.ndim(value) in AXES[name])
        own[name] = value if shared else value[i]
    return own


def loop_over(structure, y, u, **options):
    """The trackers of a loop and their results, stacked as (N, n, ..)."""
    trackers = [support.told_tracker(structure, **of(options, i)) for i in range(y.shape[1])]
    results = [tracker.run(y[:, i], u[:, i]) for i, tracker in enumerate(trackers)]
    return trackers, [np.stack(column, axis=1) for column in zip(*results, strict=True)]


def close(ours, theirs, rtol=1e-10):
    """Hold arrays together, relative to the largest entry."""
    for a, b in zip(ours, theirs, strict=True):
        a, b = np.asarray(a), np.asarray(b)
        scale = np.abs(b[np.isfinite(b)]).max(initial=0.0) if b.size else 0.0
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * min(scale, 1.0) + 1e-300)


def same(ours, theirs):
    """Hold arrays together, to the last bit."""
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


def assert_is_the_loop(structure, y, u, **options):
    """Run both, hold all columns and the final state together, return the loop's columns.

    From P = 1 I: from 100 I rounding grows to 5e-10 in an output-error model, in a loop against itself, too.
    """
    options.setdefault("P", 1.0)
    trackers, expected = loop_over(structure, y, u, **options)
    bank = support.told_bank(y.shape[1], structure, **options)
    close(bank.run(y, u)[:6], expected)
    close([bank.theta, bank.P], zip(*((t.theta, t.P) for t in trackers), strict=True))
    state = [tracker.state() for tracker in trackers]
    for name in ("outputs", "inputs", "residuals", "gradients", "measured", "undisturbed", "prefiltered"):
        close([bank.state()[name]], [np.stack([s[name] for s in state])])
    return expected


# The loop is the definition


@pytest.mark.pairwise
@pytest.mark.parametrize(
    ("structure", "gradient", "guard"),
    [
        (structure, gradient, guard)
        for structure in STRUCTURES
        for gradient in GRADIENTS
        for guard in GUARDS
        # The other structures have no feedback for which this could make a difference.
        if structure.stable_parts or (gradient, guard) == ("filtered", "halve")
    ],
    ids=str,
)
def test_bank_is_the_loop(structure, gradient, guard):
    y, u = recording(structure)
    assert_is_the_loop(structure, y, u, gradient=gradient, guard=guard, R=0.25, Q=1e-4)


def test_bank_is_the_loop_for_the_influence_functions_of_statsmodels():
    norms = pytest.importorskip("statsmodels.robust.norms")
    y, u = recording(OutputError(2, 2))
    assert_is_the_loop(OutputError(2, 2), y, u, influence=norms.TrimmedMean(2.0), R=0.25)


@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2), ARMAX(1, 1, 1)], ids=str)
def test_each_actuator_may_have_its_own_options(structure):
    rng, n = np.random.default_rng(4), structure.n_theta
    factors = 0.1 * rng.normal(size=(N, n, n))
    options = {
        "theta": 0.1 * rng.normal(size=(N, n)),
        "P": np.linspace(0.5, 3.0, N),
        "Q": 1e-3 * factors @ factors.transpose(0, 2, 1),
        "R": np.linspace(0.1, 0.5, N),
        "F": np.eye(n) * np.linspace(0.98, 1.0, N)[:, None, None],
        "forgetting": np.array([1.0, 0.9, 0.95, 0.99, 1.0]),
        "gradient": ["filtered", "pseudolinear", "filtered", "pseudolinear", "filtered"],
        "guard": ["halve", "reject", "none", "halve", "none"],
        "influence": [Huber(), Huber(2.0), Huber(), Hampel(), Linear()],
        "scaling": ["innovation", "bounded", "innovation", "innovation", "bounded"],
        "information": ["realized", "expected", "realized", "weight", "realized"],
    }
    y, u = recording(structure)
    assert_is_the_loop(structure, y, u, **options)
    for name, value in options.items():
        assert_is_the_loop(structure, y, u, **{name: value})


def assert_steps_are_the_loop(structure, y, u, **options):
    """Hold every single step together, from the same start; return how often P was larger than it began.

    Where a sample tells 1e6 times more than P, rounding in P is that much larger in the direction that matters next
    (a tracker whose P is off by the last bit drifts from itself as far), so that recordings part but steps do not.
    """
    bank, grown = support.told_bank(y.shape[1], structure, **options), 0
    trackers = [bank.tracker(i) for i in range(bank.n)]
    signals = ("outputs", "inputs", "gradients", "residuals", "measured", "undisturbed", "prefiltered")
    for k in range(len(y)):
        before, ahead = bank.state(), bank.predict(u[k])
        same(before.values(), bank.state().values())
        grown += (before["P"].max(axis=(1, 2)) > 1.01 * 100.0).sum()
        sample = bank.update(y[k], u[k])
        close([ahead], [sample.prediction], rtol=1e-13)
        after = bank.state()
        for i, tracker in enumerate(trackers):
            own = {name: before[name][i] for name in ("theta", "P", "enabled", "recursion", "start", *signals)}
            tracker.restore(own)
            prediction, residual, weight, guard = tracker.update(y[k, i], u[k, i])
            expected = tracker.state()
            np.testing.assert_allclose(sample.weights[i], weight, rtol=0, atol=1e-9)
            assert sample.guard[i] == guard
            close([after["theta"][i]], [expected["theta"]], rtol=1e-9)
            np.testing.assert_allclose(after["P"][i], expected["P"], rtol=0, atol=1e-7 * np.abs(own["P"]).max())
            largest = max(1.0, *(np.abs(own[name]).max(initial=0.0) for name in signals), np.nan_to_num(abs(y[k, i])))
            pairs = [(after[name][i], expected[name]) for name in signals]
            for found, wanted in [*pairs, (sample.prediction[i], prediction), (sample.residual[i], residual)]:
                np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * largest)
    return grown


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("gradient", ["filtered", "pseudolinear"])
@pytest.mark.parametrize("structure", [ARX(2, 2), ARMAX(2, 2, 1), OutputError(2, 2), FIR(2)], ids=str)
@pytest.mark.parametrize("spike", [1e8, 1e12, 1e40, 1e300])
def test_a_spike_in_phi_is_tempered_as_in_the_loop(structure, gradient, spike):
    y, u = recording(structure)
    y, u = y[15:60, 1:4].copy(), u[15:60, 1:4].copy()
    y[20, 0], y[30, 2], u[25, 1] = spike, -spike, min(spike, 1e90)
    assert_steps_are_the_loop(structure, y, u, gradient=gradient, R=0.25)
    if not structure.stable_parts:
        assert_is_the_loop(structure, y, u, gradient=gradient, R=0.25)


# One sample or a recording, kept or not


def test_result_has_an_axis_for_samples_and_one_for_actuators():
    structure = OutputError(2, 2)
    y, u = recording(structure)
    result = support.told_bank(N, structure, R=0.25).run(y, u)
    assert result.theta.shape == result.std.shape == (LENGTH, N, 4)
    assert result.prediction.shape == result.residual.shape == result.weights.shape == result.guard.shape == (LENGTH, N)
    assert result.guard.dtype.kind == "i"
    same([result.sample], [np.arange(LENGTH)])
    alone = result.tracker(2)
    same(alone, [column[:, 2] for column in result[:6]])
    lower, upper = result.confidence_intervals(0.9)
    same(alone.confidence_intervals(0.9), (lower[:, 2], upper[:, 2]))


def test_what_is_not_kept_changes_nothing():
    structure = OutputError(2, 2)
    y, u = recording(structure)
    whole = support.told_bank(N, structure).run(y, u)
    for keep, samples in (("last", [LENGTH - 1]), (7, np.arange(6, LENGTH, 7)), (1, range(LENGTH)), (LENGTH + 1, [])):
        some = support.told_bank(N, structure).run(y, u, keep=keep)
        same(some, [column[list(samples)] for column in whole])
    for keep in ("none", 0, 2.5):
        with pytest.raises((ValueError, TypeError), match="keep: expected"):
            support.told_bank(N, structure).run(y, u, keep=keep)


def test_an_input_may_be_shared_by_all():
    y, u = recording(ARX(2, 2))
    one, two = ARX(2, 2), ARX(2, (1, 2))
    both = np.concatenate([u, -2.0 * u[::-1]], axis=2)
    for structure, shared, forms in (
        (one, u[:, 0], [u[:, 0], u[:, 0, 0], u[:, :1].repeat(N, 1), u[:, :1, 0].repeat(N, 1)]),
        (two, both[:, 0], [both[:, 0], both[:, :1].repeat(N, 1)]),
    ):
        expected = loop_over(structure, y, np.repeat(shared[:, None], N, axis=1), P=1.0)[1]
        for form in forms:
            close(support.told_bank(N, structure, P=1.0).run(y, form)[:6], expected)
            bank = support.told_bank(N, structure, P=1.0)
            close([[bank.update(y[k], form[k]).prediction for k in range(LENGTH)]], [expected[2]])


def test_each_sample_may_have_its_own_variance():
    structure, rng = OutputError(2, 2), np.random.default_rng(3)
    y, u = recording(structure)
    R = rng.uniform(0.1, 1.0, (LENGTH, N))
    for shared, given_ in ((False, R), (True, R[:, 0]), (True, 0.7)):
        each = np.broadcast_to(R[:, :1] if shared and np.ndim(given_) else given_, (LENGTH, N))
        one, other = support.told_bank(N, structure, P=1.0), support.told_bank(N, structure, P=1.0)
        result = one.run(y, u, given_)
        close([result.prediction], [[other.update(y[k], u[k], R=each[k]).prediction for k in range(LENGTH)]])
        for i in range(N):
            close(result.tracker(i), support.told_tracker(structure, P=1.0).run(y[:, i], u[:, i], each[:, i]))
    for wrong in (np.ones(N), -1.0, np.where(R > 0.99, 0.0, R)):
        with pytest.raises(ValueError, match="R: expected"):
            one.run(y, u, wrong)
    with pytest.raises(ValueError, match=r"R: expected.*actuator 1"):
        one.update(y[0], u[0], [1.0, -1.0, 1.0, 1.0, 1.0])


def test_model_without_input_needs_none():
    y, _ = recording(ARX(2, 0))
    one, other = support.told_bank(N, ARX(2, 0)), support.told_bank(N, ARX(2, 0))
    same(one.run(y), other.run(y, np.zeros((LENGTH, 0))))
    assert one.update(y[0]).prediction.shape == (N,)


# The models


def test_coefficients_split_theta():
    theta = np.arange(N * 5, dtype=float).reshape(N, 5) / 100
    bank = support.told_bank(N, ARMAX(1, (2, 1), 1), theta=theta)
    a, b, c = bank.coefficients
    same([a, *b, c], [theta[:, :1], theta[:, 1:3], theta[:, 3:4], theta[:, 4:]])
    same(support.told_bank(N, OutputError(1, 1), theta=[0.5, 2.0]).coefficients.b, np.full((N, 1), 2.0))
    with pytest.raises(ValueError, match="your regressor"):
        support.told_bank(N, LinearRegression(3)).coefficients  # noqa: B018


@pytest.mark.parametrize("dt", [-1, 0.0, np.nan, np.inf, False, None, "1"])
def test_transfer_function_of_no_sampling_period_is_refused(dt):
    pytest.importorskip("control")
    tracker = support.told_bank(1, OutputError(1, 1), theta=[-0.5, 2.0]).tracker(0)
    with pytest.raises(ValueError, match="dt: expected a sampling period > 0 in s, or True, got"):
        tracker.transfer_function(dt=dt)
    for good in (True, 0.1, np.float64(0.1), 2):
        assert tracker.transfer_function(dt=good).dt == good


@pytest.mark.parametrize("structure", MIXED, ids=str)
def test_tracker_goes_on_where_the_bank_is(structure):
    y, u = recording(structure)
    forgetting, gradient = np.linspace(0.9, 1.0, N), ["filtered", "pseudolinear"] * 2 + ["filtered"]
    bank = support.told_bank(
        N, structure, P=1.0, Q=1e-4, R=0.25, forgetting=forgetting, gradient=gradient, influence=Huber(2.0)
    )
    first = bank.run(y[:70], u[:70])
    singles = [bank.tracker(i) for i in range(N)]
    same([bank.theta, bank.P, bank.std], zip(*((t.theta, t.P, t.std) for t in singles), strict=True))
    expected = bank.run(y[70:], u[70:])
    for i, tracker in enumerate(singles):
        close(tracker.run(y[70:, i], u[70:, i]), expected.tracker(i))
        tracker.reset()
        close(tracker.run(y[:70, i], u[:70, i]), first.tracker(i))
    for outside in (N, -1):
        with pytest.raises(IndexError, match="actuator: expected 0 to 4"):
            bank.tracker(outside)
    for wrong in ("a", True, 1.0, None):
        with pytest.raises(TypeError, match="actuator: expected an integer from 0 to 4, got"):
            bank.tracker(wrong)


# Freezing, interruption


def test_which_actuators_learn_is_a_list_of_bools():
    bank = support.told_bank(N, FIR(2))
    bank.enabled = np.arange(N) != 1
    bank.enabled[3] = False
    for wrong in (np.ones(4, dtype=bool), [1, 0, 1, 0, 1], None):
        with pytest.raises((TypeError, ValueError), match="enabled: expected"):
            bank.enabled = wrong
    assert bank.enabled.tolist() == [True, False, True, False, True]


@pytest.mark.parametrize("structure", MIXED, ids=str)
def test_pickle_and_state_continue_bit_for_bit(structure):
    y, u = recording(structure)
    original = support.told_bank(N, structure, Q=1e-5, R=np.linspace(0.1, 0.5, N), forgetting=0.99)
    original.enabled = np.arange(N) != 1
    original.run(y[:70], u[:70])
    thawed = pickle.loads(pickle.dumps(original))
    file = io.BytesIO()
    np.savez(file, **original.state())
    file.seek(0)
    restored = support.told_bank(N, structure)
    with np.load(file, allow_pickle=False) as stored:
        restored.restore(stored)
    expected = original.run(y[70:], u[70:])
    same(expected, thawed.run(y[70:], u[70:]))
    same(expected, restored.run(y[70:], u[70:]))


@pytest.mark.parametrize("state", [
    support.told_bank(N, ARX(1, 3)).state(),
    support.told_bank(N + 1, ARX(2, 2)).state(),
    support.told_tracker(ARX(2, 2)).state(),
    {"theta": np.zeros((N, 4))},
    {**support.told_bank(N, ARX(2, 2)).state(), "P": np.full((N, 4, 4), np.nan)},
])  # fmt: skip
def test_state_of_another_bank_is_refused(state):
    bank = support.told_bank(N, ARX(2, 2))
    before = bank.state()
    with pytest.raises(ValueError, match="state: expected"):
        bank.restore(state)
    same(before.values(), bank.state().values())


@pytest.mark.parametrize(("name", "value", "words"), [
    ("R", 0.0, "R > 0.*: actuator 2$"),
    ("alpha_sq", 0.0, "alpha_sq >= 1.*: actuator 2$"),
    ("P", np.diag([1.0, 1.0, 1.0, -1e-3]), "positive semidefinite.*: actuator 2$"),
    ("P", np.eye(4) + np.triu(np.full((4, 4), 0.1)), "symmetric.*: actuator 2$"),
    ("theta", [-2.5, 1.0, 0.0, 0.0], "theta of a stable model.*: actuator 2$"),
])  # fmt: skip
def test_state_that_no_bank_can_be_in_is_refused(name, value, words):
    y, u = recording(OutputError(2, 2))
    bank = support.told_bank(N, OutputError(2, 2), R=0.25)
    bank.run(y, u)
    before = bank.state()
    spoilt = bank.state()
    spoilt[name][2] = value
    with pytest.raises(ValueError, match=f"^state: .*expected .*{words}"):
        bank.restore(spoilt)
    same(before.values(), bank.state().values())


def test_unstable_model_is_restored_where_no_guard_keeps_it_stable():
    bank = support.told_bank(2, ARMAX(1, 1, 1), guard=["none", "halve"])
    theta = np.array([[0.5, 1.0, 2.0], [2.0, 1.0, 0.5]])
    bank.restore({**bank.state(), "theta": theta})
    same(bank.theta, theta)
    with pytest.raises(ValueError, match=r"stable model.*: actuator 1$"):
        bank.restore({**bank.state(), "theta": theta[::-1]})


# Bad input


@pytest.mark.parametrize(("options", "error", "words"), [
    ({"theta": [1.0, 2.0]}, ValueError, r"theta: expected 4 parameters"),
    ({"theta": np.full((N, 4), np.nan)}, ValueError, "theta: expected finite"),
    ({"theta": np.eye(N)[:, :4] * 1.5}, ValueError, "stable model.*actuators 0, 1"),
    ({"guard": np.array("project")}, ValueError, "guard: expected one of"),
    ({"P": [1.0, 1.0, -1.0, 1.0, 1.0]}, ValueError, "P: expected a positive semidefinite.*: actuator 2"),
    ({"P": np.ones(4)}, ValueError, "P: expected"),
    ({"Q": np.triu(np.ones((N, 4, 4)))}, ValueError, "Q: expected a symmetric.*: actuators 0, 1, 2, 3, 4"),
    ({"R": np.inf}, ValueError, "R: expected"),
    ({"R": [1.0, 1.0, 0.0, 1.0, np.nan]}, ValueError, "R: expected.*actuators 2, 4"),
    ({"R": np.eye(2)}, ValueError, "R: expected one for all or a list of 5, got 2"),
    ({"F": np.full((N, 4, 4), np.inf)}, ValueError, "F: expected finite"),
    ({"forgetting": [1.0, 1.0, 0.0, 1.0, 1.0]}, ValueError, "forgetting: expected.*actuator 2"),
    ({"guard": ["halve", "project", "none", "none", "none"]}, ValueError, "guard: expected one of.*: actuator 1"),
    ({"guard": ["halve"] * 4}, ValueError, "guard: expected one for all or a list of 5, got 4"),
    ({"gradient": "exact"}, ValueError, "gradient: expected one of"),
    ({"influence": Huber}, TypeError, "influence: expected an object"),
    ({"scaling": "none"}, ValueError, "scaling: expected one of"),
    ({"information": ["weight", "none", "weight", "weight", "weight"]}, ValueError, "information: expected one of"),
])  # fmt: skip
def test_bad_arguments_are_refused(options, error, words):
    with pytest.raises(error, match=words):
        support.told_bank(N, OutputError(2, 2), **options)


def test_size_and_structure_are_checked():
    with pytest.raises(TypeError, match="structure: expected ARX"):
        support.told_bank(3, 4)
    with pytest.raises(ValueError, match="n: expected an integer >= 1"):
        support.told_bank(0, ARX(1, 1))


def bad(shape, value, *where):
    """Ones with a value in some places."""
    values = np.ones(shape)
    for place in where:
        values[place] = value
    return values


@pytest.mark.parametrize(("call", "words"), [
    (lambda b: b.update(np.ones(4), 1.0), r"y: expected shape \(5,\)"),
    (lambda b: b.update(bad(N, np.inf, 1, 3), 1.0), "y: expected finite.*actuators 1, 3"),
    (lambda b: b.update(np.ones(N), np.ones(4)), r"u: expected"),
    (lambda b: b.update(np.ones(N)), r"u: expected.*got None"),
    (lambda b: b.update(np.ones(N), bad(N, np.nan, 4)), "u: expected finite.*actuator 4"),
    (lambda b: b.update(["a"] * N, 1.0), "y: expected real numbers"),
    (lambda b: b.run(np.ones((3, 4)), np.ones(3)), r"y: expected shape \(N, 5\)"),
    (lambda b: b.run(np.ones((3, N)), np.ones(4)), "u: expected"),
    (lambda b: b.run(bad((3, N), np.inf, (1, 2), (2, 4)), np.ones(3)), "sample 1.*actuator 2"),
    (lambda b: b.run(np.ones((3, N)), bad((3, N), np.nan, (2, 0))), "sample 2.*actuator 0"),
    (lambda b: b.run(np.ones((3, N)), bad(3, 1e200, 1)), "u: expected finite.*sample 1"),
    (lambda b: b.predict(np.ones(4)), "u: expected"),
])  # fmt: skip
def test_a_refused_call_changes_nothing(call, words):
    bank = support.told_bank(N, OutputError(2, 2))
    y, u = recording(OutputError(2, 2))
    bank.run(y[:20], u[:20])
    before = bank.state()
    with pytest.raises((ValueError, TypeError), match=words):
        call(bank)
    same(before.values(), bank.state().values())


@pytest.mark.parametrize(("name", "value", "words"), [
    ("R", [1.0, 1.0, -1.0, 1.0, 1.0], "R: expected.*actuator 2"),
    ("Q", 1.0, "Q: expected shape"),
    ("Q", np.full((4, 4), np.nan), "Q: expected finite numbers"),
    ("F", 1e200 * np.eye(4), "finite"),
])  # fmt: skip
def test_settings_spoilt_between_samples_are_refused(name, value, words):
    bank = support.told_bank(N, OutputError(2, 2))
    y, u = recording(OutputError(2, 2), missing=False)
    bank.run(y[:20], u[:20])
    before, good = bank.state(), getattr(bank, name)
    with pytest.raises((ValueError, TypeError), match=words):
        setattr(bank, name, value)
        bank.update(y[20], u[20])
    setattr(bank, name, good)
    same(before.values(), bank.state().values())


@pytest.mark.parametrize("scaling", ["unit", ["innovation", "unit", "unit", "innovation", "innovation"]])
def test_a_sample_that_one_filter_refuses_changes_no_actuator_and_is_named(scaling):
    y, u = recording(ARX(2, 2), missing=False)
    y[:, [0, 1, 3, 4]] *= 0.01
    u = u * [[0.01], [0.01], [1.0], [0.01], [0.01]]
    bank = support.told_bank(N, ARX(2, 2), P=1.0, scaling=scaling, influence=Linear())
    before = bank.state()
    with pytest.raises(np.linalg.LinAlgError, match='sample 1: actuator 2: scaling="unit" would make P indefinite'):
        bank.run(y, u)
    same(before.values(), bank.state().values())
    bank.update(y[0], u[0])
    before = bank.state()
    with pytest.raises(np.linalg.LinAlgError, match=r"^actuator 2"):
        bank.update(y[1], u[1])
    same(before.values(), bank.state().values())
    tracker = support.told_tracker(ARX(2, 2), P=1.0, scaling="unit", influence=Linear())
    with pytest.raises(np.linalg.LinAlgError, match="sample 1"):
        tracker.run(y[:, 2], u[:, 2])


def test_an_interrupted_run_changes_nothing(monkeypatch):
    y, u = recording(ARX(2, 2))
    bank = support.told_bank(N, ARX(2, 2))
    bank.run(y[:20], u[:20])
    monkeypatch.setattr(bank_module, "_CHUNK", 7 * N * 4)
    before, advance, calls = bank.state(), track.advance, []

    def interrupted(*args):
        calls.append(args)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return advance(*args)

    monkeypatch.setattr(track, "advance", interrupted)
    with pytest.raises(KeyboardInterrupt):
        bank.run(y[20:], u[20:])
    same(before.values(), bank.state().values())
