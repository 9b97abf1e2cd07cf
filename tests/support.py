"""Oracles, random problems and comparisons that several test files share.

The reference formulas are written from the definitions, with another way to every matrix function than the package
takes; of the package nothing is used but comparisons out of its room for testing.
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from filterpy.kalman import CubatureKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from robust_filterpy import Contaminated, RobustKalmanFilter, TukeyBiweight, kernel
from robust_filterpy.correction import Scales
from robust_filterpy.filters import (
    RobustCubatureKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustUnscentedKalmanFilter,
    shell,
)
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter
from robust_filterpy.identification import ParameterTracker, TrackerBank
from robust_filterpy.influence.information import expected_information
from robust_filterpy.testing.checks import assert_unchanged as assert_unchanged
from robust_filterpy.testing.checks import visible

# What 1.4.5 lacks, the tests compare with the definition.
FILTERPY_2 = hasattr(KalmanFilter, "update_sequential")

# What makes a filter come back, and one that is given the noise, and one that doubts the process as well.
RECOVERING = {"influence": TukeyBiweight(), "patience": 12}
NOISE_GIVEN = {"noise": Contaminated()}
TWO_SIDED = {"noise": Contaminated(), "process": Scales((1.0, 10.0, 100.0), jump=0.0)}
# What noise and process may be taken for, by any filter.
POLICIES = {
    "default": {}, "innovation": {"scaling": "innovation"}, "recovering": RECOVERING, "given": NOISE_GIVEN,
    "two-sided": TWO_SIDED, "learnt": {"noise": "learnt", "process": "given"}, "adaptive": {"noise": "learnt"},
}  # fmt: skip
recovering = partial(RobustKalmanFilter, **RECOVERING)
noise_given = partial(RobustKalmanFilter, **NOISE_GIVEN)
two_sided = partial(RobustKalmanFilter, **TWO_SIDED)

NONLINEAR = (RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter)
STATE = ("x", "P", "x_prior", "P_prior", "x_post", "P_post")
CORRECTION = ("y", "K", "S", "SI", "z")
ROBUST = ("e", "weights", "clipped", "T", "y_bounded")


@dataclass(frozen=True)
class Problem:
    """The matrices of one linear estimation problem and its starting point, x as a column."""

    x: np.ndarray
    P: np.ndarray
    F: np.ndarray
    H: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    B: np.ndarray | None
    M: np.ndarray

    @property
    def dims(self):
        return len(self.x), len(self.R), 0 if self.B is None else self.B.shape[1]


def spd(rng, n, scale=1.0):
    """Draw a well-conditioned symmetric positive definite matrix."""
    a = rng.normal(size=(n, n))
    return scale * (a @ a.T / n + 0.5 * np.eye(n))


def stable(rng, n, radius=0.95):
    """Draw a matrix of the given spectral radius."""
    a = rng.normal(size=(n, n))
    return a * radius / np.abs(np.linalg.eigvals(a)).max()


def random_problem(seed, dim_x, dim_z, dim_u=0):
    """Draw a stable problem whose M is legal with every P >= Q."""
    rng = np.random.default_rng(seed)
    Q, R = spd(rng, dim_x, 0.1), spd(rng, dim_z, 0.5)
    u, _, vt = np.linalg.svd(rng.normal(size=(dim_x, dim_z)), full_matrices=False)
    return Problem(
        x=rng.normal(size=(dim_x, 1)),
        P=spd(rng, dim_x) + Q,
        F=stable(rng, dim_x),
        H=rng.normal(size=(dim_z, dim_x)),
        Q=Q,
        R=R,
        B=rng.normal(size=(dim_x, dim_u)) if dim_u else None,
        M=0.5 * np.linalg.cholesky(Q) @ (u @ vt) @ np.linalg.cholesky(R).T,
    )


def load(kf, problem, ndim=2):
    """Put the problem into a filter and return the filter."""
    for name in ("P", "F", "H", "Q", "R", "M"):
        setattr(kf, name, getattr(problem, name).copy())
    kf.x = problem.x.copy() if ndim == 2 else problem.x[:, 0].copy()
    kf.B = None if problem.B is None else problem.B.copy()
    return kf


def make(cls, problem, ndim=2, **choices):
    """Build a filter of class `cls` for the problem, a robust one with thresholds as they are."""
    kind = getattr(cls, "func", cls)
    if hasattr(kind, "scaling") and "scaling" not in choices:
        try:
            return load(cls(*problem.dims, scaling="innovation", **choices), problem, ndim)
        except (TypeError, ValueError):
            # Its scaling follows from something else, or a choice is wrong, which then is said again.
            pass
    return load(cls(*problem.dims, **choices), problem, ndim)


def states(F, w, x=0.0):
    """The states of x_k = F x_(k-1) + w_k, shape of w, from x before them."""
    path, x = np.empty_like(w), x * np.ones(len(F))
    for k, noise in enumerate(w):
        path[k] = x = F @ x + noise
    return path


def simulate(problem, n, seed, contamination=0.0, size=100.0):
    """Return n measurements (n, dim_z) of the problem, and which components are outliers."""
    rng = np.random.default_rng(seed)
    dim_x, dim_z, _ = problem.dims
    w = rng.multivariate_normal(np.zeros(dim_x), problem.Q, n)
    v = rng.multivariate_normal(np.zeros(dim_z), problem.R, n)
    bad = rng.random((n, dim_z)) < contamination
    z = states(problem.F, w, problem.x[:, 0]) @ problem.H.T + v
    return z + bad * size * rng.choice([-1.0, 1.0], (n, dim_z)), bad


def cart():
    """A point with position and velocity whose position is measured: the smallest useful problem."""
    return Problem(
        x=np.zeros((2, 1)), P=np.eye(2), F=np.array([[1.0, 1.0], [0.0, 1.0]]), H=np.array([[1.0, 0.0]]),
        Q=np.array([[0.01, 0.0], [0.0, 0.01]]), R=np.array([[1.0]]), B=None, M=np.zeros((2, 1)),
    )  # fmt: skip


def white(h, q):
    """F and Q of a speed that white noise moves, over a time h."""
    return np.array([[1.0, h], [0.0, 1.0]]), q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])


def mover(kind, R=1.0, H=((1.0, 0.0),), h=1.0, q=1e-3, P=10.0, x=0.0):
    """A filter of a position that moves at a speed; other states that H names stand still."""
    H = np.array(H)
    kf = kind(H.shape[1], len(H))
    kf.F, kf.Q = white(h, q) if H.shape[1] == 2 else (np.eye(H.shape[1]), np.diag([1e-3, 1e-3, 1e-6]))
    kf.H, kf.R, kf.P, kf.x = H, R * np.eye(len(H)), P * np.eye(H.shape[1]), np.zeros((H.shape[1], 1))
    kf.x[0] = x
    return kf


def paper_problem(P0=0.1):
    """The state-estimation problem of the paper, equations 31-34, from P(0|0) = P0 I."""
    F = [
        [0.99, -0.012, 0.001, -0.001], [-0.005, 0.98, -0.001, 0.005], [-0.001, 0.01, 1.0, -0.001],
        [0.01, 0.001, -0.002, 1.0],
    ]  # fmt: skip
    return Problem(
        x=np.zeros((4, 1)), P=P0 * np.eye(4), F=np.array(F), H=np.eye(1, 4), Q=0.001 * np.eye(4), R=np.array([[0.1]]),
        B=None, M=np.zeros((4, 1)),
    )  # fmt: skip


class Extended(RobustExtendedKalmanFilter):
    """An extended filter of a linear sensor, whose update takes a measurement alone."""

    def update(self, z, **named):
        super().update(z, lambda x: self.H, lambda x: self.H @ x, **named)


def seen(kf, x):
    return kf.H @ np.ravel(x)


def moved(kf, x, dt):
    return kf.F @ np.ravel(x)


def of_matrices(kind, F, H, Q=None, R=None, P=None, x=None, **options):
    """A filter of any kind for a linear model (a number: times I); one of sigma points has functions of F and H."""
    (m, n), functions = np.shape(H), {}
    if issubclass(getattr(kind, "func", kind), (UnscentedKalmanFilter, CubatureKalmanFilter)):
        functions = {"dt": 1.0, "hx": None, "fx": None}
        if issubclass(getattr(kind, "func", kind), UnscentedKalmanFilter):
            functions["points"] = MerweScaledSigmaPoints(n, 1.0, 2.0, 3.0 - n)
    kf = kind(dim_x=n, dim_z=m, **functions, **options)
    if functions:
        kf.hx, kf.fx = partial(seen, kf), partial(moved, kf)
    kf.H = np.array(H, dtype=float)
    for name, value, size in (("F", F, n), ("Q", Q, n), ("R", R, m), ("P", P, n)):
        if value is not None:
            setattr(kf, name, value * np.eye(size) if np.ndim(value) == 0 else np.array(value, dtype=float))
    if x is not None:
        kf.x = np.array(x, dtype=float)
    return kf


def ensemble(F, H, Q=None, x=None, seed=3):
    """A small ensemble filter of a linear model."""
    kf = RobustEnsembleKalmanFilter(
        np.zeros(len(F)), np.eye(len(F)), len(H), 1.0, 20, None, None, rng=np.random.default_rng(seed)
    )
    kf.hx, kf.fx, kf.F, kf.H = partial(seen, kf), partial(moved, kf), np.array(F), np.array(H)
    kf.Q = np.eye(len(F)) if Q is None else Q * np.eye(len(F)) if np.ndim(Q) == 0 else np.array(Q)
    return kf


def of_every_kind(F, H, *more, patience=12, **options):
    """What makes a filter of each class and policy for a linear model, by name."""
    kinds = {"linear": RobustKalmanFilter, "extended": Extended, "unscented": NONLINEAR[1], "cubature": NONLINEAR[2]}
    makers = {"ensemble": partial(ensemble, F, H, *more)}
    for (name, kind), (policy, choices) in itertools.product(kinds.items(), POLICIES.items()):
        if name == "linear" or policy in ("default", "recovering", "adaptive"):
            key = name if policy == "default" else policy if name == "linear" else f"{policy} {name}"
            given = {**choices, "patience": patience} if policy == "recovering" else choices
            makers[key] = partial(of_matrices, kind, F, H, *more, **given, **options)
    return makers


def column(kf, z):
    """Shape a measurement like the filter's x, which is the form that filterpy wants beside H."""
    return np.reshape(z, (-1, 1)) if kf.x.ndim == 2 else np.ravel(z)


