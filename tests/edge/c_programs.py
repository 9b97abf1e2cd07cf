"""Random filters and trackers, and their samples; what Python makes of a filter's, and what their C makes of them."""

from __future__ import annotations

import copy
import ctypes
import os
import subprocess
from dataclasses import dataclass, replace

import numpy as np
from support import random_problem, spd

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import NotPositiveDefiniteError, SingularInnovationError
from robust_filterpy.edge import export_c
from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError, ParameterTracker
from robust_filterpy.influence import Hampel, Linear

OK, BAD_ARGUMENT, SINGULAR, INDEFINITE, NOT_FINITE = range(5)
WARNINGS = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion"]
PLAIN = ["-std=c99", "-O0", "-ffp-contract=off", *WARNINGS]
# Memory is watched where the process has the means: at night, see `test_export`.
CHECKS = "address,undefined" if "libasan" in os.environ.get("LD_PRELOAD", "") else "undefined"
UNDEFINED = [f"-fsanitize={CHECKS}", "-fno-sanitize-recover=all"]

INFLUENCES = (Huber(), Huber(1.0), Huber(np.inf), Hampel(1.5, 3.0, 6.0), TukeyBiweight(), StudentT(3.0), Linear())


@dataclass
class Case:
    """A model and its samples, a row each: inputs, then measurements."""

    name: str
    model: object
    samples: np.ndarray
    inputs: int

    @property
    def n(self):
        return np.size(getattr(self.model, "filter", self.model).x)


def status(call, *arguments):
    """What C is to return where Python raises this."""
    try:
        call(*arguments)
    except SingularInnovationError:
        return SINGULAR
    except NotPositiveDefiniteError:
        return INDEFINITE
    except ValueError as error:
        return NOT_FINITE if "finite x" in str(error) or "finite P" in str(error) else BAD_ARGUMENT
    return OK


def filtered(case):
    """What Python makes of a filter's samples: two codes, x, P, and e and the weight of each component."""
    kf, m = copy.deepcopy(case.model), case.samples.shape[1] - case.inputs
    e, weights, rows = np.zeros(m), np.zeros(m), []
    for u, z in zip(*np.split(case.samples, [case.inputs], axis=1), strict=True):
        # Larger than what C takes up at all: its square overflows.
        large = (np.abs(z) >= 1e150).any()
        codes = status(kf.predict, u if len(u) else None), BAD_ARGUMENT if large else status(kf.update, z)
        if codes[1] == OK:
            e, weights = np.ravel(kf.e), np.ravel(kf.weights)
        if np.isnan(z).all():
            e, weights = np.zeros(m), np.full(m, np.nan)
        rows.append([*codes, *np.ravel(kf.x), *kf.P.ravel(), *e, *weights])
    return np.array(rows)


def filter_case(name, seed, extremes=True, steps=30, joint=False):
    """A filter of random size and choices; measurements with outliers, gaps, and infinite ones.

    joint: its sensors fail together.
    """
    rng = np.random.default_rng(seed)
    n, m, inputs = (int(rng.integers(*bounds)) for bounds in ((1, 6), (1, 5), (0, 3)))
    problem = random_problem(seed, n, m, inputs)
    scaling = str(rng.choice(["learnt", "learnt", "innovation", "bounded", "unit"]))
    kf = RobustKalmanFilter(
        n, m, inputs,
        influence=INFLUENCES[int(rng.integers(len(INFLUENCES)))], scaling=scaling,
        information=str(rng.choice(["realized", "expected", "weight"])),
    )  # fmt: skip
    if joint:
        scaling = "learnt" if scaling == "learnt" else "innovation"
        kf.scaling, kf.grouping = scaling, "joint"
        kf.information = "weight" if kf.information == "weight" else "realized"
        problem = replace(problem, R=np.diag(problem.R.diagonal()))
    shrink = 0.05 if scaling == "unit" else 1.0
    kf.x, kf.P, kf.F, kf.H = problem.x.copy(), problem.P * shrink, problem.F, problem.H.copy()
    kf.Q, kf.R, kf.B = problem.Q * shrink, problem.R, problem.B
    if rng.random() < 0.3:
        kf.alpha = 1.01
    if rng.random() < 0.2:
        # A sensor that the state has no part in.
        kf.H[0] = 0.0
    z = rng.normal(size=(steps, m)) * rng.choice([1.0, 30.0], size=(steps, m), p=[0.8, 0.2])
    z[rng.random((steps, m)) < 0.15] = np.nan
    z[3] = np.nan
    if extremes:
        z[7, 0], z[8, -1] = np.inf, -np.inf
        if not kf.influence == Linear() and not kf.influence == Huber(np.inf):
            z[11, 0], z[13] = 1e300, -1e290
    u = rng.normal(size=(steps, inputs))
    return Case(name, kf, np.column_stack((u, z)), inputs)


