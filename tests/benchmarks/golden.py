"""Compare what every entry point of filters, batch, smoothing, fusion and fleet gives with what it gave before.

``python tests/benchmarks/golden.py write FILE`` with the code before (PYTHONPATH), ``.. compare FILE`` with the code
after: exit code 1 if a number differs by more than ``--tolerance`` (1e-12) of the largest of its array. Once more with
ROBUST_FILTERPY_KERNEL=off for the definition. Half a minute; ``--only PART`` takes the cases whose name has it.
"""

from __future__ import annotations

import argparse
import sys
import warnings

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints

import robust_filterpy as rf
from robust_filterpy import fleet, fusion, smoothing
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter
from robust_filterpy.influence.functions import Hampel, Linear, TukeyBiweight
from robust_filterpy.kalman import FixedLagSmoother

N = 80
LEARNT, TOLD = {"noise": "learnt", "process": "given"}, {"noise": Contaminated(0.1, 8.0)}
OPTIONS = {
    "default": {},
    "linear": {"influence": Linear()},
    "innovation": {"scaling": "innovation"},
    "unit": {"scaling": "bounded"},
    "expected": {"scaling": "innovation", "information": "expected"},
    "weight": {"information": "weight"},
    "hampel": {"influence": Hampel()},
    "tukey": {"influence": TukeyBiweight(), "scaling": "innovation"},
    "patience": {"influence": TukeyBiweight(), "patience": 4},
    "joint": {"grouping": "joint"},
    "groups": {"grouping": ((0, 1),)},
    "learnt": LEARNT,
    "learnt joint": {**LEARNT, "grouping": "joint"},
    "learnt groups": {**LEARNT, "grouping": ((0, 1),)},
    "told": TOLD,
    "told joint": {**TOLD, "grouping": "joint"},
    "told process": {**TOLD, "process": Contaminated(0.05, 10.0)},
    "told scales": {**TOLD, "process": "scales"},
    "adaptive": {**LEARNT, "process": "scales"},
    "adaptive joint": {**LEARNT, "process": "scales", "grouping": "joint"},
    "adaptive few": {"noise": Learnt(scales=(1.0, 50.0)), "process": Scales((1.0, 20.0), jump=0.0)},
}
SHOWN = ("x", "P", "weights", "e", "y_bounded", "S", "K", "T", "log_likelihood", "spread", "outlier_probability")
ALSO = ("R_learnt", "process_scale")


