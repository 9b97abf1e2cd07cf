"""Does a tracker of boxes in the manner of SORT lose people when its filter is swapped? MOTA and IDF1 of drawn scenes.

Run ``python tests/benchmarks/box_tracking.py [--runs N] [--seed S] [--jobs J] [--only TEXT]``. Pedestrians walk, turn,
stop, cross and are hidden for 5 to 30 frames; the detector misses some, invents boxes, and is off by a part of a box's
size, now and then by half a body. The tracker is that of Bewley et al., "Simple online and realtime tracking" (2016),
with its numbers: center, area and ratio of the sides with the speeds of the first three, R = diag(1, 1, 10, 10) for any
detector, assignment by overlap. MOTA is 100 (1 - (missed + false + switched identities) / boxes) by the rules of CLEAR
(Bernardin and Stiefelhagen, 2008). A row is a scene, how many frames without a box a track outlives, and one factor of
P, Q and R. The target: no filter is more than 1 below filterpy's in any row; the program ends with 1 where one is. Some
are, as the page "Which filter in my SORT?" says: a motion that is far larger than Q counts as outliers at first.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from scipy.optimize import linear_sum_assignment

from robust_filterpy import AdaptiveKalmanFilter, RobustKalmanFilter, StudentT, TukeyBiweight

WIDTH, HEIGHT, MOST_BELOW = 1920.0, 1080.0, 1.0
FILTERS: dict[str, Callable[[], Any]] = {
    "filterpy": lambda: KalmanFilter(7, 4),
    "RobustKalmanFilter": lambda: RobustKalmanFilter(7, 4),
    'grouping="joint"': lambda: RobustKalmanFilter(7, 4, grouping="joint"),
    "StudentT()": lambda: RobustKalmanFilter(7, 4, influence=StudentT()),
    "TukeyBiweight()": lambda: RobustKalmanFilter(7, 4, influence=TukeyBiweight()),
    'process="given"': lambda: AdaptiveKalmanFilter(7, 4, process="given"),
    "AdaptiveKalmanFilter": lambda: AdaptiveKalmanFilter(7, 4),
}


class Scene(NamedTuple):
    """Who is there, and what the detector makes of it: shares of boxes, parts of a box, pixels of the camera."""

    people: int = 12
    missed: float = 0.05
    false: float = 0.3
    jitter: float = 0.03
    half: float = 0.01
    shake: float = 0.0


SCENES = {
    "street": Scene(),
    "crowd": Scene(people=20, missed=0.1, half=0.02),
    "camera in the hand": Scene(missed=0.1, shake=6.0),
    "poor detector": Scene(people=15, missed=0.2, false=1.0, jitter=0.06, half=0.05),
}


class Frame(NamedTuple):
    """Who is to be seen and where, and what the detector reports: boxes are left, top, right, bottom."""

    who: np.ndarray
    boxes: np.ndarray
    detected: np.ndarray


def overlap(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return intersection over union of every box with every other."""
    low, high = np.maximum(one[:, None, :2], other[None, :, :2]), np.minimum(one[:, None, 2:], other[None, :, 2:])
    both = np.prod(np.maximum(high - low, 0.0), axis=2)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) for boxes in (one, other)]
    return both / (areas[0][:, None] + areas[1][None, :] - both)


def matches(overlaps: np.ndarray, least: float) -> list[tuple[int, int]]:
    """Return who belongs together so that the sum of overlaps is greatest, none below the least."""
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(-overlaps), strict=True) if overlaps[i, j] >= least]


