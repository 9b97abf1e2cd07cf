"""What a filter or a tracker made of a recording, as arrays: the forms that every assertion reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.diagnostics.recording import is_saver, of_saver

if TYPE_CHECKING:
    from robust_filterpy.testing.drawing import Scenario
    from robust_filterpy.testing.models import StateModel
    from robust_filterpy.testing.plants import PlantScenario

__all__ = ["Run", "run_filter", "run_tracker"]


@dataclass(frozen=True, eq=False)
class Run:
    """Hold N steps of a filter, or of a tracker, whose state is theta. What is None was not recorded.

    Attributes
    ----------
    y : ndarray, shape (N, m), optional
        Innovations z - h(x_prior), NaN where a sensor was missing.
    S : ndarray, shape (N, m, m), optional
        Their covariances according to the filter.
    x : ndarray, shape (N, n), optional
        States, or parameters, after each correction.
    P : ndarray, shape (N, n, n), optional
        Their covariances.
    truth : ndarray, shape (N, n), optional
        The true ones.
    scenario : Scenario or PlantScenario, optional
        What it ran over.

    Raises
    ------
    ValueError
        If the lengths or shapes do not fit together.
    """

    y: Array | None = None
    S: Array | None = None
    x: Array | None = None
    P: Array | None = None
    truth: Array | None = None
    scenario: Scenario | PlantScenario | None = None

    def __post_init__(self) -> None:
        """Check that N, m and n are the same everywhere."""
        sizes: dict[str, int] = {}
        for name, letters in {"y": "Nm", "S": "Nmm", "x": "Nn", "truth": "Nn", "P": "Nnn"}.items():
            value = getattr(self, name)
            wanted = ", ".join(str(sizes.get(letter, letter)) for letter in letters)
            found = list(zip(letters, np.shape(value), strict=False))
            fits = np.ndim(value) == len(letters) and all(sizes.setdefault(*one) == one[1] for one in found)
            if value is not None and not fits:
                raise ValueError(f"{name}: expected shape ({wanted}) of a run, got {np.shape(value)}")

    def __len__(self) -> int:
        """Count the steps."""
        return len(self.of("y") if self.x is None else self.x)

    def of(self, name: str) -> Any:
        """Return what was recorded under a name, or raise if nothing was."""
        value = getattr(self, name)
        if value is None:
            raise ValueError(f"{name}: expected a run with {name}; run_filter and run_tracker return one")
        return value

    @property
    def error(self) -> Array:
        """Estimate minus truth, shape (N, n)."""
        return np.asarray(self.of("x") - self.of("truth"))

    @property
    def deviation(self) -> Array:
        """Standard deviations of the estimates according to the filter, shape (N, n)."""
        return np.sqrt(np.maximum(np.einsum("kii->ki", self.of("P")), 0.0))

    @cached_property
    def whitened(self) -> Array:
        """L^-1 y with L the Cholesky factor of the observed part of S, shape (N, m); NaN where missing."""
        e = np.full(self.of("y").shape, np.nan)
        for k, (y, S) in enumerate(zip(self.of("y"), self.of("S"), strict=True)):
            seen = np.flatnonzero(~np.isnan(y))
            if seen.size:
                e[k, seen] = _whitened(S[np.ix_(seen, seen)], y[seen], f"S of step {k}")
        return e

    def standardized_error(self, step: int) -> Array:
        """Return L^-1 (x - truth) at a step, L the Cholesky factor of P, shape (n,)."""
        return _whitened(self.of("P")[step], self.error[step], f"P of step {step % len(self)}")


#: A run, several, or Savers.
Runs: TypeAlias = "Run | Sequence[Run] | Any"


def _whitened(covariance: Array, values: Array, name: str) -> Array:
    """Return L^-1 values, or fail: what is no covariance cannot be consistent with anything."""
    try:
        return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), values))
    except np.linalg.LinAlgError:
        if not np.isfinite(covariance).all():
            raise AssertionError(f"{name} holds NaN or infinity") from None
        least = np.linalg.eigvalsh((covariance + covariance.T) / 2)[0]
        raise AssertionError(f"{name} is no covariance: its least eigenvalue is {least:.3g}") from None


def as_runs(runs: Runs) -> list[Run]:
    """Return a list of runs from a run, a `filterpy.common.Saver`, or several of them."""
    if isinstance(runs, Run):
        return [runs]
    if is_saver(runs):
        saved = of_saver(runs)
        return [Run(saved.y, saved.S)]
    if isinstance(runs, Iterable) and not isinstance(runs, (str, bytes, np.ndarray)):
        parts = [run for part in runs for run in as_runs(part)]
        if parts:
            return parts
    raise TypeError(f"runs: expected a Run, a Saver or a list of these, got {_checks.shown(runs)}")


def load(kf: Any, model: StateModel) -> Any:
    """Put a model into a filter of filterpy's kind, its x in the shape that the filter has it in."""
    n, m, _ = model.dims
    for name in ("x", "P", "predict", "update"):
        if isinstance(kf, type) or not hasattr(kf, name):
            got = f"got {_checks.shown(kf)} without {name}"
            raise TypeError(f"kf: expected a filter with x, P, predict() and update(z), {got}")
    sizes = (np.size(kf.x), getattr(kf, "dim_z", m))
    if sizes != (n, m):
        raise ValueError(f"kf: expected dim_x={n}, dim_z={m} for this model, got dim_x={sizes[0]}, dim_z={sizes[1]}")
    values = {name: getattr(model, name).copy() for name in ("P", "F", "H", "Q", "R")}
    for name, value in (values | {"x": model.x.reshape(np.shape(kf.x)).copy()}).items():
        try:
            setattr(kf, name, value)
        except AttributeError as error:
            raise TypeError(f"kf: expected a filter whose {name} can be set, {type(kf).__name__}: {error}") from None
    if model.B is not None:
        kf.B = model.B.copy()
    return kf


