"""Promises of a filter beside its equations: copies, refused calls, the size of a step, errors over recordings."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy import stats

from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions import consistency, contracts, robustness
from robust_filterpy.testing.assertions.contracts import apart, deviations, furthest
from robust_filterpy.testing.assertions.robustness import SENSOR_UNITS, STATE_UNITS
from robust_filterpy.testing.checks.bench import OLD, RUNS, Check, FilterSubject, not_applicable, promise, through
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.contamination import Kinds
from robust_filterpy.testing.scenarios.drawing import draw
from robust_filterpy.testing.scenarios.models import StateModel
from robust_filterpy.testing.scenarios.runs import state

#: What is looked at before the equations, and after them.
FIRST: list[Check] = []
LATER: list[Check] = []
#: What holds the estimate.
_SHOWN = ("x", "P")
#: Values that cannot be right, and the attribute to set to them; None: the measurement.
BAD_VALUES: dict[str, tuple[str | None, Any]] = {
    "a z that is too long": (None, np.zeros(3)),
    "a z that is too short": (None, np.zeros(1)),
    "an infinite z": (None, np.array([np.inf, 0.0])),
    "text for z": (None, ["a", "b"]),
    "an R of another shape": ("R", np.eye(3)),
    "a negative R": ("R", -np.eye(2)),
    "an H of another shape": ("H", np.ones((2, 3))),
    "an F of another shape": ("F", np.eye(3)),
    "a Q of another shape": ("Q", np.ones(4)),
}


@promise(FIRST)
def state_keeps_its_shape(subject: FilterSubject) -> None:
    """predict and update leave the shapes of x and P as they were, for z as an array, a list or a number."""
    for dims in ((1, 1), (4, 2)):
        model = subject.model(*dims)
        kf = subject.new(model)
        shape = np.shape(kf.x)
        forms: list[Any] = [np.zeros(dims[1]), [0.0] * dims[1], *([0.0] if dims[1] == 1 else [])]
        for z in forms:
            runs.step(kf, z, model)
            if np.shape(kf.x) != shape or np.shape(kf.P) != (dims[0], dims[0]):
                raise AssertionError(
                    f"after update({z!r}) x has shape {np.shape(kf.x)} and P {np.shape(kf.P)}, expected {shape} and "
                    f"{(dims[0], dims[0])}"
                )


@promise(FIRST)
def arguments_are_not_written_to(subject: FilterSubject) -> None:
    """x, P, F, H, Q, R and z that the caller passed are as they were after predict and update."""
    model = subject.model()
    kf = subject.new(model)
    given = {name: np.array(getattr(kf, name), dtype=float) for name in ("x", "P", "F", "H", "Q", "R")}
    before = {name: value.copy() for name, value in given.items()}
    for name, value in given.items():
        setattr(kf, name, value)
    for z in subject.recording(model, 3):
        original = z.copy()
        runs.step(kf, z, model)
        if not np.array_equal(z, original):
            raise AssertionError("update wrote into z")
    written = [name for name, value in given.items() if not np.array_equal(value, before[name])]
    if written:
        raise AssertionError(f"the caller's {', '.join(written)} changed: copy what is to be written into")


@promise(FIRST)
def same_data_give_the_same_numbers(subject: FilterSubject) -> None:
    """Two filters with the same data agree to the last bit and leave numpy's global random state alone."""
    model = subject.model()
    zs, before = subject.recording(model), _global_state()
    one, two = (state(subject.advance(subject.new(model), zs, model)) for _ in range(2))
    if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, two, strict=True)):
        raise AssertionError("the same data gave other numbers: draw random numbers from a seeded Generator")
    if not np.array_equal(before, _global_state()):
        raise AssertionError("numpy's global random state was changed: draw from a Generator of its own")


def _global_state() -> Any:
    """Return numpy's global random state."""
    return np.random.get_state(legacy=False)["state"]["key"]  # type: ignore[call-overload,index]  # noqa: NPY002


@promise(FIRST)
def integers_are_numbers_like_any_other(subject: FilterSubject) -> None:
    """x, P, F and H as integer arrays give the numbers that they give as floats."""
    model = subject.model().with_(
        x=np.array([0.0, 1.0, 0.0, 2.0]), P=2.0 * np.eye(4), F=np.eye(4, k=1) + np.eye(4), H=np.eye(2, 4)
    )
    zs, states = subject.recording(model, 5), []
    for kind in (float, int):
        kf = subject.new(model)
        for name in ("x", "P", "F", "H"):
            setattr(kf, name, np.array(getattr(kf, name)).astype(kind))
        states.append(state(subject.advance(kf, zs, model)))
    (x, P), (x2, _) = states
    if furthest(x2 - x, P) > 1e-9:
        raise AssertionError(
            f"x differs by {furthest(x2 - x, P):.2g} of its standard deviations: it is rounded to integers"
        )