def drawn(scene: Scene, seed: int, frames: int = 300) -> list[Frame]:
    """Draw a scene of 30 frames a second."""
    g = np.random.default_rng(seed)
    n, names, found, camera = scene.people, np.arange(scene.people), [], np.zeros(2)
    height = np.exp(g.uniform(np.log(90.0), np.log(260.0), n))
    foot = np.column_stack((g.uniform(0.0, WIDTH, n), 300.0 + 2.5 * height))
    pace, way, hidden, stands = g.uniform(0.01, 0.04, n), g.choice([0.0, np.pi], n), np.zeros(n), np.zeros(n)
    for k in range(frames):
        stands = np.where(g.random(n) < 0.004, g.integers(20, 90, n), stands - 1)
        hidden = np.where((hidden <= 0) & (g.random(n) < 0.006), g.integers(5, 31, n), hidden - 1)
        way += 0.02 * g.normal(size=n) + np.where(g.random(n) < 0.005, g.uniform(-2.0, 2.0, n), 0.0)
        step = np.where(stands > 0, 0.0, pace * height)
        foot += step[:, None] * np.column_stack((np.cos(way), 0.3 * np.sin(way)))
        height *= 1.0 + 0.3 * (step / 700.0) * np.sin(way)  # who comes nearer grows
        gone = (foot[:, 0] < -50.0) | (foot[:, 0] > WIDTH + 50.0) | (height < 60.0) | (height > 400.0)
        names[gone] = names.max() + 1 + np.arange(gone.sum())
        foot[gone, 0], way[gone], height[gone] = 0.0, 0.0, g.uniform(90.0, 260.0, gone.sum())
        foot[gone, 1] = 300.0 + 2.5 * height[gone]
        camera = 0.9 * camera + scene.shake * g.normal(size=2)
        tall = height * (1.0 + 0.01 * np.sin(0.4 * k + names))  # who walks bobs
        wide = tall * (0.41 + 0.06 * np.sin(0.2 * k + 2.0 * names) * (stands <= 0))
        low, high = (foot + camera + np.column_stack((s * wide / 2.0, t * tall)) for s, t in ((-1, -1), (1, 0)))
        boxes = np.hstack((low, high))
        # Who stands nearer covers those behind.
        part = overlap(boxes, boxes) * (foot[:, 1][:, None] < foot[:, 1][None, :])
        seen = np.flatnonzero((hidden <= 0) & (part.max(axis=1) < 0.5))
        known = boxes[seen][g.random(len(seen)) >= scene.missed]
        size = np.tile(known[:, 2:] - known[:, :2], 2)
        detected = known + scene.jitter * size * g.normal(size=size.shape) / np.sqrt(2.0)
        halved = np.flatnonzero(g.random(len(known)) < scene.half)
        detected[halved, 3] -= 0.5 * size[halved, 1]
        wrong = g.poisson(scene.false)
        corner, tall = g.uniform(0.0, [WIDTH, 700.0], (wrong, 2)), g.uniform(90.0, 260.0, wrong)
        false = np.hstack((corner, corner + np.column_stack((0.41 * tall, tall))))
        found.append(Frame(names[seen].copy(), boxes[seen], np.vstack((detected, false))))
    return found


class Track:
    """One box that is followed, set up as SORT does."""

    def __init__(self, make: Callable[[], Any], name: int, box: np.ndarray, factor: float) -> None:
        self.name, self.unseen, self.streak, self.kf = name, 0, 0, make()
        self.kf.F, self.kf.H = np.eye(7) + np.eye(7, k=4), np.eye(4, 7)
        self.kf.R[2:, 2:] *= 10.0
        self.kf.P[4:, 4:] *= 1000.0
        self.kf.P *= 10.0
        self.kf.Q[-1, -1] *= 0.01
        self.kf.Q[4:, 4:] *= 0.01
        for covariance in (self.kf.P, self.kf.Q, self.kf.R):
            covariance *= factor
        self.kf.x[:4] = measured(box)

    def predict(self) -> np.ndarray:
        if self.kf.x[6] + self.kf.x[2] <= 0.0:
            self.kf.x[6] *= 0.0
        self.kf.predict()
        self.streak = 0 if self.unseen else self.streak
        self.unseen += 1
        return self.box()

    def update(self, box: np.ndarray) -> None:
        self.unseen, self.streak = 0, self.streak + 1
        self.kf.update(measured(box))

    def box(self) -> np.ndarray:
        x, y, area, ratio = self.kf.x[:4, 0]
        with np.errstate(invalid="ignore"):
            wide, tall = np.sqrt(area * ratio), np.sqrt(area / ratio)
        return np.array([x - wide / 2.0, y - tall / 2.0, x + wide / 2.0, y + tall / 2.0])


def measured(box: np.ndarray) -> np.ndarray:
    """Return center, area and ratio of the sides, as a column."""
    (x, y), (wide, tall) = (box[:2] + box[2:]) / 2.0, box[2:] - box[:2]
    return np.array([[x], [y], [wide * tall], [wide / tall]])


