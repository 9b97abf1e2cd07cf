"""Compare smoothers under outliers of the measurement and of the process, with a convex solver, and in time.

Run ``python tests/benchmarks/smoother_study.py [--runs N] [--jobs J] [--seed S] [--table NAME]``; each table says which
problem, how many runs, and gives 95 % bootstrap intervals over the runs, which all smoothers share, and whether P is
right: the normalized estimation error squared (NEES) over n, and coverage of the region of .95. The table "convex"
needs cvxpy. Targets: cart, learnt 1.00 / 1.08 / 1.33 / 1.03; vehicle 1.12; convex, difference 1e-6 and 50 times faster;
speed, 6 compiled filter passes.
"""

from __future__ import annotations

import copy
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import filterpy.kalman
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from measuring import least_time
from outlier_problems import Recording, prepared, vehicle
from outlier_tables import print_tables
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
from studies import bootstrap_interval, monte_carlo, stacked
from studies import ratio as ratio_of_means

from robust_filterpy import (
    Contaminated,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    StudentT,
    TukeyBiweight,
    estimate_noise,
    smooth,
)
from robust_filterpy.correction import Scales
from robust_filterpy.influence import Linear
from robust_filterpy.smoothing import FixedLagSmoother, smooth_series

LABELS = "given the labels, RTS"
#: States and their covariances, None where a smoother gives none.
Path = tuple[np.ndarray, np.ndarray | None]
#: An error; the normalized estimation error squared over its mean, and the share of states within the region of .95.
Judged = np.ndarray


def path(smoothed: Any) -> Path:
    """Return the states of a smoother's result and their covariances."""
    return smoothed.x, smoothed.P


def distance(apart: np.ndarray) -> float:
    """Return the root mean square distance."""
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def judged(truth: np.ndarray, x: np.ndarray, P: np.ndarray | None, error: Callable[[np.ndarray], float]) -> Judged:
    """Return how far off a smoother is, and whether it knows that."""
    apart = x.reshape(truth.shape) - truth
    if P is None:
        return np.array([error(apart), np.nan, np.nan])
    squares = np.einsum("ki,ki->k", apart, np.linalg.solve(P, apart[..., None])[..., 0])
    n = truth.shape[1]
    return np.array([error(apart), squares.mean() / n, (squares < chi2.ppf(0.95, n)).mean()])


def cart(rng: np.random.Generator, contamination: float, scale: float, steps: int = 200) -> Recording:
    """Draw a point at constant velocity but for a small noise, whose position is measured with R = 1."""
    F, g = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([0.5, 1.0])
    x, truth = np.zeros(2), np.empty((steps, 2))
    for k in range(steps):
        x = truth[k] = F @ x + 0.1 * g * rng.normal()
    bad = rng.random(steps) < contamination
    zs = truth[:, :1] + (np.where(bad, scale, 1.0) * rng.normal(size=steps))[:, None]
    none = np.zeros(steps, dtype=bool)
    H, Q, P0 = np.array([[1.0, 0.0]]), 0.01 * np.outer(g, g), 10.0 * np.eye(2)
    return Recording(F, H, Q, np.eye(1), np.zeros(2), P0, truth, zs, none, bad)


def given(data: Recording, jumped: float, outlier: float) -> Path:
    """Return what the smoother makes of it that knows which noises are large, and how much."""
    Qs = data.Q * np.where(data.jumps, jumped**2, 1.0)[:, None, None]
    Rs = data.R * np.where(data.outliers, outlier**2, 1.0)[:, None, None]
    kf = KalmanFilter(len(data.x0), len(data.R))
    return path(smooth(exactly(kf, data), data.zs, influence=Linear(), Qs=Qs, Rs=Rs))


def exactly(kf: Any, data: Recording) -> Any:
    """Put the problem into a filter, with the initial state as sure as it is."""
    kf = prepared(kf, data)
    kf.P = data.P0.copy()
    return kf


def passed_and_smoothed(kf: Any, data: Recording) -> Path:
    """Return what the backward pass of Rauch, Tung and Striebel makes of a filter's estimates."""
    kf = prepared(kf, data)
    means, covariances, _, _ = kf.batch_filter(list(data.zs))
    return kf.rts_smoother(means, covariances)[:2]


