"""A state is plain arrays, survives bytes, and is continued to the last bit by every filter and tracker."""

import copy
import io
from functools import partial

import numpy as np
import pytest
from recordings import same, unchanged
from support import noise_given, of_every_kind, of_matrices, predict_and_update, two_sided

from robust_filterpy import (
    ARX,
    AdaptiveKalmanFilter,
    Contaminated,
    OutputError,
    ParameterTracker,
    RobustKalmanFilter,
    TukeyBiweight,
)
from robust_filterpy.fleet import pack, unpack
from robust_filterpy.identification import ARMA, ARMAX, FIR, BoxJenkins, TrackerBank
from robust_filterpy.smoothing import FixedLagSmoother

F, H = np.array([[1.0, 0.1], [-0.1, 0.97]]), np.array([[1.0, 0.0]])


def linear(cls, **options):
    return partial(of_matrices, cls, F, H, 0.01, x=np.zeros(2), **options)


FILTERS = {
    **of_every_kind(F, H, 0.01, patience=3, x=np.zeros(2)),
    "column": lambda: RobustKalmanFilter(2, 1),
    "noise-matched": linear(noise_given, process=Contaminated(0.1, 10.0)),
    "adaptive, joint": linear(AdaptiveKalmanFilter, grouping="joint"),
    "psi, joint": linear(RobustKalmanFilter, influence=TukeyBiweight(), grouping="joint", scaling="bounded"),
    "fixed lag": linear(FixedLagSmoother, N=4),
    "fixed lag, adaptive": linear(FixedLagSmoother, N=4, noise="learnt", process="scales"),
}


def advance(kf, z):
    """Take one measurement, and return everything that is estimated then."""
    if isinstance(kf, FixedLagSmoother):
        kf.smooth(z)
        return [kf.x, kf.P, kf.weights, *kf.xSmooth[-5:]]
    predict_and_update(kf, z)
    shown = [np.asarray(getattr(kf, name)) for name in ("x", "P", "y", "S", "weights", "log_likelihood")]
    return [*shown, *(np.asarray(getattr(kf, name, 0.0)) for name in ("outlier_probability", "process_scale"))]


def recording(seed=0):
    z = np.random.default_rng(seed).normal(size=40)
    z[[7, 23, 30]], z[31:36] = 50.0, 20.0
    return [None if k in (5, 26) else value for k, value in enumerate(z.tolist())]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("cut", [1, 25, 33])
def test_a_filter_goes_on_to_the_last_bit(name, cut):
    kf, other, zs = FILTERS[name](), FILTERS[name](), recording()
    for z in zs[:cut]:
        advance(kf, z)
    state = kf.state()
    assert all(type(value) is np.ndarray and value.dtype == np.float64 for value in state.values())
    before = copy.deepcopy(state)
    other.restore(unpack(pack(state)))
    for z in zs[cut:]:
        same(advance(kf, z), advance(other, z))
    # What was given away has not moved with the filter.
    same(before, state)
    same(kf.state(), other.state())


@pytest.mark.parametrize("name, steady", [
    *((name, "") for name in ("linear", "two-sided", "noise-matched", "unscented", "cubature", "adaptive cubature")),
    ("linear", "_steadystate"),
])  # fmt: skip
def test_between_prediction_and_correction_too(name, steady):
    kf, other = FILTERS[name](), FILTERS[name]()
    for z in recording()[:8]:
        advance(kf, z)
    getattr(kf, f"predict{steady}")()
    other.restore(kf.state())
    for one in (kf, other):
        getattr(one, f"update{steady}")(30.0)
    np.testing.assert_array_equal(kf.x, other.x)
    np.testing.assert_array_equal(kf.P, other.P)


def signals(n=120):
    rng = np.random.default_rng(5)
    u, y = rng.choice([-1.0, 1.0], n), np.zeros(n)
    for k in range(2, n):
        y[k] = 1.2 * y[k - 1] - 0.5 * y[k - 2] + u[k - 1] + 0.2 * rng.normal()
    y[::17], y[9] = 30.0, np.nan
    return y, u


def tracker(structure, **options):
    return lambda: ParameterTracker(structure, **options)


