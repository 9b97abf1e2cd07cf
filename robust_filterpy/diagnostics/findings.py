"""What is wrong when a filter does badly: figures of its innovations, and the cause in words.

The causes are judged by repair: a copy of the model with R scaled, Q scaled, another row of H, another unit, a noise
with memory, a jump, ... goes over the recording, and the repair that makes it most likely is the cause. Where there
is no linear model to repair (an unscented filter's Saver), the innovations alone are judged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robust_filterpy._brief import wrapped
from robust_filterpy._checks import Array, fraction
from robust_filterpy._progress import stages
from robust_filterpy._warning import FOLLOWS, SMALL, STOPPED, pointer
from robust_filterpy.diagnostics import recording as statistics
from robust_filterpy.diagnostics import search
from robust_filterpy.diagnostics.recording import Band, FilterRecord, is_saver, of_filter, of_saver, of_tracker
from robust_filterpy.diagnostics.search import Repair

# The search for causes looks at so many samples.
_SEARCHED = 4000
# Recordings up to here may be too short to show a wrong noise.
_SHORT = 500
# Where the documentation has the remedy; the words of the other causes are all there is to say.
_SECTIONS = {
    **dict.fromkeys(("R too large", "Q too large", "R and Q too large", "S too large", "more outliers"), FOLLOWS),
    **dict.fromkeys(("Q too small", "level shift", "state jump", "lost units", "wrong H", "not white"), STOPPED),
    **dict.fromkeys(("R too small", "R and Q too small", "S too small"), SMALL),
}


@dataclass(frozen=True)
class Finding:
    """Hold one cause.

    Attributes
    ----------
    cause : str
        "R too small", "R too large", "Q too small", "Q too large", "R and Q too small", "R and Q too large",
        "wrong H", "lost units", "level shift", "state jump", "bias", "correlated noise", "coupled noise",
        "saturation", "frozen sensor", "wrapping", "H is 0", "wrong start", "more outliers", "S too small",
        "S too large" or "not white".
    sensor : int or None
        Component of z that it is about, None for all.
    value : float
        The factor, the correlation, the step or the share that the words name.
    gain : float
        Log-likelihood that the repair gains; NaN where the evidence is of another kind.
    text : str
        The cause in words.
    """

    cause: str
    sensor: int | None
    value: float
    gain: float
    text: str


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Hold what `diagnose` found; ``str()`` of it is a summary in words.

    e_i = y_i / sqrt(S_ii) is the innovation of sensor i in its own standard deviations.

    Attributes
    ----------
    samples : int
        Length N of the recording.
    observed : ndarray, shape (m,)
        Samples of each sensor that were there.
    clipped : ndarray, shape (m,)
        Share of clipped innovations.
    clipped_expected : ndarray, shape (m, 2)
        That share without outliers, and with the contamination that psi is made for, that is nominal, or the one given;
        NaN where the noise is learned and no psi clips.
    longest_run : ndarray, shape (m,)
        Longest run of clipped samples.
    longest_run_expected : ndarray, shape (m,)
        Length that 99 % of recordings with so many clipped samples at random stay below.
    beyond_3_sigma : ndarray, shape (m,)
        Share of \\|e_i\\| > 3.
    scale : ndarray, shape (m,)
        Standard deviation of the ordinary e_i, by the median; 1 if the model is right.
    outliers : ndarray, shape (m,)
        Share of samples that are far from the ordinary ones.
    autocorrelation : ndarray, shape (m,)
        Of successive e_i, outliers cut.
    whiteness : ndarray, shape (m,)
        p-value of Ljung and Box over ten lags, outliers cut.
    nis : Band
        Mean of y' S^-1 y over samples without a clipped component: mean, expected, lower, upper (99 %). The
        expectation is that of a truncated distribution.
    findings : tuple of Finding
        The causes, the weightiest first; empty if there is nothing unusual.
    """

    samples: int
    observed: Array
    clipped: Array
    clipped_expected: Array
    longest_run: Array
    longest_run_expected: Array
    beyond_3_sigma: Array
    scale: Array
    outliers: Array
    autocorrelation: Array
    whiteness: Array
    nis: Band
    findings: tuple[Finding, ...]

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes, the weightiest first."""
        return tuple(finding.cause for finding in self.findings)

    def __str__(self) -> str:
        """Say the causes, then the figures of each sensor."""
        lines = [wrapped(finding.text, "  ") for finding in self.findings] or ["Nothing unusual."]
        if not np.any(self.observed):
            lines = ["Nothing was measured, so that nothing can be said."]
        elif not self.findings and self.samples <= _SHORT:
            fit = "may not show; estimate_noise(kf, zs).intervals() says which fit"
            lines.append(wrapped(f"In {self.samples} samples an R or Q that is wrong {fit}.", "  "))
        for i in range(len(self.observed)):
            low, high = self.clipped_expected[i]
            # Learnt noise has no threshold, so that no share is expected.
            expected = "" if np.isnan(low) else f"expected {low:.0%} to {high:.0%}, "
            text = (
                f"  z[{i}]: {self.observed[i]} of {self.samples} samples; {self.clipped[i]:.0%} clipped "
                f"({expected}longest run {self.longest_run[i]}, "
                f"at random below {self.longest_run_expected[i]:.0f}); {self.beyond_3_sigma[i]:.1%} beyond 3 sigma; "
                f"ordinary innovations {self.scale[i]:.2g} sigma; successive ones correlated "
                f"{self.autocorrelation[i]:+.2f} (p={self.whiteness[i]:.2g})"
            )
            lines.append(wrapped(text))
        mean, expected = self.nis.mean, f"(expected {self.nis.lower:.2f} to {self.nis.upper:.2f})"
        lines.append(f"  normalized innovation squared of unclipped samples {mean:.2f} {expected}")
        sections = [_SECTIONS[cause] for cause in self.causes if cause in _SECTIONS]
        if sections:
            lines.append(wrapped(f"Remedies: {pointer(*sections)}.", "  "))
        return "\n".join(lines)


def diagnose(  # what filterpy's `batch_filter` takes, and two words
    source: Any, zs: Any = None, *, us: Any = None, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None,
    Bs: Any = None, contamination: float | None = None, progress: bool | None = None,
) -> Diagnosis:  # fmt: skip
    """Say whether a filter's model fits a recording, and if it does not, why.

    Parameters
    ----------
    source : RobustKalmanFilter, filterpy filter, Saver or ParameterTracker
        A filter as it was before the recording (a copy runs over zs); a `filterpy.common.Saver` whose ``save()`` was
        called after each update; or a tracker as it was before the recording.
    zs : sequence of length N, optional
        Measurements as `batch_filter` takes them; the outputs y for a tracker; not for a Saver.
    us : sequence of length N, optional
        Inputs.
    Fs, Qs, Hs, Rs, Bs : sequence of length N, optional
        Matrices of each step as in `batch_filter`; for a filter only.
    contamination : float, optional
        Share of outliers to be expected, in [0, 1). Default: the one that the threshold of `Huber` is made for, the
        one that ``noise=Contaminated(..)`` tells, any where noise is learned, 0 for another psi.
    progress : bool, optional
        Whether to say on standard error what it is at: by default after 2 s.

    Returns
    -------
    Diagnosis
        Figures and findings.

    Raises
    ------
    TypeError
        If source is none of these, or zs is missing or superfluous.
    ValueError
        If there are no samples or their number of components changes.

    Notes
    -----
    Of one sensor and a state that follows it, often nothing in the data tells a wrong H from a wrong Q;
    what is named then is the simplest repair. Factors below 2 of a variance are not reported. The causes are looked
    for in the first 4000 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy import RobustKalmanFilter
    >>> rng = np.random.default_rng(1)
    >>> kf = RobustKalmanFilter(dim_x=1, dim_z=1)
    >>> kf.F, kf.H, kf.Q, kf.R = np.eye(1), np.eye(1), 0.01 * np.eye(1), 0.1 * np.eye(1)
    >>> level = np.cumsum(0.1 * rng.normal(size=300))
    >>> diagnose(kf, level + rng.normal(size=300)).causes
    ('R too small',)
    """
    with stages("diagnose", progress):
        recording = _recorded(source, zs, {"us": us, "Fs": Fs, "Qs": Qs, "Hs": Hs, "Rs": Rs, "Bs": Bs})
        if contamination is not None:
            recording = replace(recording, contamination=fraction("contamination", contamination))
        return _diagnosis(recording)


def _recorded(source: Any, zs: Any, per_step: dict[str, Any]) -> FilterRecord:
    """Return the recording of any kind of source."""
    if is_saver(source):
        if zs is not None or any(values is not None for values in per_step.values()):
            raise TypeError("zs: expected None with a Saver, which has kept the measurements")
        return of_saver(source)
    is_tracker = hasattr(source, "structure") and hasattr(source, "filter")
    if not is_tracker and not (hasattr(source, "batch_filter") and hasattr(source, "H")):
        raise TypeError(
            "source: expected a filter with batch_filter and a matrix H (a linear filter, a Saver or a tracker), got "
            f"{type(source).__name__}; for another filter, keep its run in a filterpy.common.Saver, save() after each "
            "update; for the result of a tracker's run, pass the tracker as it was before, and the recording"
        )
    if zs is None:
        raise TypeError("zs: expected the measurements, got None")
    if is_tracker:
        if any(values is not None for name, values in per_step.items() if name != "us"):
            raise TypeError("Fs, Qs, Hs, Rs, Bs: expected None with a tracker")
        return of_tracker(source, zs, per_step["us"])
    return of_filter(source, zs, per_step)


def _diagnosis(recording: FilterRecord) -> Diagnosis:
    """Return the figures and the causes."""
    e = statistics.normalized(recording)
    seen = ~np.isnan(e)
    figures: dict[str, Any] = {
        "samples": len(e),
        "observed": seen.sum(axis=0),
        "clipped_expected": np.column_stack(statistics.expected_clipped(recording)),
        "nis": statistics.unclipped_nis(recording),
    }
    names = ("clipped", "longest_run", "longest_run_expected", "beyond_3_sigma", "scale", "outliers")
    each = [statistics.of_sensor(e[here, i], recording.clipped[here, i]) for i, here in enumerate(seen.T)]
    figures |= dict(zip((*names, "autocorrelation", "whiteness"), map(np.array, zip(*each, strict=True)), strict=True))
    return Diagnosis(**figures, findings=tuple(_findings(recording, e, figures)))


def _findings(recording: FilterRecord, e: Array, figures: dict[str, Any]) -> list[Finding]:
    """Return what is wrong: first what the measurements themselves show, then what a repair explains."""
    findings, z = [], recording.z.copy()
    for i in range(z.shape[1]):
        read = z[~np.isnan(z[:, i]), i]
        limit, run = statistics.saturated(read), statistics.frozen(read)
        if recording.model is not None and read.size and not recording.model.H[:, i].any():
            text = f"z[{i}] moves no state: its row of H is 0 (what H is before it is set)."
            findings.append(Finding("H is 0", i, 0.0, math.nan, text))
        elif limit is not None and not (run and statistics.breaks_loose(read, limit)):
            share = float(np.mean(z[:, i] == limit))
            text = f"z[{i}] saturates: {share:.0%} of its samples are exactly {limit:.6g}, the end of its range."
            findings.append(Finding("saturation", i, limit, math.nan, text + " Pass them as NaN (missing)."))
            z[z[:, i] == limit, i] = np.nan
        elif recording.model is not None and (period := statistics.wraps(read)) is not None:
            text = f"z[{i}] wraps at {period:.6g}, which a linear filter takes for a jump: pass it unwrapped, by"
            text += f" numpy.unwrap(z, period={period:.6g}), or take a filter with a residual function."
            findings.append(Finding("wrapping", i, period, math.nan, text))
        elif run:
            text = f"z[{i}] is frozen: {run} successive samples are exactly the same. Pass them as NaN (missing)."
            findings.append(Finding("frozen sensor", i, float(run), math.nan, text))
    if findings:
        # What a clipped or frozen signal does to the innovations afterwards says nothing about the model.
        return findings
    if recording.model is None or figures["observed"].max() < 20:
        return _by_innovations(figures, recording)
    causes = search.find(recording.model, z[:_SEARCHED], e[:_SEARCHED])
    return [
        _in_words(repair, gain, figures, recording.by_noise)
        for repair, gain in causes
        if repair.cause != "more outliers" or _is_excessive(repair.value, recording.contamination)
    ]


def _by_innovations(figures: dict[str, Any], recording: FilterRecord) -> list[Finding]:
    """Return what the innovations alone show, where there is no linear model to repair."""
    findings = []
    for i, (scale, p) in enumerate(zip(figures["scale"], figures["whiteness"], strict=True)):
        if figures["observed"][i] >= 20 and not 0.7 < scale < 1.5:
            size = "small" if scale > 1 else "large"
            text = (
                f"S is about {max(scale**2, scale**-2):.2g} times too {size} for z[{i}]: its ordinary innovations are "
                f"{scale:.2g} sigma, {figures['beyond_3_sigma'][i]:.0%} exceed 3 sigma; look at R and Q."
            )
            findings.append(Finding(f"S too {size}", i, float(scale**2), math.nan, text))
        if p < 1e-6 and abs(figures["autocorrelation"][i]) > 0.2:
            r = float(figures["autocorrelation"][i])
            why = "Q too small, or the model or its linearization wrong" if r > 0 else "Q too large or R too small"
            text = f"Successive innovations of z[{i}] are correlated ({r:+.2f}): {why}."
            findings.append(Finding("not white", i, r, math.nan, text))
        share = float(figures["outliers"][i])
        if not findings and _is_excessive(share, recording.contamination):
            text = _many_outliers(f"z[{i}]", share, recording.by_noise)
            findings.append(Finding("more outliers", i, share, math.nan, text))
    return findings


def _is_excessive(share: float, contamination: float) -> bool:
    """Tell clearly more outliers than expected."""
    return share > max(2.0 * contamination, contamination + 0.1)


def _many_outliers(z: str, share: float, by_noise: bool) -> str:
    """Return the advice for many outliers."""
    than, mend = "psi is made for", f"Huber.from_contamination({share:.2g}) is made for them."
    if by_noise:
        than, mend = "noise= tells", f"Contaminated({share:.2g}, ..) tells so many, Learnt() learns how many."
    return f"{z} has more outliers than {than}: about {share:.0%} among ordinary samples; {mend}"


def _in_words(repair: Repair, gain: float, figures: dict[str, Any], by_noise: bool) -> Finding:
    """Return a repair in words."""
    i, value = repair.sensor, repair.value
    z = "z" if i is None else f"z[{i}]"
    beyond = float(np.nanmax(figures["beyond_3_sigma"]) if i is None else figures["beyond_3_sigma"][i])
    if repair.cause in ("R", "Q", "R and Q"):
        size, factor = "small" if value > 1 else "large", max(value, 1 / value)
        which = repair.cause if i is None else f"R[{i}, {i}]"
        power = 0.5 * math.log10(factor)
        if repair.cause == "R and Q" and power > 1.8 and abs(power - round(power)) < 0.15:
            times = f"{10 ** round(power):g} times {'larger' if value > 1 else 'smaller'}"
            text = f"z may be in another unit: innovations are {times} than R and Q expect, both alike."
            return Finding("lost units", i, math.sqrt(value), gain, text)
        verb = "are" if repair.cause == "R and Q" else "is"
        text = f"{which} {verb} about {factor:.2g} times too {size}: {beyond:.0%} of innovations exceed 3 sigma"
        if repair.cause == "Q" and size == "small":
            text += " and keep their sign; the state moves more than the filter believes."
        elif size == "small":
            text += '; who judges by R (a gate, `scaling="innovation"`) clips good data.'
        else:
            text += "; with it outliers pass for good data."
        return Finding(f"{repair.cause} too {size}", i, value, gain, text)
    row = ", ".join(f"{value:.3g}" for value in np.atleast_2d(repair.rows)[i or 0]) if repair.cause == "H" else ""
    texts = {
        "units": f"{z} is about {value:.4g} times what H x says: lost units?",
        "H": f"Row {i} of H does not fit {z}; [{row}] does.",
        "correlated noise": f"The noise of z is correlated in time, about {value:+.2g} from sample to sample: model it "
        "as a state.",
        "coupled noise": f"The noise of two sensors is correlated, by roughly {value:+.1g} more than R says.",
        "more outliers": _many_outliers(z, value, by_noise),
        "state jump": f"A level shift at sample {value:.0f}: {z} moves to another level and stays there.",
        "level shift": f"A level shift of one sensor at sample {value:.0f}: {z} moves and the other sensors do not "
        "follow.",
        "wrong start": "The first state is further from the truth than its P says: x is wrong at the start, or P too "
        "small.",
        "bias": f"{z} has a constant bias against the other sensors.",
    }
    cause = {"units": "lost units", "H": "wrong H", "state jump": "level shift"}.get(repair.cause, repair.cause)
    return Finding(cause, i, value, gain, texts[repair.cause])
