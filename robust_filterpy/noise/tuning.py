"""One call from a recording to a filter: fit the noises, try each kind of filter, return the one that follows best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._brief import wrapped
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.mixin import leave_unwatched
from robust_filterpy.influence.functions import TukeyBiweight
from robust_filterpy.noise.estimation import Groups, NoiseEstimate, estimate_noise

__all__ = ["Tuned", "tune"]

# Where no outlier was seen, the filter still expects one in 500.
_LEAST_CONTAMINATION = 0.002
# An innovation counts up to so many times the median one: a sentinel value must not hide everything else.
_FAR = 100.0
# What a filter more than the simplest has to gain, so that it is not taken where both are the same.
_GAIN = 0.003
# By how much the measurements must be more likely, in nats, before sensors are taken to fail together.
_SURELY = 3.0
# Below this score a kind has shown what it is for.
_CLEARLY = 0.99
#: What makes each kind of filter, the simplest first; told noise is what was fitted.
_KINDS: dict[str, dict[str, Any]] = {
    "one-sided": {"noise": Contaminated()},
    "adaptive": {"noise": Learnt(), "process": Scales()},
    "two-sided": {"noise": Contaminated(), "process": Scales((1.0, 10.0, 100.0), jump=0.0)},
    "recovering": {"influence": TukeyBiweight(), "patience": 12},
}
_REASONS = {
    "one-sided": "measurement outliers come one by one and the process is ordinary",
    "adaptive": "the noises change, or outliers come in runs, or the process is not ordinary all the time",
    "two-sided": "the state jumps, and is believed at once",
    "recovering": "the state jumps, and measurements that insist are believed",
}


@dataclass(frozen=True)
class Tuned:
    """Hold what `tune` chose.

    Attributes
    ----------
    filter : RobustKalmanFilter
        The filter, configured, at the x and P of the one that was given.
    kind : {"one-sided", "adaptive", "two-sided", "recovering"}
        Which kind it is.
    noise : NoiseEstimate
        What was fitted.
    scores : dict of str to float
        Mean absolute innovation of each kind over that of the one-sided filter, mean of the sensors.
    report : str
        The choice in words.
    """

    filter: Any
    kind: str
    noise: NoiseEstimate
    scores: dict[str, float]
    report: str

    def __str__(self) -> str:
        """Return the report on lines that a screen holds."""
        return "\n".join(map(wrapped, self.report.splitlines()))


def tune(
    kf: Any,
    zs: Any,
    *,
    us: Any = None,
    Fs: Any = None,
    Qs: Any = None,
    Hs: Any = None,
    Rs: Any = None,
    R: Groups = "each",
    Q: Groups = True,
    grouping: Grouping | None = None,
) -> Tuned:
    """Return a filter configured for the noises of a recording.

    Fits R, Q, contamination and scale ratio (`estimate_noise`), runs a filter of each kind over the recording, and
    takes the one that predicts the measurements best: with the least mean absolute innovation. Outliers add the same
    to all of them, a filter that is off adds to its own.

    Parameters
    ----------
    kf : KalmanFilter
        A linear filter of filterpy or of this package, with F, H, x, P set and R, Q as the first guess. It is not
        changed.
    zs : array_like, shape (N,) or (N, dim_z), or sequence
        Measurements as `batch_filter` takes them, some hundreds at least: NaN and None are missing.
    us : array_like, shape (N,) or (N, dim_u), optional
        Control inputs.
    Fs, Qs, Hs, Rs : sequence of length N, optional
        Matrices of each step, otherwise the filter's own. Qs and Rs are multiplied by the fitted factors.
    R, Q : bool, "each" or sequence of int
        What to scale, as in `estimate_noise`; by default each sensor's variance, and Q as a whole.
    grouping : {"component", "joint"}, optional
        Whether sensors fail each on its own or together. Default: as kf has it if it says that some fail together, else
        both are tried and the one that makes the recording more likely is taken.

    Returns
    -------
    Tuned

    Raises
    ------
    TypeError
        If kf is no linear filter of filterpy's kind.
    ValueError
        If the recording has fewer than 10 measurements, or an option or shape does not fit.

    Notes
    -----
    The kinds, all of them `RobustKalmanFilter`: "one-sided" with ``noise=Contaminated(..)``, the fitted numbers;
    "adaptive" with ``noise=Learnt()`` and ``process=Scales()``, which starts with what it has learnt from this
    recording; "two-sided" as one-sided, with ``process=Scales((1, 10, 100), jump=0)``; "recovering" with
    ``influence=TukeyBiweight()`` and ``patience=12``. Two kinds that score within a percent are equally good, and
    chance chooses. A run of outliers that is longer than a filter resists draws its predictions too, which the
    innovations do not tell from a state that moved: where such runs are known to happen, look at the report before you
    use the filter.

    On recordings with `Qs` or `Rs` the filter that is returned has its own Q and R scaled; scale the matrices of each
    step by ``noise.Q_scale`` and ``noise.R_scale`` when it runs.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> rng = np.random.default_rng(0)
    >>> level = np.cumsum(0.5 * rng.standard_normal(400))
    >>> zs = level + np.where(rng.random(400) < 0.1, 20.0, 2.0) * rng.standard_normal(400)
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H = np.eye(1)
    >>> tuned = tune(kf, zs)
    >>> tuned.kind
    'one-sided'
    >>> means, *_ = tuned.filter.batch_filter(zs)
    """
    if hasattr(kf, "structure"):
        raise TypeError("kf: expected a linear filter, got a ParameterTracker; use estimate_noise(tracker, y, us=u)")
    tried: tuple[Any, ...] = (getattr(kf, "grouping", "component"),) if grouping is None else (grouping,)
    _checks.option("grouping", tried[0], ("component", "joint"))
    noise = estimate_noise(kf, zs, us=us, Fs=Fs, Qs=Qs, Hs=Hs, Rs=Rs, R=R, Q=Q)
    if grouping is None and tried == ("component",) and kf.dim_z > 1:
        tried = ("component", "joint")
    steps = {
        "Fs": Fs, "Hs": Hs, "us": us,
        "Qs": None if Qs is None else [_by_factors(Q_k, noise.Q_scale) for Q_k in Qs],
        "Rs": None if Rs is None else [_by_factors(R_k, noise.R_scale) for R_k in Rs],
    }  # fmt: skip
    plain = {each: _run(_with_model(_KINDS["one-sided"], each, kf, noise), zs, steps) for each in tried}
    best: Any = max(plain, key=lambda each: plain[each].log_likelihood - _SURELY * (each != tried[0]))
    filters = {kind: _with_model(options, best, kf, noise) for kind, options in _KINDS.items()}
    scores = {"one-sided": 1.0}
    for name in list(filters)[1:]:
        scores[name] = _score(_run(filters[name], zs, steps).y, plain[best].y)
    kind = min(scores, key=lambda name: scores[name] + _GAIN * (name != "one-sided"))
    chosen = _with_model(_KINDS[kind], best, kf, noise)
    if kind == "adaptive":
        chosen.learnt = filters[kind].learnt.copy()
    report = _report(kind, noise, scores, filters["adaptive"])
    if len(tried) > 1:
        report += f"\nSensors fail {'together' if best == 'joint' else 'each on its own'}."
    return Tuned(chosen, kind, noise, scores, report)


def _with_model(options: dict[str, Any], grouping: Any, kf: Any, noise: NoiseEstimate) -> Any:
    """Return a filter with the model of another and the noise that was fitted."""
    filter: Any = RobustKalmanFilter(kf.dim_x, kf.dim_z, getattr(kf, "dim_u", 0), grouping=grouping, **options)
    for name in ("x", "P", "F", "H", "B", "M"):
        value = getattr(kf, name, None)
        if value is not None and not (name == "M" and np.shape(value) != (kf.dim_x, kf.dim_z)):
            setattr(filter, name, np.array(value, dtype=float))
    filter.alpha, filter.inv = getattr(kf, "alpha", 1.0), getattr(kf, "inv", np.linalg.inv)
    return replace(noise, contamination=max(noise.contamination, _LEAST_CONTAMINATION)).apply(filter)


class _Run(NamedTuple):
    """What a filter made of a recording."""

    y: Array
    """Innovations, NaN where a component was missing, shape (N, m)."""
    log_likelihood: float


def _run(filter: Any, zs: Any, steps: dict[str, Any]) -> _Run:
    """Run a filter over a recording."""
    kept, likely = [], []
    # What a candidate does badly is said by its score.
    leave_unwatched(filter)

    class Recorder:
        """Stand where filterpy puts its Saver."""

        def save(self) -> None:
            """Keep the innovation and how likely it was."""
            likely.append(filter.log_likelihood)
            kept.append(np.where(np.isnan(filter.weights), np.nan, filter.y).ravel())

    filter.batch_filter(zs, saver=Recorder(), **steps)
    return _Run(np.array(kept), float(np.sum(likely)))


def _score(y: Array, reference: Array) -> float:
    """Return the mean absolute innovation over another filter's, mean of the sensors that were ever seen."""
    sizes, others = np.abs(y), np.abs(reference)
    seen = ~np.isnan(others).all(axis=0)
    limit = _FAR * np.nanmedian(others[:, seen], axis=0)
    ratios = [np.nanmean(np.minimum(each[:, seen], limit), axis=0) for each in (sizes, others)]
    return float(np.mean(ratios[0] / np.maximum(ratios[1], 1e-300)))


