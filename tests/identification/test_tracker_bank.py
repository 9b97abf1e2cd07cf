"""A bank of trackers is a loop over trackers."""

import io
import itertools
import pickle
import warnings

import numpy as np
import pytest
import support
from interruption import half_steps
from recordings import assert_refused, same, unchanged, unheard
from scipy.signal import lfilter
from statsmodels.robust import norms

from robust_filterpy import ARX, Contaminated, Huber, OutputError, ParameterTracker, identify
from robust_filterpy.filters import StuckSensorWarning
from robust_filterpy.identification import ARMAX, FIR, BoxJenkins, LinearRegression, LostTrackerWarning, TrackerBank
from robust_filterpy.identification.models.regressor import GUARDS
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


def loop_over(structure, y, u, **options):
    """The trackers of a loop and their results, stacked as (N, n, ..); what is a list has an option for each."""
    trackers = []
    for i in range(y.shape[1]):
        own = {name: value[i] if isinstance(value, list) else value for name, value in options.items()}
        trackers.append(support.paper_tracker(structure, **own))
    results = [tracker.run(y[:, i], u[:, i]) for i, tracker in enumerate(trackers)]
    return trackers, [np.stack(column, axis=1) for column in zip(*results, strict=True)]


def close(ours, theirs, rtol=1e-10):
    """Hold arrays together, relative to the largest entry."""
    for a, b in zip(ours, theirs, strict=True):
        a, b = np.asarray(a), np.asarray(b)
        scale = np.abs(b[np.isfinite(b)]).max(initial=0.0) if b.size else 0.0
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * min(scale, 1.0) + 1e-300)


def assert_is_the_loop(structure, y, u, **options):
    """Run both, hold all columns and the final state together, return the loop's columns.

    From P = 1 I: from 100 I rounding grows to 5e-10 in an output-error model, in a loop against itself, too.
    """
    options.setdefault("P", 1.0)
    trackers, expected = loop_over(structure, y, u, **options)
    bank = support.paper_bank(y.shape[1], structure, **options)
    close(bank.run(y, u)[:6], expected)
    close([bank.theta, bank.P], zip(*((t.theta, t.P) for t in trackers), strict=True))
    state = [tracker.state() for tracker in trackers]
    for name in ("outputs", "inputs", "residuals", "gradients", "measured", "undisturbed", "prefiltered"):
        close([bank.state()[name]], [np.stack([s[name] for s in state])])
    return expected


# The loop is the definition


@pytest.mark.pairwise
@pytest.mark.parametrize(("structure", "gradient", "guard"), [
    (structure, gradient, guard)
    for structure in STRUCTURES
    for gradient in GRADIENTS
    for guard in GUARDS
    # The other structures have no feedback for which this could make a difference.
    if structure.stable_parts or (gradient, guard) == ("filtered", "halve")
], ids=str)  # fmt: skip
def test_bank_is_the_loop(structure, gradient, guard):
    y, u = recording(structure)
    assert_is_the_loop(structure, y, u, gradient=gradient, guard=guard, R=0.25, Q=1e-4)


@pytest.mark.parametrize("structure", [ARX(2, 2), FIR(2)], ids=str)
@pytest.mark.parametrize("spike", [1e8, 1e40, 1e300])
def test_a_spike_in_phi_is_tempered_as_in_the_loop(structure, spike):
    y, u = recording(structure)
    y, u = y[15:60, 1:4].copy(), u[15:60, 1:4].copy()
    y[20, 0], y[30, 2], u[25, 1] = spike, -spike, min(spike, 1e90)
    assert_is_the_loop(structure, y, u, R=0.25)


