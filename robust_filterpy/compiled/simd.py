"""Products of matrices in LLVM's own vectors of four floats, which LLVM fits to whatever the processor has.

numba turns a sum of products into vector instructions only where the loop is long; a filter's are not. Each function
here emits LLVM code through a builder; matrices are addresses, and distances of their rows in bytes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_LANES = 4
_BYTES = 8 * _LANES
_NUMBER = ir.DoubleType()
_VECTOR = ir.VectorType(_NUMBER, _LANES)
_ANYTHING, _ZERO = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_VECTOR, [0.0] * _LANES)


class _Product(NamedTuple):
    """base + sign A B, or A B if base is 0: A has rows and steps of its own; B, base and out have rows alike."""

    out: Any
    base: Any
    sign: Any
    a: Any
    a_row: Any
    a_step: Any
    b: Any
    row: Any
    rows: Any
    inner: Any
    columns: Any


def _pointer(builder: Any, address: Any, offset: Any, kind: Any = _VECTOR) -> Any:
    """Return an address in bytes as a pointer."""
    return builder.inttoptr(builder.add(address, offset), kind.as_pointer())


def _shuffled(builder: Any, x: Any, y: Any, order: list[int]) -> Any:
    """Return lanes of x (0 to 3) and y (4 to 7) in an order."""
    return builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(ir.IntType(32), _LANES), order))


def _broadcast(builder: Any, x: Any) -> Any:
    """Return a vector of one number."""
    return _shuffled(builder, builder.insert_element(_ANYTHING, x, ir.IntType(32)(0)), _ANYTHING, [0] * _LANES)


def _tile(builder: Any, p: _Product, rows: int, width: int, i: Any, j: Any) -> list[list[Any]]:
    """Emit a tile of so many rows and vectors from row i and vector j on; return its vectors."""
    across = builder.mul(j, j.type(_BYTES))
    left, right = builder.add(p.a, builder.mul(i, p.a_row)), builder.add(p.b, across)
    sums = [[cgutils.alloca_once(builder, _VECTOR) for _ in range(width)] for _ in range(rows)]
    for row in sums:
        for total in row:
            builder.store(_ZERO, total)
    with cgutils.for_range(builder, p.inner) as loop:
        b_row, a_row = builder.mul(loop.index, p.row), builder.add(left, builder.mul(loop.index, p.a_step))
        b = [
            builder.load(_pointer(builder, right, builder.add(b_row, j.type(v * _BYTES))), align=8)
            for v in range(width)
        ]
        for r in range(rows):
            a = _broadcast(builder, builder.load(_pointer(builder, a_row, builder.mul(p.a_row, j.type(r)), _NUMBER)))
            for v in range(width):
                builder.store(builder.fadd(builder.load(sums[r][v]), builder.fmul(a, b[v])), sums[r][v])
    with cgutils.if_unlikely(builder, cgutils.is_not_null(builder, p.base)):
        sign = _broadcast(builder, p.sign)
        for r in range(rows):
            for v in range(width):
                start = builder.load(_place(builder, p, p.base, i, r, builder.add(j, j.type(v))), align=8)
                builder.store(builder.fadd(start, builder.fmul(sign, builder.load(sums[r][v]))), sums[r][v])
    return [[builder.load(total) for total in row] for row in sums]


def _place(builder: Any, p: _Product, address: Any, i: Any, r: int, j: Any) -> Any:
    """Return a pointer to vector j of row i + r."""
    down = builder.mul(p.row, builder.add(i, i.type(r)))
    return _pointer(builder, address, builder.add(down, builder.mul(j, j.type(_BYTES))))


def _pairs(builder: Any, vectors: Any) -> Any:
    """Yield a width and the vectors to take so many at a time: first two, then the one that may be left."""
    two, one = vectors.type(2), vectors.type(1)
    with cgutils.for_range(builder, builder.lshr(vectors, one)) as loop:
        yield 2, builder.mul(loop.index, two)
    with cgutils.if_unlikely(builder, builder.trunc(builder.and_(vectors, one), ir.IntType(1))):
        yield 1, builder.sub(vectors, one)


def _vectors(builder: Any, numbers: Any) -> Any:
    """Return how many vectors hold so many numbers."""
    return builder.lshr(builder.add(numbers, numbers.type(_LANES - 1)), numbers.type(2))


def _emit_product(builder: Any, p: _Product) -> None:
    """Emit tiles of four rows, one more than fits if that holds two rows or three, and of one row for a last one."""
    four = p.rows.type(4)
    fours = builder.lshr(builder.add(p.rows, p.rows.type(2)), p.rows.type(2))
    whole = builder.mul(fours, four)
    for height, number in ((4, fours), (1, builder.zext(builder.icmp_signed("<", whole, p.rows), p.rows.type))):
        with cgutils.for_range(builder, number) as loop:
            i = builder.mul(loop.index, four) if height == 4 else whole
            for width, j in _pairs(builder, _vectors(builder, p.columns)):
                for r, row in enumerate(_tile(builder, p, height, width, i, j)):
                    for v, vector in enumerate(row):
                        to = _place(builder, p, p.out, i, r, builder.add(j, j.type(v)))
                        builder.store(vector, to, align=8)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Return the columns of four vectors."""
    low = [_shuffled(builder, rows[k], rows[k + 1], [0, 4, 2, 6]) for k in (0, 2)]
    high = [_shuffled(builder, rows[k], rows[k + 1], [1, 5, 3, 7]) for k in (0, 2)]
    return [_shuffled(builder, x, y, order) for order in ([0, 1, 4, 5], [2, 3, 6, 7]) for x, y in (low, high)]


