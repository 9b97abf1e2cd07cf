"""Promises of a filter besides its equations: shapes, arrays, what it depends on, errors over many recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy import stats

from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.consistency import (
    assert_consistent,
    assert_innovations_white,
    assert_unbiased,
)
from robust_filterpy.testing.assertions.contracts import apart, assert_same_filter, furthest
from robust_filterpy.testing.assertions.robustness import (
    SENSOR_UNITS,
    STATE_UNITS,
    assert_bounded_influence,
    assert_missing_is_no_information,
    assert_recovers_from_jump,
    assert_sensor_order_irrelevant,
    assert_unit_equivariant,
)
from robust_filterpy.testing.checks.bench import OLD, Promise, not_applicable, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.drawing import draw
from robust_filterpy.testing.scenarios.models import StateModel
from robust_filterpy.testing.scenarios.runs import state

#: What is looked at first, and what a filter shows besides x and P.
CONTRACTS: list[Promise] = []
SHOWN: list[Promise] = []


@promise(CONTRACTS)
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


@promise(CONTRACTS)
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


@promise(CONTRACTS)
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


@promise(CONTRACTS)
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


@promise(SHOWN)
def innovation_and_its_covariance_are_shown(subject: FilterSubject) -> None:
    """kf.y = z - H x_prior and kf.S = H P_prior H' + R after update(z), where shown; R as learned, if it is."""
    model = subject.model()
    kf = subject.aged(model, 2)
    if not hasattr(kf, "y") or not hasattr(kf, "S"):
        raise not_applicable("shows no y or S")
    kf.predict()
    x, P = state(kf)
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


@promise(SHOWN, "likelihood", "exact")
def likelihood_is_the_gaussian_density_of_the_innovation(subject: FilterSubject) -> None:
    """log_likelihood = -(y' S^-1 y + log det S + m log 2 pi)/2, of the Kalman filter."""
    model = subject.model()
    kf = subject.aged(model, 3)
    if not hasattr(kf, "log_likelihood"):
        raise not_applicable("has no log_likelihood")
    kf.predict()
    x, P = state(kf)
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


@promise(SHOWN, "likelihood")
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


DEPENDENCE: list[Promise] = []


@promise(DEPENDENCE, "memoryless")
def nothing_is_remembered_but_x_and_P(subject: FilterSubject) -> None:
    """A filter given the x and P of another goes on as that one does, whatever either has seen before, at any age."""
    model = subject.model()
    past = draw(model, OLD, contamination=_outliers(subject), rng=subject.rng).z
    zs, old = subject.recording(model, 3), subject.new(model)
    for age, z in enumerate(past):
        fresh = subject.new(model)
        fresh.x, fresh.P = np.array(old.x), np.array(old.P)
        for kf in (fresh, old):
            runs.step(kf, z, model)
        off = apart(state(fresh), state(old))
        if off > 1e-6:
            raise AssertionError(
                f"after {age} steps the next one differs by {off:.2g} from that of a new filter with this x and P: "
                f"something of earlier steps (a gain, a measurement, a covariance) is still used"
            )
    fresh = subject.new(model)
    old.x, old.P = np.array(fresh.x), np.array(fresh.P)
    for call, z in enumerate(zs):
        for name in ("update", "predict"):
            for kf in (fresh, old):
                if name == "update":
                    runs.measure(kf, z, model)
                else:
                    kf.predict()
            off = apart(state(fresh), state(old))
            if off > 1e-6:
                raise AssertionError(
                    f"{name} {call + 1} after x and P were set differs by {off:.2g} from that of a new filter: "
                    f"something of earlier steps (a gain, a measurement, a covariance) is still used"
                )


@promise(DEPENDENCE, "memoryless")
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
            off = apart(*(state(subject.advance(one, zs[3:], changed)) for one in (fresh, kf)))
            if off > 1e-6:
                raise AssertionError(
                    f"{name} {way} between two steps does not count: {off:.2g} off, an old one is used"
                )


