"""Fusion: one state from sensors that are named, stamped, late and failing."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import without_fill_values
from robust_filterpy._warning import warn
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.fusion._stepping import Moment, Setup, begun, moved, policy_of
from robust_filterpy.fusion._table import Clock, read, table_columns
from robust_filterpy.fusion._timeline import Timeline, restored, state_of
from robust_filterpy.fusion.motion import Motion
from robust_filterpy.fusion.reacquisition import Reacquisition
from robust_filterpy.fusion.recording import Recording, delays_of, fused
from robust_filterpy.fusion.results import Estimate, Forecast, SensorNoise, forecast
from robust_filterpy.fusion.sensors import OFTEN, FusionWarning, Layout, Sensor
from robust_filterpy.fusion.verdicts import LONGEST, Verdict, of_all, silent, words
from robust_filterpy.influence.functions import Influence

__all__ = ["Fusion"]

# Standard deviation of every state where nobody tells where it starts.
_UNKNOWN = 1e4
# Entries that are kept behind the window, and where a verdict looks back.
_HISTORY, _WATCHED = 400, LONGEST + 100

#: What has become of a reading, as `Fusion.observe` says it and `Fusion.counts` counts it.
OUTCOMES = ("taken", "late", "replaced", "duplicate", "refused")


class Fusion:
    """Estimate a state from sensors that speak at their own times, in any order within a window.

    Parameters
    ----------
    motion : Motion
        How the state moves: `constant_velocity`, `constant_acceleration`, `from_continuous`, `from_function`.
    sensors : mapping of str to Sensor
        By name. At equal stamps they are judged together, the most plausible first, as one measurement.
    window : float
        Seconds behind the newest stamp within which a reading is still used, as long as it holds no more than
        50,000 stamps, 5000 with watch or reacquire; of more, the oldest take nothing more, and a `FusionWarning`
        says so.
    x0 : array_like, shape (n,), optional
        State at the first stamp, by default 0.
    P0 : array_like, shape (n, n), optional
        Its covariance; by default 1e8 I, a standard deviation of ten thousand units.
    t0 : stamp, optional
        When the state was x0; by default at the earliest reading.
    noise : Contaminated, Learnt or "learnt", default "learnt"
        How measurements fail, as in `RobustKalmanFilter`: given, or learned for each component of each sensor.
    process : Scales, Contaminated, "scales" or "given", default "scales"
        What the process may be, as there. Dwell and jump of `Scales` are in stamps. ``"given"`` trusts
        Q and the start.
    influence : Influence, optional
        Instead of noise and process: a bounded influence function as in `RobustKalmanFilter`, or ``Linear()`` for the
        Kalman filter. R is then to be given.
    watch : bool, default False
        Whether there are verdicts about the sensors, and one that lies is left out.
    reacquire : Reacquisition, optional
        Whether, when readings and state are suddenly far apart, "this reading is wrong" and "I am wrong" are both
        carried until later readings decide, and what is to be expected then. By default the policy decides at once.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit; the message names it.

    Notes
    -----
    Any order of arrival within the window gives the same numbers to the last bit, as long as no reading is refused;
    which are refused depends on the order, since the newest stamp moves the window. A late reading makes what follows
    it be judged anew when somebody asks, never before.

    A reading for which a sensor's h, Jacobian or residual raises, or returns what is not finite, counts as refused and
    changes nothing; the first of each sensor is a `FusionWarning` with the reason. A motion that raises has no way
    on: that error appears when somebody asks for an estimate after it.

    With both ``watch`` and ``reacquire`` a sensor that is left out is "false" or "biased". "false": its readings were
    suddenly more than six standard deviations from what the others say, and it is let in again as soon as they are not;
    for such a fault ``length`` says how long it lasts. "biased": it is off by about the same in very many readings, by
    six standard deviations at most, which no single one of them shows; it is let in when thirty of them say that it
    has recovered. What is "undecided" is not judged as a fault until it is decided.

    Examples
    --------
    >>> from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
    >>> fusion = Fusion(constant_velocity(1, q=0.1), {"gps": Sensor([1.0, 0.0], R=1.0)}, window=5.0)
    >>> for t in (0.0, 2.0, 1.0, 3.0):
    ...     outcome = fusion.observe("gps", t, 2.0 * t)
    >>> estimate = fusion.estimate(4.0)
    >>> bool(abs(estimate.x[0] - 8.0) < 1.0), estimate.ages
    (True, {'gps': 1.0})
    """

    def __init__(
        self, motion: Motion, sensors: Mapping[str, Sensor], window: float, *, x0: ArrayLike | None = None,
        P0: ArrayLike | None = None, t0: Any = None, noise: Contaminated | Learnt | str | None = None,
        process: Scales | Contaminated | str | None = None, influence: Influence | None = None, watch: bool = False,
        reacquire: Reacquisition | None = None,
    ) -> None:  # fmt: skip
        """Check everything and start with nothing read."""
        if not isinstance(motion, Motion):
            raise TypeError(f"motion: expected one of constant_velocity(..), .., got {_checks.shown(motion)}")
        n = motion.dim_x
        layout = Layout(sensors, n)
        seconds = _checks.real("window", window)
        if not 0.0 <= seconds < math.inf:
            raise ValueError(f"window: expected finite seconds >= 0, got {_checks.shown(window)}")
        x = np.zeros(n) if x0 is None else _checks.finite_vector("x0", np.ravel(_checks.numbers("x0", x0))).copy()
        if len(x) != n:
            raise ValueError(f"x0: expected {n} numbers, as the motion has states, got {len(x)}")
        P = np.eye(n) * _UNKNOWN**2 if P0 is None else _checks.matrix("P0", P0, (n, n), f"{n} states").copy()
        _checks.covariance("P0", P)
        if not isinstance(reacquire, (Reacquisition, type(None))):
            raise TypeError(f"reacquire: expected Reacquisition(..) or None, got {_checks.shown(reacquire)}")
        if not isinstance(watch, (bool, np.bool_)):
            raise TypeError(f"watch: expected True or False, got {_checks.shown(watch)}")
        self._clock = Clock()
        self._setup = Setup(motion, layout, policy_of(layout, noise, process, influence), bool(watch), reacquire)
        self._begin = begun(self._setup, x, P)
        self._timeline = Timeline(self._setup, self._begin, seconds, _WATCHED if watch else _HISTORY)
        self._started = None if t0 is None else self._clock.key(t0, "t0")
        self._timeline.base_key = self._started
        if self._started is not None:
            self._clock.decide(self._started)
        self._counts = {name: dict.fromkeys(OUTCOMES, 0) for name in layout.names}
        #: Sensors of whose functions it was said that they fail.
        self._said: set[str] = set()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors, as declared."""
        return self._setup.layout.names

    @property
    def window(self) -> float:
        """Seconds behind the newest stamp within which a reading is still used."""
        return self._timeline.window

    def __repr__(self) -> str:
        """Say of which sensors, and what has become of their readings."""
        sums = {one: sum(had[one] for had in self.counts.values()) for one in ("taken", "refused")}
        said = ", ".join(f"{count} {one}" for one, count in sums.items())
        return f"Fusion({', '.join(self.sensors)}; window {self.window:g} s; readings: {said})"

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """How many readings of each sensor were taken, late (and taken), replaced, duplicate, refused; a copy.

        One that was taken, and for which the sensor's function then had no answer, is refused besides.
        """
        line = self._timeline
        if self._setup.layout.curved:
            # A motion that raises is for who asks for an estimate; what was judged before it is counted.
            with suppress(Exception):
                line.until()
            self._say_failures()
        failed = line.failures(line.entries)
        return {name: {**had, "refused": had["refused"] + failed.get(name, 0)} for name, had in self._counts.items()}

    def _until(self, key: float | int | None = None) -> tuple[Moment, float | int | None, int]:
        """Return what there is after all entries up to a stamp; say which sensor's readings cannot be used."""
        result = self._timeline.until(key)
        self._say_failures()
        return result

    def _say_failures(self) -> None:
        """Warn of each sensor's first reading for which its function had no answer."""
        for name, (key, why) in self._timeline.reasons.items():
            self._say_once(
                name, f"sensor {name!r}: a reading of {self._clock.stamp(key)} was refused, since its function failed "
                f"at the state then: {why}; mend the function, or start nearer (x0); counts has how many there are"
            )  # fmt: skip

    def _say_once(self, about: str, text: str) -> None:
        """Warn of something that may come again."""
        if about not in self._said:
            self._said.add(about)
            warn(text, FusionWarning)

    def _forget(self) -> None:
        """Let go of what is too old."""
        try:
            if self._timeline.forget():
                since = self._clock.stamp(self._timeline.keys[0])
                self._say_once(
                    "(window)", f"window: at most {self._timeline.most} stamps are kept, fewer than came within "
                    f"{self.window:g} s; a reading of before {since} is refused; stamps that are rounded are fewer"
                )  # fmt: skip
        except Exception as error:
            # The reading stands; only a motion that raises comes here, and who asks for an estimate gets the error.
            text = f"motion: it has failed, and no estimate goes beyond: {type(error).__name__}: {error}"
            self._say_once("", text)
        self._say_failures()

    def observe(self, sensor: str, t: Any, z: Any, *, replace: bool = False) -> str:
        """Take a reading.

        Parameters
        ----------
        sensor : str
            Who speaks.
        t : float, numpy.datetime64, pandas.Timestamp or datetime with a time zone
            Its stamp; a sensor's known delay is taken off.
        z : array_like, shape (m,), or float, or None
            What it says; NaN marks a missing component, None a reading without any.
        replace : bool, default False
            Whether this corrects what the sensor has said with the same stamp.

        Returns
        -------
        str
            "taken"; "late", taken though something newer was there; "replaced"; "duplicate", the same again, which is
            ignored; or "refused", older than the window, which is dropped and counted.

        Raises
        ------
        ValueError, TypeError
            If the sensor is unknown, t is no time or of another kind than those before, z does not fit, or the sensor
            has said something else with this stamp and replace is False; nothing has changed then.

        Warns
        -----
        FusionWarning
            The first time that a reading of this sensor is refused.
        """
        layout, line = self._setup.layout, self._timeline
        z = layout.reading(sensor, z)
        key = self._clock.moved(self._clock.key(t), -layout.sensors[sensor].delay)
        horizon, place = line.horizon, layout.places[sensor]
        if horizon is not None and key < horizon:
            return self._refused(sensor, key, horizon)
        previous = line.find(key)
        again = previous is not None and sensor in previous.spoke
        if previous is not None and again and not replace:
            if not np.array_equal(previous.z[place], z, equal_nan=True):
                raise ValueError(
                    f"sensor {sensor!r}: expected one reading for each stamp, got {z} at {self._clock.stamp(key)} "
                    f"after {previous.z[place]}; pass replace=True if it is a correction"
                )
            self._counts[sensor]["duplicate"] += 1
            return "duplicate"
        late = bool(line.keys) and key < line.keys[-1]
        entry = line.at(key)
        entry.z[place] = z
        line.hear(entry, sensor)
        self._clock.decide(key)
        outcome = "replaced" if again else "late" if late else "taken"
        self._counts[sensor][outcome] += 1
        self._forget()
        if layout.sensors[sensor].group is not None and self._counts[sensor]["taken"] == OFTEN:
            self._say_apart(line.readings())
        return outcome

    def _say_apart(self, zs: Array) -> None:
        """Warn of groups whose sensors never speak at one stamp."""
        for party in self._setup.layout.never_together(zs):
            warn(
                f"group of {', '.join(party)}: expected readings with the same stamp, got none in {len(zs)} stamps, so "
                "each reading is judged alone; round their stamps to those of one of them, or leave group out",
                FusionWarning,
            )

    def _refused(self, sensor: str, key: float | int, horizon: float | int) -> str:
        """Count a reading that is too old, and say so the first time."""
        if not self._counts[sensor]["refused"]:
            last = max(self._timeline.latest.items(), key=lambda one: one[1], default=None)
            newest = "t0" if last is None else f"the newest reading, {last[0]!r} at {self._clock.stamp(last[1])}"
            warn(
                f"sensor {sensor!r}: a reading of {self._clock.stamp(key)} was dropped: it is "
                f"{self._clock.between(key, horizon):.6g} s older than the window allows, by {newest}; a longer window "
                "takes it; counts has how many there are",
                FusionWarning,
            )
        self._counts[sensor]["refused"] += 1
        return "refused"

    def control(self, t: Any, u: ArrayLike) -> str:
        """Say which control input acts from a moment on, until the next one.

        Parameters
        ----------
        t : stamp
            When it begins.
        u : array_like, shape (dim_u,), or float
            The input, as the motion takes it. Another one for the same stamp replaces it.

        Returns
        -------
        str
            "taken", "late", or "refused" if it is older than the window.

        Raises
        ------
        ValueError, TypeError
            If the motion takes no input, or u or t does not fit.
        """
        p, line = self._setup.motion.dim_u, self._timeline
        value = _checks.numbers("u", u).ravel()
        if len(value) != p or not np.isfinite(value).all():
            raise ValueError(f"u: expected {p} finite number(s), as the motion takes them, got {_checks.shown(u)}")
        key = self._clock.key(t)
        if line.horizon is not None and key < line.horizon:
            return "refused"
        late = bool(line.keys) and key < line.keys[-1]
        line.at(key).control = value.copy()
        self._clock.decide(key)
        self._forget()
        return "late" if late else "taken"

    def estimate(self, t: Any = None) -> Estimate:
        """Return the estimate of the state at a moment by what was read up to it; nothing is written.

        Parameters
        ----------
        t : stamp, optional
            When; by default at the newest stamp. In the future the state is predicted.

        Returns
        -------
        Estimate
            time, x, P, ages, undecided.

        Raises
        ------
        ValueError, TypeError
            If t is before anything that is kept, or no time; or if nothing was read and t is not given.
        """
        line, key = self._timeline, None if t is None else self._clock.key(t)
        if key is not None and line.begun is not None and key < line.begun:
            raise ValueError(f"t: expected a time from {self._clock.stamp(line.begun)} on, which is kept, got {t}")
        moment, at, entries = self._until(key)
        when = at if key is None else key
        if when is None:
            raise ValueError("estimate: expected a reading first, got none; or pass t")
        state = moved(self._setup, moment.state, self._clock.between(at, when))
        said = line.last_words(entries)
        ages = {name: self._clock.between(said[name], when) if name in said else math.inf for name in self.sensors}
        doubt = moment.doubt
        undecided = doubt is not None and doubt.served >= 0 and not doubt.sure
        return Estimate(self._clock.stamp(when), state.x.copy(), state.P.copy(), ages, undecided)

    def noise(self) -> dict[str, SensorNoise]:
        """Return what has been learned about each sensor's noise.

        Returns
        -------
        dict of str to SensorNoise
        """
        layout, policy = self._setup.layout, self._setup.policy
        state = self._until()[0].state
        deviation = np.sqrt(state.sizes * layout.R.diagonal() * policy.factors(state.memory))
        shares = policy.contamination(state.memory)
        return {name: SensorNoise(deviation[place], shares[place]) for name, place in layout.places.items()}

    def forecast(self, times: Any, level: float = 0.95) -> Forecast:
        """Return what each sensor should read at times to come, and two bands: of readings, and of the signal.

        Parameters
        ----------
        times : stamp or sequence of stamps, length K
            From the newest stamp on. Control inputs stay as they are.
        level : float, default 0.95
            Probability that each band should hold, at each time.

        Returns
        -------
        Forecast
            times, middle, readings, signal.

        Raises
        ------
        ValueError, TypeError
            If nothing was read, a time is before the newest stamp or none, or level is not between 0 and 1.

        Notes
        -----
        The band of readings is that of the learned mixture, that of the signal is the state's. Where Q and R are given,
        as with ``process="given"`` or ``influence=``, bands are as sure as these.

        Examples
        --------
        >>> from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
        >>> fusion = Fusion(constant_velocity(1, q=0.1), {"gps": Sensor([1.0, 0.0], R=1.0)}, window=5.0)
        >>> for t in range(100):
        ...     outcome = fusion.observe("gps", t, 2.0 * t + (-1.0) ** t)
        >>> found = fusion.forecast([100.0, 110.0])
        >>> found.middle["gps"].round(-1).ravel().tolist(), found.readings["gps"].shape
        ([200.0, 220.0], (2, 1, 2))
        """
        level = _checks.real("level", level)
        if not 0.0 < level < 1.0:
            raise ValueError(f"level: expected a probability between 0 and 1, got {level}")
        moment, at, entries = self._until()
        if at is None or not entries:
            raise ValueError("forecast: expected a reading first, got none")
        return forecast(self._setup, self._clock, moment.state, at, times, level)

    def run(
        self, table: Any, *, time: str = "time", sensor: str = "sensor", value: Any = "value",
        controls: tuple[Any, Any] | None = None, smoothed: bool = False,
    ) -> Recording:  # fmt: skip
        """Return the states of a whole recording, from the start that this fusion was made with; it stays as it is.

        Parameters
        ----------
        table : data frame
            Of any kind that narwhals knows (pandas, polars, pyarrow), or a dict of columns; a row for each reading, in
            any order.
        time, sensor : str
            Names of the columns with stamps and names.
        value : str or sequence of str
            Name of the column with what was read; of several, of which a sensor takes as many as it has components.
        controls : tuple of array_like, shape (K,) and (K, dim_u), optional
            Stamps and control inputs from then on.
        smoothed : bool, default False
            Whether each state is to be estimated from the whole recording (`robust_filterpy.smoothing.smooth`), with
            this fusion's ``influence=``; without one the outliers are learned from the recording.

        Returns
        -------
        Recording
            times, x, P, weights, duplicates; a row for each stamp. And verdicts, if the fusion watches: then it goes
            stamp by stamp, as readings in order do.

        Raises
        ------
        ValueError, TypeError
            If a column is missing, a row's time, name or value is none, or a sensor has said two things with one stamp.
        """
        rows = read(self._setup, self._clock, table, time, sensor, value, controls)
        self._say_apart(rows.zs)
        # A sensor that is watched and stays far outside is stuck.
        for name, place in {} if self._setup.watches else self._setup.layout.places.items():
            rows.zs[:, place] = without_fill_values(f"sensor {name!r}", rows.zs[:, place])[0]
        return fused(self._setup, self._begin, self._started, rows, smoothed)

    def delays(
        self, table: Any, longest: float = 1.0, *, time: str = "time", sensor: str = "sensor", value: Any = "value"
    ) -> dict[str, float]:
        """Return how late each sensor's stamps are in a recording: a constant that `Sensor` takes as ``delay``.

        Parameters
        ----------
        table : data frame or dict
            As in `run`. What is measured has to change unevenly: a delay in an even motion looks like an offset.
        longest : float, default 1
            Seconds; the longest difference of delays that is looked for.
        time, sensor, value : str
            Columns, as in `run`.

        Returns
        -------
        dict of str to float
            Seconds, what `Sensor` was already given included; NaN where the recording does not tell it. Only
            differences can be seen: the sensor that is least late counts as on time, or as late as it was given.

        Raises
        ------
        ValueError, TypeError
            As in `run`; or longest is not > 0.

        Warns
        -----
        FusionWarning
            If a delay cannot be found, and why.
        """
        _checks.positive("longest", longest)
        rows = read(self._setup, self._clock, table, time, sensor, value, None)
        if not len(rows.keys):
            raise ValueError("table: expected a row for each reading, got none")
        shifts, reasons = delays_of(self._setup, self._begin, rows, float(longest))
        for name, why in reasons.items():
            warn(f"sensor {name!r}: its delay cannot be seen in this recording: {why}", FusionWarning)
        return {name: shifts[name] + one.delay for name, one in self._setup.layout.sensors.items()}

    def verdicts(self, t: Any = None) -> dict[str, Verdict]:
        """Return what is the matter with each sensor, and with the model of the motion under "motion".

        Parameters
        ----------
        t : stamp, optional
            When; by default at the newest stamp. A sensor is silent if it has said nothing for five of its usual
            intervals and the window, within which it may only be late; three intervals if ``Sensor(every=..)`` tells
            them. One that has never spoken is silent after the window.

        Returns
        -------
        dict of str to Verdict

        Raises
        ------
        ValueError
            If the fusion was made with neither ``watch=True`` nor ``reacquire``, or nothing was read.

        Notes
        -----
        Of ``reacquire`` are "undecided", "false" (left out) and the motion's "jumped", of ``watch`` all others.
        """
        if not self._setup.watches and self._setup.reacquire is None:
            raise ValueError("verdicts: expected a fusion that watches its sensors; make it with watch=True")
        now = self.estimate(t).time
        moment, _, entries = self._timeline.until(None if t is None else self._clock.key(t))
        verdicts = of_all(self._setup.layout, moment)
        said, intervals = self._timeline.last_words(entries), self._timeline.intervals(entries)
        begun = self._timeline.begun
        for name, one in self._setup.layout.sensors.items():
            # Who has never spoken may be late by the window, and has no usual interval.
            usual = 5.0 * intervals.get(name, math.inf if name in said else 0.0) + self.window
            limit = usual if one.every is None else 3.0 * one.every
            since = said.get(name, begun)
            if since is not None and self._clock.between(since, self._clock.key(now)) > limit:
                stamp = self._clock.stamp(said[name]) if name in said else None
                verdicts[name] = silent(stamp, self._counts[name]["refused"])
        return verdicts

    def report(self, t: Any = None) -> str:
        """Return the verdicts in words, a line for each sensor, and one for the motion if its model was found wrong.

        Parameters
        ----------
        t : stamp, optional
            As in `verdicts`.

        Returns
        -------
        str
        """
        verdicts = self.verdicts(t)
        lines = [words(name, verdict) for name, verdict in verdicts.items() if name != "motion"]
        return "\n".join(lines + ([] if verdicts["motion"].since is None else [words("motion:", verdicts["motion"])]))

    def step(
        self, state: Any, table: Any, *, time: str = "time", sensor: str = "sensor", value: Any = "value"
    ) -> tuple[dict[str, Array], dict[str, np.ndarray]]:
        """Take what came of one key and change nothing: what `robust_filterpy.fleet.step` asks of a fusion.

        Parameters
        ----------
        state : mapping of str to ndarray, or None
            What the step before returned, or ``fleet.unpack`` made of it; None to begin where this fusion stands.
        table : data frame or dict
            Columns as in `run`, rows in the order of arrival; late ones are as late as they are.
        time, sensor, value : str
            Columns, as in `run`.

        Returns
        -------
        state : dict of str to ndarray
            What the next step goes on from.
        output : dict of str to ndarray
            For each row ``outcome``, as `observe` returns it, None of a row that is none; ``error``, None or what is
            wrong with the row, which costs that row alone; and by the names of the states the estimate at the newest
            stamp by then, and standard deviations, NaN before the first reading.

        Raises
        ------
        ValueError, TypeError
            If a column is missing, or the state is damaged or of a fusion made otherwise.
        """
        moving, names = copy.deepcopy(self), self._setup.motion.names
        if state is not None:
            moving.restore(state)
        stamps, who, *columns = table_columns(table, time, sensor, value)
        estimates = np.full((len(stamps), 2, len(names)), np.nan)
        outcomes, errors = np.full((2, len(stamps)), None, dtype=object)
        for k, (t, name, *z) in enumerate(zip(stamps, who.tolist(), *columns, strict=True)):
            try:
                m = self._setup.layout.sensors[name].dim_z if name in self.sensors else len(z)
                outcomes[k] = moving.observe(name, t, z[:m])
                estimate = moving.estimate()
                estimates[k] = estimate.x, np.sqrt(estimate.P.diagonal())
            except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
                errors[k] = str(error)
        by_name = {name: estimates[:, 0, i] for i, name in enumerate(names)}
        by_name.update({f"{name}_std": estimates[:, 1, i] for i, name in enumerate(names)})
        return moving.state(), {"outcome": outcomes, "error": errors, **by_name}

    def state(self) -> dict[str, Array]:
        """Return everything that the fusion needs to go on, as plain arrays: `robust_filterpy.fleet.pack` makes bytes.

        Returns
        -------
        dict of str to ndarray
            The state before the oldest entry that is kept, and all entries after it; with ``watch=True`` what is
            thought of the sensors after each, too. Motion and sensors are not in it.
        """
        return state_of(self._timeline, self._clock, self._counts, OUTCOMES)

    def restore(self, state: Any) -> None:
        """Go back to a state of this fusion, or of another one made like it, and go on the same to the last bit.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`.

        Raises
        ------
        ValueError, TypeError
            If an array is missing, does not fit or is not finite; nothing has changed then.
        """
        self._timeline.require_rest()
        self._timeline, self._clock, self._counts = restored(self._timeline, state, OUTCOMES)
