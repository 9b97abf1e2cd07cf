"""Scenarios: what a recording says of itself is true of it."""

import control
import numpy as np
import pytest
import scipy.stats
from filterpy.kalman import KalmanFilter

from robust_filterpy.fusion import constant_velocity
from robust_filterpy.identification import ARX
from robust_filterpy.testing import assert_consistent, draw, run_filter
from robust_filterpy.testing.contamination import CONTAMINATIONS
from robust_filterpy.testing.models import MODELS, StateModel, random_stable
from robust_filterpy.testing.plants import PLANTS
from robust_filterpy.testing.runs import Run, load

KINDS = ["none", *CONTAMINATIONS, ("mixture", "missing"), {"bursts": {"length": 8}, "stuck": {}}]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("name", [*MODELS, *PLANTS])
def test_every_model_and_every_plant_can_be_spoilt_in_every_way(name, kind):
    scenario, steps = draw(name, 80, contamination=kind, rng=5), (80,)
    if name in PLANTS:
        readings, estimates = scenario.y, (scenario.reference.x, steps + (scenario.structure.n_theta,))
        assert scenario.u.shape == scenario.y_clean.shape == steps
    else:
        (n, m, _), readings = scenario.model.dims, scenario.z
        steps, estimates = (80, m), (scenario.reference.x, (80, n))
        assert scenario.x.shape == (80, n) and scenario.noise_ratio.shape == steps
        assert not (scenario.is_outlier & scenario.is_missing).any() and np.isfinite(scenario.reference.P).all()
    assert readings.shape == scenario.is_outlier.shape == steps
    np.testing.assert_array_equal(np.isnan(readings), scenario.is_missing)
    assert estimates[0].shape == estimates[1] and np.isfinite(estimates[0]).all()


def test_the_same_seed_gives_the_same_scenario():
    for name in (*MODELS, *PLANTS):
        one, two, other = (draw(name, 40, contamination="mixture", rng=seed) for seed in (3, 3, 4))
        values = [getattr(s, "z" if name in MODELS else "y") for s in (one, two, other)]
        np.testing.assert_array_equal(values[0], values[1])
        assert (values[0] != values[2]).any()


def test_noises_have_the_covariances_of_the_model():
    model = random_stable(3, 2, 1, rng=1)
    scenario = draw(model, 4000, rng=2)
    v = scenario.z - scenario.x @ model.H.T
    w = scenario.x[1:] - scenario.x[:-1] @ model.F.T - scenario.u[1:] @ model.B.T
    for noise, covariance in ((v, model.R), (w, model.Q)):
        squared = np.einsum("ki,ij,kj->", noise, np.linalg.inv(covariance), noise)
        low, high = scipy.stats.chi2.interval(1 - 1e-6, noise.size)
        assert low < squared < high


@pytest.mark.parametrize(("kind", "probability"), [("mixture", 0.2), ("bursts", 0.18)])
def test_labels_tell_which_samples_have_the_larger_noise(kind, probability):
    scenario = draw("constant velocity", 4000, contamination={kind: {"probability": 0.2}}, rng=3)
    v, far = scenario.z - scenario.x @ scenario.model.H.T, scenario.is_outlier
    assert abs(far.mean() - probability) < 0.03 and abs(v[~far].std() - 1.0) < 0.05 and abs(v[far].std() - 10.0) < 1.0
    np.testing.assert_array_equal(scenario.noise_ratio, np.where(scenario.is_outlier, 10.0, 1.0))


def test_bursts_stuck_sensors_and_gaps_come_in_runs():
    for kind, length in (("bursts", 6), ("stuck", 10), ("missing", 7)):
        options = {} if kind == "stuck" else {"probability": 0.05, "length": length}
        scenario = draw("level", 2000, contamination={kind: options}, rng=3)
        marks = (scenario.is_missing if kind == "missing" else scenario.is_outlier)[:, 0].astype(int)
        edges = np.flatnonzero(np.diff(np.r_[0, marks, 0]))
        runs = edges[1::2] - edges[::2]
        assert len(runs) > 3 and np.median(runs) == length
    z = draw("level", 500, contamination="stuck", rng=3)
    same = np.r_[False, np.diff(z.z[:, 0]) == 0]
    np.testing.assert_array_equal(same, z.is_outlier[:, 0])
    assert (draw("level", 500, contamination="sentinels", rng=3).z == 9999).any()
    one = draw("level", 500, contamination="one-sided", rng=3)
    assert (one.z - one.x)[one.is_outlier].min() > -4
    np.testing.assert_array_equal(one.noise_ratio, np.where(one.is_outlier, np.hypot(1.0, 10.0), 1.0))


