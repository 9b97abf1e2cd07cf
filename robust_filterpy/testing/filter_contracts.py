"""Promises between the lines: arrays that stay the caller's, copies, refused calls, no hidden memory, no data."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from robust_filterpy._checks import Array
from robust_filterpy.testing import contracts, runs
from robust_filterpy.testing.checks import not_applicable, promise
from robust_filterpy.testing.filter_subject import FILTER_PROMISES, FilterSubject, apart, furthest, state
from robust_filterpy.testing.invariance import (
    assert_missing_is_no_information,
    assert_sensor_order_irrelevant,
    assert_unit_equivariant,
)
from robust_filterpy.testing.scenarios import draw


@promise(FILTER_PROMISES)
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


@promise(FILTER_PROMISES)
def arguments_are_not_written_to(subject: FilterSubject) -> None:
    """x, P, F, H, Q, R and z that the caller passed are as they were after predict and update."""
    model = subject.model()
    kf = subject.new(model)
    given = {name: np.array(getattr(kf, name), dtype=float) for name in ("x", "P", "F", "H", "Q", "R")}
    before = {name: value.copy() for name, value in given.items()}
    for name, value in given.items():
        setattr(kf, name, value)
    for z in subject.recording(model, 3):
        kept = z.copy()
        runs.step(kf, z, model)
        if not np.array_equal(z, kept):
            raise AssertionError("update wrote into z")
    written = [name for name, value in given.items() if not np.array_equal(value, before[name])]
    if written:
        raise AssertionError(f"the caller's {', '.join(written)} changed: copy what is to be written into")


@promise(FILTER_PROMISES)
def estimates_handed_out_stay_as_they_were(subject: FilterSubject) -> None:
    """kf.x and kf.P, kept in a list at each step, are not changed by later steps."""
    model = subject.model()
    kf, kept = subject.new(model), []
    for z in subject.recording(model, 4):
        kf.predict()
        kept.append((kf.x, kf.P, *state(kf)))
        runs.measure(kf, z, model)
        kept.append((kf.x, kf.P, *state(kf)))
    for x, P, x_then, P_then in kept:
        if not np.array_equal(np.ravel(x), x_then) or not np.array_equal(P, P_then):
            name = "P" if np.array_equal(np.ravel(x), x_then) else "x"
            raise AssertionError(f"a {name} that was kept from an earlier step has changed: it is written in place")


@promise(FILTER_PROMISES)
def two_filters_share_nothing(subject: FilterSubject) -> None:
    """A filter at work changes neither another one nor those made later."""
    model = subject.model()
    worker, idle = subject.made(4, 2), subject.made(4, 2)
    before = contracts.visible(idle)
    subject.advance(runs.load(worker, model), subject.recording(model), model)
    contracts.assert_unchanged(before, idle, "another filter's work")
    contracts.assert_unchanged(before, subject.made(4, 2), "a filter's work, in filters made later,")


@promise(FILTER_PROMISES)
def same_data_give_the_same_numbers(subject: FilterSubject) -> None:
    """Two filters with the same data agree to the last bit and leave numpy's global random state alone."""
    model = subject.model()
    zs, before = subject.recording(model), np.random.get_state()[1]  # noqa: NPY002
    one, two = (state(subject.advance(subject.new(model), zs, model)) for _ in range(2))
    if not all(np.array_equal(a, b) for a, b in zip(one, two, strict=True)):
        raise AssertionError("the same data gave other numbers: draw random numbers from a seeded Generator")
    if not np.array_equal(before, np.random.get_state()[1]):  # noqa: NPY002
        raise AssertionError("numpy's global random state was changed: draw from a Generator of its own")


