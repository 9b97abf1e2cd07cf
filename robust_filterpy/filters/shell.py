"""What every robust filter is: options, steps by the kernel, what a correction shows, a robust log-likelihood."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.common import pretty_str

from robust_filterpy import _checks, kernel
from robust_filterpy._arrays import state_of
from robust_filterpy._brief import lines_of
from robust_filterpy._checks import Array, shown
from robust_filterpy.correction.definition import correct
from robust_filterpy.correction.mixed import Mixed
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.spread import begin, settled
from robust_filterpy.filters.driver import require_finite_correction
from robust_filterpy.filters.notices import PERIOD, look, look_for_repeats, look_for_stuck
from robust_filterpy.filters.policies import Mixture, Options, Policy, policy_of
from robust_filterpy.filters.snapshot import SLOTS, put_back, snapshot, whole
from robust_filterpy.filters.states import Memories, StateMixin
from robust_filterpy.kernel.moments import log_density_of, read, weights_of

_DEFAULT_INVERSE = np.linalg.inv
Inverse = Callable[[Array], Array]
_extension = kernel.extension()
# What a subclass may do in its own way; then the kernel's is not that filter's.
_METHODS = ("_predict", "_transition", "_correct", "_measurement", "_corrected", "_inverse")


def is_own(cls: type, base: type) -> bool:
    """Return whether a subclass predicts and corrects as its base does."""
    return all(getattr(cls, name) is getattr(base, name) for name in _METHODS)


def _option(name: str, words: str) -> Any:
    """Return an option as an attribute: where it is set, the filter goes on by another policy."""

    def read(kf: Any) -> Any:
        """Return it."""
        return getattr(kf._policy if name in ("noise", "process") else kf._choices, name)

    return property(read, lambda kf, value: kf._choose(**{name: value}), doc=words)


def _view(name: str, absent: Any, words: str) -> Any:
    """Return a field of the last correction as an attribute."""
    return property(lambda kf: kf._shown(name, absent), doc=words)


def _made(name: str, words: str) -> Any:
    """Return what is made of the last correction when somebody asks for it as an attribute, which may be set."""
    place = f"_{name}"

    def read(kf: Any) -> Any:
        """Return it."""
        value = getattr(kf, place)
        if value is None:
            value = kf._make(name)
            setattr(kf, place, value)
        return value

    return property(read, lambda kf, value: setattr(kf, place, value), doc=words)


class Shell(StateMixin):
    """Add to a filter of filterpy's the choices of a robust correction and the attributes that show what it did.

    Comes before filterpy's class among the bases. The filter stores its `Correction` in ``_last`` and sets
    ``_y = _S = _SI = None`` (and ``_K = None``, unless it sets K).
    """

    __slots__ = SLOTS

    #: Whether z is a column after `update(None)` though x is none, as filterpy has it.
    _none_is_column = False
    #: Whether a kind of filter takes ``noise=``; only bounded influence is there for members of an ensemble.
    _takes_mixtures = True
    #: Whether the kernel's linear steps are this class's.
    _by_kernel = False
    #: Whether nobody else watches how often the filter clips.
    _counts_clipped = True

    noise = _option("noise", "How measurements fail: None (psi bounds them), `Contaminated` or `Learnt`.")
    process = _option("process", "What the process noise may be: None (Q as given), `Contaminated` or `Scales`.")
    patience: int | None = _option("patience", "How many readings in a row that agree are a jump; None: learned.")
    scaling: Scaling = _option("scaling", 'Which T: "learnt", "innovation", "unit" or "bounded".')
    information: Information = _option("information", 'Which D: "realized", "expected" or "weight".')
    grouping: Grouping = _option("grouping", 'Which sensors fail together: "component" (none), "joint" (all), groups.')

    @property
    def influence(self) -> Any:
        """The influence function psi; under ``noise=`` the noise, whose score is psi."""
        return self._choices.influence if self.noise is None else self.noise

    @influence.setter
    def influence(self, value: Any) -> None:
        self._choose(influence=value)

    def _set_policy(self, options: Any, **dims: int) -> None:
        """Check dimensions, and keep what was chosen as `policy_of` takes it; called before filterpy's constructor."""
        for name, value in dims.items():
            _checks.count(name, value, 0 if name == "dim_u" else 1)
        unknown = sorted(options.keys() - Options.__annotations__.keys())
        if unknown:
            names = ", ".join(Options.__annotations__)
            raise TypeError(f"{type(self).__name__}: expected options among {names}, got {unknown[0]}")
        self._policy = policy_of(**options)
        self._require_possible(self._policy)
        self._choices, self._last = self._policy.choices, None
        self._window, self._updates, self._process_scales = np.zeros((0, 2, 0)), 0, None
        self._kept = self._y = self._S = self._SI = self._K = None
        # The kernel takes arrays of the right shape, from the first measurement on.
        self._keep_sensors(Memories(self._policy.begin(dims["dim_z"]), {}))
        self._named_sensors = {}

    def _start(self) -> None:
        """Let what is kept with x and P begin at them; called at the end of a constructor."""
        x, P = state_of(self)
        # What readings have told, as a gain shows, is no guess that the next one may contradict.
        self._kept = self._policy.start(np.ravel(x), P, bool(np.any(self.K)))

    @property
    def _inverse(self) -> Inverse | None:
        """What the user wants S inverted by, None if that is what filterpy does by default."""
        if self.inv is _DEFAULT_INVERSE:
            return None
        if not callable(self.inv):
            raise TypeError(f"inv: expected a function such as numpy.linalg.pinv, got {shown(self.inv)}")
        return self.inv

    @property
    def _skips(self) -> bool:
        """Whether directions that carry no information are left out, as by a user's inverse of S, and no error."""
        return self._inverse is not None

    @property
    def choices(self) -> Choices:
        """What an innovation is judged by: influence, scaling, information, grouping, checked."""
        return self._choices

    @property
    def policy(self) -> Policy:
        """What judges measurements, made of these choices; it never changes."""
        return self._policy  # type: ignore[no-any-return]

    def _choose(self, **changes: Any) -> None:
        """Go on with other choices; a mixture that becomes another one starts to learn anew."""
        old = self._policy
        for name in {"influence", "scaling", "information"} & changes.keys() if old.noise is not None else ():
            raise AttributeError(f"{name}: follows from noise={old.noise!r}; set noise=None before")
        chosen = {"grouping": old.choices.grouping, "noise": old.noise, "process": old.process}
        if old.noise is None and changes.get("noise") is None:
            chosen |= {name: getattr(old.choices, name) for name in ("influence", "scaling", "information", "patience")}
        elif "noise" in changes and changes["noise"] is None:
            chosen["process"] = None
        policy: Any = policy_of(**{**chosen, **changes})
        self._require_possible(policy)
        anew = type(policy) is not type(old) or (isinstance(policy, Mixture) and policy.classes != old.classes)
        self._policy, self._choices = policy, policy.choices
        if anew:
            self._keep_sensors(Memories(policy.begin(self.dim_z), {}))
        if anew or policy.process != old.process:
            self._start()

    def _require_possible(self, policy: Any) -> None:
        """Raise for a policy that this kind of filter cannot follow."""
        if not self._takes_mixtures and policy.noise is not None:
            raise ValueError(
                f"noise: expected None for a {type(self).__name__}, whose members move by a bounded innovation; take a "
                "RobustUnscentedKalmanFilter"
            )

    def __str__(self) -> str:
        """Show where the filter stands, how it judges and what it has learned; `repr` shows every matrix."""
        parts = {"x": np.ravel(self.x), "std": np.sqrt(np.maximum(np.diag(self.P), 0.0))}
        z = np.ravel(self.z)
        if not all(value is None for value in z):
            parts["last z"] = z
            parts["its weights"] = np.ravel(self.weights)
        return "\n".join(
            [
                f"{type(self).__name__}: {self.dim_x} states, {self.dim_z} measured; repr() shows every matrix",
                *lines_of({**parts, **_judgement(self)}),
            ]
        )

    def __repr__(self) -> str:
        """Show the choices and everything that filterpy shows."""
        lines = super().__repr__().split("\n")
        names = ["influence", "scaling", "information", "grouping", "spread", "weights", "clipped", "e", "T"]
        if self.noise is not None:
            names[:3] = "noise", "process"
            names[3:4] = "R_learnt", "noise_learnt", "process_scale", "outlier_probability"
        elif self.patience is not None:
            names.insert(4, "patience")
        return "\n".join(
            [f"{type(self).__name__} object", *lines[1:], *(pretty_str(name, getattr(self, name)) for name in names)]
        )

    def _predict_by_kernel(self, u: Any, B: Any, F: Any, Q: Any) -> bool:
        """Predict by F."""
        return _extension is not None and self._by_kernel and bool(_extension.predict(self, u, B, F, Q, None))

    def _predict_extended(self, u: Any, F: Any = None, moved: Any = None) -> bool:
        """Predict by F; where a function has moved x, by what F says of the rest: moved is False, or the P that sigma
        points have moved to, F then being their covariance with where they were.
        """
        return _extension is not None and bool(_extension.predict(self, u, None, F, None, moved))

    def _correct_by_kernel(self, z: Any, R: Any, H: Any, M: Any) -> bool:
        """Correct by a linear sensor."""
        return _extension is not None and self._by_kernel and self._taken(_extension.correct, z, R, H, M)

    def _stepped(self, z: Any, predicted: Any, y: Any, C: Any, S: Any, R: Any) -> bool:
        """Correct by a nonlinear sensor, by z and its prediction or by y; C and S, or H and None."""
        return _extension is not None and self._taken(_extension.correct_innovation, z, predicted, y, C, S, R)

    def _taken(self, step: Any, *given: Any) -> bool:
        """Take a correction by the kernel and look at it, as one: what interrupts or refuses it undoes both."""
        policy = self._policy
        if not (policy.looks or policy.calls):
            return bool(step(self, *given))
        # With the last look something may be said.
        is_last = policy.looks.get((self._updates + 1) % PERIOD) == len(policy.looks) - 1
        before = snapshot(self) if is_last or policy.calls else None
        try:
            if not step(self, *given):
                return False
            self._look(self._last)
        except BaseException:
            # A warning that is made an error refuses the call, and then nothing has changed.
            if before is not None:
                put_back(self, before)
            raise
        return True

    @property
    def weights(self) -> Array:
        """psi(e)/e of the last correction, shape of y; NaN where a component was missing."""
        if type(self._last) is np.ndarray:
            # What wraps a filter asks for these alone at every step; the whole record takes longer than the step.
            weights = weights_of(self._last)
            return weights if np.ndim(self.x) == 1 else weights[:, None]
        return self._shown("weights", np.nan)

    clipped = _view("clipped", False, "Whether psi'(e) <= 0 in the last correction, shape of y.")
    e = _view("e", 0.0, "Standardized innovation T y of the last correction, shape of y (paper 29).")
    y_bounded = _view("y_bounded", 0.0, "Bounded innovation T^-1 psi(T y), shape of y, in the unit of z.")

    @property
    def T(self) -> Array:
        """Scaling of the last correction, shape (dim_z, dim_z) (paper 36)."""
        last = self._arrays()
        return np.eye(self.dim_z) if last is None or not last.order else last.T

    def _look(self, last: Any) -> None:
        """Count a correction, and look now and then whether most of them clip or all innovations keep their sign."""
        self._updates += 1
        looks = self._policy.looks
        place = looks.get(self._updates % PERIOD)
        if place is not None and self._counts_clipped:
            look(self, last, place, len(looks))

    def _keep(self, last: Any, carried: Any, z: Array, passed: Array | None = None) -> None:
        """Write a correction and the measurement it came from, z of shape (m,), into the attributes."""
        column = np.ndim(self.x) == 2
        require_finite_correction(last)
        self._learn(last.memory, len(z), passed)
        if self._policy.noise is not None:
            look_for_stuck(self, last.weights)
        elif last.memory is not None:
            look_for_repeats(self, last.memory)
        self._look(last)
        self.x = last.x[:, None] if column else last.x
        self.P, self._last, self._kept = last.P, last, carried
        self.z = z[:, None] if column else z
        self._y = self._S = self._SI = self._K = None
        self._as_posterior()

    @whole
    def _skip(self) -> None:
        """Do what filterpy does for update(None), and forget the last innovation."""
        m, column = self.dim_z, np.ndim(self.x) != 1
        self.z = np.full((m, 1) if column or self._none_is_column else m, None)
        self.y = np.zeros((m, 1) if column else m)
        # S, SI and K stay: those that were asked for, and those that the last correction tells on request.
        self._last = self._emptied()
        self._as_posterior()

    def _as_posterior(self) -> None:
        """Show x and P as what a correction has made of them, and let its likelihood be computed anew."""
        self.x_post, self.P_post = np.copy(self.x), np.copy(self.P)
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def _emptied(self) -> Correction | None:
        """Return the last correction with nothing observed: the scaling stays, the innovation is forgotten."""
        last = self._arrays()
        if last is None:
            return None
        zero, none = np.zeros_like(last.y), np.full(last.y.shape, np.nan)
        shown = last._replace(y=zero, score=zero, e=zero, weights=none, psi_deriv=none, log_density=0.0, memory=None)
        return shown._replace(outlier_probability=0.0)

    def _log_density(self, y: Array, S: Array) -> float:
        """Return the log-likelihood of an innovation: the correction of a state without components."""
        nothing, none, choices = np.zeros((0, 0)), np.zeros((0, len(y))), self._choices
        # Sensors may have joined since.
        memory = np.concatenate((self._memory, begin(len(y))))[: len(y)] if choices.by_typical else None
        widths = None if memory is None else settled(memory)
        return correct(nothing.ravel(), nothing, y, none, S, choices, widths, self._skips).log_density

    def _arrays(self) -> Correction | None:
        """Return the last correction, as arrays."""
        last = self._record()
        if isinstance(last, Mixed):
            self._last = last.as_arrays()
        return self._last  # type: ignore[no-any-return]

    def _record(self) -> Any:
        """Return the last correction, of the kernel's record if that is what there is."""
        if type(self._last) is np.ndarray:
            self._last = read(self._last, self.x_post, self.P_post)
        return self._last

    @property
    def outlier_probability(self) -> float:
        """Under ``noise=``, the probability that a component of the last measurement was an outlier."""
        return getattr(self._record(), "outlier_probability", 0.0)

    def _shown(self, name: str, absent: Any) -> Array:
        """Return a field of the last correction in the shape that y has for this kind of state."""
        column, last = np.ndim(self.x) != 1, self._arrays()
        if last is None:
            return np.full((self.dim_z, 1) if column else self.dim_z, absent)
        values = np.array(getattr(last, name))
        return values[:, None] if column else values

    # y, S, SI and K are filterpy's. Few programs look at them at every step, so they are made when asked for.

    y = _made("y", "Innovation z - H x of the last correction, 0 where missing, shape (dim_z, 1) or (dim_z,).")
    S = _made("S", "Innovation covariance H P H' + R, shape (dim_z, dim_z).")
    SI = _made("SI", "Inverse of S, shape (dim_z, dim_z).")
    K = _made("K", "Gain before psi, C T'T, shape (dim_x, dim_z).")

    def _make(self, name: str) -> Array:
        """Return y, S, SI or K of the last correction."""
        if name == "y":
            return self._shown("y", 0.0)
        last: Any = self._arrays()
        if name == "SI":
            return last.inverse if self._inverse is None else self._inverse(last.S)  # type: ignore[no-any-return]
        return getattr(last, name)  # type: ignore[no-any-return]

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the last measurement under the density of psi; 0 if it was missing altogether."""
        if self._log_likelihood is None:
            last = self._last
            by_kernel = type(last) is np.ndarray
            self._log_likelihood = log_density_of(last) if by_kernel else getattr(last, "log_density", 0.0)
        return self._log_likelihood

    @property
    def likelihood(self) -> float:
        """exp(log_likelihood), at least the smallest normal float."""
        if self._likelihood is None:
            self._likelihood = max(math.exp(min(self.log_likelihood, 700.0)), sys.float_info.min)
        return self._likelihood

    @property
    def mahalanobis(self) -> float:
        """Length of the innovation in standard deviations, sqrt(y' S^-1 y), the Kalman filter's."""
        if self._mahalanobis is None:
            y, last = np.ravel(self.y), self._arrays()
            # After `update_sequential` S and SI are not those of y.
            SI = self.SI if last is None or self._skips else last.inverse
            peak = float(np.abs(y).max()) or 1.0
            length = math.sqrt(max(float(y / peak @ SI @ (y / peak)), 0.0))
            self._mahalanobis = min(peak * length, sys.float_info.max)
        return self._mahalanobis


def _judgement(kf: Any) -> dict[str, Any]:
    """Return how a filter judges measurements, and what it has learned of them."""
    if kf.noise is None:
        names = ["influence", "scaling", "information", "grouping"]
        if kf.patience is not None:
            names.append("patience")
        parts = {name: getattr(kf, name) for name in names}
        return {**parts, "spread, learned": kf.spread} if np.isfinite(kf.spread).any() else parts
    parts = {name: getattr(kf, name) for name in ("noise", "process", "grouping")}
    if kf.noise_learnt is not None:
        parts["variances of ordinary noise, learned"] = np.diag(kf.R_learnt)
        parts["share of outliers, learned"] = kf.noise_learnt.contamination
        parts["their size over ordinary noise"] = kf.noise_learnt.scale_ratio
    if kf._kept is not None:
        parts["factor of Q, learned"] = kf.process_scale
    return parts


def leave_unwatched(kf: Shell) -> None:
    """Let a filter count no clipped innovations: what wraps it watches them."""
    kf._counts_clipped = False
