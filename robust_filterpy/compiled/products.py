"""Products of the matrices in the working array of the compiled loops (see `_compiled_places`).

Rows and columns there are filled up to a multiple of four, and the tiles of `_compiled_vectors` fill and read that too:
zeros beyond the states, anything finite beyond the sensors, where nobody looks.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy.compiled import simd as vectors
from robust_filterpy.compiled.influence import compiled, inlined
from robust_filterpy.compiled.workspace import FLOAT, NONE

_product_of: Any = vectors.product_of
_symmetric_product_of: Any = vectors.symmetric_product_of
_rotation_of: Any = vectors.rotation_of


@compiled
def _product(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns):
    """Write base + sign A B, or A B if base is 0."""
    _product_of(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns)


@compiled
def _symmetric(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns):
    """Write the same, of which the lower half is computed."""
    _symmetric_product_of(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns)


@inlined
def product(w, out, A, B, rows, inner, columns):
    """Write A B, rows by columns."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    _product(w0 + out * size, NONE, 1.0, w0 + A * size, row, FLOAT, w0 + B * size, row, rows, inner, columns)


@inlined
def product_added(w, out, base, sign, A, B, rows, inner, columns):
    """Write base + sign A B; out may be base."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    a, b = w0 + A * size, w0 + B * size
    _product(w0 + out * size, w0 + base * size, sign, a, row, FLOAT, b, row, rows, inner, columns)


@inlined
def symmetric_product(w, out, A, B, n, inner):
    """Write A B, which is symmetric."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    _symmetric(w0 + out * size, NONE, 1.0, w0 + A * size, row, FLOAT, w0 + B * size, row, n, inner, n)


@inlined
def symmetric_transposed_product(w, out, A, B, n, inner):
    """Write A'B, which is symmetric."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    _symmetric(w0 + out * size, NONE, 1.0, w0 + A * size, FLOAT, row, w0 + B * size, row, n, inner, n)


@inlined
def symmetric_transposed_product_added(w, out, base, sign, A, B, n, inner):
    """Write base + sign A'B, which is symmetric; out may be base."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    a, b = w0 + A * size, w0 + B * size
    _symmetric(w0 + out * size, w0 + base * size, sign, a, FLOAT, row, b, row, n, inner, n)


@inlined
def rotate_rows(w, A, i, j, c, s, columns):
    """Replace rows i and j of A by c A_i - s A_j and s A_i + c A_j."""
    row = 8 * w.shape[2]
    first = np.int64(w.ctypes.data) + A * row * w.shape[1]
    _rotation_of(first + i * row, first + j * row, c, s, columns)


@inlined
def copy_rows(w, A, to, rows):
    """Copy whole rows."""
    for i in range(rows):
        for j in range(w.shape[2]):
            w[to, i, j] = w[A, i, j]