@promise(FILTER_PROMISES)
def integers_are_numbers_like_any_other(subject: FilterSubject) -> None:
    """x, P, F and H as integer arrays give the numbers that they give as floats."""
    model = subject.model().with_(
        x=np.array([0.0, 1.0, 0.0, 2.0]), P=2.0 * np.eye(4), F=np.eye(4, k=1) + np.eye(4), H=np.eye(2, 4)
    )
    zs, found = subject.recording(model, 5), []
    for kind in (float, int):
        kf = subject.new(model)
        for name in ("x", "P", "F", "H"):
            setattr(kf, name, np.array(getattr(kf, name)).astype(kind))
        found.append(state(subject.advance(kf, zs, model)))
    (x, P), (x2, _) = found
    if furthest(x2 - x, P) > 1e-9:
        raise AssertionError(f"x differs by {furthest(x2 - x, P):.2g} of its standard deviations: it is rounded to integers")


@promise(FILTER_PROMISES)
def deepcopies_go_on_alike(subject: FilterSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy")


@promise(FILTER_PROMISES, "pickle")
def pickles_go_on_alike(subject: FilterSubject) -> None:
    """An unpickled filter goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle")


def _round_trip(subject: FilterSubject, way: str) -> None:
    """Copy in the middle of a recording."""
    model = subject.model()
    zs = subject.recording(model)
    kf = subject.advance(subject.new(model), zs[:5], model)
    contracts.assert_state_round_trip(kf, lambda one: subject.advance(one, zs[5:], model), ways=(way,))


@promise(FILTER_PROMISES, "memoryless")
def nothing_is_remembered_but_x_and_P(subject: FilterSubject) -> None:
    """A filter given the x and P of another goes on as that one does, whatever either has seen before."""
    model = subject.model()
    past, zs = subject.recording(model, 5), subject.recording(model, 3)
    fresh, old = subject.new(model), subject.advance(subject.new(model), past, model)
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


@promise(FILTER_PROMISES, "memoryless")
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
                raise AssertionError(f"{name} {way} between two steps does not count: {off:.2g} off, an old one is used")


@promise(FILTER_PROMISES)
def order_of_sensors_changes_nothing(subject: FilterSubject) -> None:
    """Permuting the sensors permutes H, R and z and nothing else."""
    model = subject.model(4, 3)
    assert_sensor_order_irrelevant(subject.made, draw(model, 20, contamination=_outliers(subject), rng=subject.rng))


@promise(FILTER_PROMISES)
def units_change_nothing(subject: FilterSubject) -> None:
    """In other units of the states and of each sensor the estimate is the same in those units."""
    model = subject.model()
    assert_unit_equivariant(subject.made, draw(model, 20, contamination=_outliers(subject), rng=subject.rng))


def _outliers(subject: FilterSubject) -> str:
    """Return outliers for a filter that does something about them."""
    return "mixture" if "robust" in subject.claims else "none"


@promise(FILTER_PROMISES)
def mirror_image_of_the_data_gives_the_mirror_image(subject: FilterSubject) -> None:
    """From -x with -z the filter gives -x+ and the same P+: it does not prefer one sign."""
    model = subject.model()
    zs = draw(model, 10, contamination="mixture" if "robust" in subject.claims else "none", rng=subject.rng).z
    # An outlier of either sign is certain to be among them.
    zs[4] += 50.0 if "robust" in subject.claims else 0.0
    (x, P), (x2, P2) = (
        state(subject.advance(subject.new(one), sign * zs, one))
        for sign, one in ((1.0, model), (-1.0, model.with_(x=-model.x)))
    )
    off = apart((x, P), (-x2, P2))
    if off > 1e-6:
        raise AssertionError(f"the mirror image differs by {off:.2g} of a standard deviation: one sign is preferred")


@promise(FILTER_PROMISES, "missing")
def none_is_no_information(subject: FilterSubject) -> None:
    """update(None) leaves x and P as they are."""
    model = subject.model()
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng), components=False)


@promise(FILTER_PROMISES, "nan")
def nan_is_a_sensor_that_is_not_there(subject: FilterSubject) -> None:
    """With NaN for a sensor the filter is the one without that sensor; all NaN is no measurement."""
    model = subject.model(4, 3)
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng))


@promise(FILTER_PROMISES, "likelihood", "exact")
def likelihood_is_the_gaussian_density_of_the_innovation(subject: FilterSubject) -> None:
    """log_likelihood = -(y' S^-1 y + log det S + m log 2 pi)/2, of the Kalman filter."""
    model = subject.model()
    kf = subject.advance(subject.new(model), subject.recording(model, 3), model)
    if not hasattr(kf, "log_likelihood"):
        raise not_applicable("has no log_likelihood")
    kf.predict()
    x, P = state(kf)
    S = model.H @ P @ model.H.T + model.R
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


@promise(FILTER_PROMISES, "likelihood")
def likelihood_integrates_to_one(subject: FilterSubject) -> None:
    """The integral of exp(log_likelihood) over all z is 1, or filters cannot be compared with each other."""
    model = subject.model(2, 1)
    kf = subject.new(model)
    if not hasattr(kf, "log_likelihood"):
        raise not_applicable("has no log_likelihood")
    x, P = state(kf)
    sigma = float(np.sqrt(model.H @ P @ model.H.T + model.R)[0, 0])
    # Steps that grow with the distance reach heavy tails.
    t = np.linspace(-6.0, 6.0, 301)
    offsets, density = sigma * np.sinh(t), np.empty(t.size)
    for k, offset in enumerate(offsets):
        kf = subject.new(model)
        runs.measure(kf, model.H @ x + offset, model)
        density[k] = np.exp(float(kf.log_likelihood))
    integral = float(np.sum(density * sigma * np.cosh(t)) * (t[1] - t[0]))
    if not abs(integral - 1.0) <= 0.02:
        raise AssertionError(f"the likelihood integrates to {integral:.3g} over z, expected 1: it is no density")


@promise(FILTER_PROMISES)
def innovation_and_its_covariance_are_shown(subject: FilterSubject) -> None:
    """kf.y = z - H x_prior and kf.S = H P_prior H' + R after update(z), where a filter shows them."""
    model = subject.model()
    kf = subject.advance(subject.new(model), subject.recording(model, 2), model)
    if not hasattr(kf, "y") or not hasattr(kf, "S"):
        raise not_applicable("shows no y or S")
    kf.predict()
    x, P = state(kf)
    S = model.H @ P @ model.H.T + model.R
    z = model.H @ x + 0.3 * np.sqrt(S.diagonal())
    runs.measure(kf, z, model)
    for name, got, wanted in (("y", np.ravel(kf.y), z - model.H @ x), ("S", np.asarray(kf.S), S)):
        if np.shape(got) != wanted.shape or not np.allclose(got, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max()):
            sign = "; it has the other sign" if np.shape(got) == wanted.shape and np.allclose(got, -wanted) else ""
            raise AssertionError(f"{name} is {np.round(got, 4).tolist()}, expected {np.round(wanted, 4).tolist()}{sign}")


BAD_CALLS: dict[str, tuple[str | None, Any]] = {
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


@promise(FILTER_PROMISES, "validates")
def bad_input_is_refused_and_changes_nothing(subject: FilterSubject) -> None:
    """A z, F, H, Q or R that cannot be right raises ValueError or TypeError, and x and P are as they were."""
    model, faults = subject.model(), []
    zs = subject.recording(model, 3)
    for words, (name, value) in BAD_CALLS.items():
        kf = subject.advance(subject.new(model), zs, model)
        if name is not None:
            setattr(kf, name, value)
        call = _bad_call(name, value, zs[0], model)
        try:
            contracts.assert_refused_call_changes_nothing(kf, call, names=("x", "P"))
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


def _bad_call(name: str | None, value: Any, z: Array, model: Any) -> Any:
    """Return the call that has to meet the bad value."""
    if name in ("F", "Q"):
        return lambda kf: kf.predict()
    if name == "H":
        # An extended filter asks for it.
        bad = model.with_(sensor=lambda x: z, sensor_jacobian=lambda x: value)
        return lambda kf: runs.measure(kf, z, bad if runs.is_extended(kf) else model)
    return lambda kf: runs.measure(kf, value if name is None else z, model)
