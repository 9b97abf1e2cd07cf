"""Whatever Python passes to the extension, it does not crash: it declines, refuses, or does what the definition does.

``ROBUST_FILTERPY_FUZZ`` in the environment says how many random calls each entry gets; under ``.ci/sanitize`` a read or
a write that goes astray ends the process.
"""

import copy
import os
import threading
import warnings

import numpy as np
import pytest
import support
from hostile import Fleeting, guarded, leaves, mutated, spoilt

from robust_filterpy import Huber, RobustKalmanFilter, filter_series, kernel, smooth
from robust_filterpy.identification import ARMAX, BoxJenkins, OutputError
from robust_filterpy.identification.recursive import track

support.needs_kernel()

EXTENSION = kernel.extension()
ROUNDS = int(os.environ.get("ROBUST_FILTERPY_FUZZ", "300"))
# What a wrong argument may raise, in the kernel or in the definition.
REFUSED = (TypeError, ValueError, AttributeError, IndexError, OverflowError, KeyError, np.linalg.LinAlgError)


class Watched:
    """The extension; every call to it is noted."""

    def __init__(self):
        self.calls = {}

    def __getattr__(self, name):
        entry = getattr(EXTENSION, name)

        def called(*arguments):
            self.calls.setdefault(name, []).append(copy.deepcopy(arguments))
            return entry(*arguments)

        return called


@pytest.fixture(scope="module")
def calls():
    """Ordinary calls, as the package makes them."""
    watched, g = Watched(), np.random.default_rng(0)
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.setattr(kernel, "extension", lambda: watched)
        for n, m in ((2, 1), (3, 2)):
            problem = support.random_problem(n, n, m, 1)
            zs = support.simulate(problem, 40, n, 0.1)[0]
            for options in ({}, {"influence": Huber(), "scaling": "innovation"}):
                kf = support.make(RobustKalmanFilter, problem, **options)
                kf.batch_filter(zs, us=list(np.ones((40, 1))))
                smooth(support.make(RobustKalmanFilter, problem, **options), zs)
            matrices = {name: getattr(problem, name) for name in "FHQR"}
            filter_series(zs[None], **matrices, noise="learnt", process="scales", x0=np.zeros(n), P0=np.eye(n))
        y, u = g.normal(size=60), g.normal(size=60)
        for structure in (OutputError(2, 2), ARMAX(2, 2, 2), BoxJenkins(2, 1, 2, 2)):
            support.paper_tracker(structure).run(y, u)
    assert track.kernel is kernel
    assert set(watched.calls) == {"filter_series", "smooth", "track"}
    return watched.calls


@pytest.mark.parametrize("name", ["filter_series", "smooth"])
def test_a_group_of_arguments_that_could_change_under_the_call_is_refused(calls, name):
    """A list, or what makes its entries when asked: nobody would hold these while they are worked on."""
    arguments = calls[name][0]
    groups = [i for i, part in enumerate(arguments) if isinstance(part, tuple) and isinstance(part[0], np.ndarray)]
    assert groups
    for place in groups:
        for other in (list(arguments[place]), Fleeting(arguments[place], len(arguments[place]))):
            with pytest.raises(ValueError, match="expected"):
                getattr(EXTENSION, name)(*arguments[:place], other, *arguments[place + 1 :])


@pytest.mark.parametrize("code", [np.nan, 1e300, -1.0, 9.0])
@pytest.mark.parametrize("place", [0, 4, 5])
def test_options_that_are_none_are_refused(calls, place, code):
    rule, *rest = calls["filter_series"][0]
    rule = rule.copy()
    rule[place] = code
    with pytest.raises(ValueError, match="expected"):
        EXTENSION.filter_series(rule, *rest)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["filter_series", "smooth", "track"])
def test_no_arguments_crash(calls, name):
    ends, refused = np.full(32, 77.0), 0
    for seed in range(10 * ROUNDS):
        g, kept = np.random.default_rng(seed), []
        arguments = guarded(calls[name][g.integers(len(calls[name]))], kept)
        every = [leaf for leaf in leaves(arguments) if isinstance(leaf, np.ndarray)]
        found = mutated(arguments, g, g.choice([0.0, 0.02, 0.1, 0.5]), every)
        try:
            getattr(EXTENSION, name)(*found)
        except (*REFUSED, MemoryError):
            refused += 1
        for longer in kept:
            if len(longer) >= 64:
                assert (longer[:32] == ends).all() and (longer[-32:] == ends).all(), f"{name}: seed {seed}"
    assert 0 < refused < 10 * ROUNDS


POLICIES = (
    {}, {"influence": Huber(), "scaling": "innovation"}, {"scaling": "bounded"}, {"noise": "learnt"},
    {"noise": "learnt", "process": "given"},
)  # fmt: skip
NAMES = (
    "x", "P", "F", "Q", "H", "R", "B", "_alpha_sq", "dim_x", "dim_z", "inv", "_memory", "_kept", "_policy", "u",
    "z", "R passed", "H passed", "M",
)  # fmt: skip
ENTRIES = ("predict", "correct")


def ordinary(options, n, m, seed):
    kf = support.make(RobustKalmanFilter, support.random_problem(seed % 7, n, m, 1), 1 + seed % 2, **options)
    passed = {
        "u": np.ones(1), "z": np.arange(float(m)), "R passed": kf.R.copy(), "H passed": kf.H.copy(),
        "M": np.zeros((n, m)),
    }  # fmt: skip
    kf.predict()
    kf.update(passed["z"])
    return kf, passed