def cart_trial(rng: np.random.Generator, contamination: float, scale: float) -> dict[str, Judged]:
    """Return each smoother's mean square error of the position, NEES and coverage."""
    data = cart(rng, contamination, scale)
    kf = exactly(RobustKalmanFilter(2, 1), data)
    live = FixedLagSmoother(2, 1)
    live.F, live.H, live.Q, live.x, live.P = data.F, data.H, data.Q, data.x0.copy(), data.P0.copy()
    states = {
        "Kalman + RTS": passed_and_smoothed(KalmanFilter(2, 1), data),
        "Huber filter + RTS": passed_and_smoothed(RobustKalmanFilter(2, 1), data),
        "Tukey filter + RTS": passed_and_smoothed(RobustKalmanFilter(2, 1, influence=TukeyBiweight()), data),
        "Student t(4) filter + RTS": passed_and_smoothed(RobustKalmanFilter(2, 1, influence=StudentT()), data),
        "smooth, Huber (convex optimum)": path(smooth(kf, data.zs, influence=Huber())),
        "smooth, Student t(4)": path(smooth(kf, data.zs, influence=StudentT())),
        "smooth, Tukey": path(smooth(kf, data.zs, influence=TukeyBiweight())),
        "smooth, learnt (default)": path(smooth(kf, data.zs)),
        "live, lag 20, learnt": (live.smooth_batch(data.zs, 20)[0], None),
        LABELS: given(data, 1.0, scale),
    }
    return {name: judged(data.truth, *one, lambda d: float(np.mean(d[:, 0] ** 2))) for name, one in states.items()}


def live_trial(rng: np.random.Generator, kind: str, factor: float, steps: int = 300) -> dict[str, np.ndarray]:
    """Return the root mean square error of the position of live smoothers with a lag of 8, R given `factor` times."""
    data = cart(rng, 0.1 if kind == "outliers" else 0.0, 10.0, steps)
    truth, noise = data.truth[:, 0], data.zs[:, 0] - data.truth[:, 0]
    if kind == "runs of 5":
        for start in rng.choice(steps - 5, 6, replace=False):
            noise[start : start + 5] *= 10.0
    if kind == "jumps":
        truth = truth + 30.0 * (np.arange(steps) // 100)
    zs, found = truth + noise, {}
    for name, cls, options in (
        ("filterpy's", filterpy.kalman.FixedLagSmoother, {}), ("FixedLagSmoother", FixedLagSmoother, {}),
        ("noise=Contaminated()", FixedLagSmoother, {"noise": Contaminated()}),
        ("influence=Huber()", FixedLagSmoother, {"influence": Huber()}),
    ):  # fmt: skip
        live = cls(2, 1, 8, **options)
        live.F, live.H, live.Q, live.R, live.P = data.F, data.H, data.Q, factor * data.R, data.P0.copy()
        live.x = np.zeros((2, 1))
        for z in zs:
            live.smooth(z)
        x = np.array(live.xSmooth)[:-8, 0, 0]
        found[name] = np.sqrt(np.mean((x - truth[:-8]) ** 2))
    return found


def live_table(runs: int, seed: int, jobs: int) -> None:
    """Print the error of live smoothers over that of filterpy's."""
    print(f"\nLive, lag 8, 300 steps, {runs} runs, seed {seed}: error over that of filterpy's, geometric mean\n")
    print("| recording | R given | filterpy's | default | Contaminated() | Huber() |\n|---|---|---|---|---|---|")
    for kind in ("clean", "outliers", "runs of 5", "jumps"):
        for factor in (1.0, 25.0, 0.04):
            trial = partial(live_trial, kind=kind, factor=factor)
            errors = np.log(np.column_stack(list(stacked(monte_carlo(trial, runs, seed, jobs)).values())))
            means = np.exp(errors.mean(axis=0))
            over = " | ".join(f"{mean / means[0]:.2f}" for mean in means[1:])
            print(f"| {kind} | {factor:g} times | {means[0]:.3f} | {over} |")


def vehicle_trial(rng: np.random.Generator, process: float, measurement: float) -> dict[str, Judged]:
    """Return each smoother's root mean square error of the state, NEES and coverage."""
    data = vehicle(rng, process, measurement, 1000)
    noise = {"noise": Contaminated(measurement, 10.0), "process": Contaminated(process, 10.0)}
    kf = exactly(RobustKalmanFilter(4, 2, grouping="joint"), data)
    states = {
        "Kalman + RTS": passed_and_smoothed(KalmanFilter(4, 2), data),
        "Huber filter + RTS": passed_and_smoothed(RobustKalmanFilter(4, 2, grouping="joint"), data),
        "noise-matched filter (given) + RTS": passed_and_smoothed(
            RobustKalmanFilter(4, 2, grouping="joint", **noise), data
        ),
        "two-sided filter + RTS": passed_and_smoothed(
            RobustKalmanFilter(4, 2, noise=Contaminated(), process=Scales((1, 10, 100), jump=0), grouping="joint"), data
        ),
        "smooth, Student t(4), both noises": path(smooth(kf, data.zs, influence=StudentT(), process=StudentT())),
        "smooth, learnt (default)": path(smooth(kf, data.zs)),
        "smooth, learnt, both noises": path(smooth(kf, data.zs, process=None)),
        LABELS: given(data, 10.0, 10.0),
    }
    return {name: judged(data.truth, *one, distance) for name, one in states.items()}


SIGMA = np.array([10.0, 0.005])


def polar(x: np.ndarray) -> np.ndarray:
    """Return range and bearing."""
    return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])


