"""Every structure goes through every ability: it works, or says in words what it does not take; nothing is silent."""

import pickle
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
import support
from recordings import silence
from scipy.signal import lfilter

from robust_filterpy.identification import (
    AR,
    ARMA,
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GreyBox,
    OutputError,
    ParameterTracker,
    StateSpace,
    compare,
    identify,
    select_structure,
    validate,
)

A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]
LAG = np.exp(-0.3)
OMEGA = np.array([0.01, 0.5, 2.0])
# Fewer tell no step of the level from the dynamics.
STEPPED = 204


def lag(x, u, p):
    """A lag of first order, whose steady state the input moves."""
    return [p[0] * (p[1] * u[0] - x[0])]


def output(x, u, p):
    """Its state, from a level."""
    return [x[0] + p[2]]


PHYSICS = GreyBox(lag, {"rate": 0.4, "gain": 1.5, "level": 4.0}, x0=[0.0], h=output)
STRUCTURES = {
    "ARX": ARX(2, 2), "OutputError": OutputError(2, 2), "ARMAX": ARMAX(1, 1, 1), "FIR": FIR(3), "AR": AR(2),
    "ARMA": ARMA(2, 1), "BoxJenkins": BoxJenkins(1, 0, 1, 1), "integrated": OutputError(1, 1, integrated=True),
    "two inputs": OutputError(2, (2, 2)), "states": StateSpace(2), "states of two outputs": StateSpace(2),
    "driven states": StateSpace(2, disturbance=True), "physics": PHYSICS,
}  # fmt: skip
OF_OUTPUTS = ("states", "states of two outputs", "driven states", "physics")
# What costs most to be found has one pole.
SMALL = ("ARMAX", "BoxJenkins", "integrated")