@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2), ARMAX(1, 1, 1)], ids=str)
def test_each_actuator_may_have_its_own_options(structure):
    rng, n = np.random.default_rng(4), structure.n_theta
    factors = 0.1 * rng.normal(size=(N, n, n))
    options = {
        "theta": list(0.1 * rng.normal(size=(N, n))),
        "P": list(np.linspace(0.5, 3.0, N)),
        "Q": list(1e-3 * factors @ factors.transpose(0, 2, 1)),
        "R": list(np.linspace(0.1, 0.5, N)),
        "F": [factor * np.eye(n) for factor in np.linspace(0.98, 1.0, N)],
        "forgetting": [1.0, 0.9, 0.95, 0.99, 1.0],
    }
    y, u = recording(structure)
    assert_is_the_loop(structure, y, u, **options)
    # A psi that the kernel does not know, one actuator after the other.
    choices = {"influence": norms.TrimmedMean(2.0), "scaling": "bounded", "information": "weight", "guard": "none"}
    assert_is_the_loop(structure, y, u, gradient="pseudolinear", **choices, **options)
    for name, value in options.items():
        assert_is_the_loop(structure, y, u, **{name: value})


def test_a_matrix_for_each_actuator_that_is_set_or_restored_later_is_its_own():
    structure, Q = FIR(2), np.geomspace(1e-5, 1e-2, N)
    y, u = recording(structure)
    expected = loop_over(structure, y, u, P=1.0, Q=list(Q))[1]
    one, other = (support.paper_bank(N, structure, P=1.0) for _ in range(2))
    one.Q = Q
    with unheard():
        other.restore(one.state())
    for bank in (one, other):
        close(bank.run(y, u)[:6], expected)


# One sample or a recording, whole or in parts


def test_result_has_an_axis_for_samples_and_one_for_actuators_and_parts_go_on_from_each_other():
    structure = OutputError(2, 2)
    y, u = recording(structure)
    result = support.paper_bank(N, structure).run(y, u)
    assert result.theta.shape == (LENGTH, N, 4) and result.guard.dtype.kind == "i"
    alone = result.tracker(2)
    same(alone, [column[:, 2] for column in result[:6]])
    lower, upper = result.confidence_intervals(0.9)
    same(alone.confidence_intervals(0.9), (lower[:, 2], upper[:, 2]))
    bank = support.paper_bank(N, structure)
    for part in (slice(0, 1), slice(1, 8), slice(8, LENGTH)):
        same(bank.run(y[part], u[part]), [column[part] for column in result])


def test_an_input_may_be_shared_by_all():
    y, u = recording(ARX(2, 2))
    both = np.concatenate([u, -2.0 * u[::-1]], axis=2)
    for structure, shared, forms in (
        (ARX(2, 2), u[:, 0], [u[:, 0], u[:, 0, 0], u[:, :1].repeat(N, 1), u[:, :1, 0].repeat(N, 1)]),
        (ARX(2, (1, 2)), both[:, 0], [both[:, 0], both[:, :1].repeat(N, 1)]),
    ):
        expected = loop_over(structure, y, np.repeat(shared[:, None], N, axis=1), P=1.0)[1]
        for form in forms:
            close(support.paper_bank(N, structure, P=1.0).run(y, form)[:6], expected)
            bank = support.paper_bank(N, structure, P=1.0)
            close([[bank.update(y[k], form[k]).prediction for k in range(LENGTH)]], [expected[2]])


def test_each_sample_may_have_its_own_variance():
    structure, rng = OutputError(2, 2), np.random.default_rng(3)
    y, u = recording(structure)
    R = rng.uniform(0.1, 1.0, (LENGTH, N))
    for given, each in ((R, R), (R[:, 0], np.repeat(R[:, :1], N, axis=1)), (0.7, np.full((LENGTH, N), 0.7))):
        one, other = support.paper_bank(N, structure, P=1.0), support.paper_bank(N, structure, P=1.0)
        result = one.run(y, u, given)
        close([result.prediction], [[other.update(y[k], u[k], R=each[k]).prediction for k in range(LENGTH)]])
        for i in range(N):
            close(result.tracker(i), support.paper_tracker(structure, P=1.0).run(y[:, i], u[:, i], each[:, i]))


# The models


def test_coefficients_split_theta():
    theta = np.arange(N * 5, dtype=float).reshape(N, 5) / 100
    a, b, c, *_ = support.paper_bank(N, ARMAX(1, (2, 1), 1), theta=theta).coefficients
    same([a, *b, c], [theta[:, :1], theta[:, 1:3], theta[:, 3:4], theta[:, 4:]])
    same(support.paper_bank(N, OutputError(1, 1), theta=[0.5, 2.0]).coefficients.b, np.full((N, 1), 2.0))
    with pytest.raises(ValueError, match="your regressor"):
        support.paper_bank(N, LinearRegression(3)).coefficients  # noqa: B018


