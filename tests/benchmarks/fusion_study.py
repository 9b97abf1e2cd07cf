"""Tables of sensors in time: late data, faults and false alarms, forecasts, speed.

python tests/benchmarks/fusion_study.py [speed] [late] [bounds] [verdicts] [false] [unknown] [forecasts] [doubts]
    [--runs 5] [--readings 200000]
"""

import argparse
import math
import time
from itertools import product

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy.fusion import (
    Contaminated,
    Fusion,
    Reacquisition,
    Scales,
    Sensor,
    constant_acceleration,
    constant_velocity,
)
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


SEEN = {"a": 10.0, "b": 5.0, "c": 20.0}


def redundant(seed, length, fault=None, size=0.0, onset=30.0, who="b"):
    """Three sensors of one place, sigma 1, of which one fails."""
    rng, motion = np.random.default_rng(seed), constant_velocity(1, 0.5)
    events = sorted(
        (float(t), name) for name, f in SEEN.items() for t in (np.arange(int(length * f)) + rng.uniform(0.2, 0.8)) / f
    )
    x, before, last, readings, colour = np.array([0.0, 1.0]), 0.0, 0.0, [], dict.fromkeys(SEEN, 0.0)
    for t, name in events:
        F, Q, _ = motion.matrices(t - before)
        more = 300.0 if fault == "manoeuvre" and t % 30.0 < 2.0 else 1.0
        x, before, v = rng.multivariate_normal(F @ x, more * Q), t, rng.normal()
        if fault == "coloured":
            colour[name] = v = 0.6 * colour[name] + 0.8 * v
        if fault == "true spikes" and rng.random() < 0.1:
            v *= 10.0
        z = x[0] + v
        if name == who and t > onset:
            if fault == "biased":
                z += size
            elif fault == "drifting":
                z += size * (t - onset)
            elif fault == "noisier":
                z = x[0] + size * v
            elif fault == "stuck":
                z = last
            elif fault == "spikes" and rng.random() < 0.3:
                z += rng.choice([-1.0, 1.0]) * size
        if name == who:
            last = z
        readings.append((name, t, z))
    return motion, readings


def watching(motion):
    """A fusion of these that is given everything and looks for faults."""
    sensors = {name: Sensor([1.0, 0.0], R=1.0) for name in SEEN}
    return Fusion(motion, sensors, 1.0, P0=100.0 * np.eye(2), watch=True)


# One false alarm in 10^5 readings: of a gate by chi-square with 1 degree, and of two sums (Siegmund's approximation).
GATE, SLACK, LIMIT = 4.417, 0.5, 10.35


def baselines(motion, readings):
    """When a gate and a CUSUM of each sensor's innovations, of a Kalman filter, first speak after 30 s, and of whom."""
    sums, first = {name: np.zeros(2) for name in SEEN}, {}
    for (name, t, _), y, spread in zip(readings, *innovations(motion, readings), strict=True):
        e = y / math.sqrt(spread + 1.0)
        sums[name] = np.maximum(0.0, sums[name] + np.array([e, -e]) - SLACK)
        over = {"gate": abs(e) > GATE, "CUSUM": sums[name].max() > LIMIT}
        if sums[name].max() > LIMIT:
            sums[name] = np.zeros(2)
        for rule in [rule for rule in over if over[rule] and t > 30.0]:
            first.setdefault(rule, (t - 30.0, name))
    return first


# Targets in seconds, mean over which sensor fails; outliers of healthy sensors as a fusion has learnt them by 30 s.
TARGETS = {
    "biased": {1.0: 2.9, 2.0: 0.75, 4.0: 0.3, 8.0: 0.2},
    "drifting": {0.1: 16.0, 0.2: 7.4, 0.4: 4.0, 0.8: 2.6},
    "noisier": {2.0: 1.7, 3.0: 0.35, 5.0: 0.2, 9.0: 0.2},
}
CLASSES, SHARES = np.array([1.0, 10.0, 100.0, 1000.0]), np.array([0.985, 0.009, 0.003, 0.003])


def density(e, spread, noise=1.0):
    """Of an innovation, under classes of noise."""
    variance = spread + noise * CLASSES
    return float((SHARES * np.exp(-0.5 * e * e / variance) / np.sqrt(2.0 * math.pi * variance)).sum())