def with_(problem, **changes):
    """Return the problem with some of its matrices replaced."""
    return replace(problem, **changes)


def mild(dim_x=4, dim_z=2, seed=21):
    """A problem with H P H' < 1, where even unit scaling is a filter."""
    problem = random_problem(seed, dim_x, dim_z)
    return with_(problem, P=0.02 * problem.P, Q=0.02 * problem.Q, M=0.1 * problem.M, H=0.5 * problem.H)


def least_favorable(e, influence):
    """Logarithm of the least favorable density of a contamination, a normal one with exponential tails (paper 17)."""
    k, r = influence.threshold, np.abs(e)
    return np.log1p(-influence.contamination) - 0.5 * np.log(2 * np.pi) - np.where(r <= k, r * r / 2, k * r - k * k / 2)


def joint_jacobian(e, functions):
    """The Jacobian of w(|e|) e by central differences, its eigenvalues clipped to [0, 1]."""
    e = np.asarray(e, dtype=float)

    def field(v):
        return functions.weights(np.array([np.linalg.norm(v)])) * v

    h = 1e-6 * max(1.0, np.linalg.norm(e))
    jacobian = np.column_stack([(field(e + h * d) - field(e - h * d)) / (2 * h) for d in np.eye(len(e))])
    values, vectors = np.linalg.eigh((jacobian + jacobian.T) / 2)
    return vectors @ np.diag(np.clip(values, 0, 1)) @ vectors.T


