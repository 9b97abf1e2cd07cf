"""A weighted pass is the conditional normal distribution of all states, written out as one."""

import dense
import numpy as np
import pytest
import support

from robust_filterpy.smoothing.linear_pass import Model, Weighting, smoothing_pass


def problem(seed, n=3, m=2, r=2, steps=7, series=1, moving=True):
    """A random problem with missing components, and the weights of some sweep."""
    rng = np.random.default_rng(seed)
    axis = steps if moving else 1
    F = np.array([[support.stable(rng, n) for _ in range(axis)] for _ in range(series)])
    model = Model(
        F, rng.normal(size=(1, axis, n, r)), rng.normal(size=(series, axis, n)), rng.normal(size=(1, axis, m, n)),
        3.0 * rng.normal(size=(series, steps, m)), rng.normal(size=(series, n)), support.spd(rng, n)[None],
    )  # fmt: skip
    d = rng.random((series, steps, m)) + 0.1
    o = rng.normal(size=d.shape)
    gone = rng.random(d.shape) < 0.2
    d[gone], o[gone] = 0.0, 0.0
    return model, Weighting(d, o, rng.random((series, steps)) + 0.5)


def written_out(model, weighting, s):
    """Mean and covariance of one series from the joint distribution of its states."""
    steps = weighting.precision.shape[1]
    at = lambda a, k: a[s % len(a), k % a.shape[1]]  # noqa: E731
    d, o = weighting.precision[s], weighting.offset[s]
    # A factor exp(-d e^2/2 - o e) is a measurement z + o/d with variance 1/d.
    with np.errstate(divide="ignore", invalid="ignore"):
        z, variance = np.where(d > 0, model.z[s] + o / d, np.nan), np.where(d > 0, 1.0 / d, 1.0)
    F, G, c, H = ([at(a, k) for k in range(steps)] for a in (model.F, model.G, model.c, model.H))
    Q = [q * g @ g.T for q, g in zip(weighting.process_scale[s], G, strict=True)]
    return dense.posterior(F, Q, c, H, [np.diag(v) for v in variance], z, model.x0[s % len(model.x0)], model.P0[0])


@pytest.mark.parametrize("moving", [False, True])
def test_states_are_the_conditional_distribution(form, moving):
    model, weighting = problem(1, series=2, moving=moving)
    found = smoothing_pass(model, weighting, states=True)
    H = np.broadcast_to(model.H[0], (7, 2, 3))
    for s in range(2):
        x, P = written_out(model, weighting, s)
        V = np.einsum("kmi,kij,klj->kml", H, P[1:], H)
        for name, expected in {
            "x": x[1:], "P": P[1:], "x0": x[0], "P0": P[0], "fitted": np.einsum("kmi,ki->km", H, x[1:]), "spread": V,
        }.items():  # fmt: skip
            np.testing.assert_allclose(getattr(found, name)[s], expected, rtol=1e-8, atol=1e-9, err_msg=name)


def test_score_and_information_are_those_of_the_process_noise(form):
    """The smoothed noise of a step is q score, its covariance q - q^2 information: noise as part of the state."""
    model, weighting = problem(2, n=2, m=1, r=1, steps=5, moving=False)
    assert model.G.shape[-1] == 1
    found = smoothing_pass(model, weighting, process=True)
    F, G, c, H = (a[0, 0] for a in (model.F, model.G, model.c, model.H))
    # The oracle's state is (x, w), w of the step that led to x.
    wide_F = np.zeros((3, 3))
    wide_F[:2, :2] = F
    wide = Model(
        wide_F[None, None], np.vstack([G, [[1.0]]])[None, None], np.append(c, 0.0)[None, None],
        np.append(H, [[0.0]], 1)[None, None], model.z, np.append(model.x0, [[0.0]], 1),
        np.block([[model.P0[0], np.zeros((2, 1))], [np.zeros((1, 3))]])[None],
    )  # fmt: skip
    x, P = written_out(wide, weighting, 0)
    q = weighting.process_scale[0]
    np.testing.assert_allclose(q * found.score[0, :, 0], x[1:, 2], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(q - q**2 * found.information[0, :, 0, 0], P[1:, 2, 2], rtol=1e-8, atol=1e-10)


WANTED = ({}, {"states": True}, {"process": True}, {"states": True, "process": True})


@pytest.mark.parametrize("seed", range(20))
def test_the_kernel_is_the_definition(monkeypatch, seed):
    support.needs_kernel()
    rng = np.random.default_rng(seed)
    sizes = {"n": rng.integers(1, 10), "m": rng.integers(1, 5), "r": rng.integers(1, 4), "series": rng.integers(1, 4)}
    model, weighting = problem(seed, **sizes, steps=30, moving=seed % 2 == 0)
    if seed % 4 == 1:
        # States that are known next to nothing of, so that the longer way is taken.
        model = model._replace(P0=1e4 * model.P0)
    ours = [smoothing_pass(model, weighting, **wanted) for wanted in WANTED]
    support.without_kernel(monkeypatch)
    for wanted, by_kernel in zip(WANTED, ours, strict=True):
        theirs = smoothing_pass(model, weighting, **wanted)
        for name, a, b in zip(theirs._fields, by_kernel, theirs, strict=True):
            assert a.shape == b.shape
            if wanted.get("states") or name not in ("x0", "P0"):
                size = np.abs(b).max(initial=0.0)
                # Next to a diffuse P the residuals' variance is a difference of large numbers, but for states.
                diffuse = seed % 4 == 1 and name in ("fitted", "spread") and not wanted.get("states")
                far = 1e-2 if diffuse else 1e-7
                np.testing.assert_allclose(a, b, rtol=0.0, atol=far * (1e-9 + size), err_msg=name)


@pytest.mark.parametrize("precision", [1e-6, 1.0, 1e8])
def test_diffuse_and_sharp_knowledge_leave_covariances_positive(form, precision):
    """From P0 = 1e6 I, with sensors that tell very little or very much, also with no process noise at all."""
    F = np.array([[1.0, 1.0], [0.0, 1.0]])[None, None]
    z = np.arange(40.0)[None, :, None]
    for G in (np.zeros((2, 1)), np.array([[0.05], [0.1]])):
        model = Model(
            F, G[None, None], np.zeros((1, 1, 2)), np.eye(1, 2)[None, None], z, np.zeros((1, 2)), 1e6 * np.eye(2)[None]
        )
        d = np.full(z.shape, precision)
        found = smoothing_pass(model, Weighting(d, np.zeros(z.shape), np.ones((1, 40))), states=True)
        least = np.linalg.eigvalsh(found.P[0])[:, 0]
        assert (least > -1e-9 * np.abs(found.P[0]).max(axis=(1, 2))).all()
        if precision >= 1.0:
            np.testing.assert_allclose(found.x[0, :, 0], np.arange(40.0), atol=1e-3)
