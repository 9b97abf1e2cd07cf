"""What is each rule of the learnt noise worth? The kernel is built once with every rule as it is and without it.

    python tests/benchmarks/adaptive_ablation.py [--runs N] [--seed S] [--write-page]

Without a rule another expression stands in its place in ``kernel/learnt.h`` (see `RULES`); which, is chosen while the
filter runs. The recordings are those of `adaptive_traps`, `default_study` and `drop_in_study` and a few more, the same
for each rule. A figure is the root mean square error of what the sensors see, in units of R, over that of the Kalman
filter which is given the covariances of every step; or the share of states within the 95 % region; or steps until the
estimate is back. The table says for each rule where the filter is worse without it, and where it is better: by more
than 2 % (coverage: .03, a step) and three standard errors over the recordings, from what to what, the farthest first.
Where no row is worse, a test says what the rule is for. --write-page puts the table into docs/learnt_noise.md.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import adaptive_traps as traps
import default_study
import drop_in_study
import numpy as np
from adaptive_problems import Case
from adaptive_traps import Trap
from filterpy.kalman import KalmanFilter
from kernel_mutations import HEADERS, ROOT, build
from measuring import on_page

from robust_filterpy import kernel
from robust_filterpy.filters.conversion import AdaptiveKalmanFilter

#: What counts as a difference: of the log of an error, of a share of states, in steps; and in standard errors.
LEAST, LEAST_COVERED, LEAST_STEPS, SURE = 0.02, 0.03, 1.0, 3.0
#: How many rows are shown of those that are worse without a rule, and of those that are better.
SHOWN, SHOWN_BETTER = 3, 2
#: Rule: what stands in the kernel, and what instead.
RULES: dict[str, tuple[tuple[str, str], ...]] = {
    "a scale of Q for each copy": (
        ("j < q ? rule->process[j] : origin[i] * origin[k]", "j < q ? 1 : origin[i] * origin[k]"),
    ),
    "parts of the state": (("(F[i * n + k] != 0 || Q[i * n + k] != 0)", "1"),),
    "a candidate for a jump": (("rule->jump * (1 - unseen[i])", "0"),),
    "a sample is worth 100 to 1 for it": (("real_min(logs[q], LEARNT_EVIDENCE * evidence)", "logs[q]"),),
    "nor tells of the scale of Q": (("experienced && logs[q] > LEARNT_TELLS * evidence", "0"),),
    "how often the state jumps": (("real_max(jumps->chance, each) + each", "0"),),
    "it knows no last class": (
        ("learnt_typical(K, &memory, w->after)", "learnt_predicted(rule->K, &memory, w->after)"),
    ),
    "it is hidden while three to one is against it": (("!(work[q * n + i] > LEARNT_SHOWN)", "0"),),
    "it is shown alone at nineteen to one": (("work[q * n + i] > LEARNT_ALONE", "0"),),
    "a start elsewhere, with .96": (
        ("waits[j] > 0 && S[j * m + j] > 0",
         "waits[j] > 0 && S[j * m + j] > 0 && unseen[(int)w->head[j]] < REAL(0.5)"),
    ),
    "readings that the state followed were no outliers": (
        ("believed || (w->goes_on[i] > 0 && learnt_of(rule, s, i).last[0] > REAL(0.5))", "believed"),
    ),
    "a candidate doubts all of P": (("(most_of - noise) / S[i * m + i]", "1"),),
    "classes come in runs": (
        ("learnt_predicted(K, &memory, w->after)", "learnt_typical(K, &memory, w->after)"),
        ("before[j] > 0 ? total * counts[i * K + j] * p[j] / before[j] : 0", "p[j] / K"),
    ),
    "sensors may fail together, t": (("learnt_follows(rule) && rule->named == 0 && count > 1", "0"),),
    "most plausible sensor first": (("best < 0 || far < least", "best < 0"),),
    "shortened to 8 deviations (here to 30)": (
        ("length > LEARNT_REACH * per_unit * (LEARNT_REACH * per_unit)", "length > 900 * per_unit * per_unit"),
        ("LEARNT_REACH / real_sqrt(length)", "30 / real_sqrt(length)"),
    ),
    "a sample counts what it tells of r": (("p[0] * part * part", "p[0]"),),
    "ordinary is what most samples are": (("K > 1 && shares[0] < REAL(0.5)", "0"),),
    "a tenth of r, by Page's sum": (("habits->less > LEARNT_LOG_DECIDES", "0"),),
    "repeats teach nothing of r": (("real_copysign(1, habits->repeats.seldom) > 0", "1"),),
    "nor of changes": (("memory->seldom < 0", "0"),),
    "stuck sensors are left out": (
        ("learnt_asks(n, w, w->at, w->spread, i, *memory->r * R) || memory->last[0] < REAL(0.5)", "0"),
    ),
    "only after changes like white noise": (("memory->scale * memory->scale >= r", "1"),),
    "r is capped by changes": (("real_max(1, repeats->scale * repeats->scale * LEARNT_MOST)", "REAL_MAX"),),
    "parity: a floor of r": (
        ("real_max(r[i], real_exp((1 - colour[i]) * real_log(r[i]) + colour[i] * real_log(least)))", "r[i]"),
    ),
    "parity: r raised for a color": (("real_exp(colour[i] * real_log((1 + part) / (1 - part)))", "1"),),
    "parity: outliers are shortened": (("real_within(e, 3 * real_sqrt(habits->parity.variance))", "e"),),
    "parity: dependent samples are worth few": (("worth / (worth + rule->begin[1])", "1"),),
}  # fmt: skip
STARTS = "test_in_the_field.py"
#: What tests see of a rule that no row needs, by the name of one or, as long names widen the page, of a file.
TESTED = {
    "a sample is worth 100 to 1 for it": "test_never_worse.py",
    "nor tells of the scale of Q": "test_a_step_of_what_is_measured_leaves_the_speed",
    "it is hidden while three to one is against it": "test_a_jump_that_nothing_confirms_does_not_show",
    "it is shown alone at nineteen to one": STARTS,
    "readings that the state followed were no outliers": STARTS,
    "nor of changes": "test_it_follows_almost_as_the_kalman_filter_or_much_better",
    "shortened to 8 deviations (here to 30)": "test_r_does_not_depend_on_how_wild_an_outlier_is",
}
NAMES = {
    "the same through one row": "sensors in turn through one row",
    "the same box for 400 steps": "SORT's box for 400 steps",
    "the same, R given 10 times too small": "two sensors, each fails, R given 10 times too small",
}


def edits(rules: dict[str, tuple[tuple[str, str], ...]]) -> list[tuple[Path, int, str, str, str]]:
    """Return for `kernel_mutations.build` the lines with each rule and, as that is chosen, without it."""
    texts = {HEADERS / name: (HEADERS / name).read_text().split("\n") for name in ("learnt.h", "repeats.h")}
    found = []
    for k, (name, changes) in enumerate(rules.items(), 1):
        for old, new in changes:
            at = [(path, i) for path, lines in texts.items() for i, line in enumerate(lines) if old in line]
            if len(at) != 1:
                raise SystemExit(f"{name}: expected one line of the kernel with {old!r}, found {len(at)}; mend RULES")
            ((path, i),) = at
            texts[path][i] = texts[path][i].replace(old, f"(MUTATION({k}) ? ({new}) : ({old}))")
            found.append((path, i, old, new, texts[path][i]))
    return found


def rows() -> dict[str, tuple[Callable[[int], Trap], Callable[..., float]]]:
    """Return how each recording is drawn, and what of it is measured."""
    found: dict[str, tuple[Callable[[int], Trap], Callable[..., float]]] = {}
    for title, draw, measure, _, _ in traps.ROWS:
        found.setdefault(title.split(": ")[0], (draw, error if measure in (traps.error, traps.coverage) else measure))
    del found["the same"]
    for title, (draw, run) in default_study.problems(800).items():
        if run is default_study.alone:
            found[title] = (_told(draw), error)
    for title, row in drop_in_study.rows().items():
        # Who is silent is no case for filterpy's filter, and what is counted in steps is a trap already.
        if row.kind == "linear" and title not in found and not ("silent" in title or row.figure == "steps"):
            found[title] = (_told(row.draw, row.P, row.Q, row.R), error)
    one = drop_in_study.one
    found |= {
        "20 samples, mixture .1": (_told(partial(one, kind="mixture .1, scale 10", steps=20)), error),
        "60 samples, R given 100 times too large": (_told(partial(one, kind="clean", steps=60), r=100.0), error),
        "R given 1000 times too large": (_told(partial(one, kind="clean"), r=1e3), error),
        "R given 1000 times too small": (_told(partial(one, kind="clean"), r=1e-3), error),
        "a level on a ramp": (ramp, error),
        "readings in coarse steps": (partial(coarse, step=1.0, sigma=0.3), error),
        "at rest without noise": (partial(coarse, step=0.0, sigma=1.0, rests=150), error),
    }
    said = {title: NAMES.get(title, title).replace("the same, mix", "P, Q, R given, mix") for title in found}
    named = {said[title]: row for title, row in found.items()}
    assert len(named) == len(found)
    return named


def ramp(seed: int, steps: int = 300) -> Trap:
    """A level that is on a ramp, one deviation a step."""
    one, truth = np.eye(1), np.arange(float(steps))[:, None]
    zs = truth + np.random.default_rng(seed).standard_normal((steps, 1))
    given = np.ones((steps, 1, 1))
    return Trap(one, one, 0.01 * one, one, np.zeros(1), 10.0 * one, truth, zs, given, given)


def coarse(seed: int, step: float, sigma: float, rests: int = 0, steps: int = 400) -> Trap:
    """Two levels that are read in steps, or rest at first and are read as 0."""
    g, two = np.random.default_rng(seed), np.eye(2)
    moves = np.where(np.arange(steps)[:, None] < rests, 0.0, 0.1 * g.standard_normal((steps, 2)))
    truth = np.cumsum(moves, axis=0) + 0.3
    zs = truth + sigma * g.standard_normal((steps, 2))
    zs[:rests] = 0.0
    zs = step * np.round(zs / step) if step else zs
    Q, R = 0.01 * two, (sigma**2 + step**2 / 12.0) * two
    Qs, Rs = (np.tile(given, (steps, 1, 1)) for given in (Q, R))
    return Trap(two, two, Q, R, np.zeros(2), 10.0 * two, truth, zs, Qs, Rs)


def _told(draw: Callable[[int], Case], p: float = 1.0, q: float = 1.0, r: float = 1.0) -> Callable[[int], Trap]:
    """Return a trap that is drawn as a case is."""

    def drawn(seed: int) -> Trap:
        F, H, Q, R, x0, P0, truth, zs, w, v = draw(seed)
        v = v if v.ndim == 2 else v[:, None] * np.ones(len(R))
        Rs = v[:, :, None] * R * v[:, None]
        return Trap(F, H, q * Q, r * R, x0, p * P0, truth, zs, w[:, None, None] ** 2 * Q, Rs)

    return drawn


def error(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> float:
    """Return the root mean square error of what the sensors see, in units of R."""
    off = ((xs - trap.truth) @ trap.H.T)[min(traps.FROM, len(xs) // 10) :]
    return float(np.sqrt(np.mean(off**2 / trap.R.diagonal())))


def covered(trap: Trap, xs: np.ndarray, Ps: np.ndarray) -> float:
    """Return the share of states within the 95 % region, NaN where a covariance has none."""
    try:
        return traps.coverage(trap, xs, Ps)
    except np.linalg.LinAlgError:
        return np.nan


def measure_all(seeds: range) -> None:
    """Print for each row the figures of who knows all, of the filter, and of it without each rule, (seeds, .., 2)."""
    warnings.simplefilter("ignore")
    chosen = ctypes.c_int.in_dll(ctypes.CDLL(kernel.extension().__file__), "mutation_chosen")
    for title, (draw, measure) in rows().items():
        found = []
        for seed in seeds:
            trap, of_seed = draw(seed), []
            for k in range(-1, len(RULES) + 1):
                chosen.value = max(k, 0)
                path = traps.filtered(KalmanFilter if k < 0 else AdaptiveKalmanFilter, trap, k < 0)
                of_seed.append((min(measure(trap, *path), 1e9), covered(trap, *path)))
            found.append(of_seed)
        print(json.dumps([title, found]), flush=True)


def measured(seeds: range) -> dict[str, np.ndarray]:
    """Build the kernel in a copy of the package, and return by row what `measure_all` prints there."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("robust_filterpy", "tests"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "setup.cfg", "setup.py", "README.md"):
            shutil.copy(ROOT / name, copy)
        build(copy, edits(RULES))
        program = copy / Path(__file__).relative_to(ROOT)
        command = [sys.executable, program, "--measure", "--runs", str(len(seeds)), "--seed", str(seeds.start)]
        found = {}
        with subprocess.Popen(
            command, cwd=copy, env={**os.environ, "PYTHONPATH": folder}, stdout=subprocess.PIPE, text=True
        ) as job:
            for line in job.stdout or ():
                title, values = json.loads(line)
                found[title] = np.array(values)
                print(f"{len(found)} {title}", file=sys.stderr, flush=True)
        if job.returncode:
            raise SystemExit(f"the filter without a rule: ended with {job.returncode}; see above")
    return found