def recorded(name, seed=0, samples=None):
    """A recording with a tenth of outliers that the structure can have made, as long as is cheap."""
    samples = samples or (120 if name in OF_OUTPUTS else 180)
    rng = np.random.default_rng([seed, 61])
    u = np.repeat(rng.choice([-1.0, 1.0], (samples // 3, 2)), 3, axis=0)
    wild = np.where(rng.random((samples, 2)) < 0.1, 10.0, 1.0)
    noise = 0.1 * wild * rng.normal(size=(samples, 2)) + 5.0
    if name in ("AR", "ARMA"):
        return lfilter([1.0, 0.4], [1.0, -1.2, 0.6], rng.normal(size=samples)) + noise[:, 0], None
    if name == "physics":
        return lfilter([0.0, 2.0 * (1.0 - LAG)], [1.0, -LAG], u[:, 0]) + noise[:, 0], u[:, 0]
    if name in SMALL:
        return lfilter([0.0, 0.5], [1.0, -0.8], u[:, 0]) + noise[:, 0], u[:, 0]
    y = lfilter(B, [1.0] if name == "FIR" else A, u[:, 0])
    if name == "two inputs":
        return y + lfilter([0.0, 0.7, -0.3], A, u[:, 1]) + noise[:, 0], u
    if name in ("states of two outputs", "driven states"):
        return np.column_stack((y, lfilter([0.0, 0.5, 0.2], A, u[:, 0]))) + noise, u[:, 0]
    return y + noise[:, 0], u[:, 0]


def timed(name, y):
    """What says when the samples were taken, where equations ask for it."""
    return {"t": np.arange(len(y)) / 1.0} if name == "physics" else {}


@cache
def found(name):
    y, u = recorded(name)
    return identify(y, u, STRUCTURES[name], **timed(name, y), progress=False), y, u


def moved(name, change, samples=None, **options):
    """A model of a recording that is changed."""
    y, u = recorded(name, 1, samples)
    y, u = change(y.copy(), None if u is None else u.copy())
    return identify(y, u, STRUCTURES[name], **timed(name, y), progress=False, **options)


def gaps(y, u):
    y[50:55] = np.nan
    return y, u


def fills(y, u):
    y[::25] = 9999.0
    return y, u


def steps(y, u):
    y[STEPPED // 2 :] += 20.0
    return y, u


def far(y, u):
    return y, None if u is None else u + 1e4


def gap_in_u(y, u):
    if u is not None:
        u[60:63] = np.nan
    return y, u


def same(y, u):
    return y, u


def named(name):
    """The first parameter of a structure by its name."""
    return STRUCTURES[name].names[0] if hasattr(STRUCTURES[name], "names") else "A"


def several(name):
    y, u = recorded(name, 1)
    t = {"t": [np.arange(len(y)) / 1.0] * 2} if name == "physics" else {}
    return identify([y, y + 3.0], None if u is None else [u, u], STRUCTURES[name], progress=False, **t)


def judged(name, of):
    model, y, u = found(name)
    return of(model, y, u, **timed(name, y))


def simulated(name, **options):
    model, y, u = found(name)
    return model.simulate(u, np.arange(len(y)) / 1.0) if name == "physics" else model.simulate(u, **options)


ABILITIES = {
    "gaps": lambda name: moved(name, gaps),
    "fill values": lambda name: moved(name, fills),
    "level step": lambda name: moved(name, steps, STEPPED),
    "operating point": lambda name: moved(name, far),
    "gap in u": lambda name: moved(name, gap_in_u),
    "groups": lambda name: moved(name, same, groups=np.arange(len(recorded(name)[0])) // 60),
    "fixed": lambda name: moved(name, same, fixed={named(name): -1.2}),
    "bounds": lambda name: moved(name, same, bounds={named(name): (-3.0, 3.0)}),
    "no trend": lambda name: moved(name, same, trend="none"),
    "constant": lambda name: moved(name, same, trend="constant"),
    "line": lambda name: moved(name, same, STEPPED if name in OF_OUTPUTS else None, trend="line"),
    "several": several,
    "times": lambda name: (
        found(name)[0] if name == "physics" else identify(*recorded(name), STRUCTURES[name], t=np.arange(180) / 1.0)
    ),
    "from rest": simulated,
    "continued": lambda name: simulated(name, start="continued"),
    "residuals": lambda name: judged(name, lambda m, y, u, **t: m.residuals(y, u, **t)),
    "free run": lambda name: judged(name, lambda m, y, u, **t: m.free_run(y, u, **t)),
    "fit": lambda name: judged(name, lambda m, y, u, **t: m.fit(y, u, **t)),
    "validate": lambda name: str(judged(name, validate)),
    "compare": lambda name: [row.fit for row in judged(name, lambda m, *s, **t: compare({"m": m}, *s, **t)).rows],
    "select": lambda name: select_structure(*recorded(name), STRUCTURES[name], progress=False),
    "summary": lambda name: str(found(name)[0].summary()),
    "intervals": lambda name: np.array(found(name)[0].confidence_intervals()),
    "table": lambda name: found(name)[0].summary().to_frame()["estimate"],
    "tracker": lambda name: ParameterTracker(found(name)[0]).theta,
    "pickle": lambda name: pickle.loads(pickle.dumps(found(name)[0])).theta,
}
POLYNOMIALS = {
    "predict": lambda name: judged(name, lambda m, y, u, **t: m.predict(y, u, steps=3, **t)),
    "frequency response": lambda name: found(name)[0].frequency_response(OMEGA).magnitude_upper,
    "step response": lambda name: found(name)[0].step_response(10).upper,
    "poles": lambda name: np.abs(found(name)[0].poles().values),
    "continuous poles": lambda name: str(found(name)[0].poles(dt=1.0)),
}
# What takes minutes of a physical model is tried of one recording; its level step has a test of its own.
COSTLY = {"level step", "gaps", "fill values", "operating point", "gap in u", "line", "several", "no trend"}
# Each makes a model of its own: an eighth of them for each structure on every commit, the next eighth for the next.
MADE = (*(one for one in ABILITIES if one in COSTLY), "groups", "fixed", "bounds", "focus", "constant", "times")


def abilities(name, often):
    """What a structure is asked for on every commit, or at night alone."""
    asked = [one for one in ABILITIES if name != "physics" or one not in COSTLY]
    asked += [one for one in POLYNOMIALS if name != "physics"]
    first = list(STRUCTURES).index(name)
    return [one for one in asked if (one not in MADE or (first + MADE.index(one)) % 8 == 0) == often]


def works_or_says(name, ability):
    """Return what is wrong, if anything is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = (ABILITIES | POLYNOMIALS)[ability](name)
            # Named, by the package: what was expected, what was found.
        except Exception as error:
            refused = isinstance(error, (ValueError, TypeError)) and not isinstance(error, np.linalg.LinAlgError)
            return [] if refused and ": expected" in str(error) else [f"{ability}: {error!r}"]
    if isinstance(result, str):
        return []
    values = np.asarray(getattr(result, "theta", result), dtype=float)
    finite = np.isfinite(values[3:] if values.ndim == 1 and values.size > 100 else values).all()
    return [] if finite else [f"{ability}: {values}"]


@pytest.mark.parametrize("often", [True, pytest.param(False, marks=pytest.mark.nightly)], ids=["often", "at night"])
@pytest.mark.parametrize("name", STRUCTURES)
def test_every_structure_does_it_or_says_what_it_does_not_take(name, often):
    asked = abilities(name, often)
    wrong = [one for ability in asked for one in works_or_says(name, ability)]
    assert asked and not wrong, "\n".join(wrong)


# What is found beside states and physics.


def states(seed, samples=300):
    """Two outputs of one plant with a tenth of outliers, and its input."""
    rng = np.random.default_rng([62, seed])
    u = np.repeat(rng.choice([-1.0, 1.0], (samples + 2) // 3), 3)[:samples]
    clean = np.column_stack((lfilter(B, A, u), lfilter([0.0, 0.5, 0.2], A, u)))
    return clean + 0.2 * np.where(rng.random(clean.shape) < 0.1, 10.0, 1.0) * rng.normal(size=clean.shape), u, clean


def off(model, u, clean):
    return np.linalg.norm(model.simulate(u) - model.simulate(np.zeros(u.size)) - clean) / np.linalg.norm(clean)


def test_levels_of_states_that_step_are_taken_off_and_put_back():
    y, u, clean = states(1, 500)
    broken = y + 15.0 * (np.arange(500) >= 250)[:, None] * [1.0, -1.0]
    with pytest.warns(UserWarning, match="output 1: the level of y steps by -1[45]"):
        model = identify(broken, u, StateSpace(2))
    assert [one.kind for one in model.findings] == ["step", "step"] and off(model, u, clean) < 0.02
    np.testing.assert_allclose(model.level, [15.0, -15.0], atol=0.2)
    assert (model.fit(broken, u) > 85.0).all()
    assert np.abs(np.median(broken - model.predict(broken, u), axis=0)).max() < 0.1
    assert {one.verdict for one in validate(model, broken, u)} == {"nothing is left in the residuals"}
    # Another recording has the level at the end, and no step.
    assert np.abs(np.median(model.residuals(y + [15.0, -15.0], u), axis=0)).max() < 0.1
    with pytest.warns(UserWarning, match="follow u"):
        bent = identify(broken, u, StateSpace(2), trend="constant")
    assert off(bent, u, clean) > 0.1 and not bent.trends


def test_a_plant_that_changes_an_angle_and_a_loop_are_said_of_states():
    y, u, _ = states(4, 500)
    with pytest.warns(UserWarning, match="the plant is another one there"):
        identify(y * np.where(np.arange(500) < 300, 1.0, -1.0)[:, None], u, StateSpace(2))
    limit = 0.6 * np.abs(y).max(axis=0)
    with pytest.warns(UserWarning, match="an angle or a counter that wraps"):
        identify((y + limit) % (2.0 * limit) - limit, u, StateSpace(2))
    rng = np.random.default_rng(5)
    x, z, v = np.zeros(800), np.zeros(800), lfilter([1.0], [1.0, -0.9], rng.normal(size=800))
    act = rng.choice([-1.0, 1.0], 800)
    for k in range(800):
        x[k] = 0.8 * x[k - 1] + act[k - 1] if k else 0.0
        z[k] = x[k] + v[k]
        act[k] -= 0.3 * z[k]
    with pytest.warns(UserWarning, match="the recording comes from a closed loop"):
        identify(z, act, StateSpace(1))


@support.draws(1, 3)
def test_nothing_is_found_in_an_ordinary_recording(draws):
    for seed in range(draws):
        y, u, clean = states(10 + seed)
        with silence():
            model = identify(y, u, StateSpace(2))
        assert model.findings == () and model.trends == () and off(model, u, clean) < 0.02


# Recordings that break an assumption.


@pytest.mark.parametrize("structure", [StateSpace(2), PHYSICS, OutputError(2, 2)], ids=["states", "physics", "output"])
@pytest.mark.parametrize(("change", "words"), [
    (lambda y, u: (1e-200 * y, u), "y: expected numbers of 1e-100"),
    (lambda y, u: (1e150 * y, u), "y: expected numbers up to"),
    (lambda y, u: ([], []), "expected"),
    (lambda y, u: (y + 0j, u), "expected real numbers"),
    (lambda y, u: ([y, y[:0]], [u, u[:0]]), "y: expected"),
    (lambda y, u: ([y, y], [u, None]), "u: expected"),
    (lambda y, u: ([y, y], [u]), "u: expected a list of 2 recordings like y, got 1"),
    (lambda y, u: ([y, np.column_stack((y, y))], [u, u]), "y: expected"),
    (lambda y, u: (y, None), "u: expected"),
    (lambda y, u: (pd.Series(y, pd.RangeIndex(5, y.size + 5)), pd.Series(u)), "u: expected the index of y"),
])  # fmt: skip
def test_what_cannot_be_identified_is_refused_in_words(structure, change, words):
    y, u = change(*recorded("physics", 2))
    t = None
    if isinstance(structure, GreyBox) and not isinstance(y, pd.Series):
        t = [np.arange(len(one)) / 1.0 for one in y] if isinstance(y, list) and y else np.arange(len(y)) / 1.0
    with pytest.raises((ValueError, TypeError), match=words):
        identify(y, u, structure, t=t)


def test_rows_of_lists_are_one_recording():
    y, u = recorded("states of two outputs")
    np.testing.assert_array_equal(
        identify(y.tolist(), u.tolist(), StateSpace(2)).theta, identify(y, u, StateSpace(2)).theta
    )


def test_a_fit_of_a_constant_is_refused_and_pandas_integers_are_compared():
    model, y, u = found("states of two outputs")
    with pytest.raises(ValueError, match="y: expected samples of output 1 that differ"):
        compare({"m": model}, np.column_stack((y[:, 0], np.ones(len(y)))), u)
    table = pd.DataFrame(np.round(100.0 * y)).astype("Int64")
    table.iloc[5, 0] = pd.NA
    assert np.isfinite(compare({"m": model}, table, pd.Series(u)).rows[0].fit)


def test_a_simulation_takes_as_many_steps_as_its_outputs_ask_for():
    model, _, u = found("physics")
    calls = []

    def counted(x, u, p):
        calls.append(1)
        return lag(x, u, p)

    replace(model, structure=replace(model.structure, f=counted)).simulate(u, np.arange(u.size) / 1.0)
    assert len(calls) < 100 * u.size


def test_what_does_not_fit_a_simulation_is_named():
    model, _, u = found("physics")
    t = np.arange(u.size) / 1.0
    with pytest.raises(ValueError, match=r"u: expected finite numbers .* got .*inf"):
        model.simulate(np.where(t == 7.0, np.inf, u), t)
    with pytest.warns(UserWarning, match="u: missing in 1 of"):
        run = model.simulate(np.where(t == 7.0, np.nan, u), t)
    np.testing.assert_array_equal(run, model.simulate(np.where(t == 7.0, u[6], u), t))
    with pytest.raises(ValueError, match="u: expected the inputs that f takes, got 0"):
        model.simulate(None, t)
    with pytest.raises(ValueError, match="x0: expected 1 states"):
        model.simulate(u, t, x0=[0.0, 1.0])