def innovations(motion, readings):
    """Innovations of the Kalman filter given everything, and the variances of what it expected."""
    x, P, before, found = np.zeros(2), 100.0 * np.eye(2), 0.0, []
    for _, t, z in readings:
        F, Q, _ = motion.matrices(t - before)
        x, P, before = F @ x, F @ P @ F.T + Q, t
        found.append((z - x[0], P[0, 0]))
        K = P[:, 0] / (P[0, 0] + 1.0)
        x, P = x + K * (z - x[0]), P - np.outer(K, K) * (P[0, 0] + 1.0)
    return np.array(found).T


def possible(fault, size, runs):
    """Seconds that a fault takes at least, at one false alarm in 1e5 readings, mean over which sensor fails.

    First Lorden's bound, log(1e5) over the divergence of a reading: noise is normal. Then a CUSUM that is given who,
    what, how large and since when it might be: noise has outliers as learnt. Nobody is given as much.
    """
    enough, found = math.log(1e5), np.full((2, 3, runs), np.nan)
    for (i, who), seed in product(enumerate("bac"), range(runs)):
        motion, quiet = redundant(seed, 50.0)
        _, loud = redundant(seed, 50.0, fault, size, who=who)
        (e0, spread), (e, _) = innovations(motion, quiet), innovations(motion, loud)
        divergence, given = 0.0, 0.0
        for (name, t, _), healthy, now, p in zip(loud, e0, e, spread, strict=True):
            if t <= 30.0 or (fault == "noisier" and name != who):
                continue
            if fault == "noisier":
                ratio = (p + size**2) / (p + 1.0)
                divergence += 0.5 * (ratio - 1.0 - math.log(ratio))
                likely = density(now, p, size**2)
            else:
                divergence += 0.5 * (now - healthy) ** 2 / (p + 1.0)
                likely = density(healthy, p)
            given = max(given, 0.0) + math.log(likely / density(now, p))
            for k, much in enumerate((divergence, given)):
                if much >= enough and np.isnan(found[k, i, seed]):
                    found[k, i, seed] = t - 30.0
    return np.nanmedian(found, axis=2).mean(axis=1)


def bounds(args):
    """What is possible."""
    print(f"seconds to the alarm, mean over which sensor fails, at one false alarm in 1e5 readings, {args.runs} runs:")
    print("target, Lorden's bound (no outliers), a CUSUM given who, what and how large (outliers as learnt)")
    for fault in ("biased", "drifting", "noisier"):
        for size, target in TARGETS[fault].items():
            least, given = possible(fault, size, args.runs)
            print(f"  {fault:9s} {size:4.1f}  {target:5.2f}  {least:5.2f}  {given:5.2f}", flush=True)


def verdicts(args):
    """How long until an alarm, and what is said five seconds later; each of three sensors in turn fails."""
    print(f"one of three sensors of one place fails after 30 s, {args.runs} runs of each: median seconds to the alarm")
    print(
        "where it is that of 5, 10, 20 Hz, and their mean; share of runs with an alarm, of these with the right sensor"
    )
    print("and the right fault 5 s after it; gate and CUSUM: mean of the medians, right sensor")
    cases = [("biased", s) for s in (1.0, 2.0, 4.0, 8.0)] + [("drifting", s) for s in (0.1, 0.2, 0.4, 0.8)]
    cases += [("noisier", s) for s in (2.0, 3.0, 5.0, 9.0)] + [("stuck", 0.0), ("spikes", 4.0), ("spikes", 10.0)]
    sure, wrong = 0, 0
    for fault, size in cases:
        delays, sensor, right = {who: [] for who in "bac"}, 0, 0
        others = {"gate": {who: [] for who in "bac"}, "CUSUM": {who: [] for who in "bac"}}
        for seed, who in product(range(args.runs), "bac"):
            motion, readings = redundant(seed, 50.0, fault, size, who=who)
            for rule, one in baselines(motion, readings).items():
                others[rule][who].append(one)
            table = dict(zip(("sensor", "time", "value"), zip(*readings, strict=True), strict=True))
            said = [
                one for one in watching(motion).run(table).verdicts if one[1] != "motion" and one[2].fault != "silent"
            ]
            # What is said to be sure, the first time that it is said.
            firm = {(n, v.fault) for t, n, v in said if v.fault not in ("healthy", "departs")}
            sure, wrong = sure + len(firm), wrong + len(firm - {(who, fault)})
            alarm = next((t for t, _, v in said if t > 30.0 and v.fault != "healthy"), None)
            if alarm is not None:
                delays[who].append(alarm - 30.0)
                then = {name: v.fault for t, name, v in said if t <= alarm + 5.0}
                sensor += [name for name, what in then.items() if what != "healthy"] == [who]
                right += then.get(who) == fault
        each = [np.median(found or [np.nan]) for found in delays.values()]
        n = max(sum(map(len, delays.values())), 1)
        rules = "   ".join(
            f"{rule} {np.mean([np.median([t for t, _ in one] or [np.nan]) for one in got.values()]):6.2f} "
            f"{np.mean([named == who for who, one in got.items() for _, named in one] or [0]):.2f}"
            for rule, got in others.items()
        )
        print(
            f"  {fault:9s} {size:4.1f}  {' '.join(f'{one:5.2f}' for one in each)}  {np.mean(each):5.2f}   "
            f"{n / (3 * args.runs):.2f} {sensor / n:.2f} {right / n:.2f}   {rules}",
            flush=True,
        )
    print(f"  of {sure} verdicts with a probability of .95 or more {wrong} were wrong")


