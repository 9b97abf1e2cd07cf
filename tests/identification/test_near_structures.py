"""select_structure looks everywhere for the structures that it begins with, and from there for those next to them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from robust_filterpy import _progress
from robust_filterpy.identification import BoxJenkins, OutputError, identify, select_structure
from robust_filterpy.identification.estimation import search
from robust_filterpy.identification.judging.select import _as_begin

RNG = np.random.default_rng([514, 0])
U = RNG.choice([-1.0, 1.0], (250, 2)) + [3.0, -2.0]
Y = 7.0 + lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], U[:, 0]) + lfilter([0.0, 0.4], [1.0, -1.5, 0.7], U[:, 1])
Y += 0.3 * RNG.normal(size=250)


@pytest.fixture
def searched(monkeypatch):
    """Collect the structures that are searched from every start."""
    structures, starts = [], search._starts
    monkeypatch.setattr(
        search, "_starts", lambda model, *given: structures.append(model.structure) or starts(model, *given)
    )
    return structures


def test_structures_next_to_the_best_begin_at_it_and_are_as_likely_as_from_everywhere(searched, monkeypatch):
    said = []
    monkeypatch.setattr(_progress._Lines, "stage", lambda self, text: said.append(text.split()))
    found = select_structure(Y, U[:, 0], na=[1, 2], nb=[1, 2], nk=[1, 2])
    # How many are to come is said with the first.
    done, totals = ([int(words[i]) for words in said if words[0].isdigit()] for i in (0, 2))
    assert totals[0] > done[-1] - 3
    assert all(total > count for count, total in zip(done[:-1], totals[:-1], strict=True))
    assert done[-1] == totals[-1]
    near = [row for row in found.rows if row.structure not in searched]
    assert near
    for row in near:
        first = 3 - max(row.structure.nf, sum(row.structure.inputs[0]) - 1)
        anywhere = identify(
            Y[max(first, 0) :], U[max(first, 0) :, 0], row.structure, trend="constant", sampled=False, progress=False
        )
        assert row.log_likelihood > anywhere.log_likelihood - 3.0


def test_a_model_as_the_beginning_of_another_structure_has_its_output():
    model = identify(Y, U, OutputError(2, (2, 1)), trend="constant", sampled=False)
    structure = BoxJenkins(nb=(3, 2), nc=1, nd=1, nf=3)
    p, places = _as_begin(model, structure), structure.polynomials
    inputs = zip(places.b, U.T, model.operating_point, strict=True)
    f = np.append(1.0, p[places.f])
    output = sum(lfilter(np.append(0.0, p[b]), f, column - rest) for b, column, rest in inputs)
    assert_allclose(output[120:] + p[structure.n_theta], model.simulate(U)[120:], atol=1e-6)
