"""What a program writes into an array of a filter where it stands counts as what it assigns, in every class."""

from functools import partial

import numpy as np
import pytest
from support import Extended, noise_given, of_matrices, recovering, two_sided

from robust_filterpy import AdaptiveKalmanFilter, RobustKalmanFilter, RobustUnscentedKalmanFilter
from robust_filterpy.filters import RobustCubatureKalmanFilter

F = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.0, 0.0, 0.95]])
H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2]])


LINEAR = {
    "default": RobustKalmanFilter, "innovation": partial(RobustKalmanFilter, scaling="innovation"),
    "recovering": recovering, "given": noise_given, "two_sided": two_sided,
    "learnt": partial(RobustKalmanFilter, noise="learnt", process="given"), "adaptive": AdaptiveKalmanFilter,
}  # fmt: skip
MAKERS = {
    **{name: partial(of_matrices, cls, F, H, dim_u=1) for name, cls in LINEAR.items()},
    "extended": partial(of_matrices, Extended, F, H, dim_u=1),
    "extended_learnt": partial(of_matrices, Extended, F, H, dim_u=1, noise="learnt"),
    "unscented": partial(of_matrices, RobustUnscentedKalmanFilter, F, H),
    "unscented_learnt": partial(of_matrices, RobustUnscentedKalmanFilter, F, H, noise="learnt"),
    "cubature": partial(of_matrices, RobustCubatureKalmanFilter, F, H),
}  # fmt: skip
SHOWN = "x P x_prior P_prior x_post P_post y S K weights log_likelihood".split()


def drawn(rng, kf):
    """Draw what is done to a filter next: a step, or a change of one of its arrays."""
    kind = rng.integers(7)
    if kind < 2:
        u = None if getattr(kf, "B", None) is None or not isinstance(kf.B, np.ndarray) else rng.normal(size=1)
        return (lambda one: one.predict(u)) if u is not None else lambda one: one.predict()
    if kind < 4:
        z = 3.0 * rng.normal(size=2) * (100.0 if rng.random() < 0.1 else 1.0)
        # A sigma-point filter corrects by the points of its prediction, as often as there is one.
        return lambda one: (hasattr(kf, "sigmas_f") and one.predict(), one.update(z))
    name = rng.choice([name for name in "xPFHQRBM" if isinstance(getattr(kf, name, None), np.ndarray)])
    factor = float(rng.choice([0.5, 2.0, 1000.0])) if name in "PQR" else 1.0
    add = rng.normal(size=np.shape(getattr(kf, name))) * (0.01 if name in "FHBM" else 0.0 if name in "PQR" else 5.0)
    place = slice(None) if name in "PQR" else slice(0, int(rng.integers(1, 3)))
    return name, lambda array: array[place].__imul__(factor).__iadd__(add[place])


def done(kf, change, assigns):
    """Do it, a change by assignment or in place."""
    if callable(change):
        return change(kf)
    name, write = change
    array = getattr(kf, name)
    array = array.copy() if assigns else array
    write(array)
    return setattr(kf, name, array) if assigns else None


@pytest.mark.parametrize("name", MAKERS)
def test_a_write_in_place_is_an_assignment(name):
    for seed in range(5):
        rng, one, other = np.random.default_rng(seed), MAKERS[name](), MAKERS[name]()
        for kf in (one, other):
            kf.B = 0.1 * np.ones((3, 1))
        for _ in range(40):
            change = drawn(rng, one)
            done(one, change, False)
            done(other, change, True)
            reads = SHOWN if rng.random() < 0.5 else SHOWN[:2]
            for shown in reads:
                found = np.asarray(getattr(one, shown, np.nan), dtype=float)
                np.testing.assert_array_equal(found, np.asarray(getattr(other, shown, np.nan), dtype=float), shown)