def false(args):
    """False alarms for 10^5 readings: of a sensor, and that the model is wrong."""
    print(f"false alarms for 1e5 readings, {args.runs} runs of 100 s (3,500 readings each):")
    for kind in (None, "coloured", "manoeuvre", "true spikes"):
        sensors, models, total = 0, 0, 0
        for seed in range(100, 100 + args.runs):
            motion, readings = redundant(seed, 100.0, kind)
            fusion, before = watching(motion), {}
            for name, t, z in readings:
                fusion.observe(name, t, z)
                found = {n: (v.fault != "healthy") for n, v in fusion.verdicts().items() if v.fault != "silent"}
                sensors += sum(found[n] and not before.get(n, False) for n in found if n != "motion")
                models += found["motion"] and not before.get("motion", False)
                before = found
            total += len(readings)
        print(
            f"  {kind or 'as learnt':12s} sensors {1e5 * sensors / total:6.1f}   model {1e5 * models / total:6.1f}",
            flush=True,
        )


MODELS = {"clean": (0.1, 1.0, 0.0), "10 % outliers": (0.1, 1.0, 0.1), "Q / 10, R * 10": (0.01, 10.0, 0.0)}
AHEAD, LEVELS, ORIGINS = np.array([1, 10, 50]), (0.5, 0.8, 0.95), np.arange(3000, 3960, 80)


def unknown(args):
    """What it costs that nobody tells R: one of three sensors is off by five deviations from the middle on."""
    print(
        f"90 s, the third sensor off from 45 s on: first verdict on it, s after; others accused; {args.runs} recordings"
    )
    deviations, periods = {"a": 0.5, "b": 1.0, "c": 0.8}, {"a": 1.0, "b": 0.25, "c": 0.5}
    for given in (True, False):
        after, accused = [], 0
        for seed in range(args.runs):
            rng, rows = np.random.default_rng(seed), {"time": [], "sensor": [], "value": []}
            for name, period in periods.items():
                stamps = np.arange(0.0, 90.0, period) + rng.uniform(0.0, 0.02, int(90.0 / period))
                off = 5.0 * (stamps > 45.0) if name == "c" else 0.0
                rows["time"].extend(stamps)
                rows["sensor"].extend([name] * len(stamps))
                rows["value"].extend(
                    20.0 * np.sin(stamps / 15.0) + deviations[name] * (rng.normal(size=len(stamps)) + off)
                )
            sensors = {name: Sensor([1.0, 0.0], R=sigma**2 if given else None) for name, sigma in deviations.items()}
            found = Fusion(constant_velocity(1, 0.5), sensors, 2.0, watch=True).run(rows)
            said = [(t, name) for t, name, one in found.verdicts if one.fault not in ("departs", "healthy")]
            after.append(min((t - 45.0 for t, name in said if name == "c" and t > 45.0), default=math.inf))
            accused += any(name != "c" for _, name in said)
        what = "given" if given else "not given"
        print(f"  R {what:8s} {', '.join(f'{t:.1f}' for t in after)}; others accused in {accused}", flush=True)


