"""What no plant, input or servo can be given is refused by the name of the argument, and what helps is said."""

import math

import control
import numpy as np
import pytest
from recordings import assert_refused

from robust_filterpy import Contaminated
from robust_filterpy.plants import simulate_arx, simulate_output_error
from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary
from robust_filterpy.plants.linear import random_walk, stable
from robust_filterpy.plants.servo import PneumaticParameters, pneumatic_servo, simulate_servo
from robust_filterpy.plants.servo.linearization import operating_point

NAN, INF = math.nan, math.inf
G = control.tf([1.0, 0.5], [1.0, -1.5, 0.7], dt=1)
ORDERS = {"system": [0.5, 1.0], "u": [1.0, 2.0], "na": 1, "nb": 1}
BAND = {"w_low": 0.5, "w_high": 2.5}
#: A call, arguments that it takes, and for each of them what it does not take.
REFUSED = [
    (bandlimited_pink_autocovariance, {**BAND, "n_lags": 3}, {
        "w_low": [0, -1, 2.5, NAN],
        "w_high": [0.5, 3.2, INF],
        "n_lags": [-1, 1.0],
    }),
    (receding_horizon_binary, {"autocovariance": [1.0, 0.1], "length": 5}, {
        "autocovariance": [[1.01, 0.1], [0.0, 0.0], [-1.0, 0.0], [1.0, 1.1], [1.0, 0.9, 0.1], [], [[1.0, 0.1]],
                           [1.0, NAN], ["r"], [1.0, 0.1j]],
        "length": [0, 5.0],
        "horizon": [0, 17, True],
        "levels": [(1, -1), (1, 1), (0, 1, 2), (0, INF)],
    }),
    *((simulate, {"system": G, "u": [1.0, 2.0]}, {
        "system": ["plant"],
        "u": [[], [[1.0], [2.0]], [1.0, NAN], ["a"]],
        "na": [2],
        "nk": [1],
        "noise": [[1.0], [1.0, INF], Contaminated],
    }) for simulate in (simulate_arx, simulate_output_error)),
    *((simulate, ORDERS, {"na": [-1, 2.0, None], "nb": [-1, None], "nk": [-1]})
      for simulate in (simulate_arx, simulate_output_error)),
    (random_walk, {"theta0": [1.0], "Q": 1.0, "n": 5}, {
        "theta0": [[], [NAN]],
        "n": [0, 5.0],
        "Q": [-1.0, INF, [1.0, 2.0]],
        "C": [np.eye(2)],
        "accept": [1],
    }),
    (stable, {"na": 1}, {"na": [-1, 1.0], "radius": [0.0, "a"]}),
    (PneumaticParameters, {}, {
        "bore": [0.0],
        "mass": [NAN, "1"],
        "rod": [-1e-3, 0.01905],
        "supply_pressure": [1e5],
        "kappa": [1.0],
        "static_friction": [0.1],
        "laminar_ratio": [0.5, 1.1],
        "dead_band": [1.0, -0.1],
        "leakage_area": [-1e-9],
    }),
    (pneumatic_servo, {}, {
        "alpha": [0.99, 1.4, "slow"],
        "beta": [0.07, NAN, 1.5, [0.3, 0.4]],
        "supply": [0.9e5],
        "outputs": [["position", "force"], "position", []],
    }),
    (simulate_servo, {"reference": np.zeros(5), "dt": 0.01}, {
        "reference": [[], [[0.0]], [0.0, NAN], [0.0, 0.2]],
        "dt": [0.0],
        "gain": [-1.0],
        "damping": [INF],
        "alpha": [1.5, [1.1, 1.2]],
        "beta": [lambda t: 0.3 - 10 * t],
        "supply": [0.5e5, [5e5, 5e5]],
        "noise": [np.zeros(5), np.full((5, 3), NAN)],
        "observer": [lambda z, u: (NAN, 0.0)],
        "load": [NAN, INF, 1e4],
    }),
    (operating_point, {}, {
        "velocity": [10.0, 1e-6, NAN],
        "position": [0.05],
        "load": [500.0],
        "alpha": [2.0],
        "beta": [0.0],
    }),
    (operating_point, {"velocity": -0.05}, {"load": [-500.0]}),
]  # fmt: skip


@pytest.mark.parametrize(("call", "good", "wrong"), REFUSED, ids=lambda value: getattr(value, "__name__", ""))
def test_what_cannot_be_is_refused_by_name(call, good, wrong):
    assert_refused(call, good, wrong)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: simulate_arx(G, [1.0], na=2), "with a transfer function"),
    (lambda: simulate_arx(G, [[1.0], [2.0]]), r"u.ravel\(\)"),
    (lambda: simulate_arx(control.tf([1.0], [1.0, 1.0]), [1.0]), "sample_system"),
    (lambda: simulate_arx(control.tf([1.0], [1.0, 1.0], dt=None), [1.0]), "discrete"),
    (lambda: simulate_arx(control.tf([1.0, 0.0, 0.0], [1.0, 1.0], dt=1), [1.0]), "degree 2 over 1"),
    (lambda: simulate_arx(control.tf([[[1.0], [1.0]]], [[[1.0, 0.5], [1.0, 0.5]]], dt=1), [1.0]), "one input"),
    (lambda: simulate_arx(control.ss(0.5, 1.0, 1.0, 0.0, dt=1), [1.0]), r"control.tf\(system\)"),
    (lambda: simulate_arx([0.1, 1.0], [1.0], na=2, nb=1), r"shape \(3,\) or \(N, 3\)"),
    (lambda: simulate_arx([], [1.0], na=0, nb=0), "at least one parameter"),
    (lambda: simulate_arx([NAN, 1.0], [1.0], na=1, nb=1), "theta: expected finite"),
    (lambda: simulate_arx(np.zeros((3, 2)), [1.0], na=1, nb=1), "a row for each of the 1 samples"),
    (lambda: simulate_arx([-9.0, 1.0], np.ones(2000), na=1, nb=1), "overflows at sample .*unstable"),
    (lambda: simulate_output_error(np.tile([-9.0, 1.0], (2000, 1)), np.ones(2000), na=1, nb=1), "overflows at sample"),
    (lambda: random_walk([1.0, 2.0], [[1.0, 0.0], [1.0, 1.0]], 5), "symmetric"),
    (lambda: random_walk([1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]], 5), "semidefinite"),
    (lambda: random_walk([1.0], 1.0, 5000, C=[[9.0]]), "overflows"),
    (lambda: random_walk([-2.0], 1.0, 5, accept=stable(1)), "theta0: expected a start that accept takes"),
    (lambda: random_walk([1.0], 1.0, 5, accept=stable(2)), "at least na=2"),
    (lambda: PneumaticParameters(supply_pressure=0.9e5), "pressures are absolute"),
    (lambda: pneumatic_servo({"mass": 1}), "expected PneumaticParameters, got dict"),
    (lambda: pneumatic_servo(beta=[0.3, 0.4]), "use lambda t: np"),
    (lambda: pneumatic_servo(alpha=lambda t: 1.0 + t).dynamics(0.5, np.array([0, 0, 3e5, 3e5]), np.zeros(2)),
     r"alpha\(0.5\): expected finite values in"),
])  # fmt: skip
def test_what_helps_is_said(call, words):
    with pytest.raises((ValueError, TypeError), match=words):
        call()
