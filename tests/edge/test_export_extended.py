"""The C of an extended filter, with the user's functions in C, is the package's kernel to the last bit."""

import math
import re
import shutil
import subprocess
from pathlib import Path

import c_programs
import numpy as np
import pytest
from c_programs import UNDEFINED, InC
from support import needs_kernel

from robust_filterpy import Contaminated, Huber, Learnt, RobustExtendedKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear

pytestmark = [
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]

# Range and bearing of a beacon, of a state (position and velocity in the plane), and a motion with drag.
FUNCTIONS = """
#include "one.h"
#include <math.h>
#include <stddef.h>
static void h(const double x[4], double z[2], const void *context) {
    const double *beacon = context, a = x[0] - beacon[0], b = x[1] - beacon[1];
    z[0] = sqrt(a * a + b * b);
    z[1] = atan2(b, a);
}
static void jacobian(const double x[4], double H[8], const void *context) {
    const double *beacon = context, a = x[0] - beacon[0], b = x[1] - beacon[1];
    const double square = a * a + b * b, r = sqrt(square);
    for (int i = 0; i < 8; i++) H[i] = 0;
    H[0] = a / r, H[1] = b / r, H[4] = -b / square, H[5] = a / square;
}
static void residual(const double z[2], const double at[2], double y[2], const void *context) {
    (void)context;
    y[0] = z[0] - at[0];
    y[1] = remainder(z[1] - at[1], 6.283185307179586);
}
static void f(const double x[4], double next[4], const void *context) {
    const double dt = *(const double *)context;
    for (int i = 0; i < 2; i++) {
        next[i] = x[i] + dt * x[i + 2];
        next[i + 2] = x[i + 2] - dt * 0.1 * x[i + 2] * fabs(x[i + 2]);
    }
}
static void slope(const double x[4], double F[16], const void *context) {
    const double dt = *(const double *)context;
    for (int i = 0; i < 16; i++) F[i] = i % 5 == 0;
    for (int i = 0; i < 2; i++) {
        F[i * 4 + i + 2] = dt;
        F[(i + 2) * 5] = 1 - dt * 0.2 * fabs(x[i + 2]);
    }
}
static void odd(const double x[4], double z[2], const void *context) {
    (void)x, (void)context;
    z[0] = z[1] = NAN;
}
static void flat(const double x[4], double H[8], const void *context) {
    (void)x, (void)context;
    for (int i = 0; i < 8; i++) H[i] = 0;
}
static const double beacon[] = {-30.0, 5.0}, dt = 0.1;
const one_sensor radar = {h, jacobian, residual, beacon};
const one_sensor broken = {odd, jacobian, NULL, beacon}, half = {h, NULL, NULL, beacon};
const one_sensor blind = {h, flat, residual, beacon};
const one_motion drag = {f, slope, &dt};
"""
A, B = -30.0, 5.0


def h(x):
    a, b = x[0] - A, x[1] - B
    return np.array([math.sqrt(a * a + b * b), math.atan2(b, a)])


def jacobian(x):
    a, b = x[0] - A, x[1] - B
    square = a * a + b * b
    r = math.sqrt(square)
    return np.array([[a / r, b / r, 0.0, 0.0], [-b / square, a / square, 0.0, 0.0]])


def residual(z, at):
    return np.array([z[0] - at[0], math.remainder(z[1] - at[1], 6.283185307179586)])


class Dragged(RobustExtendedKalmanFilter):
    """A motion of its own, and its Jacobian for the next prediction."""

    def predict_x(self, u=0):
        x, v = self.x[:2], self.x[2:]
        self.x = np.concatenate((x + 0.1 * v, v - 0.1 * 0.1 * v * np.abs(v)))


def slope(x):
    F = np.eye(4) + 0.1 * np.eye(4, k=2)
    F[[2, 3], [2, 3]] = 1.0 - 0.1 * 0.2 * np.abs(x[2:])
    return F


def made(cls=RobustExtendedKalmanFilter, **choices):
    kf = cls(4, 2, 0 if cls is Dragged else 1, **choices)
    kf.x, kf.P = np.array([1.0, -2.0, 0.5, 0.3]), np.diag([1.0, 1.0, 0.1, 0.1])
    kf.F, kf.Q, kf.R = np.eye(4) + 0.1 * np.eye(4, k=2), np.diag([1e-4, 1e-4, 1e-3, 1e-3]), np.diag([0.04, 1e-4])
    if cls is not Dragged:
        kf.B = np.array([[0.0], [0.0], [0.1], [0.0]])
    return kf