@promise(FIRST)
def estimates_handed_out_stay_as_they_were(subject: FilterSubject) -> None:
    """What the estimator showed, kept in a list after each call, is not changed by later calls."""
    new, steps = subject.work()
    estimator, shown_before = new(), []
    # As often as it takes for a buffer of past estimates to be written over.
    for step in OLD // len(steps) * list(steps):
        step(estimator)
        shown = {name: getattr(estimator, name) for name in _SHOWN if hasattr(estimator, name)}
        shown_before += [(name, value, np.array(value, dtype=float)) for name, value in shown.items()]
    for name, value, then in shown_before:
        if not np.array_equal(value, then, equal_nan=True):
            raise AssertionError(f"a {name} that was kept from an earlier step has changed: it is written in place")


@promise(FIRST)
def two_estimators_share_nothing(subject: FilterSubject) -> None:
    """An estimator at work changes neither another one, nor those made later, nor what these find."""
    new, steps = subject.work()
    idle = new()
    before = contracts.visible(idle)
    after = contracts.visible(through(new(), steps), _SHOWN)
    contracts.assert_unchanged(before, idle, "another one's work")
    contracts.assert_unchanged(before, new(), "the first one's work, in those made later,")
    contracts.assert_unchanged(after, through(new(), steps), "something that is left of the first one")


