"""Whatever the sizes of P, Q, R and z: a step is taken, or refused in a sentence that names what is wrong."""

import warnings

import numpy as np
import pytest

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Linear

SIZES = 10.0 ** np.array([-300, -160, -10, 0, 0, 10, 150, 160, 200, 300, 307])
SENTENCES = ("expected", "S = H P H' + R: ", 'scaling="unit" would make P indefinite')


def options(rng):
    found = {"grouping": str(rng.choice(["joint", "component"]))}
    if rng.random() < 0.4:
        found["noise"] = ["learnt", Contaminated(0.1, 10.0)][rng.integers(2)]
        return {**found, "process": "scales"} if rng.random() < 0.5 else found
    found["influence"] = [Huber(), Linear(), TukeyBiweight(), StudentT()][rng.integers(4)]
    return {**found, "scaling": str(rng.choice(["innovation", "unit", "bounded", "learnt"]))}


@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_taken_or_refused_in_a_sentence(seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        (n, m), said = rng.integers(1, 4, 2), options(rng)
        kf, A = RobustKalmanFilter(n, m, **said), rng.normal(size=(n, n))
        kf.F, kf.H, kf.R = np.eye(n), rng.normal(size=(m, n)), np.eye(m) * rng.choice(SIZES)
        kf.Q = A @ A.T * rng.choice(SIZES) if rng.random() < 0.7 else np.diag(rng.choice(SIZES, n))
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                for _ in range(4):
                    kf.predict()
                    kf.update(rng.normal(size=m) * rng.choice(SIZES))
            except (ValueError, np.linalg.LinAlgError) as error:
                assert any(words in str(error) for words in SENTENCES), (said, error)
        assert np.isfinite(kf.x).all() and np.isfinite(kf.P).all()