def reference_correction(
    x, P, z, H, R, functions, *, scaling="innovation", information="realized", grouping="component", M=None
):
    """What a correction should give: one sensor or group after the other, the most plausible first, x as a 1-D array.

    By updates of state and noise together, with a psi's functions as they are (`tests/influence` holds them to those
    of statsmodels). `whitened` is each sensor in its standard deviations given those before it,
    whatever the scaling, `log_det` the sum of the logarithms of one over these deviations.
    """
    x, z = np.ravel(x).astype(float), np.ravel(z).astype(float)
    M = np.zeros((len(x), len(z))) if M is None else M
    n, m = len(x), len(z)
    S = H @ P @ H.T + H @ M + M.T @ H.T + R
    # State and noise together: sensor i is row i of A without any noise, whatever R and M are.
    A, moves = np.hstack([H, np.eye(m)]), np.concatenate([x, np.zeros(m)])
    whole = np.block([[P, M], [M.T, R]])
    e, weights, order, left = np.zeros(m), np.zeros(m), [], [[i] for i in range(m)]
    whitened, log_det = np.zeros(m), 0.0
    if grouping == "joint":
        left = [list(range(m))]
    while left:
        judged = []
        for group in left:
            rows = A[group]
            T = group_scaling(rows @ whole @ rows.T, scaling)
            judged.append((np.linalg.norm(T @ (z[group] - rows @ moves)), group, T, rows))
        size, group, T, rows = min(judged, key=lambda one: one[0])
        left.remove(group)
        order.append(group)
        e[group] = T @ (z[group] - rows @ moves)
        root = group_scaling(rows @ whole @ rows.T, "innovation")
        whitened[group], log_det = root @ (z[group] - rows @ moves), log_det + np.log(np.linalg.det(root))
        if len(group) > 1:
            weights[group] = float(functions.weights(np.array([size]))[0])
            D = {"weight": lambda: np.diag(weights), "realized": lambda: joint_jacobian(e, functions)}[information]()
        else:
            weights[group] = functions.weights(e[group])
            known = {"weight": weights[group][0], "realized": np.clip(functions.psi_deriv(e[group])[0], 0, 1)}
            D = np.diag([expected_information(functions) if information == "expected" else known[information]])
        G = whole @ rows.T @ T.T
        moves, whole = moves + G @ (weights[group] * e[group]), whole - G @ D @ G.T
    T = np.zeros((m, m))
    plain = np.block([[P, M], [M.T, R]])
    lines = np.eye(m)
    for group in order:
        rows = A[group]
        t = group_scaling(rows @ plain @ rows.T, scaling)
        T[group] = t @ lines[:, group].T
        G = plain @ rows.T @ t.T
        lines = lines - T[group].T @ (A @ G).T
        plain = plain - G @ G.T
    C = P @ H.T + M
    return SimpleNamespace(
        x=moves[:n], P=whole[:n, :n], y=z - H @ x, e=e, S=S, T=T, K=C @ T.T @ T, weights=weights, prior=x,
        whitened=whitened, log_det=log_det,
    )  # fmt: skip


