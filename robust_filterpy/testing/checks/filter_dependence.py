"""Promises about what the estimate depends on, and what not: history, units, order, signs, missing measurements."""

from __future__ import annotations

import numpy as np

from robust_filterpy.testing.assertions.bounds import apart
from robust_filterpy.testing.assertions.invariance import (
    SENSOR_UNITS,
    STATE_UNITS,
    assert_missing_is_no_information,
    assert_sensor_order_irrelevant,
    assert_unit_equivariant,
)
from robust_filterpy.testing.checks.bench import OLD, Promise, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.drawing import draw
from robust_filterpy.testing.scenarios.runs import state

PROMISES: list[Promise] = []


@promise(PROMISES, "memoryless")
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


@promise(PROMISES, "memoryless")
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


@promise(PROMISES)
def order_of_sensors_changes_nothing(subject: FilterSubject) -> None:
    """Permuting the sensors permutes H, R and z and nothing else."""
    model = subject.model(4, 3)
    assert_sensor_order_irrelevant(subject.made, draw(model, 20, contamination=_outliers(subject), rng=subject.rng))


@promise(PROMISES, "units")
def units_change_nothing(subject: FilterSubject) -> None:
    """In other units of the states and of each sensor the estimate is the same in those units."""
    scenario = draw(subject.model(), 20, contamination=_outliers(subject), rng=subject.rng)
    for size in (1.0, 1e6):
        assert_unit_equivariant(subject.made, scenario, state=size * STATE_UNITS, sensors=size * SENSOR_UNITS)


def _outliers(subject: FilterSubject) -> str:
    """Return outliers for a filter that does something about them."""
    return "mixture" if "robust" in subject.claims else "none"


@promise(PROMISES)
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


@promise(PROMISES, "missing")
def none_is_no_information(subject: FilterSubject) -> None:
    """update(None) leaves x and P as they are."""
    model = subject.model()
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng), components=False)


@promise(PROMISES, "nan")
def nan_is_a_sensor_that_is_not_there(subject: FilterSubject) -> None:
    """With NaN for a sensor the filter is the one without that sensor; all NaN is no measurement."""
    model = subject.model(4, 3)
    assert_missing_is_no_information(subject.made, draw(model, 10, rng=subject.rng))
