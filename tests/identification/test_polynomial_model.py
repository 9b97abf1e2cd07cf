"""One predictor for every structure: its residuals are those of the definitions, its derivatives of differences."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy.identification import AR, ARMA, ARMAX, ARX, FIR, BoxJenkins, LinearRegression, OutputError
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import Structure

STRUCTURES = [
    ARX(2, 2), ARX(2, 0), OutputError(2, (1, 2), nk=(1, 3)), OutputError(3, 1, nk=0), ARMAX(1, 2, 3, nk=0),
    ARMAX(2, 0, 1), FIR((2, 0, 1)), LinearRegression(2), AR(2), ARMA(2, 1), BoxJenkins((2, 1), 1, 2, 2, nk=(0, 2)),
    BoxJenkins(1, 2, 0, 0), Structure(na=2, nb=2, nc=2, nd=2, nf=1),
]  # fmt: skip


def recorded(structure, length=60, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=length) + 3.0, rng.normal(size=(length, structure.n_inputs))


@pytest.mark.parametrize("offset", [True, False])
@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_the_jacobian_is_the_derivative_of_the_residuals(structure, offset):
    y, u = recorded(structure)
    model = PolynomialModel(structure, y, u, offset)
    p = 0.2 * np.random.default_rng(1).normal(size=model.n)
    differences = [(model.residuals(p + h) - model.residuals(p - h)) / 2e-6 for h in 1e-6 * np.eye(model.n)]
    np.testing.assert_allclose(model.jacobian(p), np.transpose(differences), atol=1e-8)


def test_residuals_of_linear_structures_are_those_of_the_regression():
    for structure in (ARX(2, 2), FIR((2, 1), nk=(0, 3)), LinearRegression(3), ARX(1, (1, 2))):
        y, u = recorded(structure)
        model = PolynomialModel(structure, y, u, True)
        p = np.random.default_rng(1).normal(size=model.n)
        expected = y - structure.regressors(u, y) @ p[:-1] - p[-1]
        np.testing.assert_allclose(model.residuals(p), expected[model.first :], rtol=1e-10)


def test_residuals_of_an_output_error_model_are_measured_less_filtered():
    structure = OutputError(2, 2)
    y, u = recorded(structure)
    p = np.array([-1.2, 0.6, 1.0, 0.5, 3.0])
    model = PolynomialModel(structure, y, u, True)
    w = lfilter([0.0, 1.0, 0.5], [1.0, -1.2, 0.6], u[:, 0])
    # The two samples before the first residual, which the start stands for.
    start = lfilter([1.0, -1.2, 0.6], [1.0], np.concatenate((w[:2], np.zeros(2))))[2:]
    residuals = model.residuals(np.concatenate((p, -start)))
    np.testing.assert_allclose(residuals, (y - w - 3.0)[2:], rtol=1e-10)


def test_residuals_of_an_armax_model_make_the_output_again():
    structure = ARMAX(2, 1, 1)
    rng = np.random.default_rng(2)
    u, v = rng.normal(size=200), rng.normal(size=200)
    a, c = [1.0, -1.5, 0.7], [1.0, 0.4]
    y = lfilter([0.0, 1.0], a, u) + lfilter(c, a, v)
    residuals = PolynomialModel(structure, y, u[:, None], False).residuals(np.array([-1.5, 0.7, 1.0, 0.4]))
    # What is unknown of the noise before the first residual fades with the powers of -c.
    np.testing.assert_allclose(residuals[40:], v[42:], atol=1e-12)


def test_a_delay_moves_the_first_residual_not_the_others():
    late, early = OutputError(1, 1, nk=5), OutputError(1, 1)
    y, u = recorded(early)
    moved = np.concatenate((np.zeros((4, 1)), u[:-4]))
    p = np.array([-0.5, 1.0, 0.0])
    now = PolynomialModel(late, y, u, False).residuals(p)
    then = PolynomialModel(early, y, moved, False)
    assert now.size == 55
    np.testing.assert_allclose(now, then.residuals(p)[4:] * 1.0, atol=1e-12)
