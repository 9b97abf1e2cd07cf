"""Promises about what a filter shows besides x and P: the innovation, its covariance, the likelihood."""

from __future__ import annotations

import numpy as np
from scipy import stats

from robust_filterpy.testing.checks.bench import Promise, not_applicable, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.runs import state

PROMISES: list[Promise] = []


@promise(PROMISES)
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


@promise(PROMISES, "likelihood", "exact")
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


@promise(PROMISES, "likelihood")
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
