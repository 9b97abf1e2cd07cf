"""The traps of learnt noise: recordings on which a filter that learns everything may be worse than one that does not.

Run ``python tests/benchmarks/adaptive_traps.py [--runs N] [--seed S] [--rows A B] [--write-page]``. Each row has a
figure and what it is aimed at: a root mean square error over that of the Kalman filter given the covariances of every
step (where the noise has a colour: given R and Q), the share of states within the 95 % region, or steps until the
estimate is back; with each the adaptive filter's NEES over n and coverage. --rows makes those from A to before B;
--write-page puts all of them into docs/learnt_noise.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from measuring import on_page
from scipy.stats import chi2
from statsmodels.robust.norms import TrimmedMean

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.correction import Scales
from robust_filterpy.filters.conversion import AdaptiveKalmanFilter

STEPS, FROM = 600, 100


class Named(AdaptiveKalmanFilter):
    """`update` says whose reading each is, where two take turns."""

    def batch_filter(self, zs: Any, *given: Any, **named: Any) -> Any:
        """Filter by `predict` and `update`."""
        steps = []
        for k, z in enumerate(zs):
            self.predict()
            self.update(z, sensor=k % 2)
            steps.append((self.x, self.P))
        return tuple(map(np.array, zip(*steps, strict=True)))


FILTERS: dict[str, Callable[[int, int], Any]] = {
    "adaptive": AdaptiveKalmanFilter,
    "Kalman": KalmanFilter,
    "default": RobustKalmanFilter,
}
#: What a user may set, or take instead, in the rows that ask for it.
OPTIONS: dict[str, Callable[[int, int], Any]] = {
    "a gate at three S": partial(RobustKalmanFilter, influence=TrimmedMean(3.0), scaling="innovation"),
    '`grouping="joint"`': partial(AdaptiveKalmanFilter, grouping="joint"),
    "`process=Scales(jump=1e-4)`": partial(AdaptiveKalmanFilter, process=Scales(jump=1e-4)),
    "`process=Scales((1, 30, 900), dwell=20)`": partial(AdaptiveKalmanFilter, process=Scales((1, 30, 900), dwell=20)),
    "`update(z, sensor=k % 2)`": Named,
}
GATE, JOINT, JUMPS, STEPPING, NAMED = OPTIONS


class Trap(NamedTuple):
    """What a filter is given, the truth, and the covariances of each step for the filter that knows them."""

    F: np.ndarray
    H: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    x0: np.ndarray
    P0: np.ndarray
    truth: np.ndarray
    """States, shape (N, n)."""
    zs: np.ndarray
    """Measurements, shape (N, m)."""
    Qs: np.ndarray
    """True covariances of the process noise, shape (N, n, n)."""
    Rs: np.ndarray
    """True covariances of the measurement noise, shape (N, m, m)."""


def _states(g: np.random.Generator, F: np.ndarray, roots: np.ndarray, x: np.ndarray, steps: int) -> np.ndarray:
    """Return states that start at x; roots (steps, n, k) are roots of the covariances of the process noise."""
    truth = np.empty((steps, len(x)))
    for k in range(steps):
        x = truth[k] = F @ x + roots[k] @ g.standard_normal(roots.shape[2])
    return truth


def moving(
    g: np.random.Generator, sigmas: Any, sensors: int = 1, steps: int = STEPS, axes: int = 1, w: Any = 1.0,
    begin: float = 0.0,
) -> Trap:  # fmt: skip
    """Return axes that move with nearly constant velocity; sigmas of the shape (steps, sensors), one axis a sensor."""
    root = np.kron(np.eye(axes), 0.1 * np.array([[0.5], [1.0]]))
    roots = np.broadcast_to(w, steps)[:, None, None] * root
    F, H = np.kron(np.eye(axes), [[1.0, 1.0], [0.0, 1.0]]), np.zeros((sensors, 2 * axes))
    H[np.arange(sensors), 2 * (np.arange(sensors) % axes)] = 1.0
    x = np.zeros(2 * axes)
    x[0] = begin
    truth = _states(g, F, roots, x, steps)
    sigmas = np.broadcast_to(sigmas, (steps, sensors))
    zs = truth @ H.T + sigmas * g.standard_normal((steps, sensors))
    Rs = sigmas[:, :, None] ** 2 * np.eye(sensors)
    return Trap(F, H, root @ root.T, np.eye(sensors), np.zeros(2 * axes), 10.0 * np.eye(2 * axes), truth, zs,
                roots @ np.swapaxes(roots, 1, 2), Rs)  # fmt: skip


def mixed(g: np.random.Generator, share: float = 0.1, scale: float = 10.0, size: Any = (STEPS, 1)) -> np.ndarray:
    """Return sizes of noise of which a share is larger."""
    return np.where(g.random(size) < share, scale, 1.0)


def in_turn(seed: int) -> Trap:
    """Two sensors of one position take turns, with sigma 5 and .1, both given 1; the rows of the other are NaN."""
    g = np.random.default_rng(seed)
    trap = moving(g, [5.0, 0.1], 2)
    trap.zs[::2, 1] = trap.zs[1::2, 0] = np.nan
    return trap


def one_row(seed: int) -> Trap:
    """The same readings through one row: the filter cannot know whose they are."""
    trap = in_turn(seed)
    turn = np.arange(STEPS) % 2
    rows = np.arange(STEPS)
    return trap._replace(H=trap.H[:1], R=trap.R[:1, :1], zs=trap.zs[rows, turn][:, None],
                         Rs=trap.Rs[rows, turn, turn][:, None, None])  # fmt: skip


def coloured(seed: int, sensors: int, lag: float) -> Trap:
    """Sensors of one position whose noise is a first-order autoregression of variance R, each with its own."""
    g = np.random.default_rng(seed)
    trap = moving(g, 0.0, sensors)
    zs = trap.zs + _autoregression(g, lag, sensors)
    return trap._replace(zs=zs, Rs=np.tile(np.eye(sensors), (STEPS, 1, 1)))


def _autoregression(g: np.random.Generator, lag: float, sensors: int) -> np.ndarray:
    """Return noise of variance 1 with a lag-one correlation, shape (STEPS, sensors)."""
    v = g.standard_normal((STEPS, sensors))
    for k in range(1, STEPS):
        v[k] = lag * v[k - 1] + np.sqrt(1.0 - lag * lag) * v[k]
    return v


def anchors(seed: int) -> Trap:
    """A walker among four far anchors: ranges with colored noise (.93), a tenth of the time delayed by walls."""
    g = np.random.default_rng(seed)
    angles = np.arange(4) * np.pi / 2 + 0.3
    H = np.zeros((4, 4))
    H[:, 0], H[:, 2] = np.cos(angles), np.sin(angles)
    trap = moving(g, 0.0, 1, axes=2)
    behind = np.zeros((STEPS, 4), dtype=bool)
    for k in range(1, STEPS):
        behind[k] = np.where(behind[k - 1], g.random(4) < 0.8, g.random(4) < 0.022)
    zs = trap.truth @ H.T + _autoregression(g, 0.93, 4) + behind * g.exponential(10.0, (STEPS, 4))
    Rs = np.where(behind, 200.0, 1.0)[:, :, None] * np.eye(4)
    return trap._replace(H=H, R=np.eye(4), zs=zs, Rs=Rs)


def together(seed: int) -> Trap:
    """Three sensors of one position, correlated .8, wrong together a tenth of the time."""
    g = np.random.default_rng(seed)
    sizes, R = mixed(g), np.full((3, 3), 0.8) + 0.2 * np.eye(3)
    trap = moving(g, 0.0, 3)
    zs = trap.zs + sizes * (g.standard_normal((STEPS, 3)) @ np.linalg.cholesky(R).T)
    return trap._replace(R=R, zs=zs, Rs=sizes[:, :, None] ** 2 * R)


def large_q(seed: int, factor: float) -> Trap:
    """Ten per cent outliers, Q given too large."""
    g = np.random.default_rng(seed)
    trap = moving(g, mixed(g))
    return trap._replace(Q=factor * trap.Q)


def level(seed: int) -> Trap:
    """A level that wanders, ten per cent outliers, R and Q both set to half the variance of the differences."""
    g = np.random.default_rng(seed)
    sizes, one = mixed(g), np.eye(1)
    truth = np.cumsum(0.3 * g.standard_normal((STEPS, 1)), axis=0)
    zs = truth + sizes * g.standard_normal((STEPS, 1))
    half = np.var(np.diff(zs[:, 0])) / 2.0 * one
    return Trap(one, one, half, half, np.zeros(1), one, truth, zs, np.tile(0.09 * one, (STEPS, 1, 1)),
                sizes[:, :, None] ** 2 * one)  # fmt: skip


def jumping(seed: int, size: float, every: int = 200, speed: float = 0.0) -> Trap:
    """The position, and the speed if asked, jumps at regular times, clean measurements."""
    g = np.random.default_rng(seed)
    trap = moving(g, 1.0)
    jumps, Qs = np.zeros((STEPS, 2)), trap.Qs.copy()
    at = np.arange(every, STEPS, every)
    jumps[at], Qs[at, 0, 0] = np.sign(g.standard_normal(len(at)))[:, None] * [size, speed], size * size
    Qs[at, 1, 1] += speed * speed
    for k in range(1, STEPS):
        jumps[k] += trap.F @ jumps[k - 1]
    return trap._replace(truth=trap.truth + jumps, zs=trap.zs + jumps[:, :1], Qs=Qs)


def wandering(seed: int) -> Trap:
    """One step in a hundred of the process is thirty times as large; sigma of the measurement wanders by three."""
    g = np.random.default_rng(seed)
    return moving(g, 3.0 ** np.sin(np.arange(STEPS) / 60.0)[:, None], w=mixed(g, 0.01, 30.0, STEPS))


def far_start(seed: int) -> Trap:
    """The first readings are 75 from where the filter believes to start, with P = I."""
    g = np.random.default_rng(seed)
    return moving(g, 1.0, begin=75.0)._replace(P0=np.eye(2))


def stuck(seed: int) -> Trap:
    """One sensor, and nothing else, says 0 for thirty samples in two hundred, far from where the state is."""
    g = np.random.default_rng(seed)
    trap = moving(g, 1.0, begin=3000.0)._replace(x0=np.array([3000.0, 0.0]))
    zs, Rs = trap.zs.copy(), trap.Rs.copy()
    for k in range(150, STEPS, 200):
        zs[k : k + 30], Rs[k : k + 30] = 0.0, 1e12
    return trap._replace(zs=zs, Rs=Rs)


def one_sided(seed: int) -> Trap:
    """Thirty in a hundred readings are too large by ten in the mean, never too small."""
    g = np.random.default_rng(seed)
    trap = moving(g, 1.0)
    bad = g.random((STEPS, 1)) < 0.3
    return trap._replace(zs=trap.zs + bad * g.exponential(10.0, (STEPS, 1)),
                         Rs=np.where(bad, 200.0, 1.0)[:, :, None])  # fmt: skip


def heavy(seed: int) -> Trap:
    """Two coordinates with Student's t of 2.01 degrees of freedom, as in the example of WoLF's paper."""
    g = np.random.default_rng(seed)
    # Both coordinates of one draw share its size.
    sizes = np.sqrt(2.01 / g.chisquare(2.01, (STEPS, 1)))
    return moving(g, np.tile(sizes, 2), 2, axes=2)


def boxes(seed: int, steps: int = 60) -> Trap:
    """A box of SORT in a crowd: seven states, its matrices as SORT tells them, begun at a first detection."""
    g = np.random.default_rng(seed)
    F, H = np.eye(7), np.eye(4, 7)
    F[[0, 1, 2], [4, 5, 6]] = 1.0
    Q, R, P = np.eye(7), np.diag([1.0, 1.0, 10.0, 10.0]), np.diag([10.0] * 4 + [1e4] * 3)
    Q[6, 6] *= 0.01
    Q[4:, 4:] *= 0.01
    true_q = np.diag([0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.0])
    sigmas = np.array([2.0, 2.0, 150.0, 0.01])
    speed = g.uniform(-8.0, 8.0, 2)
    truth = _states(g, F, np.tile(np.sqrt(true_q), (steps, 1, 1)),
                    np.array([500.0, 300.0, 3000.0, 0.4, *speed, 0.0]), steps)  # fmt: skip
    zs = truth @ H.T + sigmas * g.standard_normal((steps, 4))
    x0 = np.r_[zs[0], 0.0, 0.0, 0.0]
    return Trap(F, H, Q, R, x0, P, truth[1:], zs[1:], np.tile(true_q, (steps - 1, 1, 1)),
                np.tile(np.diag(sigmas**2), (steps - 1, 1, 1)))  # fmt: skip


def filtered(build: Callable[[int, int], Any], trap: Trap, knows: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return means and covariances; one that knows is given the covariances of every step."""
    kf = build(len(trap.x0), len(trap.R))
    kf.F, kf.H, kf.Q, kf.R, kf.x, kf.P = trap.F, trap.H, trap.Q, trap.R, trap.x0[:, None].copy(), trap.P0.copy()
    if build is not KalmanFilter:
        xs, Ps = kf.batch_filter(trap.zs)[:2]
        return xs[:, :, 0], Ps
    xs, Ps = np.empty(trap.truth.shape), np.empty((*trap.truth.shape, len(trap.x0)))
    for k, z in enumerate(trap.zs):
        kf.predict(Q=trap.Qs[k] if knows else None)
        seen = np.isfinite(z)
        if seen.all():
            kf.update(z, R=trap.Rs[k] if knows else None)
        elif seen.any():
            R = trap.Rs[k] if knows else trap.R
            kf.update(z[seen], R=R[np.ix_(seen, seen)], H=trap.H[seen])
        xs[k], Ps[k] = kf.x.ravel(), kf.P
    return xs, Ps