def spoil(kf, passed, g):
    """Spoil some attributes of a filter and what it is passed, by assignment in its dictionary, past all checks."""
    for name in g.choice(NAMES, size=g.integers(1, 4)):
        owner = passed if name in passed else kf.__dict__
        name = name if name in owner else "_" + name
        if name not in owner:
            continue
        value = owner[name]
        if isinstance(value, tuple) and g.random() < 0.8:
            changed = list(value)
            place = g.integers(len(changed))
            changed[place] = spoilt(changed[place], g, [])
            owner[name] = type(value)(*changed) if hasattr(value, "_fields") else tuple(changed)
        else:
            owner[name] = spoilt(value, g, [])


def outcome(calls):
    """What calls do: what they raise, None if nothing."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for call in calls:
                call()
        except REFUSED as error:
            return type(error)
        return None


def size(array):
    """The largest number of an array in size; 0 of what is none."""
    numbers = [abs(a) for a in array.ravel().tolist() if isinstance(a, (int, float)) and a - a == 0]
    return max(numbers, default=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("options", POLICIES, ids=range(len(POLICIES)))
def test_a_spoilt_filter_does_what_the_definition_does(monkeypatch, options):
    served = 0
    for seed in range(2 * ROUNDS):
        found = []
        for extension in (EXTENSION, None):
            support.served_by(monkeypatch, extension)
            g = np.random.default_rng(seed)
            kf, passed = ordinary(options, *[(2, 1), (3, 2), (1, 3)][seed % 3], seed)
            spoil(kf, passed, g)
            for entry in ENTRIES:
                given = (passed["u"], None) if "predict" in entry else (passed["z"], passed["R passed"])
                arguments = (*given, None, None, None) if "predict" in entry else (*given, None, None)
                if extension is not None:
                    outcome([lambda e=entry, a=arguments, kf=kf: getattr(EXTENSION, e)(copy.copy(kf), *a)])
            raised = outcome([
                lambda kf=kf, passed=passed: kf.predict(passed["u"]),
                lambda kf=kf, passed=passed: kf.update(passed["z"], R=passed["R passed"]),
            ])  # fmt: skip
            numbers = [np.asarray(kf.__dict__.get(name), dtype=object) for name in ("x", "P", "x_prior", "P_prior")]
            found.append((raised, numbers))
        (one, first), (two, second) = found
        # Of such a number rounding leaves no digit next to a noise of 1.
        if one is two is not None or max(map(size, (*first, *second))) > 1e12:
            continue
        # Of several things that are wrong either may name another one.
        assert (one is None) == (two is None), f"seed {seed}: {one} instead of {two}"
        served += one is None
        for a, b in zip(first, second, strict=True):
            if one is None:
                near = 1e-7 * (1.0 + size(b))
                np.testing.assert_allclose(a.astype(float), b.astype(float), rtol=1e-6, atol=near, err_msg=str(seed))
    assert served > ROUNDS // 10


class Changing(RobustKalmanFilter):
    """A filter of which arrays are freed, attributes vanish and errors arise while attributes are read."""

    armed = None

    def __getattribute__(self, name):
        g = object.__getattribute__(self, "armed")
        if g is not None and g.random() < 0.1:
            own = object.__getattribute__(self, "__dict__")
            arrays = [value for value in own.values() if type(value) is np.ndarray]
            draw = g.integers(4)
            if draw == 0 and arrays:
                arrays[g.integers(len(arrays))].resize(int(g.integers(0, 50)), refcheck=False)
            elif draw == 1:
                own.pop(str(g.choice(["x", "P", "F", "H", "_kept", "_memory"])), None)
            elif draw == 2:
                raise KeyError(name)
            else:
                return spoilt(object.__getattribute__(self, name), g, arrays)
        return object.__getattribute__(self, name)


@pytest.mark.slow
@pytest.mark.parametrize("options", POLICIES, ids=range(len(POLICIES)))
def test_a_filter_that_changes_while_it_is_read_does_no_harm(options):
    for seed in range(4 * ROUNDS):
        kf, _ = ordinary(options, 3, 2, seed)
        kf.__class__ = Changing
        kf.armed = np.random.default_rng(seed)
        for entry in ENTRIES:
            arguments = (None, None, None, None, None) if "predict" in entry else ([1.0, 2.0], None, None, None)
            outcome([lambda e=entry, a=arguments, kf=kf: getattr(EXTENSION, e)(kf, *a)])
        moments = ([1.0, 2.0], np.ones(2), None, np.ones((2, 3)), None, None)
        outcome([lambda kf=kf, a=moments: EXTENSION.correct_innovation(kf, *a)])
        outcome([lambda kf=kf: EXTENSION.predict(kf, None, None, None, None, False)])
        outcome([lambda kf=kf: EXTENSION.predict(kf, None, None, np.eye(3), None, np.eye(3))])


@pytest.mark.slow
@pytest.mark.parametrize("options", POLICIES, ids=range(len(POLICIES)))
def test_threads_on_one_filter_do_no_harm(options):
    kf, passed = ordinary(options, 3, 2, 1)
    x, P = kf.x.copy(), kf.P.copy()

    def work(seed):
        g = np.random.default_rng(seed)
        for _ in range(ROUNDS):
            calls = (
                lambda: kf.predict(), lambda: kf.update(passed["z"]), lambda: kf.batch_filter(np.zeros((20, 2))),
                lambda: setattr(kf, "x", x.copy()), lambda: setattr(kf, "P", P.copy()), lambda: kf.y,
            )  # fmt: skip
            outcome([calls[g.integers(len(calls))]])

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    kf.x, kf.P = x, P
    kf.predict()
    kf.update(passed["z"])
    support.assert_positive_definite(kf.P)