def test_tracker_goes_on_where_the_bank_is():
    structure = MIXED[1]
    y, u = recording(structure)
    own = {"forgetting": np.linspace(0.9, 1.0, N), "influence": Huber(2.0), "gradient": "pseudolinear"}
    bank = support.paper_bank(N, structure, P=1.0, Q=1e-4, R=0.25, **own)
    first = bank.run(y[:70], u[:70])
    singles = [bank.tracker(i) for i in range(N)]
    expected = bank.run(y[70:], u[70:])
    for i, tracker in enumerate(singles):
        close(tracker.run(y[70:, i], u[70:, i]), expected.tracker(i))
        tracker.reset()
        close(tracker.run(y[:70, i], u[:70, i]), first.tracker(i))
    for wrong in (N, -1, "a", True, 1.0, None):
        with pytest.raises((IndexError, TypeError), match=r"actuator: expected .*0 to 4"):
            bank.tracker(wrong)


def test_a_bank_of_a_model_goes_on_from_it_and_resets_to_it():
    y, u = recording(ARX(2, 2))
    model = identify(y[:60, 0], u[:60, 0, 0], ARX(2, 2))
    bank, tracker = TrackerBank(2, model), ParameterTracker(model)
    expected = tracker.run(y[60:, 0], u[60:, 0, 0])
    same(bank.run(y[60:, [0, 0]], u[60:, 0, 0]).tracker(1), expected)
    bank.reset()
    same(bank.theta, [model.theta] * 2)


# Freezing, interruption


def test_which_actuators_learn_is_a_list_of_bools():
    bank = support.paper_bank(N, FIR(2))
    bank.enabled = np.arange(N) != 1
    bank.enabled[3] = False
    assert bank.enabled.tolist() == [True, False, True, False, True]
    assert_refused(lambda enabled: setattr(bank, "enabled", enabled), {"enabled": True}, {
        "enabled": [np.ones(4, dtype=bool), [1, 0, 1, 0, 1], None],
    })  # fmt: skip


@pytest.mark.parametrize("structure", MIXED, ids=str)
def test_pickle_and_a_file_continue_bit_for_bit(structure):
    y, u = recording(structure)
    original = support.paper_bank(N, structure, Q=1e-5, R=np.linspace(0.1, 0.5, N), forgetting=0.99)
    original.enabled = np.arange(N) != 1
    original.run(y[:70], u[:70])
    thawed, restored, file = pickle.loads(pickle.dumps(original)), support.paper_bank(N, structure), io.BytesIO()
    np.savez(file, **original.state())
    file.seek(0)
    with np.load(file, allow_pickle=False) as stored:
        restored.restore(stored)
    with pytest.raises(ValueError, match="state: expected"):
        support.paper_bank(N + 1, structure).restore(original.state())
    expected = original.run(y[70:], u[70:])
    for other in (thawed, restored):
        same(expected, other.run(y[70:], u[70:]))


@pytest.mark.parametrize(("name", "value", "words"), [
    ("scale", 0.0, "> 0 in scale, got"),
    ("alpha_sq", 0.0, ">= 1 in alpha_sq, got"),
    ("P", np.diag([1.0, 1.0, 1.0, -1e-3]), "positive semidefinite"),
    ("P", np.diag([1e12, -1e3, 1.0, 1.0]), "positive semidefinite"),
    ("P", np.eye(4) + np.triu(np.full((4, 4), 0.1)), "symmetric"),
    ("theta", [-2.5, 1.0, 0.0, 0.0], "theta of a stable model"),
    ("theta", np.nan, "finite numbers in theta"),
    ("undisturbed", np.inf, "finite numbers in undisturbed"),
    ("windup", -1e9, "limit"),
    ("begun", 0.5, "0 or 1 in begun"),
    ("waits", -2.0, "next look"),
])  # fmt: skip
def test_state_that_no_bank_can_be_in_is_refused(name, value, words):
    bank = support.paper_bank(N, OutputError(2, 2), R=0.25)
    bank.run(*recording(OutputError(2, 2)))
    spoilt = bank.state()
    spoilt[name][2] = value
    with unchanged(bank), pytest.raises(ValueError, match=f"^state: .*expected .*{words}"):
        bank.restore(spoilt)