def structure(rng):
    """A structure of random orders."""
    na, nb, nk = (int(rng.integers(*bounds)) for bounds in ((1, 4), (1, 4), (0, 3)))
    kind = int(rng.integers(9))
    if kind >= 7:
        return BoxJenkins(nb, *rng.integers(0, 3, size=3).tolist(), nk)
    if kind == 1:
        return ARMAX(na, nb, int(rng.integers(1, 3)), nk)
    several, other = ARX(na, (nb, 1), (nk, 2)), OutputError(na, nb, nk)
    return (several, None, FIR(nb, nk), LinearRegression(nb), ARX(na, nb, nk), other, other)[kind]


def tracker_case(name, seed, steps=60, start=0):
    """A tracker of random structure and options on an ARX plant, with outliers and gaps."""
    rng = np.random.default_rng(seed)
    model = ARX(2, 2) if start else structure(rng)
    n, inputs = model.n_theta, model.n_inputs
    drawn = {
        "guard": ["halve", "reject", "none"], "gradient": ["filtered", "pseudolinear"],
        "regressor": ["cleaned", "measured"], "information": ["realized", "expected", "weight"],
        "scaling": ["innovation", "bounded"],
    }  # fmt: skip
    options = {name: str(rng.choice(values)) for name, values in drawn.items()}
    options |= {
        "influence": INFLUENCES[int(rng.integers(len(INFLUENCES)))], "Q": float(rng.choice([0.0, 1e-4])) * spd(rng, n),
        "offset": bool(rng.integers(2)), "start": start, "R_memory": int(rng.choice([10, 150])),
    }  # fmt: skip
    if rng.random() < 0.5:
        options["R"] = 0.04
    if rng.random() < 0.3:
        options["forgetting"] = 0.99
    if not start:
        options["P"] = float(rng.choice([1.0, 10.0]))
        if rng.random() < 0.2:
            options["F"] = 0.999 * np.eye(n)
    tracker = ParameterTracker(model, **options)
    total = steps + 3 * start
    u = rng.normal(size=(total, inputs))
    y = np.zeros(total)
    for k in range(total):
        y[k] = 0.3 + 1.2 * y[k - 1] - 0.5 * y[k - 2] + (u[k - 1].sum() if k else 0.0) + 0.1 * rng.normal()
    y += rng.choice([0.0, 10.0], size=total, p=[0.9, 0.1]) * rng.normal(size=total)
    y[rng.random(total) < 0.1] = np.nan
    if start:
        tracker.run(y[: 3 * start], u[: 3 * start])
    y, u = y[3 * start :], u[3 * start :]
    y[5], u[9] = np.inf, np.nan
    tracker.enabled = rng.random() < 0.95
    if tracker.form.has_offset and not start:
        # As a start would have found it.
        tracker._now = tracker._now.with_parts(centre=0.2)
    if rng.random() < 0.3:
        # As if it had been forgetting for long.
        tracker._now = tracker._now.with_parts(windup=0.3 * float(np.trace(tracker.filter.P)))
    return Case(name, tracker, np.column_stack((u, y)), inputs)