def error(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> float:
    """Return the root mean square error of the first coordinate."""
    return float(np.sqrt(np.mean((xs - trap.truth)[min(FROM, len(xs) // 10) :, 0] ** 2)))


def _squares(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> np.ndarray:
    """Return the square of each error in units of its covariance."""
    late = slice(min(FROM, len(xs) // 10), None)
    d = (xs - trap.truth)[late]
    return np.einsum("ki,ki->k", d, np.linalg.solve(Ps[late], d[..., None])[..., 0])


def coverage(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> float:
    """Return the share of states within the 95 % region."""
    return float(np.mean(_squares(trap, xs, Ps) < chi2.ppf(0.95, len(trap.x0))))


def nees(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> float:
    """Return the normalized estimation error squared over the number of states, 1 if P is right."""
    return float(np.mean(_squares(trap, xs, Ps)) / len(trap.x0))


def steps_back(trap: Trap, xs: np.ndarray, Ps: np.ndarray, at: int = 0) -> float:
    """Return how many steps pass from one on until five in a row are within three deviations of R."""
    calm = np.convolve(np.abs(xs - trap.truth)[at:, 0] < 3.0, np.ones(5), "valid") == 5.0
    return float(np.argmax(calm)) if calm.any() else np.inf


Measure = Callable[[Trap, np.ndarray, np.ndarray], float]
#: What it is called, how it is drawn, what is measured, what it is aimed at, and which option is tried too.
ROWS: list[tuple[str, Callable[[int], Trap], Measure, float, str | None]] = [
    ("sensors in turn, sigma 5 and .1, as NaN rows: error", in_turn, error, 1.15, None),
    ("the same through one row: error", one_row, error, 1.15, NAMED),
    ("colored .9, 2 sensors: error", partial(coloured, sensors=2, lag=0.9), error, 1.04, None),
    ("colored .98, 4 sensors: error", partial(coloured, sensors=4, lag=0.98), error, 1.15, None),
    ("the same: coverage", partial(coloured, sensors=4, lag=0.98), coverage, 0.75, None),
    ("ranges to anchors, colored .93, walls: error over the gate's", anchors, error, 0.97, GATE),
    ("the same: coverage", anchors, coverage, 0.5, None),
    ("3 sensors correlated .8 that fail together: error", together, error, 1.1, JOINT),
    ("Q given 10 times too large, outliers: error", partial(large_q, factor=10.0), error, 1.1, None),
    ("Q given 100 times too large, outliers: error", partial(large_q, factor=100.0), error, 1.1, None),
    ("level, R = Q = var(diff z)/2, outliers: error", level, error, 1.1, None),
    ("jumps of 30 every 200: error", partial(jumping, size=30.0), error, 13.0, JUMPS),
    ("jump of 100: steps until back", partial(jumping, size=100.0), partial(steps_back, at=200), 15.0, JUMPS),
    ("jump of 100, of 10 in speed: steps until back", partial(jumping, size=100.0, speed=10.0),
     partial(steps_back, at=200), 15.0, JUMPS),
    ("process steps of 30 in 1 %, R drifts: error", wandering, error, 1.8, STEPPING),
    ("start 75 away, P = I: steps until back", far_start, steps_back, 2.0, None),
    ("one sensor alone stuck at 0, 30 in 200: error", stuck, error, 3.0, GATE),
    ("one-sided, 30 %: coverage", one_sided, coverage, 0.88, None),
    ("SORT's box: error over filterpy's", boxes, error, 1.02, None),
    ("the same box for 400 steps: error over filterpy's", partial(boxes, steps=400), error, 1.1, None),
    ("Student's t, 2.01, two coordinates: error", heavy, error, 1.35, JOINT),
]  # fmt: skip


def row(
    draw: Callable[[int], Trap], measure: Measure, option: str | None, seeds: range, title: str
) -> tuple[dict[str, float], list[float]]:
    """Return everybody's figure, and the adaptive filter's NEES and coverage.

    A figure is a ratio of pooled errors, a mean share, or a median number of steps.
    """
    filters = {**FILTERS, **({option: OPTIONS[option]} if option else {})}
    found: dict[str, list[float]] = {name: [] for name in ["given all", *filters]}
    held = []
    for seed in seeds:
        trap = draw(seed)
        found["given all"].append(measure(trap, *filtered(KalmanFilter, trap, knows=True)))
        for name, build in filters.items():
            path = filtered(build, trap)
            found[name].append(measure(trap, *path))
            if name == "adaptive":
                held.append((nees(trap, *path), coverage(trap, *path)))
    kept = np.mean(held, axis=0).tolist()
    if measure is error:
        pooled = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in found.items()}
        over = pooled[GATE if "gate's" in title else "Kalman" if "filterpy's" in title else "given all"]
        return {name: value / over for name, value in pooled.items()}, kept
    middle = np.mean if measure is coverage else np.median
    return {name: float(middle(values)) for name, values in found.items()}, kept


def table(seeds: range, rows: slice) -> str:
    """Return all rows; a target is compared with the adaptive filter as it comes."""
    heads = ["trap", *FILTERS, "target", "", "NEES, 95 %", "compared with"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for title, draw, measure, target, option in ROWS[rows]:
        found, (worth, inside) = row(draw, measure, option, seeds, title)
        met = found["adaptive"] >= target if measure is coverage else found["adaptive"] <= target
        cells = [f"**{found[n]:.2f}**" if n == "adaptive" else f"{found[n]:.2f}" for n in FILTERS]
        tried = f"{found[option]:.2f}, {option}" if option else ""
        aim = f"{target:g} | {'met' if met else 'missed'} | {worth:.2f}, {inside:.2f}"
        lines.append(f"| {title} | {' | '.join(cells)} | {aim} | {tried} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=int, nargs=2, metavar=("A", "B"))
    parser.add_argument("--write-page", action="store_true")
    args = parser.parse_args(argv)
    if args.rows and args.write_page:
        parser.error("--write-page: expected all rows, got --rows; leave one of them out")
    made = table(range(args.seed, args.seed + args.runs), slice(*args.rows) if args.rows else slice(None))
    if args.write_page:
        on_page("learnt_noise.md", "traps", made)


if __name__ == "__main__":
    main()