def test_samples_may_come_in_one_array_that_is_written_over():
    (y, u), reused = recording(ARX(1, 1)), np.zeros((2, N))
    one, other = (TrackerBank(N, ARX(1, 1), start=60) for _ in range(2))
    for sample in zip(y, u[:, :, 0], strict=True):
        reused[:] = sample
        one.update(*reused), other.update(*sample)
    same(one.state(), other.state())


def test_unstable_model_is_restored_where_no_guard_keeps_it_stable():
    bank, guarded = (support.paper_bank(2, ARMAX(1, 1, 1), guard=guard) for guard in ("none", "halve"))
    theta = np.array([[0.5, 1.0, 2.0], [2.0, 1.0, 0.5]])
    bank.restore({**bank.state(), "theta": theta})
    same(bank.theta, theta)
    with pytest.raises(ValueError, match="stable model"):
        guarded.restore(bank.state())


# Bad input


def test_bad_arguments_are_refused_by_name():
    assert_refused(support.paper_bank, {"n": N, "structure": OutputError(2, 2)}, {
        "n": [0],
        "structure": [4],
        "theta": [[1.0, 2.0], np.full((N, 4), np.nan), np.eye(N)[:, :4] * 1.5],
        "P": [[1.0, 1.0, -1.0, 1.0, 1.0], np.ones(4)],
        "Q": [np.triu(np.ones((N, 4, 4)))],
        "R": [np.inf, [1.0, 1.0, 0.0, 1.0, np.nan], np.eye(2)],
        "F": [np.full((N, 4, 4), np.inf)],
        "forgetting": [[1.0, 1.0, 0.0, 1.0, 1.0]],
        "guard": [np.array("project"), ["halve"] * N],
        "gradient": ["exact"],
        "influence": [Huber],
        "scaling": ["none"],
        "information": [["weight"] * N],
        "gain": [1.0],
    })  # fmt: skip


def bad(shape, value, *where):
    """Ones with a value in some places."""
    values = np.ones(shape)
    for place in where:
        values[place] = value
    return values


@pytest.mark.parametrize(("call", "good", "wrong"), [
    ("update", {"y": np.ones(N), "u": 1.0}, {
        "y": [np.ones(4), bad(N, np.inf, 1, 3), ["a"] * N],
        "u": [np.ones(4), None, bad(N, np.nan, 4)],
        "R": [[1.0, -1.0, 1.0, 1.0, 1.0]],
    }),
    ("run", {"y": np.ones((3, N)), "u": np.ones(3)}, {
        "y": [np.ones((3, 4)), bad((3, N), np.inf, (1, 2), (2, 4))],
        "u": [np.ones(4), bad((3, N), np.nan, (2, 0)), bad(3, 1e200, 1)],
        "R": [np.ones(N), -1.0, bad((3, N), 0.0, (1, 1))],
        "keep": ["none", 0, 2.5],
    }),
    ("predict", {"u": 1.0}, {"u": [np.ones(4)]}),
], ids=lambda value: value if isinstance(value, str) else "")  # fmt: skip
def test_a_refused_call_changes_nothing(call, good, wrong):
    bank = support.paper_bank(N, OutputError(2, 2))
    assert_refused(getattr(bank, call), good, wrong, of=bank)


@pytest.mark.parametrize(("call", "words"), [
    (lambda b: support.paper_bank(N, OutputError(2, 2), theta=np.eye(N)[:, :4] * 1.5), "stable model.*actuators 0, 1"),
    (lambda b: support.paper_bank(N, FIR(2), R=[1.0, 1.0, 0.0, 1.0, np.nan]), "R: expected.*actuators 2, 4"),
    (lambda b: b.update(bad(N, np.inf, 1, 3), 1.0), "y: expected finite.*actuators 1, 3"),
    (lambda b: b.run(bad((3, N), np.inf, (1, 2), (2, 4)), np.ones(3)), "sample 1.*actuator 2"),
    (lambda b: b.run(np.ones((3, N)), bad((3, N), np.nan, (2, 0))), "sample 2.*actuator 0"),
])  # fmt: skip
def test_the_actuator_and_the_sample_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call(support.paper_bank(N, OutputError(2, 2)))


