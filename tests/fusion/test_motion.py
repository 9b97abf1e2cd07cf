"""Models of motion for any length of time."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from robust_filterpy.fusion import constant_acceleration, constant_velocity, from_continuous, from_function

MODELS = {
    "velocity": constant_velocity(2, [0.5, 2.0]),
    "acceleration": constant_acceleration(1, 3.0),
    "spring": from_continuous([[0.0, 1.0], [-4.0, -0.3]], [[0.0], [1.0]], 2.0, [[0.0], [1.0]]),
    "stiff": from_continuous([[-300.0, 1.0], [0.0, -0.1]], np.eye(2), np.diag([1.0, 2.0])),
}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("a", "b"), [(0.1, 0.3), (1.0, 7.0), (1e-6, 100.0)])
def test_two_stretches_are_one_long_stretch(name, a, b):
    (Fa, Qa, Ba), (Fb, Qb, Bb), (F, Q, B) = (MODELS[name].matrices(dt) for dt in (a, b, a + b))
    np.testing.assert_allclose(Fb @ Fa, F, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Fb @ Qa @ Fb.T + Qb, Q, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(Fb @ Ba + Bb, B, rtol=1e-9, atol=1e-12)


def test_van_loan_is_the_integral():
    A, L, Qc = np.array([[0.0, 1.0], [-4.0, -0.3]]), np.array([[0.0], [1.0]]), 2.0
    F, Q, B = MODELS["spring"].matrices(1.7)
    np.testing.assert_allclose(F, expm(A * 1.7), rtol=1e-10)
    np.testing.assert_allclose(
        Q, quad_vec(lambda s: Qc * expm(A * s) @ L @ L.T @ expm(A * s).T, 0.0, 1.7)[0], rtol=1e-8, atol=1e-12
    )
    np.testing.assert_allclose(B, quad_vec(lambda s: expm(A * s) @ L, 0.0, 1.7)[0], rtol=1e-8)


def test_a_chain_of_integrators_is_its_continuous_model():
    A, L = np.eye(3, k=1), np.eye(3)[:, 2:]
    for mine, other in zip(MODELS["acceleration"].matrices(2.3), from_continuous(A, L, 3.0).matrices(2.3), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_many_stretches_are_each_of_them(name):
    dts = np.array([0.0, 0.1, 2.0, 0.1])
    for i, dt in enumerate(dts.tolist()):
        for many, one in zip(MODELS[name].stacks(dts), MODELS[name].matrices(dt), strict=True):
            np.testing.assert_allclose(many[i], one, rtol=1e-14)


def test_a_model_of_python_control_is_taken():
    control = pytest.importorskip("control")
    found = from_continuous(control.ss([[0.0, 1.0], [-4.0, -0.3]], [[0.0], [1.0]], np.eye(2), 0), [[0.0], [1.0]], 2.0)
    for mine, other in zip(found.matrices(0.9), MODELS["spring"].matrices(0.9), strict=True):
        np.testing.assert_array_equal(mine, other)
    with pytest.raises(ValueError, match="continuous"):
        from_continuous(control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1))


@pytest.mark.parametrize("make", [
    lambda: constant_velocity(0),
    lambda: constant_velocity(1, -1.0),
    lambda: constant_velocity(2, [1.0, 2.0, 3.0]),
    lambda: from_continuous([[1.0, 2.0]]),
    lambda: from_continuous(np.eye(2), Qc=-1.0),
    lambda: from_continuous(np.eye(2), np.ones((3, 1))),
    lambda: from_function(lambda x, dt: x, None, np.eye(2), 2),
    lambda: from_function(lambda x, dt: x, lambda x, dt: np.eye(2), np.eye(3), 2),
])  # fmt: skip
def test_a_model_that_cannot_be_is_refused(make):
    with pytest.raises((ValueError, TypeError)):
        make()


def test_states_are_named_by_their_axes():
    assert constant_velocity(2).names == ("x.p", "x.v", "y.p", "y.v")
    assert constant_velocity(4).names[::2] == ("0.p", "1.p", "2.p", "3.p")