def test_jumps_are_put_where_they_are_asked_for_and_the_reference_knows_them():
    still = draw("level", 100, rng=1, jump_probability=0.0)
    jumped = draw("level", 100, rng=1, jump_probability=0.0, jumps={40: [25.0]})
    np.testing.assert_allclose(jumped.x - still.x, np.where(np.arange(100) < 40, 0.0, 25.0)[:, None])
    assert jumped.is_jump.nonzero()[0].tolist() == [40]
    assert np.abs(jumped.reference.error[41:]).max() < 5.0
    assert np.abs(run_filter(jumped.load(KalmanFilter(1, 1)), jumped).error[41]) > 15.0


@pytest.mark.parametrize("name", [name for name in MODELS if name != "range and bearing"])
def test_the_label_knowing_filter_is_consistent_under_outliers_and_jumps(name):
    """It has the exact covariances, however the mixture fell: NIS and NEES are chi-square."""
    runs = [draw(name, 40, contamination=("mixture", "missing"), rng=seed).reference for seed in range(30)]
    assert_consistent(runs)


def test_without_labels_the_reference_is_filterpys_filter():
    scenario = draw("constant velocity", 60, rng=1)
    run = run_filter(scenario.load(KalmanFilter(4, 2)), scenario)
    for name in ("x", "P", "y", "S"):
        np.testing.assert_allclose(getattr(run, name), getattr(scenario.reference, name), rtol=1e-9, atol=1e-12)


# Plants


@pytest.mark.parametrize("name", ["arx", "output error", "fir"])
def test_a_plant_without_noise_is_linear_in_its_parameters(name):
    """y(k) = phi(k)' theta(k), equation 14, also while theta drifts and jumps."""
    n_theta = draw(name, 1).structure.n_theta
    scenario = draw(name, 200, rng=2, drift=1e-5, jumps={90: 0.05 * np.ones(n_theta)})
    phi = scenario.structure.regressors(scenario.u, scenario.y_clean)
    np.testing.assert_allclose(np.sum(phi * scenario.theta, axis=1), scenario.y_clean, atol=1e-9)
    assert np.ptp(scenario.theta, axis=0).min() > 0 and scenario.is_jump.any()


def test_noise_in_the_loop_stays_in_the_equation():
    """A(q) y - B(q) u is the noise, outliers included: an outlier of an ARX plant goes round the loop."""
    scenario = draw("arx", 3000, contamination="mixture", rng=2)
    v = scenario.y - scenario.structure.regressors(scenario.u, scenario.y) @ scenario.theta[0]
    assert abs(v[~scenario.is_outlier].std() - 0.5) < 0.03 and abs(v[scenario.is_outlier].std() - 5.0) < 0.8


def test_a_transfer_function_of_python_control_becomes_a_plant():
    system = control.tf([2.0], [1.0, -0.5, 0.0], True)
    assert PLANTS["arx"](system).structure == ARX(2, 1, 2)
    np.testing.assert_array_equal(PLANTS["output error"](system, sigma=0.1).theta, [-0.5, 0.0, 2.0])
    scenario = draw(PLANTS["output error"](system, sigma=0.1), 50, rng=1)
    answer = control.forced_response(system, None, scenario.u).outputs
    np.testing.assert_allclose(scenario.y_clean, answer, atol=1e-12)


def test_drifting_plants_stay_stable_and_c_stands_still():
    scenario = draw("armax", 500, rng=1, drift=1e-4)
    poles = [np.abs(np.roots([1.0, *theta[:2]])).max() for theta in scenario.theta]
    assert max(poles) < 1.0
    assert np.ptp(scenario.theta[:, -1]) == 0.0 and scenario.Q[-1, -1] == 0.0


