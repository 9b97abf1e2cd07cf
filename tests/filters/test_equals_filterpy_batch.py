"""Without a finite threshold batch_filter and rts_smoother are filterpy's."""

import numpy as np
import pytest
import support
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core

NDIMS = [1, 2]


def pair(problem, ndim=2, **choices):
    """A robust filter without threshold and filterpy's, loaded alike."""
    robust = support.make(RobustKalmanFilter, problem, ndim, influence=Linear(), **choices)
    return robust, support.make(KalmanFilter, problem, ndim)


def batches(ndim):
    """The ways to call batch_filter, as keyword arguments made from (problem, n, rng)."""
    u = (1, 1) if ndim == 2 else (1,)
    return {
        "plain": lambda p, n, rng: {},
        "update_first": lambda p, n, rng: {"update_first": True},
        "control": lambda p, n, rng: {"us": list(rng.normal(size=(n, *u)))},
        "lists": lambda p, n, rng: {
            "Fs": [support.stable(rng, 4) for _ in range(n)],
            "Qs": [support.spd(rng, 4) for _ in range(n)],
            "Hs": [rng.normal(size=(2, 4)) for _ in range(n)],
            "Rs": [support.spd(rng, 2) for _ in range(n)],
            "Bs": [rng.normal(size=(4, 1)) for _ in range(n)],
            "us": list(rng.normal(size=(n, *u))),
        },
    }


def batch_by_definition(kf, zs, us=None, update_first=False, **lists):
    """The loop that batch_filter stands for; filterpy 1.4.5's refuses None beside columns."""
    out = ([], [], [], [])
    for k, z in enumerate(zs):
        one = {name[0]: values[k] for name, values in lists.items()}
        for step in ("update", "predict") if update_first else ("predict", "update"):
            if step == "predict":
                kf.predict(None if us is None else us[k], **{n: v for n, v in one.items() if n in "FQB"})
            else:
                kf.update(z, **{n: v for n, v in one.items() if n in "HR"})
            for series, value in zip(out[2:] if step == "predict" else out[:2], (kf.x, kf.P), strict=True):
                series.append(value.copy())
    return tuple(map(np.array, out))


@pytest.mark.parametrize("ndim", NDIMS)
@pytest.mark.parametrize("case", ["plain", "update_first", "control", "lists"])
@pytest.mark.parametrize("missing", [False, True])
def test_batch_filter_and_smoother(ndim, case, missing):
    problem, n = support.random_problem(14, 4, 2, dim_u=1), 40
    arguments = batches(ndim)[case](problem, n, np.random.default_rng(0))
    robust, plain = pair(problem, ndim)
    if "us" not in arguments:
        # Without B, so that filterpy's default us=0 multiplies nothing.
        robust.B = plain.B = None
    zs = [support.column(plain, z) for z in support.simulate(problem, n, seed=3)[0]]
    if missing:
        zs[3] = zs[20] = zs[21] = None
    ours = robust.batch_filter(zs, **arguments)
    theirs = plain.batch_filter(zs, **arguments) if support.FILTERPY_2 else batch_by_definition(plain, zs, **arguments)
    assert len(ours) == 4
    for a, b in zip(ours, theirs, strict=True):
        support.assert_close(a, b)
    support.assert_same_state(robust, plain, (*support.STATE, "K", "S", "SI"))

    matrices = {name: arguments.get(name) for name in ("Fs", "Qs")}
    smoothed = robust.rts_smoother(*ours[:2], **matrices), plain.rts_smoother(*theirs[:2], **matrices)
    for a, b in zip(*smoothed, strict=True):
        support.assert_close(a, b, rtol=1e-9)


def test_batch_filter_of_an_array_and_of_scalars():
    robust, plain = pair(support.cart())
    zs = support.simulate(support.cart(), 30, seed=3)[0]
    for form in (zs, zs[:, 0], list(zs[:, 0]), zs[:, :, None]):
        for kf in (robust, plain):
            support.load(kf, support.cart())
        for a, b in zip(robust.batch_filter(form), plain.batch_filter(form), strict=True):
            support.assert_close(a, b)


def test_batch_filter_with_saver():
    robust, plain = pair(support.cart(), ndim=1)
    zs = support.simulate(support.cart(), 30, seed=3)[0]
    saver = Saver(robust)
    means, covariances, *_ = robust.batch_filter(zs, saver=saver)
    saver.to_array()
    support.assert_close(saver.x, means)
    support.assert_close(saver.P, covariances)
    support.assert_close(means, plain.batch_filter(zs)[0])


@pytest.mark.filterwarnings("ignore:Q. expected a matrix")
@pytest.mark.parametrize("Q", [0.25, 1, np.float32(0.25), np.float64(0.25), np.int64(1), np.array(0.25)], ids=repr)
def test_a_number_as_q_is_what_it_is_in_filterpy(Q):
    zs, found = [1.0, 2.0, None, 3.0], []
    for make in (KalmanFilter, lambda n, m: RobustKalmanFilter(n, m, influence=Linear())):
        steps, whole = make(2, 1), make(2, 1)
        for kf in (steps, whole):
            kf.F, kf.H, kf.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), Q
        support.through(steps, zs)
        found.append((steps.P, *whole.batch_filter(zs)))
    for theirs, ours in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