@promise(FIRST)
def deepcopies_go_on_alike(subject: FilterSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy")


@promise(FIRST, "pickle")
def pickles_go_on_alike(subject: FilterSubject) -> None:
    """An unpickled estimator goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle")


def _round_trip(subject: FilterSubject, way: str) -> None:
    """Copy in the middle of a recording."""
    new, steps = subject.work()
    half = len(steps) // 2
    estimator = through(new(), steps[:half])
    contracts.assert_state_round_trip(estimator, lambda one: through(one, steps[half:]), ways=(way,))


@promise(FIRST, "validates")
def bad_input_is_refused_and_changes_nothing(subject: FilterSubject) -> None:
    """What cannot be right raises ValueError or TypeError; the estimate, and what it is later, are as without it."""
    (new, steps), faults = subject.work(), []
    half = len(steps) // 2
    wanted = contracts.visible(through(new(), steps), _SHOWN)
    for words, bad in BAD_VALUES.items():
        call = partial(_bad_call, subject.model(), *bad)
        estimator = through(new(), steps[:half])
        try:
            contracts.assert_refused_call_changes_nothing(estimator, call, names=_SHOWN)
            contracts.assert_unchanged(wanted, through(estimator, steps[half:]), "after it, what followed")
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


def _bad_call(model: StateModel, name: str | None, value: Any, kf: Any) -> None:
    """Meet a bad value, and take it back."""
    if name is None:
        runs.measure(kf, value, model)
        return
    before = getattr(kf, name)
    try:
        setattr(kf, name, value)
        if name in ("F", "Q"):
            kf.predict()
        # An extended filter asks for H.
        elif name == "H" and runs.is_extended(kf):
            z = np.zeros(len(model.R))
            runs.measure(kf, z, model.with_(sensor=lambda x: z, sensor_jacobian=lambda x: value))
        else:
            runs.measure(kf, np.zeros(len(model.R)), model)
    finally:
        setattr(kf, name, before)


@promise(LATER, "linear")
def small_innovations_are_believed(subject: FilterSubject) -> None:
    """An innovation of a hundredth of its deviation makes the step of the Kalman gain, by the P shown, at any age."""
    for age in (0, OLD):
        ratio, other = _share(subject, 0.01, age=age)
        if not (abs(ratio - 1.0) < 0.01 and other < 0.01):
            why = "" if age == 0 else " where that of a new one is right: something of earlier steps is still used"
            raise AssertionError(
                f"after {age} samples the step is {ratio:.3g} times the Kalman gain's and {other:.2g} of it across "
                f"it{why}"
            )


@promise(LATER, "linear")
def innovations_are_judged_by_their_own_deviation(subject: FilterSubject) -> None:
    """An innovation of half its deviation, the root of S, is ordinary, be R the smallest or the largest part of S."""
    for R_ratio in (1e-4, 1e4):
        ratio, _ = _share(subject, 0.5, R_ratio=R_ratio)
        if not abs(ratio - 1.0) < 0.1:
            raise AssertionError(
                f"with {R_ratio:g} times the R, an innovation of half its deviation makes {ratio:.2g} of the Kalman "
                f"gain's step: it is not judged by S"
            )


def _share(subject: FilterSubject, e: float, *, age: int = 0, R_ratio: float = 1.0) -> tuple[float, float]:
    """Return the step in units of the Kalman gain's: along it, and across it."""
    step, wanted, P, _ = subject.corrected(e, age, R_ratio)
    step, wanted = step / deviations(P), wanted / deviations(P)
    ratio = float(step @ wanted / (wanted @ wanted))
    return ratio, float(np.linalg.norm(step - ratio * wanted) / np.linalg.norm(wanted))


@promise(LATER, "robust", "recovers")
def what_is_cut_off_makes_nothing_certain(subject: FilterSubject) -> None:
    """A measurement of a hundred deviations makes P shrink by less than half of what an ordinary one does."""
    gained = []
    for e in (0.01, 100.0):
        _, _, P, after = subject.corrected(e, age=20)
        # In units of P itself.
        gained.append(float(np.trace(np.linalg.solve(P, P - after))))
    ordinary, outlier = gained
    if not outlier < 0.5 * ordinary:
        raise AssertionError(
            f"after a measurement of 100 deviations P shrinks {outlier / ordinary:.2g} times as much as after an "
            f"ordinary one: P is sure of what was cut off; keep that part of P"
        )


def _require_alike(one: Any, two: Any, words: str) -> None:
    """Fail with these words, and by how much, where x and P of one filter are not those of another."""
    off = apart(state(one), state(two))
    if off > 1e-6:
        raise AssertionError(words.format(f"{off:.2g}"))


@promise(LATER, "memoryless")
def nothing_is_remembered_but_x_and_P(subject: FilterSubject) -> None:
    """A filter given the x and P of another goes on as that one does, whatever either has seen before, at any age."""
    model, rest = subject.model(), "something of earlier steps (a gain, a measurement, a covariance) is still used"
    past = draw(model, OLD, contamination=_outliers(subject), rng=subject.rng).z
    zs, old = subject.recording(model, 3), subject.new(model)
    for age, z in enumerate(past):
        fresh = subject.new(model)
        fresh.x, fresh.P = np.array(old.x), np.array(old.P)
        for kf in (fresh, old):
            runs.step(kf, z, model)
        _require_alike(fresh, old, f"after {age} steps the next one differs by {{}} from that of a new filter with "
                       f"this x and P: {rest}")  # fmt: skip
    fresh = subject.new(model)
    old.x, old.P = np.array(fresh.x), np.array(fresh.P)
    for call, z in enumerate(zs):
        for name in ("update", "predict"):
            for kf in (fresh, old):
                if name == "update":
                    runs.measure(kf, z, model)
                else:
                    kf.predict()
            _require_alike(fresh, old, f"{name} {call + 1} after x and P were set differs by {{}} from that of a new "
                           f"filter: {rest}")  # fmt: skip


@promise(LATER, "memoryless")
def matrices_may_change_between_calls(subject: FilterSubject) -> None:
    """F, H, Q and R that are replaced, or written into, count from the next call."""
    model, other = subject.model(), subject.model()
    zs = subject.recording(model, 6)
    for name in ("F", "H", "Q", "R"):
        new = getattr(other, name) * (0.5 if name == "F" else 3.0)
        for way in ("replaced", "written into"):
            kf = subject.advance(subject.new(model), zs[:3], model)
            fresh = subject.new(model.with_(**{name: new}))
            fresh.x, fresh.P = np.array(kf.x), np.array(kf.P)
            if way == "replaced":
                setattr(kf, name, new.copy())
            elif isinstance(getattr(kf, name), np.ndarray) and getattr(kf, name).flags.writeable:
                getattr(kf, name)[:] = new
            else:
                continue
            changed = model.with_(**{name: new})
            words = f"{name} {way} between two steps does not count: {{}} off, an old one is used"
            _require_alike(subject.advance(fresh, zs[3:], changed), subject.advance(kf, zs[3:], changed), words)


@promise(LATER)
def order_of_sensors_changes_nothing(subject: FilterSubject) -> None:
    """Permuting the sensors permutes H, R and z and nothing else."""
    scenario = draw(subject.model(4, 3), 20, contamination=_outliers(subject), rng=subject.rng)
    robustness.assert_sensor_order_irrelevant(subject.made, scenario)


@promise(LATER, "units")
def units_change_nothing(subject: FilterSubject) -> None:
    """In other units of the states and of each sensor the estimate is the same in those units."""
    scenario = draw(subject.model(), 20, contamination=_outliers(subject), rng=subject.rng)
    for size in (1.0, 1e6):
        state, sensors = size * STATE_UNITS, size * SENSOR_UNITS
        robustness.assert_unit_equivariant(subject.made, scenario, state=state, sensors=sensors)


def _outliers(subject: FilterSubject) -> str:
    """Return outliers for a filter that does something about them."""
    return "mixture" if "robust" in subject.claims else "none"


@promise(LATER)
def mirror_image_of_the_data_gives_the_mirror_image(subject: FilterSubject) -> None:
    """From -x with -z the filter gives -x+ and the same P+: it does not prefer one sign."""
    model = subject.model()
    zs = draw(model, 10, contamination=_outliers(subject), rng=subject.rng).z
    # An outlier of either sign is certain to be among them.
    zs[4] += 50.0 if "robust" in subject.claims else 0.0
    (x, P), (x2, P2) = (
        state(subject.advance(subject.new(one), sign * zs, one))
        for sign, one in ((1.0, model), (-1.0, model.with_(x=-model.x)))
    )
    off = apart((x, P), (-x2, P2))
    if off > 1e-6:
        raise AssertionError(f"the mirror image differs by {off:.2g} of a standard deviation: one sign is preferred")


@promise(LATER, "missing")
def none_is_no_information(subject: FilterSubject) -> None:
    """update(None) leaves x and P as they are."""
    model = subject.model()
    robustness.assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng), components=False)