def measure(kf: Any, z: Any, model: StateModel) -> None:
    """Correct a filter, an extended one with the model's sensor and Jacobian."""
    if not is_extended(kf):
        kf.update(z)
        return

    def like_x(values: Array) -> Array:
        return values[:, None] if np.ndim(kf.x) == 2 else values

    # filterpy's extended filter subtracts z as it comes.
    z = None if z is None else like_x(np.ravel(z))
    kf.update(z, lambda x: model.jacobian(np.ravel(x)), lambda x: like_x(model.measured(np.ravel(x))))


def is_extended(kf: Any) -> bool:
    """Tell a filter whose update asks for a Jacobian."""
    return _checks.takes(getattr(type(kf), "update", is_extended), "HJacobian")


def step(kf: Any, z: Any, model: StateModel) -> None:
    """Predict and correct once, by just this z."""
    predict(kf, None)
    measure(kf, z, model)


def calls(kf: Any, zs: Array, model: StateModel, us: Array | None = None) -> Iterator[None]:
    """Predict and correct along a recording, and stop after each call; a z that is all NaN is None."""
    for k, z in enumerate(zs):
        predict(kf, None if us is None else us[k])
        yield
        measure(kf, None if np.isnan(z).all() else z.copy(), model)
        yield


def predict(kf: Any, u: Array | None) -> None:
    """Predict, with an input if there is one, in the shape of x."""
    if u is None:
        kf.predict()
    else:
        kf.predict(u=u[:, None] if np.ndim(kf.x) == 2 else u)


def state(kf: Any) -> tuple[Array, Array]:
    """Return x, shape (n,), and P as copies."""
    return np.ravel(np.array(kf.x, dtype=float)), np.array(kf.P, dtype=float)


def deviations(P: Array) -> Array:
    """Return standard deviations that can be divided by."""
    return np.sqrt(np.maximum(np.abs(np.diagonal(P)), np.finfo(float).tiny))


def furthest(difference: Array, P: Array) -> float:
    """Return the largest difference of a state in its standard deviations, infinite if one is not finite."""
    if not np.isfinite(difference).all():
        return float("inf")
    return float(np.abs(difference / deviations(P)).max())


def apart(one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Return how far x and P of one filter are from those of another, in standard deviations of the first."""
    (x, P), (x2, P2) = one, two
    sigma = deviations(P)
    covariances = (P2 - P) / np.outer(sigma, sigma)
    return max(furthest(x2 - x, P), float(np.abs(covariances).max()) if np.isfinite(covariances).all() else np.inf)


def run_filter(kf: Any, scenario: Scenario) -> Run:
    """Run a filter over a scenario.

    Parameters
    ----------
    kf : filter object
        Loaded with its model (``scenario.load(kf)``, or your own code); it is changed.
    scenario : Scenario
        Inputs and measurements.

    Returns
    -------
    Run
        y and S are computed from the filter's x, P, H and R before each correction, so that it need not show them.

    Raises
    ------
    ValueError
        If the filter and the scenario do not fit.
    """
    model = scenario.model
    n, m, _ = model.dims
    if np.size(kf.x) != n:
        raise ValueError(f"kf: expected a filter with {n} states for this scenario, got {np.size(kf.x)}")
    N = len(scenario.z)
    x, P, y, S = (np.empty((N, *shape)) for shape in ((n,), (n, n), (m,), (m, m)))
    extended = is_extended(kf)
    for call, _ in enumerate(calls(kf, scenario.z, model, scenario.u)):
        k, corrected = divmod(call, 2)
        if corrected:
            x[k], P[k] = state(kf)
            continue
        prior, covariance = state(kf)
        H, R = model.jacobian(prior), own(kf, "R", model.R)
        H = H if extended else own(kf, "H", H)
        y[k] = scenario.z[k] - (H @ prior if model.sensor is None else model.sensor(prior))
        S[k] = H @ covariance @ H.T + R
    return Run(y, S, x, P, scenario.x, scenario)


def own(kf: Any, name: str, default: Array) -> Array:
    """Return a filter's own matrix where it has one of the model's shape."""
    value = getattr(kf, name, None)
    return default if value is None or np.shape(value) != default.shape else np.asarray(value, dtype=float)


def run_tracker(tracker: Any, scenario: PlantScenario, sample: Callable[[int], Any] | None = None) -> Run:
    """Run a tracker over a scenario, sample by sample.

    Parameters
    ----------
    tracker : tracker object
        With ``update(y, u)`` and ``theta``; ``P`` if it has it. It is changed.
    scenario : PlantScenario
        Inputs and outputs.
    sample : callable, optional
        ``sample(k)`` in the place of ``tracker.update(y[k], u[k])``.

    Returns
    -------
    Run
        x is theta; y and S are not recorded.

    Raises
    ------
    ValueError
        If theta has another length than the structure's.
    """
    n, N = scenario.structure.n_theta, len(scenario.y)
    theta, P = np.empty((N, n)), np.empty((N, n, n))
    has_P = hasattr(tracker, "P")
    for k in range(N):
        if sample is None:
            tracker.update(float(scenario.y[k]), scenario.u[k])
        else:
            sample(k)
        now = np.ravel(np.asarray(tracker.theta, dtype=float))
        if now.size != n:
            raise ValueError(f"tracker: expected theta of {n} numbers for this structure, got {now.size}")
        theta[k] = now
        if has_P:
            P[k] = tracker.P
    return Run(x=theta, P=P if has_P else None, truth=scenario.theta, scenario=scenario)
