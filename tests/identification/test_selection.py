"""select_structure: the delay and the orders that made the recording, through outliers, on the same samples for all."""

import warnings

import numpy as np
import pytest
import support
from numpy.testing import assert_allclose
from recordings import A, B, assert_refused, binary, recording
from scipy.signal import lfilter
from statsmodels.tsa.ar_model import AutoReg

from robust_filterpy import _progress
from robust_filterpy.identification import ARMAX, ARX, FIR, BoxJenkins, OutputError, identify, select_structure
from robust_filterpy.identification.estimation import search
from robust_filterpy.identification.estimation.estimate import near
from robust_filterpy.identification.judging import select
from robust_filterpy.identification.judging.select import Grid
from robust_filterpy.identification.models.noise import fit_percent


def recorded(seed=0, delay=4, length=1000, b=(1.0, 0.5)):
    return recording([seed, delay], length, b=[*[0.0] * delay, *b])


@pytest.mark.parametrize("delay", [8, *(pytest.param(delay, marks=pytest.mark.nightly) for delay in (0, 1))])
def test_delay_and_orders_are_found_through_outliers(delay):
    selection = select_structure(*recorded(delay=delay, length=400), na=range(1, 4))
    assert selection.best.structure == OutputError(2, 2, delay)
    assert selection.impulse_responses[0].sure_delay == delay


def test_a_first_b_below_the_band_is_found_by_the_likelihood():
    y, u = recorded(4, b=[0.02, 1.0, 0.5], length=2000)
    selection = select_structure(y, u, na=[2], nb=[3])
    assert selection.impulse_responses[0].delay == 5
    assert selection.best.structure.nk == 4


def test_all_structures_have_the_same_samples():
    y, u = recorded(length=400)
    y[50:60] = np.nan
    narrow = select_structure(y, u, na=[2], nk=[3, 4])
    assert narrow.samples == 400 - 5 - 10
    # As if the samples that only the largest structure cannot predict were never recorded: the criterion is that of
    # residuals from sample 5 on, for every delay.
    for row in narrow.rows:
        first = 5 - (row.structure.nk + 1)
        model = identify(y[first:], u[first:], row.structure)
        assert np.isfinite(model.residuals(y[first:], u[first:])).sum() == narrow.samples
        assert row.log_likelihood == pytest.approx(model.log_likelihood, abs=0.5)


def test_rows_are_sorted_and_the_criterion_is_the_likelihood_with_its_price():
    y, u = recorded(length=300)
    for name, price in (("bic", None), ("aic", 2.0)):
        selection = select_structure(y, u, na=[1, 2], nk=[3, 4], criterion=name)
        ranks = [row.rank for row in selection.rows]
        assert ranks == sorted(ranks) and len({row.structure for row in selection.rows}) == len(ranks)
        price = price or np.log(selection.samples)
        for row in selection.rows:
            assert row.criterion == pytest.approx(-2.0 * row.log_likelihood + price * (row.structure.n_theta + 1))
        assert str(selection.rows[0].structure) in str(selection).splitlines()[1]
        assert len(selection.to_text(rows=2).splitlines()) == 3


def test_a_first_b_of_zero_comes_last_however_likely():
    best, *_, last = select_structure(*recorded(length=500), na=[1, 2], nb=[3], nk=[3, 4]).rows
    assert best.structure == OutputError(2, 3, 4) and best.shows_delay
    # b = [0, 1, .5] from one sample earlier on is as good a model, and that with too few poles a bad one.
    assert last.structure == OutputError(2, 3, 3) and not last.shows_delay
    assert last.criterion < best.criterion + 10.0


def test_the_held_out_part_is_fitted_by_the_model_of_the_part_before():
    y, u = recorded(length=800)
    selection = select_structure(y, u, na=[1, 2], nk=[3, 4], progress=False)
    alone = select_structure(y[:399], u[:399], na=[1, 2], nk=[3, 4], progress=False)
    assert [row.rank for row in selection.rows] == sorted(row.rank for row in selection.rows)
    best, poor = (next(row for row in selection.rows if row.structure.nf == nf) for nf in (2, 1))
    before = identify(y[:600], u[:600], best.structure)
    late = before.simulate(u[600:], start="continued")
    assert best.held_out_fit == pytest.approx(fit_percent(*ordinary(y[600:], late)), abs=2.0)
    assert poor.held_out_fit < best.held_out_fit - 5.0
    assert "held out" in str(selection).splitlines()[0]
    assert np.isnan([row.held_out_fit for row in alone.rows]).all() and "held out" not in str(alone)
    # A fit that nobody asked for is a dash.
    assert "nan" not in str(selection) + str(alone)


def ordinary(y, model):
    """Return the samples that lie less than three deviations of the noise from a model's."""
    left = np.abs(y - model)
    near = left < 3.0 * 1.4826 * np.median(left)
    return y[near], model[near]