@promise(LATER, "nan")
def nan_is_a_sensor_that_is_not_there(subject: FilterSubject) -> None:
    """With NaN for a sensor the filter is the one without that sensor; all NaN is no measurement."""
    model = subject.model(4, 3)
    robustness.assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng))


@promise(LATER)
def innovation_and_its_covariance_are_shown(subject: FilterSubject) -> None:
    """kf.y = z - H x_prior and kf.S = H P_prior H' + R after update(z), where shown; R as learned, if it is."""
    model = subject.model()
    kf, x, P = subject.predicted(model, 2)
    if not hasattr(kf, "y") or not hasattr(kf, "S"):
        raise not_applicable("shows no y or S")
    learnt = getattr(kf, "R_learnt", None)
    S = model.with_(R=model.R if learnt is None else learnt).innovation_covariance(P)
    z = model.H @ x + 0.3 * np.sqrt(S.diagonal())
    runs.measure(kf, z, model)
    for name, got, wanted in (("y", np.ravel(kf.y), z - model.H @ x), ("S", np.asarray(kf.S), S)):
        if np.shape(got) != wanted.shape or not np.allclose(got, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max()):
            sign = "; it has the other sign" if np.shape(got) == wanted.shape and np.allclose(got, -wanted) else ""
            raise AssertionError(
                f"{name} is {np.round(got, 4).tolist()}, expected {np.round(wanted, 4).tolist()}{sign}"
            )


@promise(LATER, "likelihood", "exact")
def likelihood_is_the_gaussian_density_of_the_innovation(subject: FilterSubject) -> None:
    """log_likelihood = -(y' S^-1 y + log det S + m log 2 pi)/2, of the Kalman filter."""
    model = subject.model()
    kf, x, P = subject.predicted(model, 3)
    if not hasattr(kf, "log_likelihood"):
        raise not_applicable("has no log_likelihood")
    S = model.innovation_covariance(P)
    z = model.H @ x + np.sqrt(S.diagonal())
    runs.measure(kf, z, model)
    wanted = float(stats.multivariate_normal(model.H @ x, S).logpdf(z))
    got = float(kf.log_likelihood)
    if not abs(got - wanted) <= 1e-6 * max(abs(wanted), 1.0):
        terms = {
            "-y' S^-1 y / 2": -0.5 * (z - model.H @ x) @ np.linalg.solve(S, z - model.H @ x),
            "-log det S / 2": -0.5 * np.linalg.slogdet(S)[1],
            "-m log(2 pi) / 2": -0.5 * len(z) * np.log(2 * np.pi),
        }
        guilty = [name for name, value in terms.items() if abs(got - (wanted - value)) < 1e-6]
        lacks = f"; {guilty[0]} is missing" if guilty else ""
        raise AssertionError(f"log_likelihood {got:.6g}, expected {wanted:.6g}{lacks}")


