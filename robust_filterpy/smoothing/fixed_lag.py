"""FixedLagSmoother: filterpy's live smoother, which weighs its last measurements anew with each one that comes."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _filterpy, _state
from robust_filterpy._arrays import control_term, measured, noise_covariance, process_noise, state_of
from robust_filterpy._brief import lines_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import GROUPINGS, Grouping
from robust_filterpy.filters.driver import at_step
from robust_filterpy.influence.functions import Influence, Linear
from robust_filterpy.smoothing.linear_pass import Recording, Smooth, Weighting, problem, smoothing_pass
from robust_filterpy.smoothing.rules import Belief, Learnt, Mixture, Rule, rule_of
from robust_filterpy.smoothing.sweeps import reweighted

__all__ = ["FixedLagSmoother"]

# Sweeps over the window for each new measurement; it starts from the last weights, so that it seldom takes more.
_SWEEPS = 10
# Weight of a measurement that nothing has been said about: next to none, so that the others judge it first.
_UNJUDGED = 1e-3
# How fast learned noise forgets: about a thousand samples.
_MEMORY = 0.999


class _Window(NamedTuple):
    """Measurements in the window, the matrices of their times, what they weigh at present; (steps, ..)."""

    F: Array
    Q: Array
    c: Array
    H: Array
    R: Array
    z: Array
    precision: Array
    offset: Array
    process_scale: Array

    @classmethod
    def empty(cls, n: int, m: int) -> _Window:
        """Return a window without a step."""
        shapes = (n, n), (n, n), (n,), (m, n), (m, m), (m,), (m,), (m,), ()
        return cls(*(np.empty((0, *shape)) for shape in shapes))


class FixedLagSmoother(_filterpy.FixedLagSmoother):
    """Smooth live like `filterpy.kalman.FixedLagSmoother`, without believing outliers.

    After each measurement ``xSmooth[k - i]`` for i = 0..N is the estimate of step k - i from everything up to step k,
    with weights that the later measurements had a say in. A measurement that leaves the window keeps its last weight.

    Parameters
    ----------
    dim_x, dim_z : int
        Lengths of the state and of the measurement, >= 1.
    N : int, optional
        The lag in steps, >= 1; not needed for `smooth_batch`.
    influence, process, grouping
        As in `robust_filterpy.smooth`: by default contamination and size of outliers are learned.

    Attributes
    ----------
    x, P : ndarray
        Estimate of the last step, shape (dim_x, 1) or (dim_x,), and its covariance.
    x_s : ndarray, shape of x
        Estimate of the oldest step in the window.
    xSmooth : list of ndarray
        Estimates of all steps.
    weights : ndarray, shape (steps in the window, dim_z)
        How much the measurements in the window are believed at present, NaN where missing.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    With ``influence=Linear()``, x and P are filterpy's, and xSmooth is the exact conditional mean, that of a smoother
    of Rauch, Tung and Striebel over the data so far. filterpy's own recursion puts the corrected covariance where the
    predicted one belongs (D. Simon, Optimal State Estimation, 2006, section 9.3), so that its xSmooth is not that mean.

    Examples
    --------
    >>> smoother = FixedLagSmoother(dim_x=1, dim_z=1, N=3)
    >>> smoother.Q = 0.01 * np.eye(1)
    >>> for z in [0.1, -0.2, 500.0, 0.3, 0.0, 0.1, -0.1]:
    ...     smoother.smooth(z)
    >>> len(smoother.xSmooth), bool(abs(smoother.xSmooth[2][0, 0]) < 0.5)
    (7, True)
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        N: int | None = None,
        *,
        influence: Influence | None = None,
        process: Influence | None = Linear(),
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the choices."""
        for name, value in (("dim_x", dim_x), ("dim_z", dim_z), ("N", 1 if N is None else N)):
            _checks.count(name, value, 1)
        self._joint = _checks.option("grouping", grouping, GROUPINGS) == "joint"
        self._influence, self._process = influence, process
        self._rules(np.ones((1, 1, dim_z), dtype=bool), np.ones((1, 1, dim_x), dtype=bool))
        super().__init__(dim_x, dim_z, N)
        self._window = _Window.empty(dim_x, dim_z)
        self._prior = (np.zeros(dim_x), np.eye(dim_x))
        self._beliefs = [Belief(), Belief()]
        self._mixtures: list[Mixture | None] = [None, None]
        self.weights = np.empty((0, dim_z))

    def __str__(self) -> str:
        """Show where the smoother stands and what it has learnt; `repr` shows every matrix."""
        parts = {"x": np.ravel(self.x), "std": np.sqrt(np.maximum(np.diag(self.P), 0.0))}
        if len(self.weights):
            parts |= {f"x, {len(self.weights) - 1} steps before": np.ravel(self.x_s), "weights": np.ravel(self.weights)}
        for name, mixture in zip(("measurements", "process"), self._mixtures, strict=True):
            if mixture is not None:
                parts[f"share of outliers, {name}"] = np.ravel(mixture.contamination)
                parts[f"size over ordinary, {name}"] = np.ravel(mixture.ratio)
        lag = "N is not set" if self.N is None else f"lag {self.N}"
        head = f"{type(self).__name__}: {self.dim_x} states, {self.dim_z} measured, {lag}; repr() shows every matrix"
        return "\n".join([head, *lines_of(parts)])

    def smooth(self, z: ArrayLike | None, u: ArrayLike | None = None) -> None:
        """Take a measurement and smooth the last N + 1 steps.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar, optional
            Control input.

        Raises
        ------
        ValueError, TypeError
            If something does not fit; nothing has changed then.
        """
        if self.N is None:
            raise ValueError("N: expected a lag, got None; use FixedLagSmoother(dim_x, dim_z, N=..)")
        x, P = state_of(self)
        step = self._step(z, u, x)
        prior = self._prior if len(self._window.z) else (x.ravel().copy(), P.copy())
        parts = zip(self._window, step, strict=True)
        window = _Window(*(np.concatenate([a, np.reshape(b, (1, *a.shape[1:]))]) for a, b in parts))
        there = problem(*(a[None] for a in (*window[:6], *prior)))
        rules = self._rules(there.observed, there.driven)
        start = Weighting(*(a[None] for a in window[6:]))
        fit = reweighted(there.model, there.observed, *rules, _SWEEPS, start=start)
        window = _Window(*window[:6], *(a[0] for a in fit.weighting))
        after: dict[str, Any] = {"_prior": prior, "_beliefs": self._beliefs, "_window": window}
        after |= self._shown(fit.smooth, step, x, P, rules)
        if len(window.z) > self.N:
            after |= self._left(there, fit.weighting, rules, window)
        after["_settled"] = len(self.xSmooth) + 1 - len(window.z)
        # Everything at once, so that an interrupt falls before it or behind it.
        self.__dict__.update(after)

    def _step(self, z: Any, u: Any, x: Array) -> _Window:
        """Return a measurement with the matrices of its time, without the axis of steps."""
        n, m = self.dim_x, self.dim_z
        F, H = _checks.matrix("F", self.F, (n, n), "dim_x"), _checks.matrix("H", self.H, (m, n), f"dim_z={m}")
        values = np.full(m, np.nan) if z is None else np.atleast_1d(measured(z, m, missing=True))
        c = np.zeros(n) if u is None else np.zeros(n) + control_term(self.B, u, (n,))
        Q = process_noise(self.Q, None, n) * np.ones((n, n))
        R, precision = noise_covariance(self.R, None, m), np.where(np.isnan(values), 0.0, _UNJUDGED)
        return _Window(F, Q, c, H, R, values, precision, np.zeros(m), np.ones(()))

    def _rules(self, observed: Array, driven: Array) -> tuple[Rule, Rule]:
        """Return what is made of residuals, with what was learned so far."""
        measurement = rule_of("influence", self._influence, self._joint, observed)
        rules = measurement, rule_of("process", self._process, True, driven)
        for rule, belief, mixture in zip(
            rules, getattr(self, "_beliefs", ()), getattr(self, "_mixtures", ()), strict=False
        ):
            if isinstance(rule, Learnt):
                rule.belief, rule.mixture = belief, rule.mixture if mixture is None else mixture
        return rules

    def _shown(self, smooth: Smooth, step: _Window, x: Array, P: Array, rules: tuple[Rule, Rule]) -> dict[str, Any]:
        """Return filterpy's attributes after a step."""
        shape = x.shape
        prior = step.F @ x.ravel() + step.c
        y = np.where(np.isnan(step.z), 0.0, step.z - step.H @ prior)
        states = [one.reshape(shape) for one in smooth.x[0]]
        return {
            "y": y.reshape((-1, 1) if len(shape) == 2 else -1),
            "S": step.H @ (step.F @ P @ step.F.T + step.Q) @ step.H.T + step.R,
            "x": states[-1].copy(), "P": smooth.P[0, -1].copy(), "x_s": states[0].copy(), "_latest": states,
            "_mixtures": [rule.mixture for rule in rules], "weights": np.array(rules[0].weights[0]),
            "count": self.count + 1,
        }  # fmt: skip

    def _left(
        self, there: Recording, weighting: Weighting, rules: tuple[Rule, Rule], window: _Window
    ) -> dict[str, Any]:
        """Let the oldest step go: the prior of the window moves on by it, and learned noise remembers it."""
        model = there.model
        model = model._replace(**{name: getattr(model, name)[:, :1] for name in ("F", "G", "c", "H", "z")})
        first = smoothing_pass(model, Weighting(*(a[:, :1] for a in weighting)), states=True)
        beliefs = [rule.remembered(_MEMORY) if isinstance(rule, Learnt) else Belief() for rule in rules]
        window = _Window(*(a[1:] for a in window))
        return {"_prior": (first.x[0, 0].copy(), first.P[0, 0].copy()), "_window": window, "_beliefs": beliefs}

    @property
    def xSmooth(self) -> list[Array]:
        """Estimates of all steps: one list, brought up to date when it is looked at."""
        if self._in_list is not self._latest:
            # Again and again the same, should an interrupt fall between the two.
            self._estimates[self._settled :] = self._latest
            self._in_list = self._latest
        return self._estimates

    @xSmooth.setter
    def xSmooth(self, value: list[Array]) -> None:
        """Begin another list."""
        latest: list[Array] = []
        self.__dict__.update(_estimates=list(value), _settled=len(value), _latest=latest, _in_list=latest)

    _estimates: list[Array]
    _latest: list[Array]
    _in_list: list[Array]
    _settled: int
    count: int

    def state(self) -> dict[str, Array]:
        """Return everything that the smoother needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            ``format``, as in `robust_filterpy.RobustKalmanFilter.state`; x and P; the window, a row for each of its L
            steps: F, Q, c, H, R, z, precision, offset, process_scale and the estimates smooth; the prior before
            the window, prior_x and prior_P; count; and what is learned of the noises, beliefs (2, 4, kinds) and
            mixtures (2, 2, kinds), NaN where nothing is. All of float64.
        """
        x, P = state_of(self)
        steps = len(self._window.z)
        window = {f"window_{name}": array for name, array in self._window._asdict().items()}
        smooth = np.reshape(self.xSmooth[len(self.xSmooth) - steps :], (steps, self.dim_x))
        parts = {"smooth": smooth, "prior_x": self._prior[0], "prior_P": self._prior[1], "count": self.count}
        return _state.labelled(self._kind, {"x": x, "P": P, **window, **parts, **self._learnt_arrays()})

    def restore(self, state: Any) -> None:
        """Go back to a state of this smoother, or of another one made like it.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If it is of something else or of a newer format, an array is missing, does not fit, or is not finite, or P
            is no covariance; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit. xSmooth begins with the oldest step of the window. F, Q, H, R and
        B of the steps to come are those of this object.
        """
        n, m = self.dim_x, self.dim_z
        parts = {f"window_{k}": (None, *a.shape[1:]) for k, a in _Window.empty(n, m)._asdict().items()}
        needed = {"x": (n,), "P": (n, n), **parts, "smooth": (None, n), "prior_x": (n,), "prior_P": (n, n), "count": ()}
        needed |= {name: array.shape for name, array in self._learnt_arrays().items()}
        entries = _state.checked(state, self._kind, needed, {}, ("window_z", "beliefs", "mixtures"))
        steps = len(entries["smooth"])
        if any(len(entries[name]) != steps for name in parts):
            raise ValueError(f"state: expected {steps} steps in each part of the window, got others")
        self.x, self.P, shape = entries["x"], entries["P"], entries["x"].shape
        self._window = _Window(*(entries[name] for name in parts))
        self._prior, self.count = (entries["prior_x"], entries["prior_P"]), int(entries["count"])
        self.xSmooth = [one.reshape(shape).copy() for one in entries["smooth"]]
        self.x_s = self.xSmooth[0].copy() if steps else np.zeros(shape)
        self.weights = np.empty((0, m))
        for i, size in enumerate((1 if self._joint else m, 1)):
            belief, mixture = entries["beliefs"][i, :, :size], entries["mixtures"][i, :, :size]
            self._beliefs[i] = Belief() if np.isnan(belief).all() else Belief(*belief[:, None])
            self._mixtures[i] = None if np.isnan(mixture).all() else Mixture(*mixture[:, None])

    @property
    def _kind(self) -> str:
        """What a state belongs to."""
        return f"{type(self).__name__} of lag {self.N}"

    def _learnt_arrays(self) -> dict[str, Array]:
        """Return what is learned of measurement and process noise, NaN where nothing is."""
        kinds = 1 if self._joint else self.dim_z
        entries = {"beliefs": np.full((2, 4, kinds), np.nan), "mixtures": np.full((2, 2, kinds), np.nan)}
        for name, noises in (("beliefs", self._beliefs), ("mixtures", self._mixtures)):
            for i, parts in enumerate(noises):
                for j, part in enumerate(parts or ()):
                    # One that has not met a sample is made of numbers.
                    if np.ndim(part):
                        entries[name][i, j, : np.size(part)] = np.ravel(part)
        return entries

    def smooth_batch(self, zs: Any, N: int, us: Any = None) -> tuple[Array, Array]:
        """Smooth a recording with a lag, and change nothing in this object.

        Parameters
        ----------
        zs : sequence of length n
            Measurements as `smooth` takes them.
        N : int
            The lag in steps, >= 1.
        us : sequence of length n, optional
            Control inputs.

        Returns
        -------
        xSmooth : ndarray, shape (n, dim_x) or (n, dim_x, 1)
            Estimate of each step from everything up to N steps later.
        xhat : ndarray, shape of xSmooth
            Estimate of each step from everything up to it.

        Raises
        ------
        ValueError, TypeError
            As `smooth`, with the step named.
        """
        live = copy.deepcopy(self)
        live.N, live.count, live.xSmooth = _checks.count("N", N, 1), 0, []
        live._window = _Window.empty(self.dim_x, self.dim_z)
        if us is not None and len(us) < len(zs):
            raise ValueError(f"us: expected an entry for each of the {len(zs)} measurements, got {len(us)}")
        latest = []
        for k, z in enumerate(zs):
            with at_step(k):
                live.smooth(z, None if us is None else us[k])
            latest.append(live.x)
        shape = (len(latest), *np.shape(self.x))
        return np.array(live.xSmooth).reshape(shape), np.array(latest).reshape(shape)