@pytest.mark.parametrize("kind, c", [(ARX, [1.0]), pytest.param(ARMAX, [1.0, 0.7, 0.3], marks=pytest.mark.nightly)])
def test_equation_error_models(kind, c):
    rng, u = binary(5, 800)
    y = lfilter([0.0, *B], A, u) + lfilter(c, A, 0.3 * rng.normal(size=800))
    y[::40] += 20.0
    found = select_structure(y, u, kind, na=range(1, 4), nk=range(1, 4)).best.structure
    assert found.form == kind.__name__ and (found.na, found.nk) == (2, 2)


def test_an_outlier_in_the_regressor_costs_as_much_as_a_few_parameters_whatever_its_size():
    y, u = recording(5, 800, share=0.0, inside=True)
    likelihoods = []
    for size in (0.0, 20.0, 2000.0):
        spoilt = y + size * (np.arange(800) % 40 == 20)
        likelihoods.append(select_structure(spoilt, u, ARX, na=[2], nk=[1]).rows[0].log_likelihood)
    lost = (likelihoods[0] - np.array(likelihoods[1:])) / 20
    assert ((4.0 < lost) & (lost < 12.0)).all()


@pytest.mark.parametrize("kind, tried", [
    (OutputError, {"na": range(1, 5), "nb": None, "nk": range(9)}),
    (ARMAX, {"na": range(1, 5), "nb": None, "nc": None, "nk": range(9)}),
    (FIR, {"nb": range(1, 5), "nk": range(9)}),
    (BoxJenkins, {"nf": range(1, 5), "nb": None, "nc": range(3), "nd": range(3), "nk": range(9)}),
])  # fmt: skip
def test_what_is_tried_where_nothing_is_given_is_what_the_documentation_says(kind, tried):
    ranges = Grid.of(kind, dict.fromkeys(("na", "nb", "nc", "nd", "nf", "nk")), True).ranges
    assert ranges == {(name, 0): None if orders is None else tuple(orders) for name, orders in tried.items()}


def test_without_input_the_order_is_that_of_statsmodels():
    y = lfilter([1.0], A, np.random.default_rng(7).normal(size=1000))
    selection = select_structure(y, None, ARX, na=range(1, 5))
    reference = min(range(1, 5), key=lambda n: AutoReg(y, n, hold_back=4).fit().bic)
    assert selection.best.structure == ARX(reference, 0, 0)
    # The mixture has a share of outliers that normal noise does not need: a little less likely, for all alike.
    for row in selection.rows:
        assert row.log_likelihood == pytest.approx(AutoReg(y, row.structure.na, hold_back=4).fit().llf, abs=2.0)


@pytest.mark.nightly
def test_an_input_that_excites_few_lags_tries_all_delays():
    t = np.arange(400)
    u = np.sin(0.2 * t) + np.sin(0.9 * t) + np.sin(1.9 * t)
    y = lfilter([0.0, 0.0, 1.0], [1.0, -0.8], u) + 0.1 * np.random.default_rng(1).normal(size=400)
    selection = select_structure(y, u, na=[1, 2], nk=range(4))
    assert selection.impulse_responses == ()
    assert selection.best.structure == OutputError(1, 1, 2)


def test_bad_options_and_inputs_are_refused_by_name():
    y, u = recorded(length=200)
    assert_refused(select_structure, {"y": y, "u": u, "na": [1], "nk": [1], "progress": False}, {
        "na": [[], [1.5], "two"],
        "nk": [range(3, 3), [-1]],
        "kind": [sorted, "oe"],
        "criterion": ["best"],
        "u": [np.column_stack((u, u)), None],
    })  # fmt: skip
    for orders, words in (([0, 1], "nb: "), ([100], "y: expected at least")):
        with pytest.raises(ValueError, match=words):
            select_structure(y, u, na=orders)


def test_each_of_several_inputs_has_orders_and_a_delay_of_its_own():
    rng = np.random.default_rng(3)
    u = rng.choice([-1.0, 1.0], (400, 2))
    y = lfilter([0.0, 1.0, 0.5], [1.0, -0.7], u[:, 0]) + lfilter([0.0, 0.0, 0.0, 0.7], [1.0, -0.7], u[:, 1])
    y += np.where(rng.random(400) < 0.1, 2.0, 0.2) * rng.normal(size=400)
    found = select_structure(y, u, na=[1], nb=range(1, 3), nk=range(1, 4))
    assert found.best.structure == OutputError(1, (2, 1), nk=(1, 3))
    assert [one.delay for one in found.impulse_responses] == [1, 3]
    assert "(2, 1)" in str(found)
    assert len(found.plot()) == 4