def _by_factors(covariance: Any, factors: Array) -> Array:
    """Multiply variances by factors and keep correlations."""
    root = np.sqrt(factors)
    return np.asarray(root[:, None] * (np.asarray(covariance, dtype=float) * np.ones((len(root),) * 2)) * root)


def _report(kind: str, noise: NoiseEstimate, scores: dict[str, float], adaptive: Any) -> str:
    """Return the choice in words."""
    factor = ", ".join(f"{v:.3g}" for v in noise.R_scale)
    lines = [
        f"R times {factor}; Q times {', '.join(f'{v:.3g}' for v in dict.fromkeys(noise.Q_scale.tolist()))}.",
        f"{100 * noise.contamination:.1f} % outliers, {noise.scale_ratio:.1f} times as large."
        if noise.contamination > _LEAST_CONTAMINATION
        else "No outliers.",
        f"Mean absolute innovation, one-sided 1: {', '.join(f'{k} {v:.3f}' for k, v in scores.items())}.",
        f"{kind}: {_REASONS[kind]}." if kind == "one-sided" or scores[kind] < _CLEARLY
        else f"{kind}: {100 * (1 - scores[kind]):.1f} % better than one-sided, which would do as well.",
    ]  # fmt: skip
    run = float(adaptive.noise_learnt.run_length.max())
    if noise.contamination > _LEAST_CONTAMINATION and run > 3.0:
        lines.insert(2, f"Outliers come in runs of about {run:.0f}.")
    if not noise.converged:
        lines.append(f"Doubtful: {noise.message}.")
    return "\n".join(lines)
