"""side_by_side: the program is left alone, its filters have shadows, and the report is right."""

import copy
import pickle

import numpy as np
import pytest
from filterpy.kalman import (
    ExtendedKalmanFilter,
    IMMEstimator,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)

from robust_filterpy import (
    Huber,
    Linear,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
)
from robust_filterpy.testing import draw, side_by_side

SCENARIO = draw("constant velocity", 60, contamination="mixture", rng=1)


def linear(*args, **kwargs):
    return RobustKalmanFilter(*args, influence=Linear(), **kwargs)


def program(scenario=SCENARIO, cls=KalmanFilter):
    """Somebody's program: every way of calling, setting and writing into slices."""
    kf, path = scenario.load(cls(dim_x=4, dim_z=2)), []
    for k, z in enumerate(scenario.z):
        kf.predict()
        kf.update(None if k == 5 else z)
        if k == 20:
            kf.x[1] = 0.0
            kf.P[1, 1] += 2.0
        if k == 30:
            kf.R = 4.0 * kf.R
        if k == 40:
            kf.update_correlated(z)
            kf.predict(Q=2 * kf.Q)
            kf.update(z[:, None], R=kf.R, H=kf.H)
        path.append(kf.x.copy())
    means, *_ = scenario.load(cls(4, 2)).batch_filter(scenario.z[:, :, None])
    return np.array(path), means


def test_the_program_computes_what_it_always_computes_and_the_class_is_as_before():
    before, methods = program(), dict(vars(KalmanFilter))
    with side_by_side(KalmanFilter, RobustKalmanFilter):
        during = program()
    for one, two in zip(before, during, strict=True):
        np.testing.assert_array_equal(one, two)
    assert dict(vars(KalmanFilter)) == methods
    with pytest.raises(ZeroDivisionError), side_by_side(KalmanFilter, RobustKalmanFilter):
        raise ZeroDivisionError
    assert dict(vars(KalmanFilter)) == methods


def test_a_shadow_that_is_the_same_filter_never_parts():
    """All that the program sets, calls and passes reaches the shadow."""
    with side_by_side(KalmanFilter, linear) as report:
        program()
    assert [f.calls for f in report.filters] == [123, 120] and [f.updates for f in report.filters] == [62, 60]
    for f in report.filters:
        assert f.first_difference is None and f.first_apart is None and f.largest < 1e-6 and f.failure is None


def test_the_shadow_is_the_other_filter_in_the_same_program():
    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        _, means = program()
    alone = SCENARIO.load(RobustKalmanFilter(4, 2))
    apart, doubted = 0.0, 0
    plain = SCENARIO.load(KalmanFilter(4, 2))
    for z in SCENARIO.z:
        for kf in (alone, plain):
            kf.predict()
            kf.update(z)
        sigma = np.sqrt(plain.P.diagonal())
        apart = max(apart, np.abs((alone.x - plain.x)[:, 0] / sigma).max())
        doubted += bool((alone.weights < 0.5).any())
    second = report.filters[1]
    assert second.largest == pytest.approx(apart) and second.doubted == doubted > 0
    assert len(means) == second.updates == 60


def test_the_first_call_where_they_part():
    def calm(outlier_at):
        kf = KalmanFilter(dim_x=1, dim_z=1)
        kf.H[:] = 1.0
        for k in range(20):
            kf.predict()
            kf.update(500.0 if k == outlier_at else 0.1)

    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        calm(12)
        calm(99)
    one, other = report.filters
    assert (one.first_apart, one.apart_in, one.doubted) == (26, "update", 1)
    assert (other.first_apart, other.first_difference, other.doubted) == (None, None, 0)
    assert one.where.startswith("test_side_by_side.py:")
    text = str(report)
    assert "2 filter(s), 80 calls: KalmanFilter beside RobustKalmanFilter. 1 parted by more than 0.5 sigma" in text
    assert "They part at call 26 (update)" in text and "They never part" in text


