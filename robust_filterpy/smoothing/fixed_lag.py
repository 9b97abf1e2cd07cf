"""FixedLagSmoother: a robust filter that corrects its last states too, by what each measurement taught it of the last.

A state of the window moves by the regression on the state now, A_i = J_(k-i) .. J_(k-1), where J = P F' (F P F' + Q)^-1
is the gain of Rauch, Tung and Striebel (AIAA Journal 3, 1965)::

    A_i <- A_i J,    x_(k-i) += A_i (x_k - F x_(k-1) - B u)

A measurement is judged once, by the filter; nothing is iterated. Where the filter believes a jump after it has rejected
readings in a row, these tell when it was: what is taught from then on says nothing of the states before.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv

from robust_filterpy import _checks, _filterpy, _state
from robust_filterpy._arrays import state_of
from robust_filterpy._brief import lines_of
from robust_filterpy._checks import Array
from robust_filterpy.filters.driver import at_step, columns_of
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.snapshot import whole
from robust_filterpy.kernel.moments import weights_of

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["FixedLagSmoother"]

# A pivot of a predicted covariance that is so small a share of its variance is rounding.
_ROUNDING = 1e-12
# A state jumped if it is so far, squared, from where it was predicted, in its standard deviations.
_JUMP = 25.0


class FixedLagSmoother(RobustKalmanFilter, _filterpy.FixedLagSmoother):
    """Smooth live like `filterpy.kalman.FixedLagSmoother`, without believing outliers.

    After each measurement ``xSmooth[k - i]`` for i = 0..N is the estimate of step k - i from everything up to step k.

    Parameters
    ----------
    dim_x, dim_z : int
        Lengths of the state and of the measurement, >= 1.
    N : int, optional
        The lag in steps, >= 1; not needed for `smooth_batch`.
    influence, scaling, information, grouping, noise, process, patience
        As in `robust_filterpy.RobustKalmanFilter`, but where none of them says how measurements fail, R, its outliers
        and the scale of Q are learned as by `AdaptiveKalmanFilter`: ``noise="learnt"``.

    Attributes
    ----------
    x, P : ndarray
        Estimate of the last step, shape (dim_x, 1) or (dim_x,), and its covariance; and the other attributes of a
        `RobustKalmanFilter`, of the last step.
    x_s : ndarray, shape of x
        Estimate of the oldest step in the window.
    xSmooth : list of ndarray
        Estimates of all steps.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    x and P are those of a `RobustKalmanFilter` with the same options. With ``influence=Linear()`` they are filterpy's,
    and xSmooth is the exact conditional mean, that of a smoother of Rauch, Tung and Striebel over the data so far.
    filterpy's own recursion puts the corrected covariance where the predicted one belongs (D. Simon, Optimal State
    Estimation, 2006, section 9.3), so that its xSmooth is not that mean.

    Each measurement is judged once, by those before it. What judges a measurement by those after it, too, is
    `robust_filterpy.smooth`.

    Examples
    --------
    >>> smoother = FixedLagSmoother(dim_x=1, dim_z=1, N=3)
    >>> smoother.Q = 0.01 * np.eye(1)
    >>> for z in [0.1, -0.2, 500.0, 0.3, 0.0, 0.1, -0.1]:
    ...     smoother.smooth(z)
    >>> len(smoother.xSmooth), bool(abs(smoother.xSmooth[2][0, 0]) < 0.5)
    (7, True)
    """

    @with_options
    def __init__(self, dim_x: int, dim_z: int, N: int | None = None, **options: Unpack[Options]) -> None:
        """Set up the filter and an empty window."""
        self.N = None if N is None else _checks.count("N", N, 1)
        if not options.keys() - {"grouping"}:
            options["noise"] = "learnt"
        super().__init__(dim_x, dim_z, **options)
        self._empty()

    def _empty(self) -> None:
        """Start a window, and a list of estimates, without a step."""
        n = self.dim_x
        self.count, self.xSmooth, self.x_s = 0, [], np.zeros(np.shape(self.x))
        self._lagged, self._regressions = np.empty((0, n)), np.empty((0, n, n))
        # Rejected readings in a row, and what was predicted for the first of them.
        self._rejected, self._expected = 0, (np.zeros(n), np.eye(n))

    def __str__(self) -> str:
        """Show where the smoother stands; `repr` shows every matrix."""
        lines = super().__str__().split("\n")
        lag = "N is not set" if self.N is None else f"lag {self.N}"
        steps = len(self._lagged)
        more = lines_of({f"x, {steps - 1} steps before": np.ravel(self.x_s)}) if steps else []
        return "\n".join([lines[0].replace("measured;", f"measured, {lag};"), *lines[1:], *more])

    @whole
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
        before = state_of(self)[1]
        self.predict(u)
        prior, kept = (np.ravel(self.x), self.P), slice(max(len(self._lagged) - self.N, 0), None)
        A = self._regressions[kept] @ _gain(self.F @ before, self.P)
        self.update(z)
        x = np.ravel(self.x)
        states = np.concatenate([self._lagged[kept] + A @ (x - prior[0]), x[None]])
        self._expected = self._expected if self._rejected else prior
        begun = max(len(A) - self._rejected, 0)
        apart = states[begun] - self._expected[0]
        # The Kalman filter believes that nothing jumps.
        if not self._choices.is_linear and apart @ np.linalg.lstsq(self._expected[1], apart, rcond=None)[0] > _JUMP:
            A[:begun], states[:begun] = 0.0, self._lagged[kept][:begun]
        self._lagged, self._regressions = states, np.concatenate([A, np.eye(len(x))[None]])
        self._rejected = self._rejected_after()
        self.count += 1
        estimates = [state.reshape(self.x.shape) for state in self._lagged]
        self.x_s = estimates[0].copy()
        # The last line, since what an interrupt undoes is no list's contents.
        self.xSmooth[max(len(self.xSmooth) - len(A), 0) :] = estimates

    def _rejected_after(self) -> int:
        """Return how many readings in a row have been rejected, by all sensors that had one."""
        last = self._last
        weights = weights_of(last) if type(last) is np.ndarray else getattr(last, "weights", np.empty(0))
        seen = weights[~np.isnan(weights)]
        if not seen.size:
            return self._rejected
        return self._rejected + 1 if seen.max() < 0.5 else 0

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
        live.N = _checks.count("N", N, 1)
        live._empty()
        columns = columns_of({"zs": zs, "us": us})
        latest = np.empty((len(columns[0]), *np.shape(self.x)))
        for k, (z, u) in enumerate(zip(*columns, strict=False)):
            with at_step(k):
                live.smooth(z, u)
            latest[k] = live.x
        return np.array(live.xSmooth).reshape(latest.shape), latest

    def _moving(self) -> dict[str, Any]:
        """Return what a step moves, the window among it."""
        expected = {"rejected": self._rejected, "expected_x": self._expected[0], "expected_P": self._expected[1]}
        window = {"window": self._lagged, "regressions": self._regressions, "count": self.count}
        return {**super()._moving(), **window, **expected}

    def _go_on(self, entries: dict[str, Array]) -> None:
        """Take over a checked state; xSmooth begins with the oldest step of its window."""
        if len(entries["window"]) != len(entries["regressions"]):
            raise _state.StateError("state: expected as many regressions as states in the window, got others")
        super()._go_on(entries)
        self._empty()
        self._lagged, self._regressions, self.count = entries["window"], entries["regressions"], int(entries["count"])
        self._rejected, self._expected = int(entries["rejected"]), (entries["expected_x"], entries["expected_P"])
        self.xSmooth = [state.reshape(self.x.shape) for state in self._lagged.copy()]
        self.x_s = self.xSmooth[0].copy() if self.xSmooth else self.x_s


def _gain(moved: Array, predicted: Array) -> Array:
    """Return J = P F' (F P F' + Q)^-1, given F P and the inverse; what is known exactly has no share in it."""
    factor, gain, failed = dposv(predicted, moved)
    if failed or (factor.diagonal() ** 2 < _ROUNDING * predicted.diagonal()).any():
        unit = np.sqrt(np.where(predicted.diagonal() > 0.0, predicted.diagonal(), 1.0))
        inverse = np.linalg.pinv(predicted / unit / unit[:, None], rcond=_ROUNDING, hermitian=True)
        gain = inverse @ (moved / unit[:, None]) / unit[:, None]
    return np.asarray(gain.T)
