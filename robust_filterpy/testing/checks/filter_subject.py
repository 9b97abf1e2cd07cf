"""The subject of a filter's checks: a factory ``make(dim_x, dim_z)``, and what is done with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.robustness import assert_efficient
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.contamination import Kinds
from robust_filterpy.testing.scenarios.drawing import Scenario, draw
from robust_filterpy.testing.scenarios.models import StateModel, random_stable
from robust_filterpy.testing.scenarios.runs import FilterRun

#: What a filter can claim; `check_filter` tests all of it that is not in not_claimed.
FILTER_TAGS = {
    "prediction": "the prediction is linear: x = F x + B u, P = F P F' + Q",
    "exact": "it is the Kalman filter to rounding (never tested of a filter that claims to be robust)",
    "linear": "innovations within their noise move the state by the Kalman gain",
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

# How far a filter that is no Kalman filter may be off in its own judgment of its errors on clean normal data.
_FACTOR = 1.5
_RUNS, _STEPS = 30, 40

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


class Corrected(NamedTuple):
    """Hold what one correction did: the step of x or theta, the Kalman gain's step, and P before and after."""

    step: Array
    kalman_step: Array
    P: Array
    P_after: Array


@dataclass(frozen=True)
class FilterSubject:
    """Make filters, load them and move them: what a promise is tested on.

    Attributes
    ----------
    make : callable
        Returns a new filter.
    claims : frozenset of str
        Tags of what it claims.
    seed : sequence of int
        Seed of everything that is drawn.
    false_alarm : float
        Probability that a right filter fails one stochastic check.
    """

    #: Attributes that hold the estimate.
    shown: ClassVar[tuple[str, ...]] = ("x", "P")
    make: Callable[..., Any]
    claims: frozenset[str]
    seed: Sequence[int]
    false_alarm: float

    @cached_property
    def rng(self) -> np.random.Generator:
        """Draws everything that this check draws."""
        return np.random.default_rng(list(self.seed))

    @property
    def is_exact(self) -> bool:
        """Whether the estimator claims to be the Kalman filter."""
        return "exact" in self.claims

    @property
    def factor(self) -> float:
        """Factor by which S and P may be wrong."""
        return 1.0 if self.is_exact else _FACTOR

    def made(self, dim_x: int, dim_z: int) -> Any:
        """Make a filter, or say what make returned."""
        what = "dim_x and dim_z"
        if not callable(self.make):
            raise TypeError(f"make: expected a class or a function of {what}, got {_checks.shown(self.make)}")
        kf = self.make(dim_x, dim_z)
        needed = ("x", "P", "predict", "update")
        lacking = [name for name in needed if isinstance(kf, type) or not hasattr(kf, name)]
        if lacking:
            raise TypeError(
                f"make: expected a function of {what} that returns a filter with x, P, predict() and update(z), got "
                f"{_checks.shown(kf)} without {lacking[0]}"
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

    def aged(self, model: StateModel, age: int) -> Any:
        """Make a filter that has filtered this many ordinary measurements, or none."""
        return self.advance(self.new(model), self.recording(model, age) if age else np.empty((0, 0)), model)

    def many(self, contamination: Kinds = "none", count: int = _RUNS) -> tuple[list[Scenario], list[FilterRun]]:
        """Run new filters over independent recordings of one system."""
        model = self.model()
        scenarios = [draw(model, _STEPS, contamination=contamination, rng=self.rng) for _ in range(count)]
        return scenarios, [runs.run_filter(self.new(model), scenario) for scenario in scenarios]

    def try_out(self) -> None:
        """Make a filter and load a model into it, or say what make returned."""
        try:
            self.new(self.model())
        except (TypeError, ValueError) as error:
            raise type(error)(str(error).replace("kf: ", "make: ", 1)) from None

    def work(self) -> tuple[Callable[[], Any], Sequence[Callable[[Any], Any]]]:
        """Return what makes loaded filters, and predictions and corrections in turn."""
        model = self.model()
        steps = [
            call
            for z in self.recording(model)
            for call in (partial(runs.predict, u=None), partial(runs.measure, z=z, model=model))
        ]
        return lambda: self.new(model), steps

    def bad_calls(self) -> Mapping[str, Callable[[Any], Any]]:
        """Return predictions and corrections with a matrix or a measurement that cannot be right."""
        return {words: partial(_bad_call, self.model(), *bad) for words, bad in BAD_VALUES.items()}

    def covariances(self) -> list[Array]:
        """Return P where rounding that is not damped from both sides grows at each step by the unstable pole."""
        F = np.array([[1.3, 0.3], [0.0, 0.98]])
        model = StateModel(np.zeros(2), np.eye(2), F, np.array([[1.0, 0.5]]), 0.01 * np.eye(2), np.eye(1))
        covariances = []
        for start in (1.0, 1e6):
            kf = self.new(model.with_(P=start * np.eye(2)))
            for _ in range(300):
                kf.predict()
                x, P = runs.state(kf)
                runs.measure(kf, model.H @ x, model)
                covariances += [P, runs.state(kf)[1]]
        return covariances

    def corrected(self, e: float, age: int = 0, R_ratio: float = 1.0) -> Corrected:
        """Correct by e deviations of each sensor; in an old filter H and R are others from then on."""
        model = self.model()
        model = model.with_(R=R_ratio * model.R)
        kf = self.aged(model, age)
        if age:
            other = self.model()
            model = model.with_(H=other.H, R=other.R)
            kf.H, kf.R = model.H.copy(), model.R.copy()
        kf.predict()
        x, P = runs.state(kf)
        S = model.innovation_covariance(P)
        y = e * np.sqrt(S.diagonal())
        runs.measure(kf, model.H @ x + y, model)
        after, P_after = runs.state(kf)
        return Corrected(after - x, P @ model.H.T @ np.linalg.solve(S, y), P, P_after)

    def assert_efficient(self, contamination: Kinds) -> None:
        """Compare with the filter that knows every label, over many recordings."""
        clean = contamination == "none"
        scenarios, tested = self.many(contamination, _RUNS if clean else 2 * _RUNS)
        at_least = (0.9999 if self.is_exact else 0.6) if clean else 0.5
        best = [scenario.reference for scenario in scenarios]
        assert_efficient(tested, at_least=at_least, relative_to=best, false_alarm=self.false_alarm)


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