def group_scaling(S, scaling):
    """T of a group of sensors with covariance S."""
    if scaling == "unit":
        return np.eye(len(S))
    if scaling == "bounded":
        return np.eye(len(S)) / np.sqrt(max(np.linalg.eigvalsh(S)[-1], 1.0))
    return np.linalg.inv(np.linalg.cholesky(S))


def snapshot(kf, names=(*STATE, *CORRECTION, *ROBUST)):
    """Copy what a refused call must leave alone."""
    return visible(kf, names)


def contents(kf):
    """Return everything that the filter holds, copied."""
    kf.likelihood, kf.mahalanobis, kf.SI  # what is made when asked for  # noqa: B018
    return copy.deepcopy({**kf.__dict__, **{name: getattr(kf, name) for name in ("y", "S", "SI", "K", "e", "weights")}})


def assert_same_contents(found, expected):
    """Compare the contents of two filters to the last bit."""
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        if isinstance(value, (np.ndarray, int, float, tuple)):
            np.testing.assert_equal(found[name], value, err_msg=name)


def assert_same_state(robust, plain, names=(*STATE, "y", "K", "S", "SI"), rtol=1e-10):
    """Compare attribute by attribute."""
    for name in names:
        assert_close(getattr(robust, name), getattr(plain, name), rtol, name)


