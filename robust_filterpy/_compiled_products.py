"""Products of small matrices, four columns at a time, for the compiled loops.

numba turns a sum of products into vector instructions only where the loop is long; a filter's are not. So the innermost
tile is written in LLVM's own vectors of four floats, which LLVM fits to whatever the processor has.

A matrix is named by its place in the working array w (see `_compiled_places`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from robust_filterpy._compiled_places import FLOAT, NONE, WHOLE
from robust_filterpy._compiled_psi import compiled, inlined

_LANES = 4
_NUMBER = ir.DoubleType()
_VECTOR = ir.VectorType(_NUMBER, _LANES)
_ANYTHING, _ZERO = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_VECTOR, [0.0] * _LANES)
_FIRST = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)


def _pointer(builder: Any, address: Any, offset: Any, kind: Any = _VECTOR) -> Any:
    """Return an address in bytes as a pointer."""
    return builder.inttoptr(builder.add(address, offset), kind.as_pointer())


def _broadcast(builder: Any, x: Any) -> Any:
    """Return a vector of one number."""
    some = builder.insert_element(_ANYTHING, x, ir.IntType(32)(0))
    return builder.shuffle_vector(some, _ANYTHING, _FIRST)


def _tile(builder: Any, rows: int, places: Any, at: Any, left: Any, right: Any) -> None:
    """Emit a tile of so many rows and four columns; at: where it is in out and base, left and right: in A and B."""
    out, base, sign, a_row, a_step, row, inner = places
    sums = [cgutils.alloca_once(builder, _VECTOR) for _ in range(rows)]
    for total in sums:
        builder.store(_ZERO, total)
    with cgutils.for_range(builder, inner) as loop:
        b = builder.load(_pointer(builder, right, builder.mul(loop.index, row)), align=8)
        step = builder.add(left, builder.mul(loop.index, a_step))
        for r, total in enumerate(sums):
            a = builder.load(_pointer(builder, step, builder.mul(a_row, a_row.type(r)), _NUMBER))
            builder.store(builder.fadd(builder.load(total), builder.fmul(_broadcast(builder, a), b)), total)
    with cgutils.if_unlikely(builder, cgutils.is_not_null(builder, base)):
        for r, total in enumerate(sums):
            start = _pointer(builder, base, builder.add(at, builder.mul(row, row.type(r))))
            scaled = builder.fmul(_broadcast(builder, sign), builder.load(total))
            builder.store(builder.fadd(builder.load(start, align=8), scaled), total)
    for r, total in enumerate(sums):
        to = _pointer(builder, out, builder.add(at, builder.mul(row, row.type(r))))
        builder.store(builder.load(total), to, align=8)


def _generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Emit the loops over tiles: of four rows, then of one."""
    # Copies of this at every product would only take longer to compile.
    builder.function.attributes.discard("alwaysinline")
    builder.function.attributes.add("noinline")
    out, base, sign, a, a_row, a_step, b, row, rows, inner, columns, half = args
    kind = rows.type
    places = out, base, sign, a_row, a_step, row, inner
    fours = builder.sdiv(rows, kind(4))
    for height, number in ((4, fours), (1, builder.sub(rows, builder.mul(fours, kind(4))))):
        with cgutils.for_range(builder, number) as loop:
            i = loop.index if height == 4 else builder.add(loop.index, builder.mul(fours, kind(4)))
            i = builder.mul(i, kind(height))
            below = builder.add(i, kind(height))
            use = builder.and_(cgutils.is_not_null(builder, half), builder.icmp_signed("<", below, columns))
            width = builder.select(use, below, columns)
            with cgutils.for_range(builder, builder.sdiv(builder.add(width, kind(3)), kind(4))) as inside:
                across = builder.mul(inside.index, kind(8 * _LANES))
                at = builder.add(builder.mul(i, row), across)
                left = builder.add(a, builder.mul(i, a_row))
                _tile(builder, height, places, at, left, builder.add(b, across))
    return context.get_dummy_value()


@intrinsic
def _emitted(typingctx, out, base, sign, a, a_row, a_step, b, row, rows, inner, columns, half):  # type: ignore[no-untyped-def]
    """Stand for what `_generate` emits."""
    n = types.int64
    return types.void(n, n, types.float64, *(n,) * 9), _generate


@compiled
def _tiles(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns, half):
    """Write rows by columns of base + sign A B by tiles, or A B if base is 0; half: no tile wholly above the diagonal.

    Matrices are addresses, and distances of their rows (and of A's columns) in bytes.
    """
    _emitted(out, base, sign, a, a_row, a_step, b, row, rows, inner, columns, half)  # type: ignore[call-arg]


@inlined
def product(w, out, A, B, rows, inner, columns):
    """Write A B, rows by columns."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    _tiles(w0 + out * size, NONE, 1.0, w0 + A * size, row, FLOAT, w0 + B * size, row, rows, inner, columns, WHOLE)


@inlined
def product_added(w, out, base, sign, A, B, rows, inner, columns):
    """Write base + sign A B; out may be base."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    a, b = w0 + A * size, w0 + B * size
    _tiles(w0 + out * size, w0 + base * size, sign, a, row, FLOAT, b, row, rows, inner, columns, WHOLE)


@inlined
def transposed_product(w, out, A, B, rows, inner, columns, half):
    """Write A'B; half: the lower half, and some more."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    _tiles(w0 + out * size, NONE, 1.0, w0 + A * size, FLOAT, row, w0 + B * size, row, rows, inner, columns, half)


@inlined
def transposed_product_added(w, out, base, sign, A, B, rows, inner, columns, half):
    """Write base + sign A'B; out may be base; half: the lower half, and some more."""
    row, size, w0 = 8 * w.shape[2], 8 * w.shape[2] * w.shape[1], np.int64(w.ctypes.data)
    a, b = w0 + A * size, w0 + B * size
    _tiles(w0 + out * size, w0 + base * size, sign, a, FLOAT, row, b, row, rows, inner, columns, half)


@inlined
def mirror(w, P, n):
    """Copy the lower half of a square matrix to the upper."""
    for i in range(n):
        for j in range(i):
            w[P, j, i] = w[P, i, j]


@inlined
def copy_rows(w, A, to, rows):
    """Copy whole rows."""
    for i in range(rows):
        for j in range(w.shape[2]):
            w[to, i, j] = w[A, i, j]