TRACKERS = {
    "ARX": tracker(ARX(2, 1), start=0), "output error": tracker(OutputError(2, 1), start=0, R=0.04),
    "ARMAX": tracker(ARMAX(2, 1, 1), start=0, forgetting=0.99), "FIR": tracker(FIR(3), start=0, Q=1e-5),
    "starting": tracker(ARX(2, 1), start=100), "ARMA": tracker(ARMA(2, 1), start=0),
    "Box and Jenkins": tracker(BoxJenkins(1, 1, 1, 1), start=0, R=0.04),
    "two-sided inside": lambda: ParameterTracker(ARX(2, 1), filter=two_sided(3, 1), start=0, Q=1e-6),
    "adaptive inside": tracker(ARX(2, 1), filter=AdaptiveKalmanFilter, start=0, Q=1e-6),
    "bank": lambda: TrackerBank(2, ARX(2, 1), start=0),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", TRACKERS)
@pytest.mark.parametrize("cut", [1, 64])
def test_a_tracker_goes_on_to_the_last_bit(name, cut):
    one, other, (y, u) = TRACKERS[name](), TRACKERS[name](), signals()
    pairs = np.column_stack((y, y)) if name == "bank" else y
    for k in range(cut):
        one.update(pairs[k], None if name == "ARMA" else u[k])
    state = one.state()
    assert all(type(value) is np.ndarray and value.dtype == np.float64 for value in state.values())
    other.restore(unpack(pack(state)))
    for k in range(cut, len(y)):
        now = pairs[k], None if name == "ARMA" else u[k]
        same(one.update(*now), other.update(*now))
        np.testing.assert_array_equal(one.theta, other.theta)
        np.testing.assert_array_equal(one.P, other.P)


# What is refused.


def refused(kf, state, match, error=ValueError):
    with unchanged(kf), pytest.raises(error, match=match):
        kf.restore(state)


EVERYTHING = {**FILTERS, **TRACKERS}


@pytest.mark.parametrize("name", EVERYTHING)
def test_a_state_of_something_else_is_refused_by_name(name):
    one = EVERYTHING[name]()
    theirs = linear(RobustKalmanFilter if name == "adaptive, joint" else AdaptiveKalmanFilter)().state()
    refused(one, theirs, "got one of a (AdaptiveKalman|RobustKalman)Filter")


@pytest.mark.parametrize("name", EVERYTHING)
def test_bad_states_change_nothing(name):
    one = EVERYTHING[name]()
    state = one.state()
    newer = {**state, "format": np.r_[2.0, state["format"][1:]]}
    refused(one, newer, "newer robust_filterpy")
    key = "theta" if "theta" in state else "x"
    refused(one, {k: v for k, v in state.items() if k != key}, f"expected {key}")
    refused(one, {**state, key: np.zeros(7)}, f"expected {key}")
    refused(one, {**state, "P": np.full_like(state["P"], np.nan)}, "finite")
    refused(one, {**state, "P": -1.0 - np.abs(state["P"])}, "P")
    refused(one, [1.0], "expected what state", TypeError)


def test_a_state_of_another_structure_with_as_many_parameters_is_refused():
    refused(ParameterTracker(ARX(2, 2)), ParameterTracker(OutputError(2, 2)).state(), r"OutputError\(")


def test_an_ensemble_refuses_the_numbers_of_another_generator():
    other, again = FILTERS["ensemble"](), FILTERS["ensemble"]()
    other.rng = np.random.Generator(np.random.MT19937(1))
    refused(again, other.state(), "PCG64, got those of a MT19937")
    again.rng = np.random.Generator(np.random.MT19937(2))
    again.restore(other.state())
    assert again.rng.normal() == other.rng.normal()


def test_a_packed_state_is_a_npy_record():
    state = FILTERS["two-sided"]().state()
    record = np.load(io.BytesIO(pack(state)), allow_pickle=False)
    assert record.dtype.names == (*state, "checksum")
    for name, value in state.items():
        np.testing.assert_array_equal(record[name], value)
        np.testing.assert_array_equal(unpack(pack(state))[name], value)


def test_a_name_beyond_ascii_survives():
    class Föhnfilter(RobustKalmanFilter):
        pass

    class Фильтр(RobustKalmanFilter):
        pass

    for cls in (Föhnfilter, Фильтр):
        cls(2, 1).restore(unpack(pack(cls(2, 1).state())))
        with pytest.raises(ValueError, match=cls.__name__):
            RobustKalmanFilter(2, 1).restore(unpack(pack(cls(2, 1).state())))


def test_every_damage_is_seen():
    data = pack(FILTERS["linear"]().state())
    for k in range(0, len(data), 7):
        broken = bytearray(data)
        broken[k] ^= 0x10
        with pytest.raises(ValueError, match="data: expected"):
            unpack(bytes(broken))
        with pytest.raises(ValueError, match="data: expected"):
            unpack(data[:k])
    with pytest.raises(ValueError, match="data: expected"):
        unpack(data + b"0")
    with pytest.raises(TypeError, match="data: expected bytes"):
        unpack("text")


def test_a_newer_format_is_not_unpacked_and_pickles_never_are():
    state = FILTERS["linear"]().state()
    with pytest.raises(ValueError, match="newer robust_filterpy"):
        pack({**state, "format": np.r_[2.0, state["format"][1:]]})
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="data: expected"):
        unpack(file.getvalue())
    with pytest.raises(TypeError, match="numbers in x"):
        pack({**state, "x": np.array([None, "a"])})
    with pytest.raises(ValueError, match="format"):
        pack({"x": np.zeros(2)})
