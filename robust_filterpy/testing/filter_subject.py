"""The subject of a filter's checks: a factory ``make(dim_x, dim_z)``, and what is done with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing import runs
from robust_filterpy.testing.checks import Subject
from robust_filterpy.testing.models import StateModel, random_stable
from robust_filterpy.testing.scenarios import Scenario, draw

#: What a filter can claim; `check_filter` tests all of it that is not in not_claimed.
FILTER_TAGS = {
    "prediction": "the prediction is linear: x = F x + B u, P = F P F' + Q",
    "exact": "it is the Kalman filter to rounding (never tested of a filter that claims to be robust)",
    "robust": "one wrong measurement moves the state by a bounded amount",
    "recovers": "it follows a true jump of the state",
    "missing": "update(None) is a missing measurement",
    "nan": "NaN in z is a missing component, and the others are used",
    "likelihood": "log_likelihood is the logarithm of a density of z",
    "units": "the units of states and sensors do not matter",
    "memoryless": "nothing is remembered but x and P",
    "validates": "bad input raises, and a refused call changes nothing",
    "pickle": "it can be pickled",
}

# How far a filter that is no Kalman filter may be off in its own judgement of its errors on clean normal data.
_FACTOR = 1.5


@dataclass(frozen=True)
class FilterSubject(Subject):
    """Make filters, load them and move them."""

    @property
    def is_exact(self) -> bool:
        """Whether the filter claims to be the Kalman filter."""
        return "exact" in self.claims

    @property
    def factor(self) -> float:
        """Factor by which S and P may be wrong."""
        return 1.0 if self.is_exact else _FACTOR

    def made(self, dim_x: int, dim_z: int) -> Any:
        """Make a filter, or say what make returned."""
        if not callable(self.make):
            raise TypeError(f"make: expected a class or a function of dim_x and dim_z, got {_checks.shown(self.make)}")
        kf = self.make(dim_x, dim_z)
        for name in ("x", "P", "predict", "update"):
            if isinstance(kf, type) or not hasattr(kf, name):
                raise TypeError(
                    f"make: expected a function of dim_x and dim_z that returns a filter with x, P, predict() and "
                    f"update(z), got {_checks.shown(kf)} without {name}"
                )
        if np.size(kf.x) != dim_x:
            raise ValueError(f"make: expected x of {dim_x} numbers from make({dim_x}, {dim_z}), got {np.size(kf.x)}")
        return kf

    def new(self, model: StateModel) -> Any:
        """Make a filter and load a model into it."""
        return runs.load(self.made(*model.dims[:2]), model)

    def at_prior(self, model: StateModel) -> Any:
        """Make a filter that has just predicted the model's x and P: some cannot correct before they predict."""
        kf = self.new(model.with_(F=np.eye(len(model.x)), Q=np.zeros_like(model.Q)))
        kf.predict()
        kf.F, kf.Q = model.F.copy(), model.Q.copy()
        return kf

    def model(self, dim_x: int = 4, dim_z: int = 2, dim_u: int = 0) -> StateModel:
        """Draw a random stable system."""
        return random_stable(dim_x, dim_z, dim_u, rng=self.rng)

    def recording(self, model: StateModel, steps: int = 10) -> Array:
        """Draw ordinary measurements, shape (steps, m)."""
        scenario: Scenario = draw(model, steps, rng=self.rng)
        return scenario.z

    def advance(self, kf: Any, zs: Array, model: StateModel) -> Any:
        """Predict and correct along a recording and return the filter."""
        for z in zs:
            runs.step(kf, runs.or_none(z), model)
        return kf


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
