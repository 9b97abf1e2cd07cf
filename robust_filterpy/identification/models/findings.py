"""What a recording has beside a model and its noise: what repeats, lasts or depends on u, with the evidence for it."""

from __future__ import annotations

from typing import NamedTuple

from robust_filterpy._fill_values import FillValues

__all__ = ["Finding", "of_fill_values", "said"]


class Finding(NamedTuple):
    """One thing that breaks an assumption of `identify`, and what was made of it.

    Attributes
    ----------
    kind : str
        "fill value", "stuck", "copy", "step", "ramp", "slow start", "another plant", "input outliers", "gap", "wraps",
        "closed loop".
    text : str
        In words, with time and size.
    evidence : float
        Twice the log-likelihood that it explains; NaN where it is no matter of likelihood.
    place : tuple of int
        First sample that it concerns, and the one after the last.
    """

    kind: str
    text: str
    evidence: float
    place: tuple[int, int]


def of_fill_values(fills: FillValues) -> tuple[Finding, ...]:
    """Return the finding that y has fill values, or none."""
    if not fills.values:
        return ()
    return (Finding("fill value", f"y has {fills.said}", float("nan"), (0, fills.signal.size)),)


def said(findings: tuple[Finding, ...]) -> str:
    """Return all findings in one sentence, empty if there are none."""
    return "; ".join(finding.text for finding in findings)