def _emit_symmetric(builder: Any, p: _Product) -> None:
    """Emit the tiles of the lower half, and what they hold a second time in the upper."""
    with cgutils.for_range(builder, _vectors(builder, p.rows)) as loop:
        block = loop.index
        i = builder.mul(block, block.type(4))
        for width, j in _pairs(builder, builder.add(block, block.type(1))):
            tile = _tile(builder, p, 4, width, i, j)
            for v in range(width):
                to = builder.add(j, j.type(v))
                rows = [row[v] for row in tile]
                columns = _transposed(builder, rows)
                diagonal = builder.icmp_signed("==", to, block)
                for r in range(4):
                    both = _shuffled(builder, rows[r], columns[r], [k if k <= r else 4 + k for k in range(4)])
                    lower, upper = (builder.select(diagonal, both, x[r]) for x in (rows, columns))
                    builder.store(lower, _place(builder, p, p.out, i, r, to), align=8)
                    builder.store(upper, _place(builder, p, p.out, builder.mul(to, to.type(4)), r, block), align=8)


def _product_of(emit: Any) -> Any:
    """Return the intrinsic that a function emits."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        """Emit it once for all callers: copies at every product would only take longer to compile."""
        builder.function.attributes.discard("alwaysinline")
        builder.function.attributes.add("noinline")
        builder.function.attributes.add("optsize")
        emit(builder, _Product(*args))
        return context.get_dummy_value()

    @intrinsic
    def emitted(typingctx, out, base, sign, a, a_row, a_step, b, row, rows, inner, columns):  # type: ignore[no-untyped-def]
        """Stand for what is emitted."""
        n = types.int64
        return types.void(n, n, types.float64, *(n,) * 8), generate

    return emitted


product_of, symmetric_product_of = _product_of(_emit_product), _product_of(_emit_symmetric)


def _emit_rotation(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Emit the rotation of two rows."""
    first, second, c, s, columns = args
    c, s = _broadcast(builder, c), _broadcast(builder, s)
    with cgutils.for_range(builder, _vectors(builder, columns)) as loop:
        shift = builder.mul(loop.index, columns.type(_BYTES))
        places = _pointer(builder, first, shift), _pointer(builder, second, shift)
        x, y = (builder.load(place, align=8) for place in places)
        builder.store(builder.fsub(builder.fmul(c, x), builder.fmul(s, y)), places[0], align=8)
        builder.store(builder.fadd(builder.fmul(s, x), builder.fmul(c, y)), places[1], align=8)
    return context.get_dummy_value()


@intrinsic
def rotation_of(typingctx, first, second, c, s, columns):  # type: ignore[no-untyped-def]
    """Replace a first row x and a second y by c x - s y and s x + c y."""
    n = types.int64
    return types.void(n, n, types.float64, types.float64, n), _emit_rotation