def polar_jacobian(x: np.ndarray) -> np.ndarray:
    """Return their derivative."""
    r2 = x[0] ** 2 + x[2] ** 2
    return np.array([[x[0] / r2**0.5, 0, x[2] / r2**0.5, 0], [-x[2] / r2, 0, x[0] / r2, 0]])


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Subtract; the bearing's difference is between -pi and pi."""
    y = a - b
    y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
    return y


def radar_trial(rng: np.random.Generator, contamination: float, steps: int = 200) -> dict[str, Judged]:
    """Return each smoother's root mean square error of the position: range and bearing with glint."""
    F = np.kron(np.eye(2), [[1.0, 0.5], [0.0, 1.0]])
    Q = 0.5 * np.kron(np.eye(2), [[0.5**3 / 3, 0.5**2 / 2], [0.5**2 / 2, 0.5]])
    x, truth = np.array([-2000.0, 20.0, 100.0, -5.0]), np.empty((steps, 4))
    for k in range(steps):
        x = truth[k] = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4)
    glint = rng.random(steps) < contamination
    zs = np.apply_along_axis(polar, 1, truth) + SIGMA * rng.normal(size=(steps, 2)) * np.where(glint, 15, 1)[:, None]
    zs[:, 1] = (zs[:, 1] + np.pi) % (2 * np.pi) - np.pi

    def ready(kf: Any) -> Any:
        kf.x, kf.P = np.array([-2000.0, 0.0, 100.0, 0.0]), np.diag([30.0, 10.0, 30.0, 10.0]) ** 2
        kf.Q, kf.R = Q.copy(), np.diag(SIGMA**2)
        return kf

    points = MerweScaledSigmaPoints(4, 0.1, 2.0, -1.0)
    extended = ready(ExtendedKalmanFilter(4, 2))
    extended.F = F
    unscented = ready(UnscentedKalmanFilter(4, 2, 0.5, polar, lambda x, dt: F @ x, points, residual_z=turned))
    functions: dict[str, Any] = {"HJacobian": polar_jacobian, "Hx": polar, "residual": turned}
    Rs = [np.diag(SIGMA**2) * (225.0 if bad else 1.0) for bad in glint]
    live = ready(RobustExtendedKalmanFilter(4, 2, grouping="joint"))
    live.F, means, covariances = F, [], []
    for z in zs:
        live.predict()
        live.update(z, polar_jacobian, polar, residual=turned)
        means.append(live.x)
        covariances.append(live.P)
    states = {
        "extended, Huber, filter": (np.array(means), np.array(covariances)),
        "extended, not robust": path(smooth(extended, zs, influence=Linear(), **functions)),
        "extended, Student t(4)": path(smooth(extended, zs, influence=StudentT(), grouping="joint", **functions)),
        "extended, learnt": path(smooth(extended, zs, grouping="joint", **functions)),
        "unscented, learnt": path(smooth(unscented, zs, grouping="joint")),
        LABELS: path(smooth(extended, zs, influence=Linear(), Rs=Rs, **functions)),
    }
    return {name: judged(truth, *one, lambda d: distance(d[:, [0, 2]])) for name, one in states.items()}


