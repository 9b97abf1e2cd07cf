"""The model of several recordings: one plant, each recording with its own level, breaks of the level, and start."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.estimate import Problem, estimated
from robust_filterpy.identification.estimation.level import (
    Beside,
    beside_input_outliers,
    break_finding,
    endless_pole,
    unlike_in_parts,
)
from robust_filterpy.identification.estimation.trend import PRICE, Trend, piecewise_level
from robust_filterpy.identification.models.findings import Finding
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.signals import fingerprint

__all__ = ["of_several"]

# In fewer samples a step and the dynamics cannot be told apart.
_LEAST_SAMPLES: Final = 200


def of_several(problem: Problem, y: Array, trend: str) -> tuple[Model, tuple[Finding, ...]]:
    """Find the model of several recordings that follow each other.

    Parameters
    ----------
    problem : Problem
        What is to be found; its ``begins`` say where each recording begins.
    y : ndarray, shape (N,)
        Output, NaN where it is missing.
    trend : str
        As of `identify`; a line or breaks are looked for in each recording.

    Returns
    -------
    model : Model
    findings : tuple of Finding
        Each names its recording.
    """
    best = beside_input_outliers(problem.u, lambda u: _beside_outputs(problem.of_inputs(u), y, trend))
    model, findings = best.model, best.findings
    acted = problem.of_inputs(best.u) if best.held else problem
    for i, part in enumerate(problem.spans):
        unlike = unlike_in_parts(acted.alone(i), y[part], model, True)
        findings = (*findings, *(_of_recording(i, one) for one in unlike))
    return model, findings


def _beside_outputs(problem: Problem, y: Array, trend: str) -> Beside:
    """Return the model beside levels that break, and without a motion that never dies."""
    model, levels, findings = _beside_levels(problem, y, trend)
    slowest = endless_pole(model, max(part.stop - part.start for part in problem.spans))
    if slowest is not None:
        model = estimated(problem._replace(moving=False), y - levels)
        text = f"a pole at {slowest:.6g} would keep a motion beyond every recording: each begins at rest"
        findings = (*findings, Finding("slow start", text, float("nan"), (0, y.size)))
    again = zip(problem.spans, model.recordings, strict=True)
    known_again = tuple((fingerprint(y[part]), own + levels[part]) for part, (_, own) in again)
    return Beside(replace(model, recordings=known_again), findings)


def _beside_levels(problem: Problem, y: Array, trend: str) -> tuple[Model, Array, tuple[Finding, ...]]:
    """Return the model beside the levels that break, these, and what to say of them."""
    plain, levels = estimated(problem, y), np.zeros(y.size)
    line = trend == "line"
    if not plain.structure.n_inputs or trend not in ("breaks", "line"):
        return plain, levels, ()
    found: list[Trend] = []
    for i, part in enumerate(problem.spans):
        own, u = y[part], problem.alone(i).u
        enough = np.count_nonzero(~np.isnan(own)) >= _LEAST_SAMPLES
        left = own - plain.free_run(own, u) if enough or line else np.zeros(0)
        now = piecewise_level(left, line=line) if left.size else Trend(np.zeros(own.size), ())
        found.append(now)
        levels[part] = now.values if now.breaks else 0.0
    count = sum(len(one.breaks) for one in found)
    if not count:
        return plain, np.zeros(y.size), ()
    other = estimated(problem, y - levels)
    gain = other.log_likelihood - plain.log_likelihood
    if not line and gain < 0.5 * PRICE * np.log(y.size) * count:
        return plain, np.zeros(y.size), ()
    findings = [
        _of_recording(i, break_finding(b, None, 2.0 * gain, part.stop - part.start, problem.u[part]))
        for i, (part, one) in enumerate(zip(problem.spans, found, strict=True))
        for b in one.breaks
    ]
    return other, levels, () if line else tuple(findings)


def _of_recording(i: int, finding: Finding) -> Finding:
    """Return a finding that names its recording."""
    return finding._replace(text=f"recording {i}: {finding.text}")
