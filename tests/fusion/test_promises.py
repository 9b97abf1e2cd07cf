"""The filters of this room keep the promises that the test bench has for every filter."""

import numpy as np
import pytest

from robust_filterpy.fusion import Fusion, Scales, Sensor, from_function
from robust_filterpy.influence import Huber, Linear
from robust_filterpy.testing import filter_checks


class Stepped:
    """A fusion of one sensor that speaks once a second, told step by step; matrices may be set between steps."""

    def __init__(self, dim_x, dim_z, **options):
        self.dim_x, self.dim_z, self.options = dim_x, dim_z, options
        self.F, self.Q, self.P0 = np.eye(dim_x), np.eye(dim_x), np.eye(dim_x)
        self.H, self.R, self.x0 = np.zeros((dim_z, dim_x)), np.eye(dim_z), np.zeros(dim_x)
        self.t, self.fusion, self.told = 0.0, None, ()
        self.step = self.F, self.Q

    def ready(self):
        """Return the fusion; one that goes on from x and P if a matrix has changed that it takes for constant."""
        now = tuple(np.array(a, dtype=float) for a in (self.H, self.R, self.Q))
        if self.fusion is None or not all(map(np.array_equal, self.told, now)):
            x, P = self.x, self.P
            motion = from_function(
                lambda x, dt: self.over(dt)[0] @ x, lambda x, dt: self.over(dt)[0], lambda dt: self.over(dt)[1],
                self.dim_x,
            )  # fmt: skip
            sensors = {"z": Sensor(self.H, R=self.R)}
            self.fusion = Fusion(motion, sensors, 0.0, x0=x, P0=P, t0=self.t, **self.options)
            self.told = now
        return self.fusion

    def over(self, dt):
        """Return F and Q of a step, which are those of nothing where no time passes."""
        return self.step if dt else (np.eye(self.dim_x), np.zeros((self.dim_x, self.dim_x)))

    @property
    def x(self):
        return self.x0 if self.fusion is None else self.fusion.estimate(self.t).x

    @x.setter
    def x(self, value):
        self.P0, self.x0, self.fusion = self.P, np.array(value, dtype=float), None

    @property
    def P(self):
        return self.P0 if self.fusion is None else self.fusion.estimate(self.t).P

    @P.setter
    def P(self, value):
        self.x0, self.P0, self.fusion = self.x, np.array(value, dtype=float), None

    def predict(self):
        fusion, self.t = self.ready(), self.t + 1.0
        self.step = np.array(self.F, dtype=float), np.array(self.Q, dtype=float)
        fusion.observe("z", self.t, None)
        fusion.estimate(self.t)

    def update(self, z):
        if z is not None:
            self.ready().observe("z", self.t, z, replace=True)
            self.fusion.estimate(self.t)


# Matrices are a motion's and a sensor's here, which check them; a stream has no likelihood, and functions no pickle.
NOT = ("likelihood", "pickle", "validates")
KINDS = {
    "Huber": ({"influence": Huber()}, ("exact", "recovers")),
    "Linear": ({"influence": Linear()}, ("robust", "recovers")),
    "learnt": ({"process": Scales((1.0,), jump=0.0)}, ("exact", "recovers", "linear", "memoryless")),
}


@pytest.mark.parametrize(
    ("name", "check"),
    [
        pytest.param(name, check, id=f"{name}-{check}", marks=[pytest.mark.nightly] if k % 4 and i else [])
        for i, (name, (_, not_claimed)) in enumerate(KINDS.items())
        for k, check in enumerate(filter_checks(not_claimed=(*NOT, *not_claimed)), i)
    ],
)
def test_promise(name, check):
    check(lambda n, m: Stepped(n, m, **KINDS[name][0]))