def predict_and_update(kf, z, **of_call):
    """Take the usual step, with what is passed to the update."""
    kf.predict()
    kf.update(z, **of_call)


def through(kf, zs):
    """Predict and update along measurements, and return x after each, flat."""
    path = []
    for z in zs:
        predict_and_update(kf, z)
        path.append(np.ravel(kf.x).copy())
    return np.array(path)


def by_loop(kf, zs, update_first=False, **per_step):
    """The loop that batch_filter stands for, matrices of each step by their names there: Fs, Qs, Hs, Rs, Bs, us."""
    shown = ([], [], [], [])
    for k, z in enumerate(zs):
        now = {name[:-1]: values[k] for name, values in per_step.items()}
        for step in ("update", "predict") if update_first else ("predict", "update"):
            if step == "predict":
                kf.predict(**{name: value for name, value in now.items() if name in "uBFQ"})
            else:
                kf.update(z, **{name: value for name, value in now.items() if name in "RH"})
            for column, value in zip(shown[2:] if step == "predict" else shown[:2], (kf.x, kf.P), strict=True):
                column.append(value.copy())
    return tuple(map(np.array, shown))


def assert_same_along(robust, plain, zs, step=predict_and_update, names=(*STATE, "y", "K", "S", "SI"), rtol=1e-10):
    """Compare after every step, attribute by attribute."""
    for k, z in enumerate(zs):
        for kf in (robust, plain):
            step(kf, z)
        for name in names:
            assert_close(getattr(robust, name), getattr(plain, name), rtol, f"step {k}: {name}")


def assert_positive_definite(P, what="P", size=0.0):
    """Finite, with a Cholesky factor, and symmetric but for rounding at the size that P has or had before."""
    assert np.all(np.isfinite(P)), f"{what}: {P}"
    np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-12 * max(size, np.abs(P).max()), err_msg=what)
    np.linalg.cholesky(P)


def assert_all_finite(kf):
    """Nothing that a user or a consumer can read is NaN or infinite."""
    for name in (*STATE, "y", "K", "S", "SI", "e", "weights", "T", "y_bounded"):
        assert np.all(np.isfinite(np.asarray(getattr(kf, name), dtype=float))), name
    for name in ("log_likelihood", "likelihood", "mahalanobis"):
        assert np.isfinite(getattr(kf, name)), name


def assert_corrected(kf, reference, rtol=1e-9):
    """Compare everything that the filter shows with the reference."""
    # A difference of numbers of the size of z.
    size = float(np.abs(np.asarray(kf.z, dtype=float)).max())
    for name in ("x", "y", "e", "weights"):
        assert_close(np.ravel(getattr(kf, name)), getattr(reference, name), rtol, name, size * (name in "ye"))
    for name in ("P", "S", "T", "K"):
        assert_close(getattr(kf, name), getattr(reference, name), rtol, name)
    assert_close(reference.prior + kf.K @ np.ravel(kf.y_bounded), reference.x, rtol, "K y_bounded", size)
    assert_close(kf.SI, np.linalg.inv(reference.S), rtol, "SI")
    length = np.sqrt(np.ravel(kf.y) @ np.linalg.solve(reference.S, np.ravel(kf.y)))
    np.testing.assert_allclose(kf.mahalanobis, length, rtol=1e-7)
    np.testing.assert_array_equal(kf.x_post, kf.x)
    for name in ("e", "weights", "clipped", "y_bounded"):
        assert getattr(kf, name).shape == kf.y.shape == (len(reference.y), 1)[: kf.x.ndim], name


