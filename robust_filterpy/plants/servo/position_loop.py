"""The pneumatic servo simulated in a position loop, and its recording."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import odeint

from robust_filterpy._checks import Array, finite, finite_vector, positive

from .equations import (
    ALPHA_RANGE,
    BETA_RANGE,
    NOMINAL_ALPHA,
    STATES,
    Coefficient,
    PneumaticParameters,
    as_parameters,
    checked,
    servo_derivatives,
)
from .linearization import PositionGains, check_loop, chosen_gains, operating_point

Signal: TypeAlias = "Coefficient | ArrayLike"


def _samples(value: Signal, t: Array, name: str, limits: tuple[float, float]) -> Array:
    """Return a signal at the sampling times."""
    samples = checked([value(now) for now in t.tolist()] if callable(value) else value, name, limits)
    if samples.shape not in ((), t.shape):
        raise ValueError(f"{name}: expected one value for each of the {t.size} samples, got shape {samples.shape}")
    return np.broadcast_to(samples, t.shape).copy()


class ServoRecording(NamedTuple):
    """Hold a simulated experiment, N samples each; the inputs of row k act from t[k] to t[k] + dt.

    Attributes
    ----------
    t : numpy.ndarray, shape (N,)
        Times, in s.
    reference : numpy.ndarray, shape (N,)
        Reference position, in m.
    valve : numpy.ndarray, shape (N,)
        Command to the valve, a fraction of the spool's stroke, in [-1, 1], its dead band included.
    position, velocity : numpy.ndarray, shape (N,)
        Motion of the piston at t[k], in m and m/s, free of measurement noise.
    P_a, P_b : numpy.ndarray, shape (N,)
        Absolute pressures of the chambers, in Pa, free of measurement noise.
    alpha, beta : numpy.ndarray, shape (N,)
        Heat coefficient and bound parameter.
    load : numpy.ndarray, shape (N,)
        Load force, in N.
    supply : numpy.ndarray, shape (N,)
        Absolute supply pressure, in Pa.
    position_measured, P_a_measured, P_b_measured : numpy.ndarray, shape (N,)
        What the sensors said, in m, Pa, Pa.
    position_estimate, acceleration_estimate : numpy.ndarray, shape (N,)
        What the controller took for the motion, in m and m/s^2.
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
    supply: Array
    position_measured: Array
    P_a_measured: Array
    P_b_measured: Array
    position_estimate: Array
    acceleration_estimate: Array


#: Readings (position, P_a, P_b) and the command of the period before; estimated position and acceleration.
Observer: TypeAlias = Callable[[Array, float], "tuple[float, float]"]
#: Relative tolerance of the solver (LSODA, restarted at each sample); of each state where it is 1: m, m/s, Pa, Pa.
_RELATIVE, _TOLERANCES = 1e-6, np.array([1e-3, 1e-2, 1e4, 1e4])
#: Share of the parameters' dead band that the controller knows of, and steps over: our choice.
_COMPENSATION = 0.9