@promise(LATER, "likelihood")
def likelihood_integrates_to_one(subject: FilterSubject) -> None:
    """The integral of exp(log_likelihood) over all z is 1, or filters cannot be compared with each other."""
    model = subject.model(2, 1)
    kf = subject.new(model)
    if not hasattr(kf, "log_likelihood"):
        raise not_applicable("has no log_likelihood")
    x, P = state(kf)
    sigma = float(np.sqrt(model.innovation_covariance(P)[0, 0]))
    # Steps that grow with the distance reach heavy tails.
    t = np.linspace(-6.0, 6.0, 301)
    offsets, density = sigma * np.sinh(t), np.empty(t.size)
    for k, offset in enumerate(offsets):
        kf = subject.at_prior(model)
        runs.measure(kf, model.H @ x + offset, model)
        density[k] = np.exp(float(kf.log_likelihood))
    integral = float(np.sum(density * sigma * np.cosh(t)) * (t[1] - t[0]))
    if not abs(integral - 1.0) <= 0.02:
        raise AssertionError(f"the likelihood integrates to {integral:.3g} over z, expected 1: it is no density")


@promise(LATER, "exact")
def recording_is_filtered_as_by_the_kalman_filter(subject: FilterSubject) -> None:
    """x and P are those of filterpy's KalmanFilter, call by call, over a recording."""
    for dims in ((1, 1), (4, 2), (5, 3)):
        model = subject.model(*dims)
        zs = subject.recording(model, 40)
        kf, reference = subject.new(model), runs.load(KalmanFilter(*dims), model)

        def step(one: Any, z: Array, model: StateModel = model) -> None:
            runs.step(one, z, model)

        reference.x = reference.x.reshape(np.shape(kf.x))
        contracts.assert_same_filter(kf, reference, zs, rtol=1e-6, step=step)


@promise(LATER, stochastic=True)
def errors_are_as_large_as_P_says(subject: FilterSubject) -> None:
    """NIS and NEES are chi-square: innovations have covariance S, errors have covariance P."""
    consistency.assert_consistent(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(LATER, stochastic=True)
def errors_have_mean_zero(subject: FilterSubject) -> None:
    """Over independent runs the error of each state has mean 0."""
    consistency.assert_unbiased(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(LATER, stochastic=True)
def innovations_are_white(subject: FilterSubject) -> None:
    """An innovation tells nothing about the next ones: all that could be learned was learned."""
    tolerance = 0.0 if subject.is_exact else 0.15
    consistency.assert_innovations_white(subject.many()[1], tolerance=tolerance, false_alarm=subject.false_alarm)


@promise(LATER, "robust")
def influence_of_one_measurement_is_bounded(subject: FilterSubject) -> None:
    """A measurement of 1e2 to 1e12 standard deviations moves the state by at most ten of its own."""
    robustness.assert_bounded_influence(subject.made, rng=subject.rng)


@promise(LATER, "recovers", stochastic=True)
def a_true_jump_is_followed(subject: FilterSubject) -> None:
    """A hundred samples after a jump of the state by 30 sigma the estimate is back at the truth."""
    robustness.assert_recovers_from_jump(subject.made, rng=subject.rng)


@promise(LATER, stochastic=True)
def clean_data_are_used_well(subject: FilterSubject) -> None:
    """On clean normal data the squared error is not much more than the Kalman filter's, or that of least squares."""
    _require_efficient(subject, "none", RUNS, 0.9999 if subject.is_exact else 0.6)


@promise(LATER, "robust", stochastic=True)
def outliers_cost_little(subject: FilterSubject) -> None:
    """With one sample in ten of 30 times the noise the squared error stays near that of who knows the labels."""
    _require_efficient(subject, {"mixture": {"scale_ratio": 30.0}}, 2 * RUNS, 0.5)


def _require_efficient(subject: FilterSubject, contamination: Kinds, count: int, at_least: float) -> None:
    """Compare with the filter that is told every label, over many recordings."""
    scenarios, tested = subject.many(contamination, count)
    best = [scenario.reference for scenario in scenarios]
    robustness.assert_efficient(tested, at_least=at_least, relative_to=best, false_alarm=subject.false_alarm)


@promise(LATER)
def covariance_stays_one(subject: FilterSubject) -> None:
    """P stays symmetric and positive semidefinite, also where rounding errors are not damped."""
    # Without damping from both sides rounding grows at each step by the unstable pole.
    F = np.array([[1.3, 0.3], [0.0, 0.98]])
    model = StateModel(np.zeros(2), np.eye(2), F, np.array([[1.0, 0.5]]), 0.01 * np.eye(2), np.eye(1))
    covariances = []
    for start in (1.0, 1e6):
        kf = subject.new(model.with_(P=start * np.eye(2)))
        for _ in range(300):
            kf.predict()
            x, P = runs.state(kf)
            runs.measure(kf, model.H @ x, model)
            covariances += [P, runs.state(kf)[1]]
    consistency.assert_covariance_stays_one(covariances)
