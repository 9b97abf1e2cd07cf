"""Corrections of arrays by the kernel are the definition's: by linear sensors, and by moments of any sensor."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, StudentT, TukeyBiweight
from robust_filterpy.correction import definition, spread
from robust_filterpy.correction.options import Choices
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.kernel import moments

support.needs_kernel()


def problem(seed):
    """P, y, C, S and R of a random sensor that is bent a little; now and then a component is missing."""
    g = np.random.default_rng(seed)
    n, m = int(g.integers(1, 7)), int(g.integers(1, 5))
    root, H = g.normal(size=(n, n)), g.normal(size=(m, n))
    P, R = root @ root.T, np.diag(g.uniform(0.1, 2.0, m))
    bend = 0.1 * np.diag(g.uniform(size=m))
    y = 3.0 * g.standard_t(2, size=m)
    y[g.random(m) < 0.1] = np.nan
    return P, y, P @ H.T, H @ P @ H.T + bend + R, R


def assert_alike(found, expected, *names, rounding=0.0):
    shown = found.as_arrays()
    for name in names:
        a, b = getattr(shown, name), getattr(expected, name)
        near = 1e-12 * (1.0 + np.nanmax(np.abs(b), initial=0.0)) + rounding
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=near, err_msg=name)


def defined(choices, memory, P, z, y, C, S, R):
    x = np.zeros(len(P))
    if choices.by_typical:
        return definition.correct_by_typical(memory, x, P, definition.Innovation(z, y, C, S, R), choices)
    return definition.correct(x, P, y, C, S, choices)


@pytest.mark.parametrize(
    ("grouping", "scaling"),
    [("component", "learnt"), ("component", "innovation"), ("component", "bounded"), ("joint", "learnt"),
     ("joint", "innovation")],
)  # fmt: skip
@pytest.mark.parametrize("influence", [Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT()], ids=str)
@support.draws(20, 60)
def test_it_is_the_definition(influence, grouping, scaling, draws):
    choices, taken = Choices(influence, scaling, grouping=grouping), 0
    for seed in range(draws):
        P, y, C, S, R = problem(seed)
        memory = spread.begin(len(y))
        for again in range(3):
            # A reading that repeats counts less.
            z = np.where(np.arange(len(y)) % 2, y, float(again))
            found = moments.correct(choices, memory, P, z, y * (1.0 + 0.1 * again), C, S, R)
            if found is None:
                continue
            taken += 1
            expected = defined(choices, memory, P, z, y * (1.0 + 0.1 * again), C, S, R)
            assert_alike(found, expected, "x", "P", "y", "C", "S", "e", "weights", "psi_deriv", "score", "T")
            assert found.log_density == pytest.approx(expected.log_density, rel=1e-12, abs=1e-12)
            if expected.memory is not None:
                np.testing.assert_allclose(found.memory, expected.memory, rtol=1e-12, atol=1e-12)
                memory = expected.memory
    assert taken > 2.5 * draws


@pytest.mark.parametrize("jump", [30.0, 3e3])
@pytest.mark.parametrize("grouping", ["component", "joint"])
@support.draws(30, 90)
def test_with_a_jacobian_it_is_the_definition_where_p_grows_too(grouping, jump, draws):
    choices, grew = Choices(Huber(), "learnt", grouping=grouping), 0
    for seed in range(draws):
        P, y, C, _, R = problem(seed)
        H = np.linalg.lstsq(P, C, rcond=None)[0].T
        C, S = definition.innovation_moments(P, H, R)
        memory = spread.begin(len(y))
        for k in range(12):
            # A run of innovations that keep their sign and height is a jump, if none repeats to the last bit.
            y_now = y * (1.0 if k < 6 else jump) * (1.0 + 1e-6 * k)
            found = moments.correct(choices, memory, P, y_now, y_now, H, None, R)
            expected = definition.correct_by_typical(
                memory, np.zeros(len(P)), P, definition.Innovation(y_now, y_now, C, S, R, H), choices
            )
            memory = expected.memory
            if found is None:
                continue
            grew += not np.allclose(expected.S, S)
            # What is left of a P that had grown has the last bits of what it was: one for each step that grows and
            # corrects it, in either form.
            grown = definition._opened(P, H, (expected.S - S).diagonal())
            rounding = 2 * (len(y) + 1) * np.finfo(float).eps * max(np.abs(expected.S).max(), grown.max())
            assert_alike(found, expected, "x", "P", "C", "S", "e", "weights", rounding=rounding)
            near = np.full(memory.shape, 1e-12 * np.nanmax(np.abs(y_now)))
            near[:, spread.LEFT] += rounding / R.diagonal()
            assert (np.abs(found.memory - expected.memory) <= near + 1e-12 * np.abs(expected.memory)).all()
    assert grew > draws / 9


def test_what_is_out_of_the_ordinary_is_declined():
    P, y, C, S, R = problem(3)
    choices, memory = Choices(Huber(), "learnt"), spread.begin(len(y))
    assert moments.correct(choices, memory, P, y, np.full_like(y, np.nan), C, S, R) is None
    assert moments.correct(choices, memory, P, y, np.full_like(y, np.inf), C, S, R) is None
    assert moments.correct(choices, memory, P, y, y, C, np.zeros_like(S), R) is None
    assert moments.correct(choices, memory, P, y, y, np.full_like(C, np.nan), S, R) is None
    assert moments.correct(choices, memory[:0], P, y, y, C, S, R) is None
    assert moments.correct(choices, memory, P + np.triu(np.ones_like(P), 1), y, y, C, S, R) is None or len(P) == 1
    assert moments.correct(Choices(Huber(), "learnt", grouping=((0,),)), memory, P, y, y, C, S, R) is None
