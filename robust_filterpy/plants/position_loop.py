"""The pneumatic servo in a sampled position loop, simulated to identification data.

The actuator integrates the valve opening, so an experiment of any length needs a loop that keeps the piston off the
ends of its stroke.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import odeint

from .coefficients import ALPHA_RANGE, BETA_RANGE, Coefficient, checked, coefficient_function
from .servo_equations import STATES, servo_derivatives
from .servo_linearization import DAMPING, GAIN, operating_point
from .servo_parameters import NOMINAL_ALPHA, PneumaticParameters, as_parameters

Array: TypeAlias = NDArray[np.floating[Any]]
Signal: TypeAlias = "Coefficient | ArrayLike"

#: Absolute tolerance of each state where the relative one is 1: m, m/s, Pa, Pa.
_SCALES = np.array([1e-3, 1e-2, 1e4, 1e4])


class ServoRecording(NamedTuple):
    """Hold a simulated experiment, N samples each; the inputs of row k act from t[k] to t[k] + dt.

    Attributes
    ----------
    t : numpy.ndarray, shape (N,)
        Times, in s.
    reference : numpy.ndarray, shape (N,)
        Reference position, in m (NaN without a loop).
    valve : numpy.ndarray, shape (N,)
        Valve opening, a fraction of full, in [-1, 1].
    position, velocity : numpy.ndarray, shape (N,)
        Motion of the piston at t[k], in m and m/s, free of measurement noise.
    P_a, P_b : numpy.ndarray, shape (N,)
        Absolute pressures of the chambers, in Pa.
    alpha, beta : numpy.ndarray, shape (N,)
        Heat coefficient and bound parameter.
    load : numpy.ndarray, shape (N,)
        Load force, in N.
    """

    t: Array
    reference: Array
    valve: Array
    position: Array
    velocity: Array
    P_a: Array
    P_b: Array
    alpha: Array
    beta: Array
    load: Array


def simulate_servo(
    reference: ArrayLike | Callable[[float], float],
    dt: float,
    parameters: PneumaticParameters | None = None,
    *,
    duration: float | None = None,
    gain: float = GAIN,
    damping: float = DAMPING,
    alpha: Signal = NOMINAL_ALPHA,
    beta: Signal | None = None,
    load: Signal = 0.0,
    initial: ArrayLike | None = None,
    rtol: float = 1e-6,
) -> ServoRecording:
    """Simulate the pneumatic servo in a position loop, sampled to identification data.

    A digital controller samples the motion and holds the valve between samples,
    ``u(k) = gain (r(k) - y(k)) - damping v'(k)``, limited to [-1, 1]. Hence y(k) depends on u(k-1) and r(k-1) at the
    latest: the delay of a model is nk = 1.

    Parameters
    ----------
    reference : array_like, shape (N,), or callable
        Reference position r, in m from mid-stroke; or a function of time in s, with `duration`.
    dt : float
        Period of sampling and control, in s.
    parameters : PneumaticParameters, optional
    duration : float, optional
        Length of the experiment in s, for a reference given as a function: N = round(duration / dt).
    gain : float
        Valve opening per position error, in 1/m.
    damping : float
        Valve opening per acceleration, in s^2/m.
    alpha, beta : float, callable, (times, values) or array_like, shape (N,)
        Coefficients of eq (2) as in `pneumatic_servo`, or one value a sample. They are held from sample to sample.
    load : float, callable, (times, values) or array_like, shape (N,)
        Load force in N against positive motion, held from sample to sample.
    initial : array_like, shape (4,), optional
        Position, velocity, P_a, P_b at t = 0. By default at rest in mid-stroke, at the pressures of
        `operating_point` under the first load.
    rtol : float
        Relative tolerance of the ODE solver (LSODA, restarted at each sample).

    Returns
    -------
    ServoRecording

    Raises
    ------
    ValueError
        If the reference is empty, not finite or beyond the stroke, dt, duration, rtol or a gain is out of range, alpha
        or beta leaves its range, a sequence has not N values, or the initial pressures are not positive.
    TypeError
        If a signal is of an unknown kind.
    RuntimeError
        If the ODE solver fails.

    Notes
    -----
    The acceleration is fed back, not the velocity. The mass on its air springs is hardly damped, and the motion is an
    integral of the valve opening: at the resonance the velocity lags a quarter of a period behind the valve, so that
    its feedback stiffens and, with the delay of sampling, destabilizes; the acceleration is what damps. By
    `linearize_servo` the default loop is stable for dt of 5 to 20 ms and beta from 0.1 to 0.5, and a loop without
    damping, at dt = 10 ms, up to beta = 0.2 (positions within 30 mm, velocities 0.05 to 0.2 m/s).

    Examples
    --------
    >>> import numpy as np
    >>> recording = simulate_servo(np.full(200, 0.01), 0.01)
    >>> print(f"{recording.position[-1]:.3f}")
    0.010
    """
    parameters = as_parameters(parameters)
    r = _samples_of_reference(reference, dt, duration)
    if np.max(np.abs(r)) > parameters.stroke / 2:
        raise ValueError(
            f"reference: expected positions within the stroke, +-{parameters.stroke / 2:g} m, got "
            f"{r[np.argmax(np.abs(r))]:g}"
        )
    for name, value in (("gain", gain), ("damping", damping)):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}: expected a finite number >= 0, got {value}")
    targets = r.tolist()

    def controller(k: int, y: float, acceleration: float) -> float:
        return min(1.0, max(-1.0, gain * (targets[k] - y) - damping * acceleration))

    return _simulate(controller, r, dt, parameters, alpha, beta, load, initial, rtol)


def simulate_actuator(
    valve: ArrayLike,
    dt: float,
    parameters: PneumaticParameters | None = None,
    *,
    alpha: Signal = NOMINAL_ALPHA,
    beta: Signal | None = None,
    load: Signal = 0.0,
    initial: ArrayLike | None = None,
    rtol: float = 1e-6,
) -> ServoRecording:
    """Simulate the pneumatic actuator without a loop, for a given valve opening.

    Parameters
    ----------
    valve : array_like, shape (N,)
        Valve opening, a fraction of full, in [-1, 1], held from sample to sample.
    dt, parameters, alpha, beta, load, initial, rtol
        As in `simulate_servo`.

    Returns
    -------
    ServoRecording
        Its reference is NaN.

    Raises
    ------
    ValueError
        If the opening leaves [-1, 1], and as `simulate_servo`.
    TypeError, RuntimeError
        As `simulate_servo`.

    Examples
    --------
    >>> recording = simulate_actuator([0.01] * 50, 0.01)
    >>> print(f"{recording.position[-1]:.3f}")
    0.027
    """
    u = np.asarray(valve, dtype=float)
    if u.ndim != 1 or u.size == 0:
        raise ValueError(f"valve: expected a non-empty sequence of openings, got shape {u.shape}")
    u = checked(u, "valve", (-1.0, 1.0))
    openings = u.tolist()
    return _simulate(
        lambda k, y, acceleration: openings[k],
        np.full(u.size, np.nan),
        dt,
        as_parameters(parameters),
        alpha,
        beta,
        load,
        initial,
        rtol,
    )


def _simulate(
    controller: Callable[[int, float, float], float],
    reference: Array,
    dt: float,
    parameters: PneumaticParameters,
    alpha: Signal,
    beta: Signal | None,
    load: Signal,
    initial: ArrayLike | None,
    rtol: float,
) -> ServoRecording:
    """Integrate sample by sample, every input held."""
    for name, value in (("dt", dt), ("rtol", rtol)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name}: expected a finite number > 0, got {value}")
    n = reference.size
    t = dt * np.arange(n, dtype=np.float64)
    alphas = _samples(alpha, t, "alpha", ALPHA_RANGE)
    if beta is None:
        betas = checked(alphas * parameters.discharge_coefficient, "beta", BETA_RANGE)
    else:
        betas = _samples(beta, t, "beta", BETA_RANGE)
    loads = _samples(load, t, "load", (-math.inf, math.inf))
    x = _initial_state(initial, parameters, float(loads[0]))

    derivatives = servo_derivatives(parameters)
    held = np.column_stack([loads, alphas, betas]).tolist()
    atol = rtol * _SCALES
    states, valve = np.empty((n, 4)), np.empty(n)

    def right_hand_side(x: Any, t: float, *inputs: Any) -> tuple[float, float, float, float]:
        y, v, p_a, p_b = x.tolist()
        return derivatives(y, v, p_a, p_b, *inputs)

    for k in range(n):
        states[k] = x
        # The opening changes the flow, not the forces: 0 stands for the one still to be found.
        y, v, p_a, p_b = x.tolist()
        acceleration = derivatives(y, v, p_a, p_b, 0.0, *held[k])[1]
        opening = controller(k, y, acceleration)
        valve[k] = opening
        if k == n - 1:
            break
        path, info = odeint(
            right_hand_side, x, (0.0, dt), args=(opening, *held[k]), rtol=rtol, atol=atol, mxstep=5000, full_output=True
        )
        x = path[1]
        if info["message"] != "Integration successful." or not np.all(np.isfinite(x)):
            raise RuntimeError(
                f"simulation: the ODE solver failed between {t[k]:g} and {t[k + 1]:g} s from {STATES} = "
                f"{states[k].tolist()}: {info['message']}; a smaller dt or other parameters may help"
            )
    y_path, v_path, a_path, b_path = states.T.copy()
    return ServoRecording(t, reference, valve, y_path, v_path, a_path, b_path, alphas, betas, loads)


def _samples_of_reference(reference: ArrayLike | Callable[[float], float], dt: float, duration: float | None) -> Array:
    """Return the reference at the sampling times."""
    if callable(reference):
        if duration is None or not (math.isfinite(duration) and math.isfinite(dt) and dt > 0 and duration >= dt):
            raise ValueError(
                f"duration: expected at least dt = {dt} s for a reference that is a function, got {duration}"
            )
        r = np.array([float(reference(dt * k)) for k in range(round(duration / dt))])
    else:
        if duration is not None:
            raise ValueError("duration: expected None for a sampled reference, whose length says it")
        r = np.array(reference, dtype=float)
    if r.ndim != 1 or r.size == 0:
        raise ValueError(f"reference: expected a non-empty sequence of positions, got shape {r.shape}")
    if not np.all(np.isfinite(r)):
        raise ValueError(
            f"reference: expected finite positions, got {r[~np.isfinite(r)][0]} at {np.argmin(np.isfinite(r))}"
        )
    return r


def _samples(value: Signal, t: Array, name: str, limits: tuple[float, float]) -> Array:
    """Return a signal at the sampling times."""
    if not callable(value) and not isinstance(value, tuple) and np.ndim(value):
        samples = checked(value, name, limits)
        if samples.shape != t.shape:
            raise ValueError(f"{name}: expected one value for each of the {t.size} samples, got shape {samples.shape}")
    else:
        function = coefficient_function(value, name, limits)  # type: ignore[arg-type]
        samples = np.array([function(now) for now in t.tolist()])
    if not np.all(np.isfinite(samples)):
        raise ValueError(f"{name}: expected finite values")
    return samples.copy()


def _initial_state(initial: ArrayLike | None, parameters: PneumaticParameters, load: float) -> Array:
    """Return the state at t = 0."""
    if initial is None:
        point = operating_point(parameters, load=load, velocity=0.0)
        return np.array([0.0, 0.0, point.P_a, point.P_b])
    x = np.array(initial, dtype=float)
    if x.shape != (4,) or not np.all(np.isfinite(x)):
        raise ValueError(f"initial: expected 4 finite numbers {STATES}, got {initial!r}")
    if x[2] <= 0 or x[3] <= 0:
        raise ValueError(f"initial: expected positive absolute pressures, got P_a = {x[2]:g} and P_b = {x[3]:g} Pa")
    if abs(x[0]) > parameters.stroke / 2:
        raise ValueError(f"initial: expected a position within +-{parameters.stroke / 2:g} m, got {x[0]:g}")
    return x