def oracle(spread, share, level):
    """Half the width of the band of a reading whose noise, of sd 1, and ten for a share, is given."""
    sd, low, high = np.sqrt([spread + 1.0, spread + 100.0]), 0.0, 40.0 * np.sqrt(spread + 1.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        held = np.dot([1.0 - share, share], [math.erf(middle / (s * math.sqrt(2.0))) for s in sd])
        low, high = (middle, high) if held < level else (low, middle)
    return high


def forecasts(args):
    """How often bands hold after 3,000 readings, for readings and for the signal, and how wide they are."""
    print(f"a point seen once a second, {args.runs} runs of {len(ORIGINS)} forecasts after 3,000 readings: share of")
    print("readings and of the signal inside, width of the readings' band over that of a filter given everything")
    print("  model            ahead   " + "   ".join(f"{level:4.2f} (signal) width" for level in LEVELS))
    F, Q, _ = constant_velocity(1, 0.1).matrices(1.0)
    for model, (q, R, share) in MODELS.items():
        inside, widths = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
        for seed in range(300, 300 + args.runs):
            rng, x, places = np.random.default_rng(seed), np.zeros(2), []
            for w in rng.multivariate_normal(np.zeros(2), Q, 4020):
                x = F @ x + w
                places.append(x[0])
            places = np.array(places)
            z = places + rng.normal(size=4020) * np.where(rng.random(4020) < share, 10.0, 1.0)
            sensors = {"gps": Sensor([1.0, 0.0], R=R)}
            fusion = Fusion(constant_velocity(1, q), sensors, 1.0, P0=100.0 * np.eye(2))
            given = {"noise": Contaminated(share, 10.0), "process": Scales((1.0,), jump=0.0)}
            given = Fusion(constant_velocity(1, 0.1), {"gps": Sensor([1.0, 0.0], R=1.0)}, 1.0, **given)
            for t in range(ORIGINS[-1] + 1):
                for one in (fusion, given):
                    one.observe("gps", float(t), z[t])
                if t not in ORIGINS:
                    continue
                spread = [given.estimate(float(t + h)).P[0, 0] for h in AHEAD]
                for k, level in enumerate(LEVELS):
                    found = fusion.forecast((t + AHEAD).astype(float), level)
                    for i, (band, values) in enumerate(((found.readings, z), (found.signal, places))):
                        low, high = band["gps"][:, 0].T
                        inside[i, :, k] += (low <= values[t + AHEAD]) & (values[t + AHEAD] <= high)
                        if not i:
                            widths[0, :, k] += high - low
                            widths[1, :, k] += [2.0 * oracle(one, share, level) for one in spread]
        inside /= args.runs * len(ORIGINS)
        for j, ahead in enumerate(AHEAD):
            cells = [
                f"{inside[0, j, k]:4.2f} ({inside[1, j, k]:4.2f})   {widths[0, j, k] / widths[1, j, k]:4.2f}"
                for k in range(len(LEVELS))
            ]
            print(f"  {model:16s} {ahead:4d}    " + "     ".join(cells), flush=True)


GPS = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
WHEEL = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
# Fixes end at 60 s and come back at 260 s; where something is wrong it is so for 100 fixes, which are 800 m off.
GONE, BACK, WRONG, OFF = 60, 260, 100, 800.0


def blackout(seed, case):
    """A vehicle in the plane, with fixes once a second (2 m) and odometry five times (.1 m/s): readings, and truth."""
    rng, motion = np.random.default_rng(seed), constant_velocity(2, 0.02)
    way = rng.uniform(0.0, 2.0 * math.pi)
    towards = np.array([math.cos(way), math.sin(way)])
    way += rng.uniform(-1.0, 1.0)
    x = np.array([0.0, 5.0 * math.cos(way), 0.0, 5.0 * math.sin(way)])
    F, Q, _ = motion.matrices(0.2)
    root, readings, truth, stands = np.linalg.cholesky(Q), [], {}, None
    for k in range(5 * (BACK + WRONG + 60)):
        t, x = 0.2 * k, F @ x + root @ rng.normal(size=4)
        amid = BACK <= t < BACK + WRONG
        # A slip that begins, and in the mirror ends, too slowly to be seen: 8 m/s for 100 s, or at its height.
        amount = np.interp(t, [GONE, 0.5 * (GONE + BACK), BACK], [0.0, 8.0, 0.0 if case == "mirror" else 8.0])
        slips = amount if case in ("mirror", "drifting") else 0.0
        odometry = x[[1, 3]] + 0.1 * rng.normal(size=2) - slips * towards
        readings.append(("odometry", t, odometry))
        if k % 5 == 0 and not GONE < t < BACK:
            place = x[[0, 2]]
            if amid and case == "cluster":
                place = place + OFF * towards
            elif amid and case == "standing":
                stands = place + OFF * towards if stands is None else stands
                place = stands
            readings.append(("gps", t, place + 2.0 * rng.normal(size=2)))
        truth[t] = x[[0, 2]]
    return motion, readings, truth


def gated(motion, readings):
    """The Kalman filter that leaves out what a gate of 1 in 1000 says; x, after each fix."""
    kf, before, found = KalmanFilter(4, 2), 0.0, []
    kf.P *= 100.0
    for name, t, z in readings:
        F, Q, _ = motion.matrices(t - before)
        kf.predict(F=F, Q=Q)
        before, H = t, np.array(GPS if name == "gps" else WHEEL)
        R = (4.0 if name == "gps" else 0.01) * np.eye(2)
        y = z - H @ kf.x[:, 0]
        if y @ np.linalg.solve(H @ kf.P @ H.T + R, y) < 13.8:
            kf.update(z[:, None], R=R, H=H)
        if name == "gps":
            found.append((t, kf.x[[0, 2], 0].copy(), True))
    return found


def served(fusion, readings):
    """What a fusion says after each fix, and whether it is sure of it."""
    found = []
    for name, t, z in readings:
        fusion.observe(name, t, z)
        # Its fix comes after the odometry of the same stamp.
        if name == "gps":
            now = fusion.estimate()
            found.append((t, now.x[[0, 2]], not now.undecided))
    return found


def doubts(args):
    """After a blackout: who decides rightly, who is sure and wrong, and how long what is served is wrong."""
    prior = Reacquisition()
    late = prior.length * math.log(100.0)
    print("fixes end for 200 s; right: within 10 fixes of what tells it, x within 20 m; sure and wrong: ever after")
    print("the third fix more than 50 m off, and sure; wrong: share of fixes after the blackout more than 50 m off.")
    print(f"{prior}, {args.runs} runs")
    events = {"cluster": BACK + WRONG, "mirror": BACK + late, "drifting": BACK, "standing": BACK}
    sensors = {"gps": Sensor(GPS, R=4.0), "odometry": Sensor(WHEEL, R=0.01)}
    for case, event in events.items():
        scores = {}
        for seed in range(args.runs):
            motion, readings, truth = blackout(seed, case)
            policies = {"Kalman": {"influence": Linear()}, "default": {}, "reacquire": {"reacquire": prior}}
            said = {
                name: served(Fusion(motion, sensors, 1.0, P0=100.0 * np.eye(4), **policy), readings)
                for name, policy in policies.items()
            }
            for name, found in {"gate": gated(motion, readings), **said}.items():
                after = [(t, np.hypot(*(x - truth[t])), sure) for t, x, sure in found if t >= BACK]
                then = next(one for one in after if one[0] >= event + 9.0)
                scores.setdefault(name, []).append((
                    then[1] < 20.0 and then[2],
                    any(sure and apart > 50.0 for t, apart, sure in after if t >= BACK + 3.0),
                    np.mean([apart > 50.0 for _, apart, _ in after]),
                ))  # fmt: skip
        for name, rows in scores.items():
            right, wrong, share = np.mean(rows, axis=0)
            figures = f"right {right:4.2f}   sure and wrong {wrong:4.2f}   wrong {share:4.2f}"
            print(f"  {case:9s} {name:10s} {figures}", flush=True)
    fusion, times = Fusion(motion, sensors, 1.0, P0=100.0 * np.eye(4), reacquire=prior), {True: [], False: []}
    for name, t, z in blackout(0, "mirror")[1]:
        fusion.observe(name, t, z)
        begun = time.perf_counter()
        moment = fusion._timeline.until()[0]
        times[moment.doubt is not None].append(1e3 * (time.perf_counter() - begun))
    print(f"  a stamp takes {np.median(times[True]):.2f} ms in doubt, {np.median(times[False]):.2f} ms else")


TABLES = {one.__name__: one for one in (speed, late, bounds, verdicts, false, unknown, forecasts, doubts)}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--readings", type=int, default=200_000)
    arguments = parser.parse_args()
    for name in arguments.tables or TABLES:
        TABLES[name](arguments)
