"""`update(z, sensor=..)`: sensors that take turns each have a noise of their own, in every filter."""

import copy
import json

import numpy as np
import pytest
from support import cart, load, of_every_kind, of_matrices, predict_and_update

from robust_filterpy import AdaptiveKalmanFilter, _state
from robust_filterpy.correction.spread import SPREAD
from robust_filterpy.filters.sigma_point import RobustUnscentedKalmanFilter

SIGMAS = {"gps": 5.0, "wheel": 0.1}
F, H, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.array([[0.25, 0.5], [0.5, 1.0]])


FILTERS = of_every_kind(F, H, Q, P=10.0)


@pytest.fixture(params=["linear", "adaptive", *(name for name in FILTERS if name.startswith("adaptive ")), "ensemble"])
def kf(request):
    return FILTERS[request.param]()


def drawn(seed, steps=400):
    g = np.random.default_rng(seed)
    x, found = np.zeros(2), []
    for k in range(steps):
        x = F @ x + 0.1 * np.array([0.5, 1.0]) * g.normal()
        name = list(SIGMAS)[k % 2]
        found.append((x.copy(), name, x[0] + SIGMAS[name] * g.normal()))
    return found


def run(kf, readings, named=True):
    path = []
    for _, name, z in readings:
        kf.predict()
        kf.update(z, **({"sensor": name} if named else {}))
        path.append(np.ravel(kf.x).copy())
    return np.array(path)


def test_each_has_a_noise_of_its_own(kf):
    run(kf, drawn(0))
    if kf.noise is None:
        assert kf.sensors_learnt is None
        memory = kf._named_sensors
        assert memory["gps"][0, SPREAD] > 2.0 * memory["wheel"][0, SPREAD] and np.isnan(kf.spread).all()
        return
    known = kf.sensors_learnt
    assert list(known) == list(SIGMAS)
    assert 12.0 < known["gps"].r[0] < 50.0 and 0.001 < known["wheel"].r[0] < 0.1
    # Nothing was read by a sensor without a name.
    np.testing.assert_array_equal(kf.R_learnt, np.eye(1))


def test_a_call_that_is_refused_has_not_happened(kf):
    run(kf, drawn(1, 20))
    before = kf.state()
    for z, sensor, error in ((1.0, [1], TypeError), (1.0, True, TypeError), (1.0, 1.5, TypeError)):
        with pytest.raises(error, match="sensor: expected a name or a number"):
            kf.update(z, sensor=sensor)
    with pytest.raises(ValueError, match="z: expected a finite number"):
        kf.update(np.inf, sensor="gps")
    for names in ("none", "[1]", "{}", json.dumps({"gps": 7}), json.dumps({"gps": 0, "wheel": 2})):
        with pytest.raises(_state.StateError, match="names of 2 sensors"):
            kf.restore({**before, "named": _state.spelt(names)})
    np.testing.assert_equal(kf.state(), before)


def test_a_state_has_what_is_known_of_them_and_a_copy_too(kf):
    readings = drawn(2, 60)
    run(kf, readings[:40])
    twin, other = copy.deepcopy(kf), copy.deepcopy(kf)
    other._named_sensors = {}
    other.restore(kf.state())
    expected = run(kf, readings[40:])
    np.testing.assert_array_equal(run(twin, readings[40:]), expected)
    np.testing.assert_allclose(run(other, readings[40:]), expected, rtol=1e-12)


def test_vectors_of_other_heights_by_their_names():
    kf = load(AdaptiveKalmanFilter(2, 1), cart())
    g = np.random.default_rng(0)
    for _ in range(300):
        predict_and_update(kf, 4.0 * g.normal(), sensor="one")
        kf.update(g.normal(size=2) * [1.0, 0.1], R=np.eye(2), H=np.eye(2), sensor="both")
    known = kf.sensors_learnt
    assert known["one"].r.shape == (1,) and known["both"].r.shape == (2,)
    assert known["one"].r[0] > 5.0 > 2.0 > known["both"].r[0] > 0.3 > known["both"].r[1]


def test_an_hx_with_an_argument_of_that_name_has_it_too():
    handed = []

    def measured(x, sensor=None):
        handed.append(sensor)
        return x[:1]

    kf = of_matrices(RobustUnscentedKalmanFilter, F, H, noise="learnt")
    kf.hx = measured
    predict_and_update(kf, 1.0, sensor="gps")
    assert set(handed) == {"gps"} and list(kf.sensors_learnt) == ["gps"]
    # What is no name is hx's alone, as in filterpy.
    kf.update(1.0, sensor=(3.0, 4.0))
    assert handed[-1] == (3.0, 4.0) and list(kf.sensors_learnt) == ["gps"]
