"""The compiled loops say what correction.py says."""

import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import support

from robust_filterpy import Hampel, Huber, Linear, StudentT, TukeyBiweight
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction import correct, log_density
from robust_filterpy.correction.options import Choices

pytest.importorskip("numba")

INFLUENCES = [Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT()]
CHOICES = list(
    itertools.product(["innovation", "unit", "bounded"], ["realized", "expected", "weight"], ["component", "joint"])
)


def compiled(choices, zs, F, Q, H, R, P, **options):
    """Run one series from x = 0 and return what the loops kept, and how far they came."""
    (steps, m), n = zs.shape, len(F)
    kept = dispatch.Kept(
        np.zeros((1, steps, n)), np.zeros((1, steps, n, n)), np.zeros((1, steps, n)), np.zeros((1, steps, n, n)),
        np.zeros((1, steps, m)), np.zeros(1),
    )  # fmt: skip
    model = tuple(np.ascontiguousarray(a)[None, None] for a in (F, Q, H, R, np.zeros(n)))
    done = dispatch.recurse(choices, zs[None], model, np.zeros((1, n)), P[None].copy(), kept, **options)
    return kept, int(done[0])


@pytest.mark.parametrize("influence", INFLUENCES, ids=lambda f: type(f).__name__)
def test_every_choice_agrees_with_the_definition(influence):
    for (scaling, information, grouping), (n, m) in itertools.product(
        CHOICES, [(2, 1), (4, 2), (4, 3), (13, 3), (2, 4)]
    ):
        if m == 1 and grouping == "joint":
            continue
        rng = np.random.default_rng(10 * n + m)
        choices = Choices(influence, scaling, information, grouping)
        F, Q, H, R, P = (
            support.stable(rng, n),
            0.01 * np.eye(n),
            rng.normal(size=(m, n)) / n,
            support.spd(rng, m),
            0.1 * np.eye(n),
        )
        zs = rng.normal(size=(25, m))
        zs[rng.random(zs.shape) < 0.1] += 50.0
        zs[rng.random(zs.shape) < 0.2] = np.nan
        kept, done = compiled(choices, zs, F, Q, H, R, P)
        assert done == 25
        x, total = np.zeros(n), 0.0
        for k, z in enumerate(zs):
            x, P = F @ x, F @ P @ F.T + Q
            np.testing.assert_allclose(kept.means_p[0, k], x, rtol=1e-10, atol=1e-11)
            np.testing.assert_allclose(kept.covariances_p[0, k], P, rtol=1e-10, atol=1e-11)
            c = correct(x, P, z - H @ x, H, R, choices)
            total += log_density(z - H @ x, c.S, choices)
            x, P = c.x, c.P
            np.testing.assert_allclose(kept.means[0, k], x, rtol=1e-10, atol=1e-11)
            np.testing.assert_allclose(kept.covariances[0, k], P, rtol=1e-10, atol=1e-11)
            np.testing.assert_allclose(kept.weights[0, k], c.weights, rtol=1e-10, atol=1e-11)
        assert kept.log_likelihood[0] == pytest.approx(total, rel=1e-10)


def test_the_loop_stops_before_a_step_that_is_out_of_the_ordinary():
    zs = np.zeros((6, 1))
    zs[3] = np.inf
    eye = np.eye(1)
    assert compiled(Choices(), zs, eye, eye, eye, eye, eye)[1] == 3
    assert compiled(Choices(scaling="unit"), zs, eye, eye, eye, eye, eye)[1] == 0
    assert compiled(Choices(), zs, 1e200 * eye, eye, eye, eye, eye)[1] == 0


def test_a_series_that_overflows_leaves_the_others_alone():
    rng = np.random.default_rng(0)
    n, m, steps = 5, 2, 40
    H, eye = rng.normal(size=(m, n)), np.eye(n)
    F = np.array([1e80 * eye, support.stable(rng, n), support.stable(rng, n)])[:, None]
    zs, P = rng.normal(size=(3, steps, m)), np.array([eye] * 3)

    def run(part):
        k = len(zs[part])
        model = (F[part], *(np.ascontiguousarray(a)[None, None] for a in (0.1 * eye, H, np.eye(m), np.zeros(n))))
        kept = dispatch.Kept(
            np.zeros((k, steps, n)), np.zeros((k, steps, n, n)), np.zeros((k, 0, n)), np.zeros((k, 0, n, n)),
            np.zeros((k, steps, m)), np.zeros(k),
        )  # fmt: skip
        x, choices = np.zeros((k, n)), Choices()
        return kept, dispatch.recurse(choices, zs[part], model, x, P[part].copy(), kept, update_first=True)

    together, done = run(slice(0, 3))
    alone, done_alone = run(slice(1, 3))
    assert done[0] == 1 and done[1:].tolist() == done_alone.tolist() == [steps, steps]
    np.testing.assert_array_equal(together.covariances[1:], alone.covariances)
    np.testing.assert_array_equal(together.means[1:], alone.means)


