"""Promises between the lines: shapes, arrays that stay the caller's, numbers of any type; y, S and the likelihood."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from robust_filterpy.testing.assertions.bounds import furthest
from robust_filterpy.testing.checks.bench import Promise, not_applicable, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.runs import state

#: What is looked at first, and what a filter shows besides x and P.
PROMISES: list[Promise] = []
SHOWN: list[Promise] = []


@promise(PROMISES)
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


@promise(PROMISES)
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


@promise(PROMISES)
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


@promise(PROMISES)
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
        raise AssertionError(
            f"x differs by {furthest(x2 - x, P):.2g} of its standard deviations: it is rounded to integers"
        )


@promise(SHOWN)
def innovation_and_its_covariance_are_shown(subject: FilterSubject) -> None:
    """kf.y = z - H x_prior and kf.S = H P_prior H' + R after update(z), where shown; R as learnt, if it is."""
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
