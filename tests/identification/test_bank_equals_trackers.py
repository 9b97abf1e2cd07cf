"""Whatever is asked of them, a bank does what as many trackers do: defaults, starts, watch, warnings, restore."""

import itertools
import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy import Huber
from robust_filterpy.identification import (
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    LostTrackerWarning,
    OutputError,
    ParameterTracker,
    TrackerBank,
)
from robust_filterpy.influence import Hampel

N, LENGTH = 3, 620
STRUCTURES = [OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 1), FIR(4), BoxJenkins(1, 1, 1, 1), ARX(2, (1, 2)), ARX(2, 0)]
# Cold starts make models, which takes time.
SEEDS = [0, 2, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in [1, *range(3, 60)])]


def recording(rng, structure):
    """Plants at a level, with outliers and gaps; one changes its gain, one is still for a while, one is quiet."""
    u = rng.choice([-1.0, 1.0], (LENGTH, N, max(structure.n_inputs, 1)))
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u[:, :, 0], axis=0)
    y[350:, 0] *= rng.choice([1.0, 2.0, -1.0])
    if rng.random() < 0.5:
        y[:120, 1], u[:120, 1] = 0.0, 0.0
    y += rng.choice([0.0, 30.0]) + 0.3 * rng.normal(size=y.shape) * np.where(rng.random(y.shape) < 0.1, 10.0, 1.0)
    y[rng.random(y.shape) < rng.choice([0.0, 0.1])] = np.nan
    return y, u[:, :, : structure.n_inputs]


def options(rng, structure):
    """Draw some of the arguments; all else stays at its default."""
    start = rng.choice([None, 0, 40, 200, 400])
    drawn = {
        "start": None if start is None else int(start), "offset": rng.choice([None, True, False]),
        "regressor": rng.choice([None, "measured", "cleaned"]), "R": rng.choice([None, 0.09]),
        "R_memory": int(rng.choice([20, 150])), "Q": rng.choice([0.0, 1e-5]), "forgetting": rng.choice([None, 0.99]),
        "gradient": str(rng.choice(["filtered", "pseudolinear"])), "guard": str(rng.choice(["halve", "reject"])),
        "influence": rng.choice([None, Huber(2.0), Hampel()]), "scaling": rng.choice([None, "bounded"]),
        "information": rng.choice([None, "expected"]),
    }  # fmt: skip
    if not start and rng.random() < 0.5:
        drawn |= {"start": None, "theta": 0.1, "P": 1.0}
    kept = rng.random(len(drawn)) < 0.6
    return {name: value for (name, value), keep in zip(drawn.items(), kept, strict=True) if keep or name == "theta"}


def told(bank, found, call):
    """Call and return the sentences of lost trackers, by actuator."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    for w in caught:
        if issubclass(w.category, LostTrackerWarning):
            text = str(w.message).split("; see")[0]
            if bank is None:
                found.append(text.removeprefix("ParameterTracker: "))
            else:
                names, _, rest = text.removeprefix("TrackerBank: actuator").lstrip("s ").partition(": ")
                for i in names.split(", "):
                    found[int(i)].append(rest)
    return result


def assert_same(bank, tracker, i):
    """Hold what moves of actuator i together."""
    ours, theirs = bank.tracker(i).state(), tracker.state()
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        scale = np.abs(value[np.isfinite(value)]).max(initial=1.0)
        np.testing.assert_allclose(ours[name], value, rtol=1e-6, atol=1e-7 * scale, err_msg=name)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bank_is_its_trackers_whatever_is_drawn(seed):
    rng = np.random.default_rng([25, seed])
    structure = STRUCTURES[rng.integers(len(STRUCTURES))]
    given = options(rng, structure)
    y, u = recording(rng, structure)
    bank = TrackerBank(N, structure, **given)
    trackers = [ParameterTracker(structure, **given) for _ in range(N)]
    news, own = [[] for _ in range(N)], [[] for _ in range(N)]
    cuts = [0, *sorted(rng.choice(np.arange(1, LENGTH), 3, replace=False).tolist()), LENGTH]
    for first, stop in itertools.pairwise(cuts):
        enabled = rng.random(N) < 0.9
        bank.enabled = enabled
        if rng.random() < 0.3:
            again = TrackerBank(N, structure, **given)
            # What has been said is not in a state.
            again.restore(bank.state())
            for i in range(N):
                fresh = ParameterTracker(structure, **given)
                fresh.restore(trackers[i].state())
                trackers[i] = fresh
            bank = again
        result = told(bank, news, lambda bank=bank, k=slice(first, stop): bank.run(y[k], u[k]))
        for i, tracker in enumerate(trackers):
            tracker.enabled = bool(enabled[i])
            expected = told(None, own[i], lambda t=tracker, i=i, k=slice(first, stop): t.run(y[k, i], u[k, i]))
            for ours, theirs in zip(result.tracker(i), expected, strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7)
            assert_same(bank, tracker, i)
    assert news == own
    ahead = rng.normal(size=(N, structure.n_inputs))
    theirs = [tracker.predict(ahead[i] if structure.n_inputs else None) for i, tracker in enumerate(trackers)]
    np.testing.assert_allclose(bank.predict(ahead if structure.n_inputs else None), theirs, rtol=1e-6, atol=1e-7)