def test_a_sample_that_one_filter_refuses_changes_no_actuator_and_is_named():
    y, u = recording(ARX(2, 2), missing=False)
    size = np.where(np.arange(N) == 2, 1.0, 0.01)
    y, u = y * size, u * size[:, None]
    bank = support.paper_bank(N, ARX(2, 2), P=1.0, scaling="unit", influence=Linear())
    words = 'sample 1: actuator 2: scaling="unit" would make P indefinite'
    with unchanged(bank), pytest.raises(np.linalg.LinAlgError, match=words):
        bank.run(y, u)
    bank.update(y[0], u[0])
    with unchanged(bank), pytest.raises(np.linalg.LinAlgError, match=r"^actuator 2"):
        bank.update(y[1], u[1])
    tracker = support.paper_tracker(ARX(2, 2), P=1.0, scaling="unit", influence=Linear())
    with pytest.raises(np.linalg.LinAlgError, match="sample 1"):
        tracker.run(y[:, 2], u[:, 2])


def test_an_interrupted_run_has_happened_or_it_has_not():
    y, u = recording(ARX(2, 2))
    bank = support.paper_bank(N, ARX(2, 2))
    bank.run(y[:20], u[:20])
    half, lines = half_steps(bank, lambda one: one.run(y[20:], u[20:]), TrackerBank.state, every=5)
    assert lines > 10 and not half


# Whatever is asked of them, a bank does what as many trackers do: defaults, starts, watch, warnings, restore.


FEW, LONG = 3, 620
DRAWN = [OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 1), FIR(4), BoxJenkins(1, 1, 1, 1), ARX(2, (1, 2)), ARX(2, 0)]
# Cold starts make models, which takes time.
SEEDS = [0, 2, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in [1, *range(3, 60)])]


def drawn_recording(rng, structure):
    """Plants at a level, with outliers, gaps; one changes its gain, one is still for a while, a sensor gets stuck."""
    u = rng.choice([-1.0, 1.0], (LONG, FEW, max(structure.n_inputs, 1)))
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u[:, :, 0], axis=0)
    y[350:, 0] *= rng.choice([1.0, 2.0, -1.0])
    if rng.random() < 0.5:
        y[:120, 1], u[:120, 1] = 0.0, 0.0
    y += rng.choice([0.0, 30.0]) + 0.3 * rng.normal(size=y.shape) * np.where(rng.random(y.shape) < 0.1, 10.0, 1.0)
    y[rng.random(y.shape) < rng.choice([0.0, 0.1])] = np.nan
    y[450:520, 2] = y[449, 2]
    return y, u[:, :, : structure.n_inputs]


def options(rng, structure):
    """Draw some of the arguments; all else stays at its default."""
    start = rng.choice([None, 0, 40, 200, 400])
    drawn = {
        "start": None if start is None else int(start), "offset": rng.choice([None, True, False]),
        "regressor": rng.choice([None, "measured", "cleaned"]), "R": rng.choice([None, 0.09]),
        "R_memory": int(rng.choice([20, 150])), "Q": rng.choice([0.0, 1e-5]), "forgetting": rng.choice([None, 0.99]),
        "gradient": str(rng.choice(["filtered", "pseudolinear"])), "guard": str(rng.choice(["halve", "reject"])),
        "influence": rng.choice([None, Huber(2.0), Hampel()]), "scaling": rng.choice([None, "bounded"]),
        "information": rng.choice([None, "expected"]),
    }  # fmt: skip
    if not start and rng.random() < 0.5:
        drawn |= {"start": None, "theta": 0.1, "P": 1.0}
    kept = rng.random(len(drawn)) < 0.6
    return {name: value for (name, value), keep in zip(drawn.items(), kept, strict=True) if keep or name == "theta"}