def test_a_long_run_stays_symmetric_and_positive_definite():
    rng = np.random.default_rng(3)
    n, m = 4, 3
    zs = rng.standard_t(1.5, size=(20000, m))
    kept, done = compiled(
        Choices(), zs, support.stable(rng, n), 1e-6 * np.eye(n), rng.normal(size=(m, n)), np.eye(m), 1e9 * np.eye(n)
    )
    assert done == len(zs)
    covariances = kept.covariances[0, 1000::100]
    np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(covariances).min() > 0.0


def run_python(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **environment}, check=True
    )
    return done.stdout, done.stderr


def test_numba_is_imported_with_the_first_long_batch_and_not_before():
    code = (
        "import sys, numpy as np; from robust_filterpy import RobustKalmanFilter\n"
        "from robust_filterpy.compiled import dispatch\n"
        "kf = RobustKalmanFilter(1, 1); kf.H[:] = 1.0; kf.batch_filter(np.zeros(50)); print('numba' in sys.modules)\n"
        "kf.batch_filter(np.zeros(dispatch.LONG)); print('numba' in sys.modules)"
    )
    assert run_python(code)[0].split() == ["False", "True"]


def test_arrays_that_are_read_only_or_strided_are_not_compiled_for():
    from robust_filterpy.compiled import filter_loop

    def run(change):
        kept = dispatch.Kept(
            np.zeros((2, 9, 3)), np.zeros((2, 9, 3, 3)), np.zeros((2, 0, 3)), np.zeros((2, 0, 3, 3)),
            np.zeros((2, 9, 2)), np.zeros(2),
        )  # fmt: skip
        rng = np.random.default_rng(0)
        eye, H, z = np.eye(3)[None, None], rng.normal(size=(1, 1, 2, 3)), rng.normal(size=(2, 9, 2))
        model = (0.9 * eye, 0.1 * eye, H, np.eye(2)[None, None], np.zeros((1, 1, 3)))
        P = np.tile(np.eye(3), (2, 1, 1))
        dispatch.recurse(Choices(), change(z), tuple(change(a) for a in model), np.zeros((2, 3)), P, kept)
        return kept.means, list(filter_loop.recurse.signatures)

    def strided(a):
        return np.repeat(a, 2, axis=-1)[..., ::2]

    means, signatures = run(np.copy)
    for change in (strided, np.asfortranarray, lambda a: np.frombuffer(a.tobytes()).reshape(a.shape)):
        found, after = run(change)
        assert after == signatures
        np.testing.assert_array_equal(found, means)


@pytest.mark.parametrize("name", ["influence/scalar.py", "compiled/inverse_root.py"])
def test_the_cache_sees_an_edit_of_any_source(tmp_path, name):
    from robust_filterpy.compiled import filter_loop

    here = Path(filter_loop.__file__).parent
    copy = shutil.copytree(here.parent, tmp_path / "package") / "compiled"
    assert filter_loop.stamp(copy) == filter_loop.stamp(here)
    with open(copy.parent / name, "a") as source:
        source.write("# edited")
    assert filter_loop.stamp(copy) != filter_loop.stamp(here)


@pytest.mark.slow
def test_a_compilation_is_announced_and_comes_again_only_after_an_edit(tmp_path):
    package = shutil.copytree(Path(dispatch.__file__).parents[1], tmp_path / "robust_filterpy")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "import numpy as np; from robust_filterpy import RobustKalmanFilter\n"
        "from robust_filterpy.compiled import dispatch\n"
        "kf = RobustKalmanFilter(1, 1); kf.H[:] = 1.0; kf.batch_filter(np.zeros(dispatch.LONG))"
    )
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = [run_python(code, **environment)[1].count("compiling its loops") for _ in range(2)]
    with open(package / "influence" / "scalar.py", "a") as source:
        source.write("# edited")
    told.append(run_python(code, **environment)[1].count("compiling its loops"))
    assert told == [1, 0, 1]