def test_the_label_knowing_tracker_is_least_squares_where_nothing_is_to_be_known():
    scenario = draw("fir", 80, rng=1)
    phi = scenario.structure.regressors(scenario.u)
    information = phi.T @ phi / scenario.R + np.eye(4)
    expected = np.linalg.solve(information, phi.T @ scenario.y / scenario.R + scenario.theta[0])
    np.testing.assert_allclose(scenario.reference.x[-1], expected, rtol=1e-9)


def test_moving_points_and_what_is_seen_of_them_are_their_equations():
    point = MODELS["constant velocity"](0.7)
    F, Q, _ = constant_velocity(2, 0.02).matrices(0.7)
    np.testing.assert_allclose(point.F, F, rtol=1e-12)
    np.testing.assert_allclose(point.Q, Q, rtol=1e-12)
    np.testing.assert_array_equal(point.measured(np.array([1.0, 2.0, 3.0, 4.0])), [1.0, 3.0])
    target, x = MODELS["range and bearing"](), np.array([3.0, 1.0, 4.0, -2.0])
    np.testing.assert_allclose(target.measured(x), [5.0, np.arctan2(4.0, 3.0)], rtol=1e-12)
    steps = 1e-6 * np.eye(4)
    slope = [(target.measured(x + step) - target.measured(x - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(target.jacobian(x), np.transpose(slope), atol=1e-8)


# Bad input


@pytest.mark.parametrize(("call", "error", "words"), [
    (lambda: draw("velocity"), ValueError, "problem: expected one of 'constant velocity'"),
    (lambda: draw(3), TypeError, "problem: expected a name, a StateModel or a Plant"),
    (lambda: draw("level", 0), ValueError, "steps"),
    (lambda: draw("level", contamination="outliers"), ValueError, "contamination: expected one of 'none'"),
    (lambda: draw("level", contamination=[3]), TypeError, "contamination: expected one of"),
    (lambda: draw("level", 10, jumps={10: [1.0]}), ValueError, "jumps: expected steps below 10"),
    (lambda: draw("level", 10, jumps={1: [1.0, 2.0]}), ValueError, r"jumps: expected shape \(1, 1\)"),
    (lambda: draw("level", dt=0.1), TypeError, "dt"),
    (lambda: draw(random_stable(2, 1, rng=0), dt=1), TypeError, "dt: expected only with the name of a problem"),
    (lambda: draw("level", jump_probability=2.0), ValueError, "jump_probability"),
    (lambda: random_stable(0, 1), ValueError, "dim_x"),
    (lambda: StateModel(np.zeros(2), *[np.eye(2)] * 2, np.eye(3), *[np.eye(2)] * 2), ValueError, "H: expected"),
    (lambda: StateModel(np.zeros(2), *[np.eye(2)] * 4, 1.0), ValueError, "R: expected a square matrix"),
    (lambda: random_stable(2, 1, rng=0).with_(B=np.ones(2)), ValueError, "B: expected"),
    (lambda: random_stable(2, 1, rng=0).with_(sensor=np.sin), ValueError, "sensor, sensor_jacobian"),
    (lambda: load(KalmanFilter(3, 1), MODELS["level"]()), ValueError, "expected dim_x=1, dim_z=1.* got dim_x=3"),
    (lambda: load(object(), MODELS["level"]()), TypeError, "kf: expected a filter"),
    (lambda: run_filter(KalmanFilter(3, 1), draw("level", 5, rng=0)), ValueError, "with 1 states"),
    (lambda: draw("level", 5, contamination={"bursts": {"size": 3}}), ValueError, "'length'.*got 'size'"),
    (lambda: draw("level", 5, contamination={"stuck": {"scale_ratio": 3}}), ValueError, "contamination 'stuck'"),
    (lambda: Run(np.zeros((3, 1)), np.ones((4, 1, 1))), ValueError, "S: expected shape"),
    (lambda: Run(np.zeros((3, 1)), np.ones((3, 1, 1)), np.zeros((3, 2)), truth=np.zeros((4, 2))), ValueError,
     r"truth: expected shape \(3, 2\)"),
])  # fmt: skip
def test_bad_input_is_named(call, error, words):
    with pytest.raises(error, match=words):
        call()
