"""The recording of a simulated servo experiment, and files that other tools read."""

from __future__ import annotations

from os import PathLike
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.floating[Any]]

#: Unit of each signal, in the order of the fields.
UNITS = {
    "t": "s",
    "reference": "m",
    "valve": "1",
    "position": "m",
    "velocity": "m/s",
    "P_a": "Pa",
    "P_b": "Pa",
    "alpha": "1",
    "beta": "1",
    "load": "N",
    "supply": "Pa",
    "position_measured": "m",
    "P_a_measured": "Pa",
    "P_b_measured": "Pa",
    "position_estimate": "m",
    "acceleration_estimate": "m/s^2",
}


class ServoRecording(NamedTuple):
    """Hold a simulated experiment, N samples each; the inputs of row k act from t[k] to t[k] + dt.

    Attributes
    ----------
    t : numpy.ndarray, shape (N,)
        Times, in s.
    reference : numpy.ndarray, shape (N,)
        Reference position, in m (NaN without a loop).
    valve : numpy.ndarray, shape (N,)
        Command to the valve, a fraction of the spool's stroke, in [-1, 1]; `valve_opening` makes an opening of it.
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
        What the controller took for the motion, in m and m/s^2 (NaN without a loop).
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

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write a table of all signals, one row a sample, with the units in its first line: "t [s],reference [m],..".

        Parameters
        ----------
        path : str or path-like
            File to write; one that is there is overwritten.

        Notes
        -----
        Numbers keep all their digits; a signal that does not exist is written as nan.
        """
        header = ",".join(f"{name} [{unit}]" for name, unit in UNITS.items())
        np.savetxt(path, np.column_stack(self), fmt="%.17g", delimiter=",", header=header, comments="")

    def to_mat(self, path: str | PathLike[str]) -> None:
        """Write a MATLAB file (level 5) with a column vector for each signal and a structure ``units``.

        Parameters
        ----------
        path : str or path-like
            File to write; one that is there is overwritten. ``.mat`` is appended where it is missing.
        """
        from scipy.io import savemat

        savemat(str(path), {**self._asdict(), "units": UNITS}, oned_as="column")