def differences(title: str, values: np.ndarray, k: int) -> list[tuple[float, str]]:
    """Return how far a row changes without rule k, above 0 where it is worse, and from what to what."""
    labels, usual, without = values[:, 0], values[:, 1], values[:, k + 1]
    found = []
    if rows()[title][1] is error:
        change = np.log(without[:, 0] / usual[:, 0])
        # Pooled, as who reads it would: one wild recording counts, but does not decide whether there is a change.
        size = [np.sqrt(np.mean(v[:, 0] ** 2) / np.mean(labels[:, 0] ** 2)) for v in (usual, without)]
        found.append((change, LEAST, f"{title} {size[0]:.2f} → {size[1]:.2f}", 1.0))
        inside = [np.nanmean(v[:, 1]) for v in (usual, without)]
        change = np.abs(without[:, 1] - 0.95) - np.abs(usual[:, 1] - 0.95)
        found.append((change, LEAST_COVERED, f"{title} covered {inside[0]:.2f} → {inside[1]:.2f}", 1.0))
    else:
        size = [np.mean(v[:, 0]) for v in (usual, without)]
        found.append((without[:, 0] - usual[:, 0], LEAST_STEPS, f"{title} {size[0]:.1f} → {size[1]:.1f} steps", 0.1))
    kept = []
    for change, least, text, unit in found:
        change = change[np.isfinite(change)]
        mean, sure = (change.mean(), SURE * change.std(ddof=1) / np.sqrt(len(change))) if len(change) > 1 else (0, 0)
        if abs(mean) > max(least, sure):
            kept.append((float(mean) * unit, text))
    return kept


def table(found: dict[str, np.ndarray]) -> str:
    """Return what every rule is worth."""
    lines = ["| without | is worse | is better |", "|---|---|---|"]
    for k, name in enumerate(RULES, 1):
        changes = sorted(change for title, values in found.items() for change in differences(title, values, k))
        worse, better, cells = [c for c in changes if c[0] > 0.0][::-1], [c for c in changes if c[0] < 0.0], []
        for kept, shown in ((worse, SHOWN), (better, SHOWN_BETTER)):
            more = f"; {len(kept) - shown} more" if len(kept) > shown else ""
            cells.append("; ".join(text for _, text in kept[:shown]) + more or "-")
        if cells[0] == "-" and name in TESTED:
            cells[0] = f"no row, but `{TESTED[name]}`"
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write-page", action="store_true")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    seeds = range(args.seed, args.seed + args.runs)
    if args.measure:
        measure_all(seeds)
        return
    made = table(measured(seeds))
    print(made)
    if args.write_page:
        on_page("learnt_noise.md", "ablation", made)


if __name__ == "__main__":
    main()