def recording(seed, steps=200):
    """Readings with outliers, gaps, and a jump of the state; inputs."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(steps)
    at = np.column_stack((1.0 + 0.5 * t, -2.0 + 0.3 * t + 8.0 * (t > 10.0), 0.0 * t, 0.0 * t))
    z = np.array([h(x) for x in at]) + rng.normal(size=(steps, 2)) * [0.2, 0.01]
    z += rng.choice([0.0, 30.0], size=z.shape, p=[0.9, 0.1]) * rng.normal(size=z.shape) * [0.2, 0.01]
    z[rng.random(z.shape) < 0.1] = np.nan
    z[[3, 70]] = np.nan
    return z, 0.1 * rng.normal(size=steps)


def in_c_of(kf, folder, watched=()):
    return InC(kf, folder, watched, FUNCTIONS)


def step(kf, in_c, z, u):
    """Let Python and C predict and correct."""
    if isinstance(kf, Dragged):
        kf.F = slope(kf.x)
        kf.predict()
        assert in_c.predict("drag") == c_programs.OK
    else:
        kf.predict([u])
        assert in_c.predict(None, u=[u]) == c_programs.OK
    kf.update(z, jacobian, h, residual=residual)
    assert in_c.update(z, "radar") == c_programs.OK


CHOICES = [
    {}, {"influence": TukeyBiweight()}, {"influence": Hampel(), "information": "expected"}, {"scaling": "bounded"},
    {"scaling": "innovation", "influence": StudentT(4.0), "information": "weight"}, {"influence": Linear()},
    {"influence": Huber(np.inf)}, {"grouping": "joint"},
]  # fmt: skip


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("cls", [RobustExtendedKalmanFilter, Dragged])
@pytest.mark.parametrize("choices", CHOICES, ids=str)
def test_c_equals_the_kernel_to_the_last_bit(cls, choices, tmp_path):
    needs_kernel()
    kf = made(cls, **choices)
    in_c, grew = in_c_of(kf, tmp_path), False
    for seed in range(3):
        for k, (z, u) in enumerate(zip(*recording(seed), strict=True)):
            step(kf, in_c, z, u)
            grew |= np.trace(kf.P_post) > np.trace(kf.P_prior)
            if not np.isnan(z).all():
                # The definition would differ in the last bits.
                expected = np.concatenate([np.where(np.isnan(z), 0.0, kf.y), np.nan_to_num(kf.e), kf.weights])
                assert np.array_equal(in_c.shown, expected, equal_nan=True), (seed, k)
            assert np.array_equal(in_c.x, kf.x) and np.array_equal(in_c.P, kf.P), (seed, k)
            assert np.array_equal(in_c.rest, kf._memory.ravel()[: in_c.rest.size]), (seed, k)
    # A jump that is believed makes P larger.
    assert grew or choices


MIXED = {"learnt": Learnt(), "learnt, two classes": Learnt((1.0, 50.0), 100.0, 20.0), "given": Contaminated(0.1, 100.0)}


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("cls", [RobustExtendedKalmanFilter, Dragged])
@pytest.mark.parametrize("noise", MIXED.values(), ids=MIXED)
def test_noise_that_is_learnt_or_given_is_weighed_as_python_does(cls, noise, tmp_path):
    needs_kernel()
    kf = made(cls, noise=noise, process="given")
    in_c, hit = in_c_of(kf, tmp_path), 0
    # Noise that is given is the definition's, which differs in the last bits.
    close = {"rtol": 1e-9, "atol": 1e-12} if isinstance(noise, Contaminated) else {"rtol": 0.0, "atol": 0.0}
    for k, (z, u) in enumerate(zip(*recording(4), strict=True)):
        step(kf, in_c, z, u)
        in_c.assert_shows(kf, z, **close)
        hit += kf.outlier_probability > 0.5
        if isinstance(noise, Learnt):
            assert np.array_equal(in_c.rest, kf._memory.ravel()), k
    # That the state jumps is no part of this model: most of what comes after is an outlier to noise that is given.
    assert 10 < hit < 150


def test_a_sensor_that_sees_nothing_of_the_state_changes_nothing(tmp_path):
    kf = made(noise=Learnt(), process="given")
    in_c = in_c_of(kf, tmp_path, UNDEFINED)
    before = list(in_c.state)
    assert in_c.update([np.nan, np.nan], "radar") == in_c.update([3.0, 4.0], "blind") == c_programs.OK
    assert list(in_c.state) == before and np.isnan(list(in_c.shown)[4:]).all()


def test_refusals_change_nothing(tmp_path):
    in_c = in_c_of(made(), tmp_path, UNDEFINED)
    before = list(in_c.state)
    assert in_c.update([1.0, 1.0], None) == in_c.update([1.0, 1.0], "half") == c_programs.BAD_ARGUMENT
    assert in_c.update([np.inf, 1.0], "radar") == in_c.update([1.0, 1e200], "radar") == c_programs.BAD_ARGUMENT
    assert in_c.update([1.0, 1.0], "broken") == c_programs.NOT_FINITE
    # An input has no place in a motion of one's own but its context.
    assert in_c.predict("drag", u=[1.0]) == in_c.predict(None, u=[np.nan]) == c_programs.BAD_ARGUMENT
    assert list(in_c.state) == before
    (tmp_path / "own").mkdir()
    own = in_c_of(made(Dragged), tmp_path / "own")
    before = list(own.state)
    # A motion of its own is asked for.
    assert own.predict(None) == c_programs.BAD_ARGUMENT and list(own.state) == before
    assert own.predict("drag") == c_programs.OK and list(own.state) != before


@pytest.mark.parametrize(("place", "lines"), [
    ("# ", {2: "weight 0.13", 3: "weight nan"}), ("## A nonlinear sensor", {-1: r"ends at\s+`([\d.]+)`"}),
])  # fmt: skip
def test_the_programs_of_the_page_run_and_print_what_it_says(place, lines, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "edge.md").read_text()
    part = page[page.index(place) :]
    python, code = (re.search(rf"```{language}\n(.*?)```", part, flags=re.S).group(1) for language in ("python", "c"))
    exec(python, {})
    Path("main.c").write_text(code)
    sources = [path for path in tmp_path.glob("*.c") if path.name != "main.c"]
    subprocess.run(["cc", "-std=c99", *c_programs.WARNINGS, "main.c", *sources, "-lm"], check=True)
    subprocess.run(["./a.out"], check=True)
    printed = capfd.readouterr().out.splitlines()
    for line, end in lines.items():
        said = re.search(end, part)
        assert printed[line].endswith(said.group(1) if said and said.groups() else end)
