"""Where each matrix and vector of a compiled run stands in its one working array, of shape (COUNT, rows, columns).

Arrays of their own would be counted by numba whenever they are passed on, which costs more than a small filter's
arithmetic. A vector is the first row of its matrix. Rows are filled up with zeros to a multiple of four.
"""

from __future__ import annotations

import numpy as np

# Numbers that are passed on are of numpy's type: numba compiles a function anew for each plain one.
NONE, ONE, FLOAT = np.int64(0), np.int64(1), np.int64(8)
NO, YES = np.int64(0), np.int64(1)

(
    X0, X1, X2, P0, P1, P2,  # the state as it was, between, and after the step
    F_T, Q, CONTROL, Z, H_ALL, R_ALL,  # the model of a step; the measurement's is that of all components
    Y, H, H_T, R, S,  # of the observed components
    T, V, V_T, A, ROOT, ROOT_SQRT,  # the scaling and what it is made from
    E, PSI, WEIGHT, D_DIAGONAL, D, MASK,  # the bounded influence
    C_T, G_T, GD_T, K_T, DEFECT, B, WORK,  # the gains, transposed, and room
    EXPECTED, NORMALIZER,  # by number of sensors
    COUNT,
) = range(39)  # fmt: skip
