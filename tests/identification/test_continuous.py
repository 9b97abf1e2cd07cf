"""Continuous time: from a model in discrete time, and parameters of physics from samples at any times."""

import control
import numpy as np
import pytest
from recordings import binary, recording, unheard
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from robust_filterpy import OutputError, identify
from robust_filterpy.identification import GreyBox, StateSpace


def tank(x, u, p):
    """Outflow by Torricelli's law."""
    return [p[0] * u[0] - p[1] * np.sqrt(np.maximum(x[0], 1e-9))]


def recorded(seed, outliers=0.1, samples=150):
    """A tank with samples at irregular times, one reading in ten ten times as bad."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.2, 2.0, samples))
    u = np.repeat(rng.uniform(0.5, 2.0, samples // 10), 10)
    x, y = 1.0, np.empty(samples)
    for k in range(samples):
        y[k] = x
        fine = (t[k + 1] - t[k] if k < samples - 1 else 0.0) / 50
        for _ in range(50):
            x += fine * (0.4 * u[k] - 0.3 * np.sqrt(max(x, 0.0)))
    wrong = rng.random(samples) < outliers
    return y + 0.05 * np.where(wrong, 10.0, 1.0) * rng.normal(size=samples), u, t


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 4), marks=pytest.mark.nightly)], ids=["one", "more"])
def test_physical_parameters_from_irregular_samples_through_outliers(seeds):
    inside = []
    for seed in seeds:
        y, u, t = recorded(seed)
        model = identify(y, u, GreyBox(tank, {"inflow": 1.0, "outflow": 1.0}, x0=[0.5]), t=t)
        assert np.abs(model.theta - [0.4, 0.3]).max() < 0.02
        inside.append(np.abs(model.theta - [0.4, 0.3]) < 4.0 * model.std)
    assert np.mean(inside) > 0.9
    assert not model.unidentifiable
    assert model.p["inflow"] == model.theta[0] and "inflow" in str(model.summary())


def scalar(x, u, p):
    """As `tank`, of numbers alone."""
    return [float(p[0]) * float(u[0]) - float(p[1]) * float(x[0]) ** 0.5 if x[0] > 0 else 0.0]


def halved(x, u, p):
    """As `tank` of half the first parameter, which it writes into."""
    p[0] *= 0.5
    return tank(x, u, p)


@pytest.mark.parametrize(("f", "factor"), [(scalar, 1.0), (halved, 2.0)])
def test_a_function_may_take_no_columns_and_write_into_its_parameters(f, factor):
    y, u, t = recorded(5, samples=60)
    guesses = {tank: 0.5, f: 0.5 * factor}
    one, other = (identify(y, u, GreyBox(g, {"in": a, "out": 0.4}, [0.8]), t=t).theta for g, a in guesses.items())
    assert np.allclose(one, other / [factor, 1.0], rtol=1e-4)


def test_of_a_recording_without_noise_nothing_but_rounding_is_left():
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 30), 2)
    # A whole number of steps: what is integrated then is the input's sum.
    y = np.concatenate(([0.0], np.cumsum(0.5 * u[:-1])))
    with unheard():
        model = identify(y, u, GreyBox(lambda x, u, p: [p[0] * u[0]], [1.0], x0=[0.0]), t=np.arange(60.0))
    assert model.theta == pytest.approx([0.5], abs=1e-9)
    assert model.noise[0].R < 1e-20


def test_without_noise_standard_deviations_are_no_smaller_than_the_integration_is_wrong():
    def pendulum(x, u, p):
        return np.array([x[1], -p[0] * np.sin(x[0]) - p[1] * x[1] + p[2] * u[0]])

    truth, x, y = np.array([4.0, 0.5, 2.0]), np.zeros(2), []
    u = np.random.default_rng(1).choice([0.0, 1.0], 100)
    for k in range(100):
        y.append(x[:1])
        after = solve_ivp(lambda t, x, k=k: pendulum(x, u[k : k + 1], truth), (0.0, 0.2), x, rtol=1e-11, atol=1e-11)
        x = after.y[:, -1]
    box = GreyBox(pendulum, 1.1 * truth, x0=[0.0, 0.0], h=lambda x, u, p: [x[0]])
    model = identify(np.array(y), u, box, t=0.2 * np.arange(100))
    # By what is left of 1e-8 alone the first is 135 standard deviations off.
    assert (np.abs(model.theta - truth) < 2.0 * model.std).all()
    assert (model.std < 1e-4).all()


def test_parameters_that_the_recording_cannot_tell_apart_are_named():
    a = np.exp(-0.5)
    y, u = recording(6, 80, share=0.0, sigma=0.02, a=[1.0, -a], b=[0.0, (1.0 - a) / 0.5])
    guess = {"area": 2.0, "speed": 0.3, "rate": 0.3}

    def identified(**options):
        return identify(y, u, GreyBox(lambda x, u, p: [p[0] * p[1] * u[0] - p[2] * x[0]], guess, x0=[0.0], **options),
                        t=np.arange(80.0))  # fmt: skip

    with pytest.warns(UserWarning, match="cannot tell area and speed apart"):
        model = identified()
    assert model.unidentifiable == (("area", "speed"),)
    assert np.isinf(model.std[:2]).all() and model.std[2] < 0.05
    fixed = identified(fixed=["area"])
    assert not fixed.unidentifiable
    assert fixed.p["area"] == 2.0
    assert fixed.p["speed"] == pytest.approx(0.5, rel=0.05)


def test_bounds_are_kept_and_said():
    y, u, t = recorded(7)
    box = GreyBox(
        tank, {"inflow": 0.45, "outflow": 0.4}, x0=[1.0], bounds={"outflow": (0.35, 1.0), "inflow": (0, None)}
    )
    with pytest.warns(UserWarning, match="outflow is at its bound"):
        model = identify(y, u, box, t=t)
    assert 0.35 <= model.p["outflow"] < 0.352


Y, U, T = recorded(9)
TANK = GreyBox(tank, {"inflow": 1.0, "outflow": 1.0}, x0=[1.0])


@pytest.mark.parametrize(("call", "says"), [
    (lambda: identify(Y, U, TANK), "expected the times"),
    (lambda: identify(Y, U, TANK, t=T[::-1]), "times that increase"),
    (lambda: identify(np.full(150, np.nan), U, TANK, t=T), "output 0 in recording 0"),
    (lambda: identify(np.column_stack((Y, Y)), U, TANK, t=T), "h: expected one number for each output, 2"),
    (lambda: identify(Y[:3], U[:3], TANK, t=T[:3]), "at least 6 measured"),
    (lambda: GreyBox(tank, {"a": 1.0}, [0.0], bounds={"a": (2.0, 3.0)}), "between 2 and 3"),
    (lambda: GreyBox(tank, {"a": 1.0}, [0.0], bounds={"a": 0.5}), r"bounds.'a'.: expected .low, high., got 0.5"),
    (lambda: GreyBox(tank, {"a": 1.0}, [0.0], fixed=["b"]), "a parameter 'b'"),
    (lambda: GreyBox("f", {"a": 1.0}, [0.0]), "a function"),
    (lambda: identify(np.zeros(9), None, GreyBox(lambda x, u, p: [p[0] * x[0] ** 3], {"a": 9.0}, [9.0]), t=range(9)),
     "unstable there"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_and_a_box_before_there_are_data(call, says):
    with pytest.raises((ValueError, TypeError), match=says):
        call()


@pytest.mark.parametrize("structure", [OutputError(2, 2), StateSpace(2)], ids=["polynomials", "states"])
def test_poles_in_continuous_time_are_those_of_the_plant(structure):
    system = control.ss(control.tf([2.0], [1.0, 1.2, 4.0]))
    rng, u = binary(1, 600)
    y = control.forced_response(control.sample_system(system, 0.1), inputs=u).outputs + 0.002 * rng.normal(size=600)
    found = identify(y, u, structure).poles(dt=0.1)
    assert np.allclose(np.sort_complex(found.values), np.sort_complex(system.poles()), atol=0.1)
    assert found.contains(np.sort_complex(system.poles())[np.argsort(np.argsort(found.values.imag))]).all()


def test_a_pole_that_no_continuous_time_has_is_refused():
    y, u = recording(2, 200, share=0.0, sigma=1e-6, a=[1.0, 0.8], b=[0.0, 1.0])
    with pytest.raises(ValueError, match="negative real axis"):
        identify(y, u, OutputError(1, 1)).poles(dt=1.0)


def test_a_prediction_of_what_is_missing_has_the_level_too():
    rng, a = np.random.default_rng(522), np.exp(-0.25)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 8)
    truth = lfilter([0.0, 3.0 * (1.0 - a)], [1.0, -a], u) + 4.0 * (np.arange(240) < 100)
    y = truth + 0.1 * rng.normal(size=240)
    y[50:55] = np.nan
    box = GreyBox(lambda x, u, p: [(p[0] * u[0] - x[0]) / p[1]], {"gain": 2.0, "time": 1.0}, x0=[0.0])
    with pytest.warns(UserWarning, match="the level of y steps by"):
        model = identify(y, u, box, t=0.5 * np.arange(240))
    assert [one.kind for one in model.findings] == ["step"] and np.abs(model.theta - [3.0, 2.0]).max() < 0.05
    assert np.abs(model.predict(y, u, t=0.5 * np.arange(240))[:, 0] - truth).max() < 0.3
