"""Several recordings of one plant are one model; a simulation begins where it should."""

import numpy as np
import pandas as pd
import pytest
from recordings import THETA, A, B, binary
from scipy.signal import lfilter

from robust_filterpy import ARX, OutputError, identify
from robust_filterpy.identification import AR, ARMAX, BoxJenkins, StateSpace


def plant(sizes, seed, inside=False, outliers=0.1, noise=0.3):
    """Recordings at levels that differ much, each cut out of a longer motion."""
    rng, ys, us = np.random.default_rng(seed), [], []
    for n in sizes:
        u = binary(rng, n + 60)[1]
        v = noise * rng.normal(size=n + 60)
        y = lfilter(B, A, u) + (lfilter([1.0], A, v) if inside else v)
        y += np.where(rng.random(n + 60) < outliers, 3.0, 0.0) * rng.normal(size=n + 60) + 20.0 * rng.normal()
        ys.append(y[60:])
        us.append(u[60:])
    return ys, us


@pytest.mark.parametrize(("structure", "inside", "near"), [
    (OutputError(2, 2), False, 0.05),
    (ARX(2, 2), True, 0.1),
    pytest.param(ARMAX(2, 2, 1), True, 0.12, marks=pytest.mark.nightly),
], ids=str)  # fmt: skip
def test_several_recordings_tell_as_much_as_one(structure, inside, near):
    model = identify(*plant([250, 150, 200], 1, inside), structure)
    assert np.abs(model.theta[:4] - THETA).max() < near
    assert (np.abs(model.theta[:4] - THETA) < 5.0 * model.std[:4]).all()
    assert "Recordings" in model.summary().facts
    # Each is known again with its level and start.
    ys, us = plant([250, 150, 200], 2, inside, outliers=0.0)
    model = identify(ys, us, structure)
    assert all(model.fit(y, u) > 75.0 for y, u in zip(ys, us, strict=True))
    assert np.abs(model.levels - [np.mean(y) for y in ys]).max() < 1.5 and model.level == model.levels[-1]
    assert np.array_equal(identify(ys[:1], us[:1], structure).theta, identify(ys[0], us[0], structure).theta)


def test_the_parts_of_a_table_are_a_list_of_recordings():
    ys, us = plant([200, 150], 4)
    table = pd.DataFrame({"y": np.concatenate(ys), "u": np.concatenate(us), "batch": ["a"] * 200 + ["b"] * 150})
    parts = [part for _, part in table.groupby("batch")]
    grouped = identify([part["y"] for part in parts], [part["u"] for part in parts], OutputError(2, 2))
    assert np.allclose(grouped.theta, identify(ys, us, OutputError(2, 2)).theta, rtol=1e-9)


def test_a_step_in_one_recording_is_taken_off_there():
    ys, us = plant([400, 400], 5, outliers=0.0)
    ys[1][250:] += 4.0
    with pytest.warns(UserWarning, match="recording 1: the level of y steps"):
        model = identify(ys, us, OutputError(2, 2))
    assert np.abs(model.theta - THETA).max() < 0.05 and model.fit(ys[1], us[1]) > 85.0
    assert [one.place for one in model.findings] == [(250, 400)]


def test_without_input_and_with_a_disturbance():
    rng = np.random.default_rng(6)
    alone = [lfilter([1.0], [1.0, -0.8], rng.normal(size=300)) + 10.0 * i for i in range(3)]
    assert abs(identify(alone, None, AR(1)).theta[0] + 0.8) < 0.1
    ys, us = plant([300, 300], 7, outliers=0.05)
    wandering = [y + 0.5 * lfilter([1.0], [1.0, -0.9], rng.normal(size=y.size)) for y in ys]
    boxed = identify(wandering, us, BoxJenkins(2, 0, 1, 2))
    assert np.abs(boxed.theta[:2] - THETA[2:]).max() < 0.25


def test_a_long_gap_in_u_or_of_the_time_axis_makes_two_recordings_and_a_short_one_is_held():
    (y,), (u,) = plant([600], 8, outliers=0.0)
    gap = u.copy()
    gap[300:350] = np.nan
    with pytest.warns(UserWarning, match="2 recordings"):
        model = identify(y, gap, OutputError(2, 2))
    assert model.levels.size == 2 and np.abs(model.theta - THETA).max() < 0.05
    short = u.copy()
    short[100] = np.nan
    with pytest.warns(UserWarning, match="u is missing in 1 samples"):
        assert identify(y, short, OutputError(2, 2)).levels.size == 0
    # As does a long jump of the time axis.
    index = pd.date_range("2024-01-01", periods=600, freq="2s")
    kept = np.r_[0:280, 330:600]
    with pytest.warns(UserWarning, match="1 jumps of the time axis: 2 recordings"):
        model = identify(pd.Series(y, index).iloc[kept], pd.Series(u, index).iloc[kept], OutputError(2, 2))
    assert (model.levels.size, model.dt) == (2, 2.0) and np.abs(model.theta - THETA).max() < 0.05


@pytest.mark.parametrize(("change", "says"), [
    (lambda ys, us: (ys, us[0]), "list of 2 recordings like y, got ndarray"),
    (lambda ys, us: ([ys[0], ys[1][:3]], [us[0], us[1][:3]]), "in recording 1"),
    (lambda ys, us: ([ys[0], np.full(150, np.nan)], us), "got 0 in recording 1"),
    (lambda ys, us: (ys, [us[0], us[1][:-1]]), "150 samples like y, got 149"),
])  # fmt: skip
def test_recordings_that_do_not_fit_are_refused_by_number(change, says):
    y, u = change(*plant([200, 150], 10))
    with pytest.raises(ValueError, match=says):
        identify(y, u, OutputError(2, 2))


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("structure", [
    OutputError(2, 2), ARX(2, 2), BoxJenkins(2, 0, 1, 2), StateSpace(2),
    pytest.param(StateSpace(2, disturbance=True), marks=pytest.mark.nightly),
], ids=str)  # fmt: skip
@pytest.mark.parametrize("about", [0.0, 500.0])
def test_a_simulation_goes_on_where_a_recording_ended(structure, about):
    (y,), (u,) = plant([400], 12, inside=structure == ARX(2, 2), outliers=0.0, noise=1e-3)
    u = u + about
    model = identify(y[:300], u[:300], structure)
    for start in ("continued", (y[:300], u[:300]), (y[250:300], u[250:300])):
        assert np.abs(np.ravel(model.simulate(u[300:], start=start)) - y[300:]).max() < 0.05
    assert np.abs(np.ravel(model.simulate(u[300:])) - y[300:])[:3].max() > 0.05
    # Outliers and gaps at the end do not spoil it.
    before = y[:300].copy()
    before[298], before[297] = 1e6, np.nan
    assert np.abs(np.ravel(model.simulate(u[300:], start=(before, u[:300]))) - y[300:]).max() < 0.05


def test_a_missing_input_keeps_its_value_and_that_is_said():
    (y,), (u,) = plant([300], 14)
    model = identify(y, u, OutputError(2, 2))
    gap, held = u.copy(), u.copy()
    gap[50:53], held[50:53] = np.nan, u[49]
    with pytest.warns(UserWarning, match="missing in 3 of 300"):
        assert np.array_equal(model.simulate(gap), model.simulate(held))
    with pytest.raises(ValueError, match="'rest', 'continued'"):
        model.simulate(u, start="here")
