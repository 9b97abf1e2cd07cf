"""TrackerBank: the parameters of many actuators of one structure, advanced together."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import brief, lines_of
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.filters.states import kept_with
from robust_filterpy.identification.models import regressor as coefficients
from robust_filterpy.identification.models.regressor import Guard
from robust_filterpy.identification.models.results import Intervals, Recorded, TrackingResult, intervals
from robust_filterpy.identification.models.signals import recording, table
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import setup
from robust_filterpy.identification.recursive.following import Following, joined
from robust_filterpy.identification.recursive.recursion import Gradient, Regressor
from robust_filterpy.identification.recursive.tracker import ParameterTracker, keeps_spread
from robust_filterpy.influence.functions import Influence

__all__ = ["BankResult", "BankSample", "TrackerBank"]

class BankSample(NamedTuple):
    """What one update did to each of n actuators; see `Sample`.

    Attributes
    ----------
    prediction : ndarray, shape (n,)
        phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : ndarray, shape (n,)
        y(k) - prediction (23); NaN where y is missing.
    weights : ndarray, shape (n,)
        psi(e)/e; NaN where there was no correction (y missing, or adaptation off).
    guard : ndarray of int, shape (n,)
        0: step taken as it is; h > 0: halved h times; -1: not taken.
    """

    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class BankResult(Recorded):
    """What recordings of n actuators gave: the columns of a `TrackingResult` with an axis of actuators.

    A tuple of its first six attributes.

    Attributes
    ----------
    theta, std : ndarray, shape (K, n, n_theta)
        Parameters and their standard deviations, after each of the K samples that were kept.
    prediction, residual, weights : ndarray, shape (K, n)
        As in `BankSample`.
    guard : ndarray of int, shape (K, n)
        As in `BankSample`.
    sample : ndarray of int, shape (K,)
        Which samples were kept.
    names : tuple of str, length n_theta
        Names of the parameters.
    actuators : tuple, length n
        The columns of y if it was a pandas DataFrame, otherwise 0, 1, ..
    index : pandas.Index or None
        When the samples that were kept were taken, if the recording was a pandas object.
    """

    names: tuple[str, ...] = ()
    actuators: tuple[Any, ...] = ()
    index: Any = None
    sample: np.ndarray

    __str__ = brief

    def to_frame(self) -> Any:
        """Return all columns as a pandas DataFrame, a row for each sample that was kept.

        Returns
        -------
        pandas.DataFrame
            Columns (actuator, quantity), the quantities as in `TrackingResult.to_frame`.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        actuators = self.actuators or tuple(range(self.theta.shape[1]))
        columns = {
            (actuator, name): column
            for i, actuator in enumerate(actuators)
            for name, column in self.tracker(i).columns().items()
        }
        return table(columns, self.sample, "sample") if self.index is None else table(columns, self.index)

    def tracker(self, i: int) -> TrackingResult:
        """Return what actuator i gave.

        Parameters
        ----------
        i : int
            Which actuator.

        Returns
        -------
        TrackingResult
            A row for each sample that was kept.
        """
        return TrackingResult(*(column[:, i] for column in self)).labelled(self.names, self.index)

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std for every sample that was kept, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of the interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (K, n, n_theta).
        """
        return intervals(self.theta, self.std, level)


class TrackerBank(Following):
    """Follow the parameters of n actuators of one structure; equal to a loop over n `ParameterTracker`.

    Parameters
    ----------
    n : int
        Number of actuators, >= 1.
    structure : Structure
        What phi is made of: ARX(..), OutputError(..) ..
    theta : array_like, shape (n_theta,) or (n, n_theta), or float, optional
        Parameters to start from. Default: found by the start; 0 with ``start=0``.
    P : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), or float, or shape (n,), optional
        Their covariances; a number p stands for p I. Default: found by the start; 100 I with
        ``start=0``.
    Q : array_like, any shape that P may have, optional
        Covariance of a step of theta (paper 8). Default: 0.
    R : float, or array_like, shape (n,), optional
        Variance of the ordinary noise. Default: found from the data and followed. Setting the attribute fixes it.
    F : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), optional
        Transition matrix C of (9). Default: the identity.
    forgetting : float, or array_like, shape (n,), optional
        Forgetting factor in (0, 1].
    start : int, optional
        How many samples may be looked at for a model of each actuator, as in `ParameterTracker`. Default: 400, or 0 if
        theta or P is given.
    offset : bool, optional
        Whether there is a constant; default as in `ParameterTracker`.
    regressor, R_memory
        As in `ParameterTracker`.
    gradient, guard : str, or list of n str
        As in `ParameterTracker`.
    influence, scaling, information : optional
        As in `RobustKalmanFilter`, or lists of n.

    Attributes
    ----------
    n : int
        As given.
    structure : Structure
        As given.
    Q, F : ndarray, shape (n_theta, n_theta) or (n, n_theta, n_theta)
        As given; may be changed between samples.
    R : ndarray, shape (n,), or float
        As given; may be changed between samples.

    Raises
    ------
    ValueError, TypeError
        As by `ParameterTracker`; the message names the actuators.

    Warns
    -----
    LostTrackerWarning, StuckSensorWarning
        As `ParameterTracker`; the message names the actuators.

    Notes
    -----
    Everything is `ParameterTracker`'s, by the kernel for all actuators where that serves
    (`robust_filterpy.kernel`), otherwise one actuator after the other. The filters are always the robust
    ones: for the Kalman baseline pass ``influence=Linear()``.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import ARX
    >>> rng = np.random.default_rng(1)
    >>> gains = np.linspace(1.0, 2.0, 5)
    >>> u = rng.choice([-1.0, 1.0], 400)
    >>> y = np.zeros((400, 5))
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + gains * u[k - 1] + 0.1 * rng.normal(size=5)
    >>> y[rng.random(y.shape) < 0.01] = np.nan
    >>> bank = TrackerBank(5, ARX(1, 1), R=0.01)
    >>> result = bank.run(y, u, keep="last")
    >>> result.theta.shape, bool(np.abs(bank.coefficients.b[:, 0] - gains).max() < 0.05)
    ((1, 5, 2), True)
    """

    _name = "TrackerBank"

    def __init__(
        self, n: int, structure: Structure, *, theta: ArrayLike | None = None, P: ArrayLike | None = None,
        Q: ArrayLike | None = None, R: ArrayLike | None = None, F: ArrayLike | None = None,
        forgetting: ArrayLike | None = None, start: int | None = None, offset: bool | None = None,
        regressor: Regressor | None = None, R_memory: int = 150,
        gradient: Gradient | Sequence[Gradient] = "filtered", guard: Guard | Sequence[Guard] = "halve",
        influence: Influence | Sequence[Influence] | None = None, scaling: Scaling | Sequence[Scaling] | None = None,
        information: Information | Sequence[Information] | None = None,
    ) -> None:  # fmt: skip
        """Set up n filters and a memory at rest; so many arguments, since they are those of a `ParameterTracker`."""
        given = {name: value for name, value in locals().items() if name not in ("self", "n")}
        n = _checks.count("n", n, 1)
        if not isinstance(structure, Structure):
            raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
        # Every actuator is a tracker; one stands for all where they have their options in common.
        _, self._options = setup.of_each(n, given)
        trackers = setup.for_each(lambda each: ParameterTracker(**each), self._options)
        if len(trackers) < n and keeps_spread(trackers[0]):
            trackers = [copy.deepcopy(trackers[0]) for _ in range(n)]
        vars(self).update({**vars(trackers[0]), "n": len(trackers), **joined(trackers)})
        vars(self).update(vars(self._like(TrackerBank, np.arange(n) % len(trackers))))
        self._first, self._initial = self._now, self.state()

    def __repr__(self) -> str:
        """Show the size and the structure."""
        return f"TrackerBank(n={self.n}, {self.structure})"

    def __str__(self) -> str:
        """Show where the models stand as well."""
        return "\n".join([repr(self), *lines_of({"theta": self.theta, "std": self.std, "R": self.R})])

    # The models as they stand.

    @property
    def coefficients(self) -> Any:
        """Those of the polynomials, each with a leading axis of n; see `ParameterTracker`."""
        values = coefficients.coefficients(self.structure, self.theta.T)
        return type(values)(*(tuple(p.T for p in part) if isinstance(part, tuple) else part.T for part in values))

    def tracker(self, i: int) -> ParameterTracker:
        """Return a tracker of one actuator that goes on where the bank is, and resets to where the bank began.

        Parameters
        ----------
        i : int
            Which actuator, from 0.

        Returns
        -------
        ParameterTracker
            Independent of the bank.

        Raises
        ------
        IndexError
            If there is no such actuator.
        TypeError
            If i is no integer.
        """
        if isinstance(i, bool) or not isinstance(i, (int, np.integer)):
            raise TypeError(f"actuator: expected an integer from 0 to {self.n - 1}, got {i!r}")
        if not 0 <= i < self.n:
            raise IndexError(f"actuator: expected 0 to {self.n - 1}, got {i}")
        one = self._like(ParameterTracker, np.array([i]))
        one._filters, one._given = copy.deepcopy(one._filters), self._options[i % len(self._options)]
        now, enabled = one._now, one._enabled
        one._now, one._enabled = self._first.rows(np.array([i])), np.array([True])
        one._initial, one._now, one._enabled = one.state(), now, enabled
        return one

    # The recursion.

    def update(self, y: ArrayLike | None, u: ArrayLike | None = None, R: ArrayLike | None = None) -> BankSample:
        """Take one sample of every actuator: the outputs y(k) and the inputs u(k).

        Parameters
        ----------
        y : array_like, shape (n,), or None
            Measured outputs; NaN where one is missing, None if all are.
        u : array_like, shape (n,), or (n, n_inputs) for several inputs, optional
            Inputs of the same sample; a number, or shape (n_inputs,), for all actuators alike.
        R : float, or array_like, shape (n,), optional
            Variances of the noise in this sample. Default: the bank's R.

        Returns
        -------
        BankSample
            prediction, residual, weights, guard, each of shape (n,).

        Raises
        ------
        ValueError, TypeError
            If y is infinite, u not finite, R not positive or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses its sample; no actuator has changed then.
        """
        return BankSample(*self._updated(y, u, R))

    def run(
        self,
        y: ArrayLike,
        u: ArrayLike | None = None,
        R: ArrayLike | None = None,
        *,
        keep: str | int = "all",
        progress: bool | None = None,
    ) -> BankResult:
        """Take whole recordings; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N, n)
            Measured outputs, N >= 1; NaN where one is missing. A pandas DataFrame has the index of u, in equal steps.
        u : array_like, shape (N, n), or (N, n, n_inputs) for several inputs, optional
            Inputs; shape (N,), or (N, n_inputs), for all actuators alike.
        R : array_like, shape (N, n), or (N,) for all actuators alike, or float, optional
            Variances of the noise in each sample. Default: the bank's R.
        keep : {"all", "last"} or int, default "all"
            Which samples to return: all, the last, or every keep-th (samples keep - 1, 2 keep - 1, ..), so that
            memory is bounded.
        progress : bool, optional
            Say on standard error what it is at: True at once, False never, None from 2 s on.

        Returns
        -------
        BankResult
            theta, std, prediction, residual, weights, guard, with axes (samples kept, n, ..).

        Raises
        ------
        ValueError, TypeError
            If y or u is empty or not finite, R not positive, or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses a sample; the message names both, and no actuator has changed then.

        Warns
        -----
        UserWarning
            If outputs have fill values, which are taken for missing as in `ParameterTracker.run`; it names them.
        """
        names = getattr(y, "columns", range(self.n))
        axis, y, u, R = recording(self.structure, y=y, u=u, R=R)
        fills = [fill_values(column) for column in setup.outputs(y, self.n, True).T]
        length = fills[0].signal.size
        signal = setup.inputs(self.structure, u, self.n, length)
        every = _every(keep, length)
        columns, rows = self._recorded(axis, fills, signal, R, progress, every, [f"{name}: " for name in names])
        result = BankResult(*columns)
        result.sample, result.actuators, result.names = rows, tuple(names), self.structure.names
        result.index = None if axis.index is None else axis.index[rows]
        return result

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return f"{setup.actuators(np.isin(np.arange(self.n), which))}: "

    # Interruption.

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            What `ParameterTracker.state` returns, with a leading axis of n but for ``format``; Q and F without it if
            they are shared.
            ``numpy.savez(file, **state)`` stores it.
        """
        return super().state()

    def _settings(self) -> dict[str, Array]:
        """Return what may be set of them."""
        kept = [kept_with(kf) for kf in self._filters]
        stacked = {name: np.stack([one[name] for one in kept]) for name in kept[0]}
        return {"Q": self.Q, "F": self.F, "alpha_sq": self._using().alpha_sq, "R": self.R, **stacked}

def _every(keep: Any, length: int) -> int:
    """Return which samples to keep: each of how many."""
    if isinstance(keep, str):
        return 1 if _checks.option("keep", keep, ("all", "last")) == "all" else length
    return _checks.count("keep", keep, 1)