def test_the_report_says_what_diagnose_says():
    scenario = draw("constant velocity", 300, rng=2)
    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        kf = scenario.load(KalmanFilter(4, 2))
        kf.R = kf.R / 50
        for z in scenario.z:
            kf.predict()
            kf.update(z)
    assert "R too small" in report.filters[0].diagnosis.causes
    assert "R is about" in str(report)


def test_filters_made_before_and_copies_are_followed_from_their_first_call():
    kf = SCENARIO.load(KalmanFilter(4, 2))
    kf.predict()
    kf.update(SCENARIO.z[0])
    with side_by_side(KalmanFilter, linear) as report:
        twin = copy.deepcopy(kf)
        for one in (kf, twin, pickle.loads(pickle.dumps(kf))):
            one.predict()
            one.update(SCENARIO.z[1])
    assert [f.calls for f in report.filters] == [2, 2, 2]
    assert all(f.first_difference is None for f in report.filters)


def test_subclasses_and_the_shadows_own_class_are_left_alone():
    class Own(KalmanFilter):
        pass

    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        program(cls=Own)
        program(cls=RobustKalmanFilter)
    assert report.filters == [] and str(report).startswith("0 filter(s)")


def test_other_kinds_of_filters():
    radar = draw("range and bearing", 30, rng=1)
    model = radar.model

    def extended():
        kf = radar.load(ExtendedKalmanFilter(4, 2))
        kf.x = model.x.copy()
        for z in radar.z:
            kf.predict()
            kf.update(z, lambda x: model.jacobian(np.ravel(x)), lambda x: model.measured(np.ravel(x)))

    def unscented():
        points = MerweScaledSigmaPoints(4, 0.1, 2.0, 0.0)
        kf = UnscentedKalmanFilter(4, 2, 1.0, model.measured, lambda x, dt: model.F @ x, points)
        kf.x, kf.P, kf.Q, kf.R = model.x.copy(), model.P.copy(), model.Q.copy(), model.R.copy()
        for z in radar.z:
            kf.predict()
            kf.update(z)

    for run, first, second in (
        (extended, ExtendedKalmanFilter, RobustExtendedKalmanFilter),
        (unscented, UnscentedKalmanFilter, RobustUnscentedKalmanFilter),
    ):
        with side_by_side(first, lambda *a, second=second, **k: second(*a, influence=Huber(np.inf), **k)) as report:
            run()
        (only,) = report.filters
        assert only.calls == 60 and only.failure is None and only.largest < 1e-5, only


def test_a_bank_goes_on():
    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        filters = [SCENARIO.load(KalmanFilter(4, 2)) for _ in range(2)]
        imm = IMMEstimator(filters, (0.5, 0.5), np.array([[0.9, 0.1], [0.1, 0.9]]))
        for z in SCENARIO.z:
            imm.predict()
            imm.update(z[:, None])
    assert [f.updates for f in report.filters] == [60, 60] and all(f.failure is None for f in report.filters)


def test_a_shadow_that_refuses_ends_and_says_why():
    with side_by_side(KalmanFilter, RobustKalmanFilter) as report:
        kf = SCENARIO.load(KalmanFilter(4, 2))
        kf.predict()
        kf.R = -np.eye(2)
        kf.update(SCENARIO.z[0])
        kf.predict()
    (only,) = report.filters
    assert only.calls == 2 and only.failure.startswith("ValueError: R: expected a positive semidefinite")
    assert "The shadow ended at call 2: ValueError: R" in str(report)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((3, RobustKalmanFilter), "first: expected a class of filters"),
        ((dict, RobustKalmanFilter), "first: expected a class of filters"),
        ((KalmanFilter, RobustKalmanFilter(2, 1)), "second: expected a class"),
    ],
)
def test_bad_input_is_named(arguments, match):
    with pytest.raises(TypeError, match=match), side_by_side(*arguments):
        pass
