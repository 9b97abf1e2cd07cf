"""What was chosen for a filter, as attributes that can be read and set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.filters._held import Held
from robust_filterpy.filters._mixture import Mixture
from robust_filterpy.filters._policy import Policy, policy_of
from robust_filterpy.filters._sensors import Customs
from robust_filterpy.influence.functions import Influence


class OptionsMixin(Held):
    """Show the choices that a policy was made of, and make another policy where one is set."""

    __slots__ = ()

    #: Whether a kind of filter takes ``process=``; only bounded influence is there for members of an ensemble.
    _takes_process, _takes_mixtures = True, True

    _keep_sensors: Callable[[Customs], None]
    _start: Callable[[], None]

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
            chosen |= {name: getattr(old.choices, name) for name in ("influence", "scaling", "information")}
        policy: Any = policy_of(**{**chosen, "patience": old.patience, **changes})
        self._require_possible(policy)
        anew = type(policy) is not type(old) or (isinstance(policy, Mixture) and policy.classes != old.classes)
        self._policy, self._choices = policy, policy.choices
        if anew:
            self._keep_sensors(Customs(policy.begin(self.dim_z), {}))
        if anew or policy.process != old.process or policy.patience != old.patience:
            self._start()

    def _require_possible(self, policy: Any) -> None:
        """Raise for a policy that this kind of filter cannot follow."""
        name = type(self).__name__
        if policy.process is not None and not self._takes_process:
            raise ValueError(
                f"process: expected None for a {name}, got {policy.process!r}; copies with another Q are for linear "
                "models (RobustKalmanFilter). Where the state may jump, say patience= without noise="
            )
        if not self._takes_mixtures and (policy.noise is not None or policy.patience is not None):
            raise ValueError(
                f"noise, patience: expected None for a {name}, whose members move by a bounded innovation; take a "
                "RobustUnscentedKalmanFilter"
            )

    @property
    def noise(self) -> Any:
        """How measurements fail: None (psi bounds them), `Contaminated` or `Learnt`."""
        return self._policy.noise

    @noise.setter
    def noise(self, value: Any) -> None:
        self._choose(noise=value, **({"process": None} if value is None else {}))

    @property
    def process(self) -> Any:
        """What the process noise may be: None (Q as given), `Contaminated` or `Scales`."""
        return self._policy.process

    @process.setter
    def process(self, value: Any) -> None:
        self._choose(process=value)

    @property
    def patience(self) -> int | None:
        """How many refused measurements that agree are believed, None if however many are not."""
        return self._policy.patience  # type: ignore[no-any-return]

    @patience.setter
    def patience(self, value: int | None) -> None:
        self._choose(patience=value)

    @property
    def influence(self) -> Any:
        """The influence function psi; under ``noise=`` the noise, whose score is psi."""
        return self._choices.influence if self.noise is None else self.noise

    @influence.setter
    def influence(self, value: Influence) -> None:
        self._choose(influence=value)

    @property
    def scaling(self) -> Scaling:
        """Which T: "learnt", "innovation", "unit" or "bounded"."""
        return self._choices.scaling

    @scaling.setter
    def scaling(self, value: Scaling) -> None:
        self._choose(scaling=value)

    @property
    def information(self) -> Information:
        """Which D: "realized", "expected" or "weight"."""
        return self._choices.information

    @information.setter
    def information(self, value: Information) -> None:
        self._choose(information=value)

    @property
    def grouping(self) -> Grouping:
        """Which sensors fail together: none ("component"), all ("joint"), or groups of them."""
        return self._choices.grouping

    @grouping.setter
    def grouping(self, value: Grouping) -> None:
        self._choose(grouping=value)
