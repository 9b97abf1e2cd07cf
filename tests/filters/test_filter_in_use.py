"""The robust filter in a program: its defaults, changes between calls, shared memory, singular S."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, RobustKalmanFilter

pytestmark = pytest.mark.core

SCALINGS = ["innovation", "bounded", "unit"]
COMPONENT = [("component", information) for information in ("realized", "expected", "weight")]
JOINT = [("joint", information) for information in ("realized", "weight")]


def robust(problem=None, ndim=2, **choices):
    """A robust filter for the problem, or for one of four states and two sensors."""
    return support.make(RobustKalmanFilter, problem or support.random_problem(21, 4, 2), ndim, **choices)


@pytest.mark.parametrize("missing_first", [False, True])
def test_choices_can_be_changed_between_calls(missing_first):
    problem = support.mild()
    kf = robust(problem)
    if missing_first:
        kf.update(None)
    for scaling in SCALINGS:
        for grouping, information in COMPONENT + JOINT[1:]:
            for influence in (Huber(0.8), Huber(2.0)):
                choices = {"scaling": scaling, "grouping": grouping, "information": information}
                support.load(kf, problem)
                for name, value in {**choices, "influence": influence}.items():
                    setattr(kf, name, value)
                    assert getattr(kf, name) == value
                fresh = robust(problem, influence=influence, **choices)
                for one in (kf, fresh):
                    one.update([0.1, 30.0])
                support.assert_same_state(kf, fresh, ("x", "P", "K", "T", "e", "weights"), rtol=1e-14)


def test_defaults():
    kf = RobustKalmanFilter(2, 1)
    assert kf.influence == Huber(1.345)
    assert (kf.scaling, kf.information, kf.grouping) == ("learnt", "realized", "component")


def test_a_singular_s_is_said_and_a_pseudo_inverse_is_obeyed():
    problem = support.with_(
        support.cart(),
        H=np.array([[1.0, 0.0], [1.0, 0.0]]),
        R=1e-10 * np.eye(2),
        P=1e30 * np.eye(2),
        M=np.zeros((2, 2)),
    )
    kf = robust(problem)
    before = support.snapshot(kf)
    with pytest.raises(np.linalg.LinAlgError):
        kf.update([1.0, 1.0])
    support.assert_unchanged(before, kf)
    kf.inv = np.linalg.pinv
    kf.update([1.0, 1.0])
    support.assert_close(kf.SI, np.linalg.pinv(kf.S), 1e-12)
    assert np.all(np.isfinite(kf.x))
    assert kf.x[0, 0] == pytest.approx(1.0, abs=1e-6)


def test_repr_names_the_class_and_the_choices():
    text = repr(
        RobustKalmanFilter(2, 1, influence=Huber(1.5), scaling="bounded", information="weight", grouping="joint")
    )
    for part in ("RobustKalmanFilter", "Huber(threshold=1.5)", "bounded", "weight", "joint", "dim_x = 2"):
        assert part in text, part
    kf = robust()
    kf.predict()
    kf.update([1.0, 1e6])
    assert "spread" in repr(kf) and "weights" in repr(kf)