def simulate_servo(
    reference: ArrayLike, dt: float, parameters: PneumaticParameters | None = None, *, gain: float | None = None,
    damping: float | None = None, alpha: Signal = NOMINAL_ALPHA, beta: Signal | None = None, load: Signal = 0.0,
    supply: Signal | None = None, noise: ArrayLike | None = None, observer: Observer | None = None,
) -> ServoRecording:  # fmt: skip
    """Simulate the pneumatic servo in a position loop, sampled to identification data.

    A digital controller samples the motion and holds the valve between samples. It asks for the opening
    ``o(k) = gain (r(k) - y(k)) - damping y''(k)`` and steps over nine tenths d of the valve's dead band,
    ``u = sgn(o) (d + (1 - d) |o|)``, limited to [-1, 1]. Hence y(k) depends on u(k-1) and r(k-1) at the latest: the
    delay of a model is nk = 1.

    Parameters
    ----------
    reference : array_like, shape (N,)
        Reference position r, in m from mid-stroke.
    dt : float
        Period of sampling and control, in s.
    parameters : PneumaticParameters, optional
    gain : float, optional
        Valve opening per position error, in 1/m. By default that of `position_gains`.
    damping : float, optional
        Valve opening per acceleration, in s^2/m. By default that of `position_gains`.
    alpha, beta : float, callable or array_like, shape (N,)
        Coefficients of eq (2) as in `pneumatic_servo`, or one value a sample. They are held from sample to sample.
    load : float, callable or array_like, shape (N,)
        Load force in N against positive motion, held from sample to sample.
    supply : float, callable or array_like, shape (N,), optional
        Absolute supply pressure in Pa, held from sample to sample. By default the parameters'.
    noise : array_like, shape (N, 3), optional
        What the sensors of position, P_a and P_b add to the truth, in m, Pa, Pa: noise and outliers.
    observer : callable, optional
        ``observer(readings, valve) -> (position, acceleration)``: what the controller takes for the motion, of the
        readings of position, P_a and P_b, shape (3,), and of the command of the period before; examples/servo has one
        that filters. By default the controller sees the true motion.

    Returns
    -------
    ServoRecording

    Raises
    ------
    UnstableLoopError
        If the linear model of the loop is unstable on the stroke, at the least or the largest beta.
    ValueError
        If the reference is empty, not finite or beyond the stroke, dt or a gain is out of range, alpha or beta
        leaves its range, the supply falls below the atmosphere, or a sequence has not N values.
    TypeError
        If a signal is of an unknown kind.
    RuntimeError
        If the ODE solver fails.

    Notes
    -----
    The piston begins at rest in mid-stroke, at the pressures of `operating_point` under the first load. For another
    start, simulate `pneumatic_servo` by python-control.

    The acceleration is fed back, not the velocity. The mass on its air springs is hardly damped, and the motion is an
    integral of the valve opening: at the resonance the velocity lags a quarter of a period behind the valve, so that
    its feedback stiffens and, with the delay of sampling, destabilizes; the acceleration is what damps. The default
    loop is stable for beta from 0.1 to 0.5, masses from 0.3 to 50 kg and dt of 5 and 10 ms (from 1 kg on of 20 ms too).
    Stability is judged by the linear models without dry friction, in which nothing but the loop damps.

    Examples
    --------
    >>> import numpy as np
    >>> recording = simulate_servo(np.full(200, 0.01), 0.01)
    >>> print(f"{recording.position[-1]:.3f}")
    0.010
    """
    p = as_parameters(parameters)
    r = finite_vector("reference", reference).copy()
    if np.max(np.abs(r)) > p.stroke / 2:
        raise ValueError(
            f"reference: expected positions within the stroke, +-{p.stroke / 2:g} m, got {r[np.argmax(np.abs(r))]:g}"
        )
    gains = chosen_gains(p, gain, damping)
    positive("dt", dt)
    t = dt * np.arange(r.size, dtype=np.float64)
    alpha = _samples(alpha, t, "alpha", ALPHA_RANGE)
    if beta is None:
        beta = checked(alpha * p.discharge_coefficient, "beta", BETA_RANGE)
    else:
        beta = _samples(beta, t, "beta", BETA_RANGE)
    load = _samples(load, t, "load", (-math.inf, math.inf))
    supply = _samples(p.supply_pressure if supply is None else supply, t, "supply", (p.atmospheric_pressure, math.inf))
    noise = np.zeros((r.size, 3)) if noise is None else finite("noise", noise, (r.size, 3))
    start = operating_point(p, load=float(load[0]), velocity=0.0)
    x = np.array([0.0, 0.0, start.P_a, start.P_b])
    check_loop(p, dt, gains, {float(beta.min()), float(beta.max())})
    inputs = np.column_stack([load, alpha, beta, supply])
    states, readings, commands, estimates = _driven(r, dt, p, gains, inputs, noise, x, observer)
    truth, measured, taken = states.T.copy(), readings.T.copy(), estimates.T.copy()
    signals = t, r, commands, *truth, alpha, beta, load, supply, *measured, *taken
    return ServoRecording(*signals)


def _driven(
    reference: Array, dt: float, p: PneumaticParameters, gains: PositionGains, inputs: Array, noise: Array, x: Array,
    observer: Observer | None,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Integrate the loop sample by sample, inputs held; return states, readings, commands and estimates."""
    derivatives, n, held = servo_derivatives(p), reference.size, inputs.tolist()
    targets, step = reference.tolist(), _COMPENSATION * p.dead_band
    states, readings, commands, estimates = np.empty((n, 4)), np.empty((n, 3)), np.empty(n), np.empty((n, 2))
    command = 0.0

    def right_hand_side(x: Any, t: float, *held: Any) -> tuple[float, float, float, float]:
        y, v, p_a, p_b = x.tolist()
        return derivatives(y, v, p_a, p_b, *held)

    for k in range(n):
        if k:
            path, info = odeint(
                right_hand_side, x, (0.0, dt), args=(command, *held[k - 1]), rtol=_RELATIVE,
                atol=_RELATIVE * _TOLERANCES, mxstep=5000, full_output=True,
            )  # fmt: skip
            if info["message"] != "Integration successful." or not np.all(np.isfinite(path[1])):
                raise RuntimeError(
                    f"simulation: the ODE solver failed between {(k - 1) * dt:g} and {k * dt:g} s from {STATES} = "
                    f"{x.tolist()}: {info['message']}; a smaller dt or other parameters may help"
                )
            x = path[1]
        states[k] = x
        readings[k] = x[[0, 2, 3]] + noise[k]
        # The opening changes the flow, not the forces: 0 stands for the one still to be found.
        motion = x[0], right_hand_side(x, 0.0, 0.0, *held[k])[1]
        estimates[k] = estimate = motion if observer is None else observer(readings[k], command)
        opening = gains.gain * (targets[k] - estimate[0]) - gains.damping * estimate[1]
        if not math.isfinite(opening):
            raise ValueError(f"observer: expected a finite position and acceleration, got {estimate} at sample {k}")
        command = math.copysign(step + (1 - step) * abs(opening), opening) if opening else 0.0
        commands[k] = command = min(1.0, max(-1.0, command))
    return states, readings, commands, estimates