def recording(m: int, seed: int = 0) -> np.ndarray:
    """Return positions of something that turns, with outliers, gaps and a jump."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) * 0.1
    zs = np.stack([5.0 * np.cos(t), 5.0 * np.sin(t), 5.0 * np.cos(t)][:m], axis=1) + 0.3 * rng.normal(size=(N, m))
    zs[rng.random((N, m)) < 0.1] += 12.0
    zs[rng.random((N, m)) < 0.05] = np.nan
    zs[50:] += 3.0
    zs[20] = np.nan
    return zs


def filled(cls, m: int = 2, **options):
    """Return a filter of a point that moves in the plane."""
    kf = cls(4, m, dim_u=1, **options)
    kf.F = np.eye(4) + 0.1 * np.eye(4, k=2)
    kf.H = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0.1]])[:m]
    kf.Q, kf.R, kf.P = 0.02 * np.eye(4) + 0.01, 0.1 * np.eye(m) + 0.01, 10.0 * np.eye(4)
    kf.B = np.array([[0.0], [0], [0.1], [0.1]])
    return kf


def shown(kf) -> list:
    """Return what a filter shows, end to end."""
    each = [getattr(kf, name) for name in SHOWN] + [getattr(kf, name, None) for name in ALSO]
    return np.concatenate([np.ravel(np.asarray(value, dtype=float)) for value in each if value is not None])


def steps(kf, step) -> np.ndarray:
    """Return what a filter shows after each step."""
    rows = []
    for k in range(N):
        step(kf, k)
        rows.append(shown(kf))
    width = max(map(len, rows))
    return np.array([np.pad(row, (0, width - len(row)), constant_values=np.nan) for row in rows])


def walks():
    """Yield ways to take a step: name, number of sensors, function of filter and step."""
    rng = np.random.default_rng(3)
    M = 0.02 * rng.normal(size=(4, 2))
    three = recording(3, 5)
    turned = 0.1 * rng.normal(size=(N, 2, 4))

    def plain(kf, k, zs=recording(2)):
        kf.predict(u=0.1)
        kf.update(zs[k])

    def redundant(kf, k):
        kf.predict()
        kf.update(three[k])

    def passed(kf, k, zs=recording(2, 1)):
        kf.predict(F=kf.F * (1.0 + 0.01 * np.sin(k)), Q=kf.Q * (1 + k % 3))
        kf.update(zs[k], R=kf.R * (1 + k % 2), H=kf.H + turned[k] if k % 4 else kf.H[::-1].copy())

    def alternating(kf, k, zs=recording(2, 2)):
        kf.predict()
        kf.update(zs[k, k % 2], R=0.2, H=kf.H[[k % 2]])

    def named(kf, k, zs=recording(2, 6)):
        kf.predict()
        kf.update(zs[k], sensor="ab"[k % 2])

    def correlated(kf, k, zs=recording(2, 3)):
        kf.M = M
        kf.predict()
        kf.update_correlated(zs[k])

    def sequential(kf, k, zs=recording(2, 4)):
        kf.predict()
        kf.update_sequential(0, zs[k, 0])
        kf.update_sequential(1, zs[k, 1])

    def steady(kf, k, zs=recording(2, 7)):
        kf.predict() if k < 20 else kf.predict_steadystate()
        kf.update(zs[k]) if k < 19 else kf.update_steadystate(zs[k])

    yield from (
        ("plain", 2, plain), ("redundant", 3, redundant), ("passed", 2, passed), ("alternating", 2, alternating),
        ("named", 2, named), ("correlated", 2, correlated), ("sequential", 2, sequential), ("steady", 2, steady),
    )  # fmt: skip


def linear_cases():
    """Yield linear filters, step by step and over recordings."""
    for name, options in OPTIONS.items():
        for way, m, step in walks():
            if m == 3 and name.endswith("groups") and way != "redundant":
                continue
            yield f"{way} / {name}", lambda o=options, m=m, s=step: steps(filled(rf.RobustKalmanFilter, m, **o), s)
        for first in (False, True):
            yield f"batch_filter {first} / {name}", lambda o=options, f=first: np.concatenate([
                np.reshape(a, (N, -1))
                for a in filled(rf.RobustKalmanFilter, **o).batch_filter(
                    list(recording(2, 8)), us=0.1 * np.ones((N, 1)), update_first=f
                )
            ], axis=1)  # fmt: skip
        if "patience" not in options:
            yield f"filter_series / {name}", lambda o=options: series(o)


def series(options) -> np.ndarray:
    """Return what `filter_series` does, in two parts."""
    kf, zs = filled(rf.RobustKalmanFilter), np.stack([recording(2, s) for s in (8, 9, 10)])
    model = kf.F, kf.H, kf.Q, kf.R
    first = rf.filter_series(zs[:, :30], *model, np.zeros(4), 10.0 * np.eye(4), **options)
    second = rf.filter_series(zs[:, 30:], *model, state=first.state, **options)
    parts = [np.concatenate([a, b], axis=1) for a, b in ((first.x, second.x), (first.weights, second.weights))]
    return np.concatenate([np.ravel(a) for a in (*parts, first.log_likelihood, second.P, second.log_likelihood)])


def nonlinear_cases():
    """Yield filters of a range and a bearing."""
    rng = np.random.default_rng(11)
    t = np.arange(N) * 0.1
    truth = np.stack([20.0 + 3.0 * np.cos(t), 15.0 + 3.0 * np.sin(t)], axis=1)
    zs = np.stack([np.hypot(*truth.T), np.arctan2(truth[:, 1], truth[:, 0])], axis=1)
    zs += rng.normal(size=zs.shape) * (0.1, 0.01)
    zs[rng.random(N) < 0.1, 0] += 5.0
    zs[rng.random(N) < 0.1, 1] += 0.5
    F = np.eye(4) + 0.1 * np.eye(4, k=2)

    def h(x):
        x = np.ravel(x)
        return np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])])

    def jacobian(x):
        a, b = np.ravel(x)[:2]
        r = np.hypot(a, b)
        return np.array([[a / r, b / r, 0, 0], [-b / r**2, a / r**2, 0, 0]])

    def move(x, dt):
        return F @ x

    def extended(o):
        kf = rf.RobustExtendedKalmanFilter(4, 2, **o)
        kf.F = F
        return kf, lambda kf, k: (kf.predict(), kf.update(zs[k], jacobian, h))

    def unscented(o):
        kf = rf.RobustUnscentedKalmanFilter(4, 2, 0.1, h, move, MerweScaledSigmaPoints(4, 0.5, 2.0, -1.0), **o)
        return kf, lambda kf, k: (kf.predict(), kf.update(zs[k]))

    def cubature(o):
        return rf.filters.RobustCubatureKalmanFilter(4, 2, 0.1, h, move, **o), lambda kf, k: (
            kf.predict(),
            kf.update(zs[k]),
        )

    def ensemble(o):
        kf = RobustEnsembleKalmanFilter(
            np.array([22.0, 15, 0, 0]), np.eye(4), 2, 0.1, 40, h, move, rng=np.random.default_rng(3), **o
        )  # fmt: skip
        return kf, lambda kf, k: (kf.predict(), kf.update(zs[k]))

    def case(made, options):
        kf, step = made(options)
        kf.x, kf.P = np.array([22.0, 15.0, 0.0, 0.0]), np.diag([4.0, 4.0, 1.0, 1.0])
        kf.Q, kf.R = 0.01 * np.eye(4), np.diag([0.01, 1e-4])
        return steps(kf, step)

    for made in (extended, unscented, cubature, ensemble):
        for name in ("default", "innovation", "joint", "patience", "learnt", "learnt joint", "told", "told joint"):
            if made is not ensemble or name in ("default", "innovation", "joint"):
                yield f"{made.__name__} / {name}", lambda m=made, n=name: case(m, OPTIONS[n])


def others():
    """Yield smoothers, fusion, fleet."""
    for name in ("default", "learnt", "told", "adaptive", "tukey"):
        options = {k: v for k, v in OPTIONS[name].items() if k in ("noise", "process", "influence")}
        # A fusion that learns noise doubts Q.
        doubting = {k: v for k, v in options.items() if v != "given"}

        def fused(options=doubting):
            sensors = {
                "a": fusion.Sensor(H=[[1.0, 0, 0, 0], [0, 0, 1.0, 0]], R=0.1 * np.eye(2)),
                "b": fusion.Sensor(H=[[1.0, 0, 0, 0]], R=[[0.2]]),
            }
            f = fusion.Fusion(fusion.constant_velocity(2, 0.1), sensors, 1.0, x0=np.zeros(4), P0=10 * np.eye(4),
                              t0=0.0, **options)  # fmt: skip
            zs, rows = recording(2, 12), []
            for k in range(N):
                f.observe("a", 0.1 * k, zs[k])
                if k % 3 == 2:
                    f.observe("b", 0.1 * k - 0.15, zs[k - 1, :1])
                now = f.estimate()
                rows.append(np.concatenate([np.ravel(now.x), np.ravel(now.P)]))
            return np.array(rows)

        yield f"fusion / {name}", fused

        def stepped(options=options):
            kf = filled(rf.RobustKalmanFilter)
            model = fleet.FilterModel(filled(rf.RobustKalmanFilter, **options))
            state, rows = None, []
            for part in np.array_split(np.hstack([recording(2, 13), 0.1 * np.ones((N, 1))]), 7):
                state, out = fleet.step(model, state, part[:, : sum(model.widths)])
                rows.append(np.stack([np.asarray(out[c], dtype=float) for c in model.columns], axis=1))
            return np.concatenate([np.ravel(np.concatenate(rows)), np.ravel(kf.x)])

        yield f"fleet / {name}", stepped
    for name, options in {
        "default": {}, "joint": {"grouping": "joint"}, "tukey": {"influence": TukeyBiweight()},
    }.items():  # fmt: skip

        def smoothed(options=options):
            kf = filled(rf.RobustKalmanFilter)
            found = smoothing.smooth(kf, recording(2, 14), **options)
            return np.concatenate([np.ravel(found.x), np.ravel(found.P)])

        yield f"smooth / {name}", smoothed

    def lagged():
        kf = filled(rf.RobustKalmanFilter)
        s = FixedLagSmoother(4, 2, N=5)
        s.F, s.H, s.Q, s.R, s.P = kf.F, kf.H, kf.Q, kf.R, kf.P
        for z in recording(2, 15):
            s.smooth(z)
        return np.concatenate([np.ravel(x) for x in s.xSmooth])

    yield "fixed lag", lagged


def gathered(part: str) -> dict[str, np.ndarray]:
    """Return what each case gives; an error that it raises counts as its result."""
    found = {}
    for cases in (linear_cases(), nonlinear_cases(), others()):
        for name, case in cases:
            if part not in name:
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    found[name] = np.asarray(case(), dtype=float)
                except Exception as error:
                    found[name] = np.array(f"{type(error).__name__}: {error}")
    return found


def difference(before: np.ndarray, after: np.ndarray) -> float:
    """Return how far two results are apart, over the largest number of a column; NaN stands for itself."""
    if before.dtype.kind == "U" or after.dtype.kind == "U":
        return 0.0 if before.dtype == after.dtype and str(before) == str(after) else np.inf
    if before.shape != after.shape or not (np.isnan(before) == np.isnan(after)).all():
        return np.inf
    scale = np.nanmax(np.abs(before), initial=0.0) + 1e-300 if before.ndim < 2 else (
        np.nanmax(np.abs(np.where(np.isnan(before), 0.0, before)), axis=0, initial=0.0) + 1e-300
    )  # fmt: skip
    return float(np.nanmax(np.abs(before - after) / np.maximum(scale, 1e-9), initial=0.0))


def main() -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("write", "compare"))
    parser.add_argument("file")
    parser.add_argument("--only", default="", help="part of the names of the cases to take")
    parser.add_argument("--tolerance", type=float, default=1e-12)
    arguments = parser.parse_args()
    found = gathered(arguments.only)
    if arguments.action == "write":
        np.savez_compressed(arguments.file, **{name.replace("/", "|"): value for name, value in found.items()})
        errors = [f"{name}: {value}" for name, value in found.items() if value.dtype.kind == "U"]
        print(f"{len(found)} cases", *errors, sep="\n")
        return 0
    with np.load(arguments.file) as before:
        stored = {name.replace("|", "/"): before[name] for name in before.files}
    apart = {name: difference(stored[name], found[name]) for name in found if name in stored}
    for name, off in apart.items():
        if off > arguments.tolerance:
            print(f"{off:9.1e}  {name}" + (f": {found[name]}" if found[name].dtype.kind == "U" else ""))
    missing = sorted(set(found) ^ {name for name in stored if arguments.only in name})
    print(f"{len(apart)} cases compared, the farthest {max(apart.values(), default=0.0):.1e}", *missing)
    return int(bool(missing) or max(apart.values(), default=0.0) > arguments.tolerance)


if __name__ == "__main__":
    sys.exit(main())