class InC:
    """A filter or a tracker as C, compiled with functions of C's, and its state."""

    def __init__(self, model, folder, watched=(), functions="", precision="double"):
        export_c(model, folder / "one.c", precision=precision)
        sizes = "const size_t sizes[] = {sizeof(one_model), sizeof(one_state)};"
        (folder / "functions.c").write_text(f'#include <stddef.h>\n#include "one.h"\n{sizes}\n{functions}')
        for command in (
            ["cc", *PLAIN, *watched, "-fPIC", "-c", "one.c"],
            ["cc", "-ffp-contract=off", *watched, "-fPIC", "-shared", "functions.c", "one.o", "-lm", "-o", "one.so"],
        ):
            built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            assert built.returncode == 0, built.stderr[:3000]
        self.library, self.is_filter = ctypes.CDLL(str(folder / "one.so")), hasattr(model, "dim_x")
        self.real = ctypes.c_double if precision == "double" else ctypes.c_float
        kf = getattr(model, "filter", model)
        self.n, self.m = np.size(kf.x), kf.dim_z
        self.inputs = model.dim_u if self.is_filter else model.structure.n_inputs
        sizes = [size // ctypes.sizeof(self.real) for size in (ctypes.c_size_t * 2).in_dll(self.library, "sizes")]
        # What is no number in a tracker's state fills one as well.
        self.model, self.state = (
            (self.real * size)(*(self.real * size).in_dll(self.library, f"one_{name}"))
            for size, name in zip(sizes, ("default", "start"), strict=True)
        )
        self.shown = (self.real * (3 * self.m if self.is_filter else 5))()

    def of(self, name):
        """The address of one of the functions' structures, None for none."""
        return None if name is None else ctypes.byref(ctypes.c_char.in_dll(self.library, name))

    def predict(self, *motion, u=()):
        given = [(self.real * len(u))(*u)] if len(u) else []
        return self.library.one_predict(self.model, self.state, *map(self.of, motion), *given)

    def update(self, z, *sensor, u=None):
        """Take a measurement; a tracker with its inputs."""
        z = np.atleast_1d(z)
        given = (self.real * len(z))(*z)
        if not self.is_filter:
            inputs = (self.real * (len(u) + 1))(*u)
            return self.library.one_update(self.model, self.state, self.real(z[0]), inputs, self.shown)
        return self.library.one_update(self.model, self.state, *map(self.of, sensor), given, self.shown)

    def step(self, z, u):
        """Take a sample; return two codes, the state, and what is shown, as `filtered` has it of Python."""
        codes = (self.predict(u=u), self.update(z)) if self.is_filter else (OK, self.update(z, u=u))
        shown = [*self.shown[self.m : 3 * self.m]]
        if not self.is_filter:
            shown = [*self.shown[:3], ctypes.c_int32.from_buffer(self.shown, 3 * ctypes.sizeof(self.real)).value]
        return [*codes, *self.state[: self.n + self.n**2], *shown]

    def fuzz(self, rounds=3000):
        """Take odd numbers as samples, in the model, in the state: what is refused has changed nothing."""
        rng, odd = np.random.default_rng(0), (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e-300, 1e-320, 1.0, 0.3)
        model, state = bytes(self.model), bytes(self.state)
        for k in range(rounds):
            ctypes.memmove(self.model, model, len(model)), ctypes.memmove(self.state, state, len(state))
            numbers = rng.choice(odd, 8)
            if k % 3:
                # The last eight bytes of a tracker's state are no number.
                spoilt, most = (self.model, len(self.model)) if k % 3 == 1 else (self.state, len(self.state) - 1)
                spoilt[int(rng.integers(most))] = rng.choice(odd)
            for step in range(4):
                before = bytes(self.state)
                u = numbers[: self.inputs]
                if not self.is_filter:
                    code = self.update(numbers[-1:], u=u)
                else:
                    code = self.update(numbers[: self.m]) if step % 2 else self.predict(u=u)
                assert code == OK or bytes(self.state) == before
                assert k % 3 or np.isfinite(self.state[: self.n + self.n**2]).all()

    def assert_shows(self, kf, z, **close):
        """Hold x, P and what is shown of a reading, unless it is missing, together with a filter's under a noise."""
        np.testing.assert_allclose(self.x, np.ravel(kf.x), **close)
        np.testing.assert_allclose(self.P, kf.P, **close)
        if not np.isnan(z).all():
            y, outlying, weights = np.reshape(self.shown, (3, -1))
            np.testing.assert_allclose(y, np.where(np.isnan(z), 0.0, np.ravel(kf.y)), atol=1e-12)
            np.testing.assert_allclose(weights, np.ravel(kf.weights), **close)
            np.testing.assert_allclose(1.0 - np.prod(1.0 - outlying), kf.outlier_probability, atol=1e-9)

    @property
    def x(self):
        return np.array(self.state[: self.n])

    @property
    def P(self):
        return np.array(self.state[self.n : self.n + self.n**2]).reshape(self.n, self.n)

    @property
    def rest(self):
        return np.array(self.state[self.n + self.n**2 :])


def compiled(cases, folder, precision="double"):
    """Each case, and what its C makes of its samples."""
    for case in cases:
        (folder / case.name).mkdir(parents=True)
        in_c = InC(case.model, folder / case.name, UNDEFINED, precision=precision)
        yield case, np.array([in_c.step(row[case.inputs :], row[: case.inputs]) for row in case.samples])