def tracked(make: Callable[[], Any], frames: list[Frame], max_age: int, factor: float = 1.0, min_hits: int = 3):
    """Return for each frame the names of the tracks that are shown, and their boxes."""
    tracks: list[Track] = []
    names, found = 0, []
    for k, frame in enumerate(frames, 1):
        boxes = [track.predict() for track in tracks]
        lost = [not np.all(np.isfinite(box)) for box in boxes]
        tracks = [track for track, gone in zip(tracks, lost, strict=True) if not gone]
        boxes = np.reshape([box for box, gone in zip(boxes, lost, strict=True) if not gone], (-1, 4))
        pairs = matches(overlap(frame.detected, boxes), 0.3)
        for i, j in pairs:
            tracks[j].update(frame.detected[i])
        for i in sorted(set(range(len(frame.detected))) - {i for i, _ in pairs}):
            tracks.append(Track(make, names, frame.detected[i], factor))
            names += 1
        shown = [t for t in tracks if not t.unseen and (t.streak >= min_hits or k <= min_hits)]
        found.append(([t.name for t in shown], np.reshape([t.box() for t in shown], (-1, 4))))
        tracks = [t for t in tracks if t.unseen <= max_age]
    return found


def judged(frames: list[Frame], found) -> np.ndarray:
    """Return MOTA and IDF1 in percent, and how often an identity was switched; a box is found from an overlap of .5."""
    last: dict[int, int] = {}
    together: dict[tuple[int, int], int] = {}
    wrong = switched = total = shown = 0
    for frame, (names, boxes) in zip(frames, found, strict=True):
        overlaps = overlap(frame.boxes, boxes)
        enough = overlaps >= 0.5
        for i, j in zip(*np.nonzero(enough), strict=True):
            pair = (int(frame.who[i]), names[j])
            together[pair] = together.get(pair, 0) + 1
        # Who belonged together before and still may stays so.
        kept = enough & (np.array([last.get(int(who), -1) for who in frame.who])[:, None] == np.array(names)[None, :])
        pairs = matches(np.where(enough, overlaps + 1000.0 * kept, 0.0), 0.5)
        for i, j in pairs:
            who = int(frame.who[i])
            switched += last.get(who, names[j]) != names[j]
            last[who] = names[j]
        total, shown = total + len(frame.who), shown + len(names)
        wrong += len(frame.who) + len(names) - 2 * len(pairs)
    people, tracks = (sorted({pair[i] for pair in together}) for i in (0, 1))
    counts = np.array([[together.get((who, name), 0) for name in tracks] for who in people])
    identified = counts[linear_sum_assignment(-counts)].sum()
    return np.array([100.0 * (1.0 - (wrong + switched) / total), 200.0 * identified / (total + shown), switched])


def row(scene: Scene, seed: int, max_age: int, factor: float) -> list[np.ndarray]:
    """Return what every filter makes of one scene."""
    warnings.simplefilter("ignore")
    frames = drawn(scene, seed)
    return [judged(frames, tracked(make, frames, max_age, factor)) for make in FILTERS.values()]


def main(argv: list[str] | None = None) -> None:
    """Print MOTA, and IDF1 after it, of filterpy's filter and how far the others are above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", help="rows whose scene has this text")
    args = parser.parse_args(argv)
    seeds, below = range(args.seed, args.seed + args.runs), []
    print("| scene, frames without a box, factor of P, Q, R | " + " | ".join(FILTERS) + " |")
    print("|---" * (len(FILTERS) + 1) + "|", flush=True)
    for scene in [title for title in SCENES if args.only in title]:
        for age in (1, 10):
            for factor in (1.0, 1e-4, 1e4):
                title = f"{scene}, {age}, {factor:g}"
                found = Parallel(args.jobs)(delayed(row)(SCENES[scene], seed, age, factor) for seed in seeds)
                first, *others = np.mean(found, axis=0)
                more = np.array(others) - first
                cells = [f"{first[0]:.1f} / {first[1]:.1f}", *(f"{a:+.1f} / {b:+.1f}" for a, b, _ in more)]
                print(f"| {title} | {' | '.join(cells)} |", flush=True)
                names = zip(list(FILTERS)[1:], more[:, 0], strict=True)
                below += [f"{title}: {name} {change:.1f}" for name, change in names if change < -MOST_BELOW]
    print(f"MOTA at most {MOST_BELOW:g} below filterpy's: " + ("met" if not below else "NOT MET: " + "; ".join(below)))
    sys.exit(bool(below))


if __name__ == "__main__":
    main()
