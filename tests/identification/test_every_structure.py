"""Every structure goes through every ability: it works, or says in words what it does not take; nothing is silent."""

import pickle
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import (
    AR,
    ARMA,
    ARMAX,
    FIR,
    BoxJenkins,
    GreyBox,
    StateSpace,
    compare,
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


def put(signal, rows, value):
    """A signal, or None, with a value in some rows."""
    if signal is not None:
        signal = signal.copy()
        signal[rows] = value
    return signal


CHANGES = {
    "gaps": lambda y, u: (put(y, slice(50, 55), np.nan), u),
    "fill values": lambda y, u: (put(y, slice(None, None, 25), 9999.0), u),
    "level step": lambda y, u: (np.append(y[: STEPPED // 2], y[STEPPED // 2 :] + 20.0, axis=0), u),
    "operating point": lambda y, u: (y, None if u is None else u + 1e4),
    "gap in u": lambda y, u: (y, put(u, slice(60, 63), np.nan)),
}


def moved(name, change=None, samples=None, **options):
    """A model of a recording that is changed."""
    y, u = recorded(name, 1, samples)
    y, u = CHANGES[change](y, u) if change else (y, u)
    return identify(y, u, STRUCTURES[name], **timed(name, y), progress=False, **options)


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
    **{one: lambda name, one=one: moved(name, one, STEPPED if one == "level step" else None) for one in CHANGES},
    "fixed": lambda name: moved(name, fixed={named(name): -1.2}),
    "bounds": lambda name: moved(name, bounds={named(name): (-3.0, 3.0)}),
    "no trend": lambda name: moved(name, trend="none"),
    "constant": lambda name: moved(name, trend="constant"),
    "line": lambda name: moved(name, samples=STEPPED if name in OF_OUTPUTS else None, trend="line"),
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
MADE = (*(one for one in ABILITIES if one in COSTLY), "fixed", "bounds", "focus", "constant", "times")


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
    model, y, u = found("states of two outputs")
    np.testing.assert_array_equal(identify(y.tolist(), u.tolist(), StateSpace(2)).theta, model.theta)


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