def with_dead_zone(seed, length=720):
    """Return a plant whose input has a dead zone and whose noise is slow: what no linear structure has."""
    rng = np.random.default_rng([31, seed])
    u = np.repeat(rng.uniform(-1.0, 1.0, length // 8), 8)
    acting = np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0)
    drift = lfilter([0.3], [1.0, -0.98], rng.normal(size=length))
    return lfilter([0.0, 0.3], [1.0, -0.9], acting) + 0.1 * drift + 0.02 * rng.normal(size=length), u


@support.draws(1, 2)
def test_what_is_taken_is_not_below_the_best_on_samples_held_out(draws):
    said = 0
    for seed in range(draws):
        y, u = with_dead_zone(seed)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = select_structure(y, u, na=range(1, 4), nk=[1])
        said += any("the criterion would take" in str(each.message) for each in caught)
        late = [row.held_out_fit for row in found.rows if not np.isnan(row.held_out_fit)]
        assert len(late) > 1 and found.rows[0].held_out_fit >= max(late) - 1.0
        assert found.best.structure == found.rows[0].structure
    assert said


@pytest.mark.parametrize("broken", support.by_night(["step", "input outliers"], "step"))
def test_what_breaks_in_the_recording_takes_no_orders_from_it(broken):
    y, u = recording(6, 800, share=0.0, sigma=0.1, inside=True)
    if broken == "step":
        y[590:] += 20.0  # shortly before the part that is held out
    else:
        rng = np.random.default_rng(6)
        u = np.where(rng.random(800) < 0.04, 10.0 * rng.normal(size=800), u + 1e6)
    with pytest.warns(UserWarning, match="steps by|unlike the others") as caught:
        found = select_structure(y, u, ARX, na=[1, 2], nk=[1], progress=False)
    assert found.best.structure == ARX(2, 2)
    assert not any("the criterion would take" in str(each.message) for each in caught)
    assert np.isnan([row.held_out_fit for row in found.rows]).all() == (broken == "input outliers")


# select_structure looks everywhere for the structures that it begins with, and from there for those next to them.


RNG = np.random.default_rng([514, 0])
U = RNG.choice([-1.0, 1.0], (250, 2)) + [3.0, -2.0]
Y = 7.0 + lfilter(B, A, U[:, 0]) + lfilter([0.0, 0.4], A, U[:, 1]) + 0.3 * RNG.normal(size=250)


@pytest.fixture
def searched(monkeypatch):
    """Collect the structures that are searched from every start."""
    structures, starts = [], search.starts_of
    monkeypatch.setattr(
        search, "starts_of", lambda model, *given: structures.append(model.structure) or starts(model, *given)
    )
    return structures


def test_structures_next_to_the_best_begin_at_it_and_are_as_likely_as_from_everywhere(searched, monkeypatch):
    said = []
    monkeypatch.setattr(_progress._Lines, "stage", lambda self, text: said.append(text.split()))
    found = select_structure(Y, U[:, 0], na=[1, 2], nb=[1, 2], nk=[1, 2])
    # How many are to come is said with the first.
    done, totals = ([int(words[i]) for words in said if words[0].isdigit()] for i in (0, 2))
    assert totals[0] > done[-1] - 3 and done[-1] == totals[-1]
    assert all(total > count for count, total in zip(done[:-1], totals[:-1], strict=True))
    near = [row for row in found.rows if row.structure not in searched]
    assert near
    for row in near:
        seen = slice(max(3 - max(row.structure.nf, sum(row.structure.inputs[0]) - 1), 0), None)
        anywhere = identify(Y[seen], U[seen, 0], row.structure, trend="constant", progress=False)
        assert row.log_likelihood > anywhere.log_likelihood - 3.0


def test_a_model_as_the_beginning_of_another_structure_has_its_output():
    model = identify(Y, U, OutputError(2, (2, 1)), trend="constant")
    structure = BoxJenkins(nb=(3, 2), nc=1, nd=1, nf=3)
    p, places = near(model.structure, model.theta, model.offset, structure, U), structure.polynomials
    inputs = zip(places.b, U.T, model.operating_point, strict=True)
    f = np.append(1.0, p[places.f])
    output = sum(lfilter(np.append(0.0, p[b]), f, column - rest) for b, column, rest in inputs)
    assert_allclose(output[120:] + p[structure.n_theta], model.simulate(U)[120:], atol=1e-6)


# Steps of the level are those of the recording, the same for every structure that is compared.


def test_every_structure_has_the_same_steps(monkeypatch):
    y, u = recording(9101, 500, share=0.0, sigma=0.2)
    y[300:] += 1.0
    models, levels = [], []
    identify = select.identify

    def recorded(y, *arguments, **options):
        model = identify(y, *arguments, **options)
        if model.structure.nf:
            models.append({y.size - one.place[0] for one in model.findings if one.kind == "step"})
            levels.append(options.get("trend"))
        return model

    monkeypatch.setattr(select, "identify", recorded)
    # Models of a part are others.
    monkeypatch.setattr(select, "_LEAST_HELD", y.size + 1)
    chosen = select.select_structure(y, u, na=range(1, 3), nk=range(3), progress=False)
    assert chosen.best.structure == OutputError(2, 2) and [one.kind for one in chosen.best.findings] == ["step"]
    assert len(models) > 3 and all(one == models[0] for one in models)
    # It is looked for in the largest structure alone.
    assert sum(one is None for one in levels) == 1