def ratios(title: str, trial: Callable[..., Any], runs: int, seed: int, jobs: int) -> None:
    """Print each smoother's error over that of the one that is given the labels, with its interval."""
    start = time.perf_counter()
    found = stacked(monte_carlo(trial, runs, seed, jobs))
    print(f"\n{title}\n{runs} runs, seed {seed}, {time.perf_counter() - start:.0f} s; error over that of: {LABELS}\n")
    print("| smoother | ratio | 95 % interval | NEES/n | coverage |\n|---|---|---|---|---|")
    for name, values in found.items():
        interval = bootstrap_interval((values[:, 0], found[LABELS][:, 0]), ratio_of_means, seed)
        nees, inside = np.mean(values[:, 1:], axis=0)
        spread = f"{interval.low:.3f} to {interval.high:.3f}"
        print(f"| {name} | {interval.estimate:.3f} | {spread} | {nees:.2f} | {inside:.3f} |")


def cart_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of measurement outliers."""
    for contamination, scale in ((0.0, 10.0), (0.1, 10.0), (0.3, 10.0), (0.1, 40.0)):
        title = f"Constant velocity, 200 steps, contamination {contamination}, scale {scale:g}: mean square of position"
        ratios(title, partial(cart_trial, contamination=contamination, scale=scale), runs, seed, jobs)


def vehicle_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of process outliers."""
    for process, measurement in ((0.1, 0.1), (0.02, 0.1), (0.0, 0.1), (0.0, 0.0)):
        title = f"Vehicle, outliers of process {process}, of measurement {measurement}, 1000 steps: RMSE of the state"
        ratios(title, partial(vehicle_trial, process=process, measurement=measurement), runs, seed, jobs)


def radar_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of nonlinear smoothers, the bearing passing through pi."""
    for contamination in (0.0, 0.15):
        title = f"Radar, range and bearing, 200 steps, glint {contamination}: RMSE of the position"
        ratios(title, partial(radar_trial, contamination=contamination), runs, seed, jobs)


def robust_kalman_problem(size: int, rng: np.random.Generator) -> dict[str, Any]:
    """Draw a problem as AlgoTune's task robust_kalman_filter describes it, x0 known."""
    steps, few, states = 2 * size, size // 10 + 2, size // 5 + 4
    A = rng.normal(size=(states, states))
    A /= np.abs(np.linalg.eigvals(A)).max() + 0.05
    B, C, x0 = 0.5 * rng.normal(size=(states, few)), rng.normal(size=(few, states)), rng.normal(size=states)
    v = np.where(rng.random(steps) < 0.15, 5.0, 0.1)[:, None] * rng.normal(size=(steps, few))
    x, y = x0, np.empty((steps, few))
    for t in range(steps):
        y[t] = C @ x + v[t]
        x = A @ x + B @ (0.1 * rng.normal(size=few))
    return {"A": A, "B": B, "C": C, "y": y, "x0": x0, "tau": 1.0, "M": 3.0}


def by_cvxpy(given: dict[str, Any], **options: Any) -> np.ndarray:
    """Return the states by a generic convex solver, stated step by step."""
    import cvxpy as cp

    A, B, C, y = (given[name] for name in "ABCy")
    steps = len(y)
    x, w, v = cp.Variable((steps + 1, len(A))), cp.Variable((steps, B.shape[1])), cp.Variable(y.shape)
    loss = given["tau"] * cp.sum([cp.huber(cp.norm(v[t]), given["M"]) for t in range(steps)])
    rules = [x[0] == given["x0"]]
    for t in range(steps):
        rules += [x[t + 1] == A @ x[t] + B @ w[t], y[t] == C @ x[t] + v[t]]
    cp.Problem(cp.Minimize(cp.sum_squares(w) + loss), rules).solve(**options)
    return x.value


def by_smoothing(given: dict[str, Any]) -> np.ndarray:
    """Return the states by `smooth_series`; the first measurement is of a state that is known."""
    A, B, C, y = (given[name] for name in "ABCy")
    n, m = len(A), y.shape[1]
    R, influence = np.eye(m) / given["tau"], Huber(given["M"] * given["tau"] ** 0.5)
    found = smooth_series(
        y[None, 1:], A, C, B @ B.T, R, given["x0"], np.zeros((n, n)), influence=influence, grouping="joint"
    )
    assert found.converged.all()
    x = np.vstack([given["x0"], found.x[0]])
    return np.vstack([x, A @ x[-1]])


