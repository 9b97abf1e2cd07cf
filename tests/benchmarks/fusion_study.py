"""Tables of sensors in time: what late data cost and gain, and how fast a recording is read.

python tests/benchmarks/fusion_study.py [speed] [late] [--runs 5] [--readings 200000]
"""

import argparse
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy.fusion import Fusion, Scales, Sensor, constant_acceleration, constant_velocity
from robust_filterpy.influence import Huber, Linear

POLICIES = {
    "Linear": {"influence": Linear()},
    "Huber": {"influence": Huber()},
    "noise learnt, Q trusted": {"process": Scales((1.0,), jump=0.0)},
    "noise learnt, Q doubted": {},
}
RATES = {"a": 10.0, "b": 20.0, "c": 5.0}
ROWS = {"a": [1.0, 0.0, 0.0], "b": [0.0, 1.0, 0.0], "c": [0.0, 1.0, 1.0]}


def speed(args):
    """Time for a reading by `run`, over that of the loop that everybody writes."""
    rng = np.random.default_rng(0)
    length = args.readings / sum(RATES.values())
    stamps = [np.unique(np.round(rng.uniform(0.0, length, int(length * rate)), 4)) for rate in RATES.values()]
    t, who = np.concatenate(stamps), np.repeat(list(RATES), [len(s) for s in stamps])
    z = rng.normal(size=len(t))
    kf, before, order = KalmanFilter(3, 1), 0.0, np.argsort(t)[:20000]
    kf.P *= 100.0
    H, R = {name: np.array([row]) for name, row in ROWS.items()}, np.eye(1)
    begun = time.perf_counter()
    for i in order:
        dt, before = t[i] - before, t[i]
        F = np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
        Q = 0.5 * np.array(
            [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
        )
        kf.predict(F=F, Q=Q)
        kf.update(z[i], R=R, H=H[who[i]])
    loop = (time.perf_counter() - begun) / len(order)
    print(f"filterpy's loop {1e6 * loop:.1f} us a reading; {len(t)} readings of 3 sensors by run:")
    table = {"time": t, "sensor": who, "value": z}
    for name, policy in POLICIES.items():
        sensors = {sensor: Sensor(row, R=1.0) for sensor, row in ROWS.items()}
        fusion = Fusion(constant_acceleration(1, 0.5), sensors, 1.0, P0=100.0 * np.eye(3), **policy)
        begun = time.perf_counter()
        fusion.run(table)
        each = (time.perf_counter() - begun) / len(t)
        print(f"  {name:26s} {1e6 * each:6.2f} us, ratio {each / loop:.3f}")


def recording(seed, length=120.0):
    """A point on a line; position from a noisy sensor at 10 Hz and a good one at 5 Hz, speed at 20 Hz."""
    rng, motion = np.random.default_rng(seed), constant_velocity(1, 1.0)
    rates, rows, sigma = (
        {"far": 10, "near": 5, "speed": 20},
        {"far": [1.0, 0.0], "near": [1.0, 0.0], "speed": [0.0, 1.0]},
        {"far": 3.0, "near": 0.3, "speed": 0.3},
    )
    events = sorted((float(t), name) for name, f in rates.items() for t in rng.uniform(0, length, int(length * f)))
    x, before, truth, readings = np.array([0.0, 1.0]), 0.0, [], []
    for t, name in events:
        F, Q, _ = motion.matrices(t - before)
        x, before = rng.multivariate_normal(F @ x, Q), t
        truth.append(x[0])
        readings.append((name, t, rows[name] @ x + sigma[name] * rng.normal()))
    sensors = {name: Sensor(rows[name], R=sigma[name] ** 2) for name in rates}
    return motion, sensors, readings, np.array(truth)


def late(args):
    """Position error over no delay, at the moment each reading arrives, and steps taken over those in order."""
    print(
        f"late by up to 20 readings, {args.runs} runs: steps over in order; position RMSE over no delay when late ones"
    )
    print("are replayed, dropped, used as if on time")
    for title, share, only in (
        ("1 % late", 0.01, None),
        ("5 % late", 0.05, None),
        ("20 % late", 0.2, None),
        ("best late", 1.0, "near"),
    ):
        errors, steps = {name: 0.0 for name in ("no delay", "replayed", "dropped", "as if on time")}, []
        for seed in range(args.runs):
            motion, sensors, readings, truth = recording(seed)
            rng = np.random.default_rng(1000 + seed)
            chosen = (rng.random(len(readings)) < share) & [only in (None, r[0]) for r in readings]
            places = np.arange(len(readings)) + np.where(chosen, rng.integers(1, 21, len(readings)), 0) + chosen * 0.5
            order = np.argsort(places, kind="stable")
            where = {t: at for (_, t, _), at in zip(readings, truth, strict=True)}
            for how in errors:
                fusion = Fusion(motion, sensors, 5.0, influence=Linear(), P0=100.0 * np.eye(2))
                line, newest = fusion._timeline, 0.0
                judged, inner = [0], line._judge
                line._judge = lambda i, judged=judged, inner=inner: (judged.__setitem__(0, judged[0] + 1), inner(i))
                for place in range(len(readings)) if how == "no delay" else order.tolist():
                    name, t, z = readings[place]
                    behind, newest = t < newest, max(t, newest)
                    if not (behind and how == "dropped"):
                        fusion.observe(name, newest + 1e-9 * place if behind and how == "as if on time" else t, z)
                    errors[how] += (fusion.estimate().x[0] - where[newest]) ** 2
                if how == "replayed":
                    steps.append(judged[0] / len(readings))
        base = errors["no delay"]
        print(
            f"  {title:10s} {np.mean(steps):5.2f}   "
            + "  ".join(f"{name} {np.sqrt(error / base):.2f}" for name, error in errors.items() if name != "no delay")
        )


TABLES = {"speed": speed, "late": late}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--readings", type=int, default=200_000)
    arguments = parser.parse_args()
    for name in arguments.tables or TABLES:
        TABLES[name](arguments)