NEWS = (LostTrackerWarning, StuckSensorWarning)


def warned(bank, sentences, call):
    """Call, and add the sentences of lost trackers and stuck sensors, by actuator."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    for text in (str(one.message).split("; see")[0] for one in caught if issubclass(one.category, NEWS)):
        if bank is None:
            sentences.append(text.removeprefix("ParameterTracker: "))
        else:
            names, _, rest = text.removeprefix("TrackerBank: actuator").lstrip("s ").partition(": ")
            for i in names.split(", "):
                sentences[int(i)].append(rest)
    return result


def assert_same(bank, tracker, i):
    """Hold what moves of actuator i together."""
    ours, theirs = bank.tracker(i).state(), tracker.state()
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        scale = np.abs(value[np.isfinite(value)]).max(initial=1.0)
        np.testing.assert_allclose(ours[name], value, rtol=1e-6, atol=1e-7 * scale, err_msg=name)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bank_is_its_trackers_whatever_is_drawn(seed):
    rng = np.random.default_rng([25, seed])
    structure = DRAWN[rng.integers(len(DRAWN))]
    given = options(rng, structure)
    y, u = drawn_recording(rng, structure)
    bank = TrackerBank(FEW, structure, **given)
    trackers = [ParameterTracker(structure, **given) for _ in range(FEW)]
    news, own = [[] for _ in range(FEW)], [[] for _ in range(FEW)]
    cuts = [0, *sorted(rng.choice(np.arange(1, LONG), 3, replace=False).tolist()), LONG]
    for first, stop in itertools.pairwise(cuts):
        enabled = rng.random(FEW) < 0.9
        bank.enabled = enabled
        if rng.random() < 0.3:
            again = TrackerBank(FEW, structure, **given)
            # What has been said is not in a state.
            again.restore(bank.state())
            for i in range(FEW):
                fresh = ParameterTracker(structure, **given)
                fresh.restore(trackers[i].state())
                trackers[i] = fresh
            bank = again
        result = warned(bank, news, lambda bank=bank, k=slice(first, stop): bank.run(y[k], u[k]))
        for i, tracker in enumerate(trackers):
            tracker.enabled = bool(enabled[i])
            expected = warned(None, own[i], lambda t=tracker, i=i, k=slice(first, stop): t.run(y[k, i], u[k, i]))
            for ours, theirs in zip(result.tracker(i), expected, strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7)
            assert_same(bank, tracker, i)
    assert news == own
    ahead = rng.normal(size=(FEW, structure.n_inputs))
    theirs = [tracker.predict(ahead[i] if structure.n_inputs else None) for i, tracker in enumerate(trackers)]
    np.testing.assert_allclose(bank.predict(ahead if structure.n_inputs else None), theirs, rtol=1e-6, atol=1e-7)


def test_an_actuator_without_a_model_is_predicted_as_it_is_alone_however_long_that_lasts():
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], (600, 2))
    u[:, 1] = 0.0
    y = lfilter([0.0, 1.0], [1.0, -0.5], u, axis=0) + np.cumsum(0.1 * rng.normal(size=(600, 2)), axis=0)
    with unheard():
        bank = TrackerBank(2, ARX(1, 1), start=100).run(y, u)
        alone = ParameterTracker(ARX(1, 1), start=100).run(y[:, 1], u[:, 1])
    # The other one is looked at meanwhile, so that its samples are divided otherwise.
    np.testing.assert_array_equal(bank.prediction[:, 1], alone.prediction)


def test_filters_that_learn_what_is_typical_do_so_for_each_actuator_and_go_on():
    structure = ARX(2, 2)
    y, u = recording(structure)
    y = y * np.geomspace(0.1, 10.0, N)
    options = {"scaling": "learnt", "R": 0.25}
    assert_is_the_loop(structure, y, u, **options)
    bank, other = (support.paper_bank(N, structure, **options) for _ in range(2))
    bank.run(y[:50], u[:50])
    other.restore(bank.state())
    bank.run(y[50:], u[50:])
    other.run(y[50:], u[50:])
    same(other.state(), bank.state())