@promise(DEPENDENCE)
def order_of_sensors_changes_nothing(subject: FilterSubject) -> None:
    """Permuting the sensors permutes H, R and z and nothing else."""
    model = subject.model(4, 3)
    assert_sensor_order_irrelevant(subject.made, draw(model, 20, contamination=_outliers(subject), rng=subject.rng))


@promise(DEPENDENCE, "units")
def units_change_nothing(subject: FilterSubject) -> None:
    """In other units of the states and of each sensor the estimate is the same in those units."""
    scenario = draw(subject.model(), 20, contamination=_outliers(subject), rng=subject.rng)
    for size in (1.0, 1e6):
        assert_unit_equivariant(subject.made, scenario, state=size * STATE_UNITS, sensors=size * SENSOR_UNITS)


def _outliers(subject: FilterSubject) -> str:
    """Return outliers for a filter that does something about them."""
    return "mixture" if "robust" in subject.claims else "none"


@promise(DEPENDENCE)
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


@promise(DEPENDENCE, "missing")
def none_is_no_information(subject: FilterSubject) -> None:
    """update(None) leaves x and P as they are."""
    model = subject.model()
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng), components=False)


@promise(DEPENDENCE, "nan")
def nan_is_a_sensor_that_is_not_there(subject: FilterSubject) -> None:
    """With NaN for a sensor the filter is the one without that sensor; all NaN is no measurement."""
    model = subject.model(4, 3)
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng))


STATISTICS: list[Promise] = []


@promise(STATISTICS)
def ordinary_data_keep_everything_finite(subject: FilterSubject) -> None:
    """On 50 ordinary measurements x and P stay finite and the error stays below 1000 standard deviations."""
    model = subject.model()
    kf = subject.new(model)
    for k, z in enumerate(subject.recording(model, 50)):
        runs.step(kf, z, model)
        x, P = state(kf)
        if not (np.isfinite(P).all() and furthest(model.H @ x - z, model.R) < 1e3):
            raise AssertionError(f"after step {k} the state has run away from the measurements, or is not finite")


@promise(STATISTICS, "exact")
def recording_is_filtered_as_by_the_kalman_filter(subject: FilterSubject) -> None:
    """x and P are those of filterpy's KalmanFilter, call by call, over a recording."""
    for dims in ((1, 1), (4, 2), (5, 3)):
        model = subject.model(*dims)
        zs = subject.recording(model, 40)
        kf, reference = subject.new(model), runs.load(KalmanFilter(*dims), model)

        def step(one: Any, z: Array, model: StateModel = model) -> None:
            runs.step(one, z, model)

        reference.x = reference.x.reshape(np.shape(kf.x))
        assert_same_filter(kf, reference, zs, rtol=1e-6, step=step)


@promise(STATISTICS, stochastic=True)
def errors_are_as_large_as_P_says(subject: FilterSubject) -> None:
    """NIS and NEES are chi-square: innovations have covariance S, errors have covariance P."""
    assert_consistent(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(STATISTICS, stochastic=True)
def errors_have_mean_zero(subject: FilterSubject) -> None:
    """Over independent runs the error of each state has mean 0."""
    assert_unbiased(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(STATISTICS, stochastic=True)
def innovations_are_white(subject: FilterSubject) -> None:
    """An innovation tells nothing about the next ones: all that could be learned was learned."""
    tolerance = 0.0 if subject.is_exact else 0.15
    assert_innovations_white(subject.many()[1], tolerance=tolerance, false_alarm=subject.false_alarm)


@promise(STATISTICS, "robust")
def influence_of_one_measurement_is_bounded(subject: FilterSubject) -> None:
    """A measurement of 1e2 to 1e12 standard deviations moves the state by at most ten of its own."""
    assert_bounded_influence(subject.made, rng=subject.rng)


@promise(STATISTICS, "recovers", stochastic=True)
def a_true_jump_is_followed(subject: FilterSubject) -> None:
    """A hundred samples after a jump of the state by 30 sigma the estimate is back at the truth."""
    assert_recovers_from_jump(subject.made, rng=subject.rng)