SHOWN = (
    *STATE, "z", "y", "S", "SI", "K", "T", "e", "weights", "clipped", "y_bounded", "spread", "log_likelihood",
    "mahalanobis",
)  # fmt: skip


def shown(kf, *more):
    """What a filter shows, by name, with copies of other attributes."""
    found = {name: np.array(getattr(kf, name), dtype=float) for name in SHOWN}
    return found | {name: np.array(getattr(kf, name), dtype=float) for name in more}


def assert_alike(ours, theirs, rtol, looser=()):
    """Hold rows of attributes together, each in the size of its largest number; some as near as is said of them.

    What is learned of a sensor has numbers of many units: each is held on its own.
    """
    for k, (one, two) in enumerate(zip(ours, theirs, strict=True)):
        for name, b in two.items():
            a, near = np.nan_to_num(one[name], nan=-7.0), dict(looser).get(name, rtol)
            b = np.nan_to_num(b, nan=-7.0)
            assert a.shape == b.shape, (k, name)
            size = 1.0 + (np.abs(b) if name in ("_memory", "information") else np.abs(b).max(initial=0.0))
            assert np.all(np.abs(a - b) <= near * size), f"step {k}, {name}: {a} instead of {b}"


def served_by(monkeypatch, extension):
    """Let an extension serve; None: the definition, as where there is no compiler."""
    monkeypatch.setattr(kernel, "extension", lambda: extension)
    monkeypatch.setattr(shell, "_extension", extension)


def without_kernel(monkeypatch):
    """Let the definition serve."""
    served_by(monkeypatch, None)


def needs_kernel():
    """Skip a test of the kernel, or a file of them, where there is none."""
    if not kernel.available():
        pytest.skip("no kernel: python setup.py build_ext --inplace", allow_module_level=True)


def draws(few, many):
    """Give a test of a random claim `draws`, the number of its draws: on every commit, and at night."""
    return pytest.mark.parametrize("draws", [few, pytest.param(many, marks=pytest.mark.nightly)])


def by_night(values, *by_day):
    """Give the values of a parameter, of which all but some are for the night."""
    return [value if value in by_day else pytest.param(value, marks=pytest.mark.nightly) for value in values]


def paper_tracker(structure, **options):
    """The paper's recursion from the first sample: no start, no constant, R is 1 unless given."""
    own = {} if "filter" in options and not isinstance(options["filter"], type) else {"R": 1.0}
    return ParameterTracker(structure, **{"start": 0, **own, **options})


def paper_bank(n, structure, **options):
    """Such trackers for n actuators."""
    return TrackerBank(n, structure, **{"start": 0, "R": 1.0, **options})


def polar(x):
    """Range and bearing of a row or column state."""
    return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])


def polar_jacobian(x):
    """Return the derivative of range and bearing."""
    px, py = np.ravel(x)[[0, 2]]
    r = np.hypot(px, py)
    return np.array([[px / r, 0, py / r, 0], [-py / r**2, 0, px / r**2, 0]])


def wrapped(a, b):
    """Subtract; the difference of bearings is between -pi and pi."""
    y = a - b
    y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
    return y


def assert_close(actual, desired, rtol=1e-10, what="", size=0.0):
    """Assert that two arrays differ by little of the size of the whole array."""
    actual, desired = np.asarray(actual, dtype=float), np.asarray(desired, dtype=float)
    assert actual.shape == desired.shape, f"{what}: shape {actual.shape}, expected {desired.shape}"
    assert np.isfinite(actual).all(), f"{what}: NaN or infinity"
    scale = max(float(np.abs(desired).max(initial=0.0)), size, float(np.finfo(float).tiny))
    difference = float(np.abs(actual - desired).max(initial=0.0))
    assert difference <= rtol * scale, f"{what}: differs by {difference / scale:.3g} of its size"