def objective(given: dict[str, Any], x: np.ndarray) -> float:
    """Return the cost of a path of states."""
    A, B, C, y = (given[name] for name in "ABCy")
    w = np.linalg.lstsq(B, (x[1:] - x[:-1] @ A.T).T, rcond=None)[0]
    length, M = np.linalg.norm(y - x[:-1] @ C.T, axis=1), given["M"]
    return float((w**2).sum() + given["tau"] * np.where(length <= M, length**2, 2 * M * length - M**2).sum())


def convex_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of a generic convex solver: the same optimum, and how much faster."""
    print("\nAlgoTune's robust_kalman_filter (x0 known, Q = B B' singular, Huber of the length of v): ours and cvxpy's")
    print("excess: cost over the solver's, relative; difference: largest of a state, solver at tolerance 1e-12\n")
    print("| size | excess | difference | cvxpy, ms | smooth_series, ms | times faster |\n|---|---|---|---|---|---|")
    for size in (10, 20, 40):
        excess, apart, theirs, ours = [], [], [], []
        for run in range(min(runs, 10)):
            given = robust_kalman_problem(size, np.random.default_rng([seed, size, run]))
            by_smoothing(given)
            ours.append(least_time(lambda given=given: by_smoothing(given), 5))
            theirs.append(least_time(lambda given=given: by_cvxpy(given), 2))
            x = by_smoothing(given)
            tight = by_cvxpy(given, solver="CLARABEL", tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
            apart.append(np.abs(x - tight).max())
            excess.append(objective(given, x) / objective(given, tight) - 1.0)
        ratio = bootstrap_interval((np.array(theirs), np.array(ours)), ratio_of_means, seed)
        print(
            f"| {size} | {np.max(excess):.1e} | {np.max(apart):.1e} | {1e3 * np.mean(theirs):.0f} "
            f"| {1e3 * np.mean(ours):.2f} | {ratio.estimate:.0f} ({ratio.low:.0f} to {ratio.high:.0f}) |"
        )


def speed_table(runs: int, seed: int, jobs: int) -> None:
    """Print how long smoothing takes, in passes of the filter."""
    steps, rng = 100_000, np.random.default_rng(seed)
    F, g = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2)), 0.1 * np.kron([[0.5], [1.0]], np.eye(2))
    kf = RobustKalmanFilter(4, 2)
    kf.F, kf.H, kf.Q, kf.P, kf.x = F, np.eye(2, 4), g @ g.T, 10.0 * np.eye(4), np.zeros(4)
    x, truth = np.zeros(4), np.empty((steps, 4))
    for k in range(steps):
        x = truth[k] = F @ x + g @ rng.normal(size=2)
    noise = rng.normal(size=(steps, 2))
    print(f"\nSmoothing {steps} steps, 4 states and 2 sensors, in passes of the filter, least of many turns\n")
    print("| contamination | smoother | passes | sweeps | ms |\n|---|---|---|---|---|")
    for contamination in (0.0, 0.1, 0.3):
        zs = truth[:, :2] + noise * np.where(rng.random((steps, 2)) < contamination, 10.0, 1.0)
        smoothers: dict[str, dict[str, Any]] = {
            "learnt (default)": {},
            "learnt, joint": {"grouping": "joint"},
            "Huber": {"influence": Huber()},
            "Student t(4)": {"influence": StudentT()},
            "Linear": {"influence": Linear()},
        }
        durations: dict[str, list[float]] = {name: [] for name in ("filter", *smoothers)}
        sweeps = {name: smooth(kf, zs, **options).sweeps for name, options in smoothers.items()}
        for _ in range(max(runs // 10, 3)):
            durations["filter"].append(least_time(lambda zs=zs: copy.deepcopy(kf).batch_filter(zs), 2))
            for name, options in smoothers.items():
                durations[name].append(least_time(lambda zs=zs, options=options: smooth(kf, zs, **options), 1))
        one = min(durations["filter"])
        for name in smoothers:
            least = min(durations[name])
            print(f"| {contamination} | {name} | {least / one:.1f} | {sweeps[name]} | {1e3 * least:.0f} |")


def wrong_noise_table(runs: int, seed: int, jobs: int) -> None:
    """Print what R or Q given ten times wrong costs, whether it is said, and what fitting them first saves."""
    print("\nThe cart, 400 steps, 10 % outliers of ten times the size, R and Q given wrong: squared error of")
    print("the position over that of the smoother given the labels; coverage of the region of .95; also after a fit\n")
    print("| given | error | coverage | said, runs | error, fitted first | coverage |\n|---|---|---|---|---|---|")
    for name, r, q in (("right", 1, 1), ("R / 10", 0.1, 1), ("R x 10", 10, 1), ("Q / 10", 1, 0.1), ("Q x 10", 1, 10)):
        errors, inside, said = np.zeros((3, runs)), np.zeros((2, runs)), 0
        for run in range(runs):
            data = cart(np.random.default_rng([seed, run]), 0.1, 10.0, 400)
            kf = exactly(RobustKalmanFilter(2, 1), data)
            kf.R, kf.Q = r * data.R, q * data.Q
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = [smooth(kf, data.zs), smooth(estimate_noise(kf, data.zs).apply(copy.deepcopy(kf)), data.zs)]
            said += "do not fit" in found[0].message
            off = np.array([x[:, 0] - data.truth[:, 0] for x in (*(each.x for each in found), given(data, 1.0, 10.0))])
            errors[:, run] = (off**2).mean(axis=1)
            variances = np.array([each.P[:, 0, 0] for each in found])
            inside[:, run] = (off[:2] ** 2 < 3.841 * variances).mean(axis=1)
        error, covered = errors.mean(axis=1) / errors[2].mean(), inside.mean(axis=1)
        print(
            f"| {name} | {error[0]:.2f} | {covered[0]:.2f} | {said} of {runs} | {error[1]:.2f} | {covered[1]:.2f} |",
            flush=True,
        )


def bad_input_table(runs: int, seed: int, jobs: int) -> None:
    """Print what is said of input that is bad, and of a search that does not end."""
    data = cart(np.random.default_rng(seed), 0.1, 10.0)
    kf = exactly(RobustKalmanFilter(2, 1), data)

    def changed(**attributes: Any) -> Any:
        other = copy.deepcopy(kf)
        for name, value in attributes.items():
            setattr(other, name, value)
        return other

    infinite = data.zs.copy()
    infinite[7] = np.inf
    calls: dict[str, Callable[[], Any]] = {
        "an infinite measurement": lambda: smooth(kf, infinite),
        "measurements of two numbers": lambda: smooth(kf, np.zeros((50, 2))),
        "no measurements": lambda: smooth(kf, []),
        "all missing": lambda: smooth(kf, [None] * 20),
        "R = 0": lambda: smooth(changed(R=np.zeros((1, 1))), data.zs),
        "Q with a negative variance": lambda: smooth(changed(Q=-np.eye(2)), data.zs),
        "too few Fs": lambda: smooth(kf, data.zs, Fs=[kf.F] * 5),
        "influence without weights": lambda: smooth(kf, data.zs, influence=np.sin),
        "unstable F": lambda: smooth(changed(F=9.0 * np.eye(2), H=np.zeros((1, 2))), np.zeros(2000)),
        "a fading memory": lambda: smooth(changed(alpha=1.01), data.zs),
        "extended filter without its functions": lambda: smooth(ExtendedKalmanFilter(2, 1), data.zs),
        "measurements of 1e300": lambda: smooth(kf, np.where(np.arange(200)[:, None] % 9 == 0, 1e300, data.zs)),
        "R a hundred times too small": lambda: smooth(changed(R=0.01 * np.eye(1)), data.zs),
        "one sweep only": lambda: smooth(kf, data.zs, max_sweeps=1),
        "three sweeps only, Tukey": lambda: smooth(kf, data.zs, influence=TukeyBiweight(), max_sweeps=3),
    }
    print("\n| input | answer |\n|---|---|")
    for name, call in calls.items():
        try:
            found = call()
            rms = np.sqrt(np.mean((found.x[: len(data.truth), 0] - data.truth[: len(found.x), 0]) ** 2))
            answer = f"converged={found.converged}: {found.message}; error {rms:.2f}"
        except (TypeError, ValueError, np.linalg.LinAlgError) as error:
            answer = f"{type(error).__name__}: {error}"
        print(f"| {name} | {answer} |")


TABLES = {
    "cart": (cart_table, 100),
    "live": (live_table, 20),
    "vehicle": (vehicle_table, 20),
    "radar": (radar_table, 20),
    "convex": (convex_table, 10),
    "speed": (speed_table, 50),
    "wrong noise": (wrong_noise_table, 10),
    "bad input": (bad_input_table, 1),
}


if __name__ == "__main__":
    print_tables(TABLES, __doc__)
