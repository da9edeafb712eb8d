"""Short rows of float32 times a matrix, with sums that stay in registers, for compiled functions.

Of a product of matrices compilers keep the sums in memory, and fetch and store them all the time. This one is written
in vectors of 16 numbers, which stand for one register or for several narrower ones. Every sum goes on in one order,
each product is rounded before it is added, and no number has to do with its neighbours: what comes out is that of a
plain loop, to the bit, on every processor.
"""

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic

VECTOR: Final = 16
"""Numbers at a time."""
ROWS: Final = 4
"""Rows at a time: what is fetched of the matrix is used so often."""
_BYTES: Final = 4
_VECTOR: Final = ir.VectorType(ir.FloatType(), VECTOR)
_INDEX: Final = ir.IntType(32)
_UNDEFINED: Final = ir.Constant(_VECTOR, ir.Undefined)
_X, _Y, _W, _B, _OUT = 0, 4, 8, 10, 13
"""Places of the arrays among the arguments."""


class _Code:
    """Writes the loops of one call.

    Args:
        vectors: of each row whose sums stay in registers at a time.
        context, builder, signature, arguments: numba's.
    """

    def __init__(self, vectors: int, context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        self._builder, self._number = builder, context.get_value_type(types.intp)
        self._data = {
            k: context.make_array(signature.args[k])(context, builder, arguments[k]).data
            for k in (_X, _Y, _W, _B, _OUT)
        }
        self._offsets = [self._constant(VECTOR * v) for v in range(vectors)]
        self._block = self._constant(VECTOR * vectors)
        room: Any = cgutils.alloca_once
        self._sums = [[room(builder, _VECTOR) for _ in range(vectors)] for _ in range(ROWS)]
        self._arguments = arguments

    def write(self) -> None:
        """All blocks of columns of the matrix."""
        builder = self._builder
        _, x_at, x_stride, told, _, y_at, y_stride, more, _, w_at, _, b_at, width, _, out_at, out_stride = (
            self._arguments
        )
        y_weights_at = builder.add(w_at, builder.mul(told, width))
        with cgutils.for_range(builder, builder.sdiv(width, self._block)) as blocks:
            first = builder.mul(blocks.index, self._block)
            for v, offset in enumerate(self._offsets):
                start = self._fetch(_B, builder.add(b_at, builder.add(first, offset)))
                for sums in self._sums:
                    builder.store(start, sums[v])
            self._add(_X, x_at, x_stride, told, builder.add(w_at, first), width)
            self._add(_Y, y_at, y_stride, more, builder.add(y_weights_at, first), width)
            for r, sums in enumerate(self._sums):
                row_at = builder.add(out_at, builder.add(builder.mul(self._constant(r), out_stride), first))
                for v, offset in enumerate(self._offsets):
                    to = self._place(_OUT, builder.add(row_at, offset), _VECTOR)
                    builder.store(builder.load(sums[v]), to, align=_BYTES)

    def _add(self, array: int, at: Any, stride: Any, columns: Any, weights_at: Any, width: Any) -> None:
        """Add what so many numbers of each row make of the matrix, one after the other."""
        builder = self._builder
        with cgutils.for_range(builder, columns) as column:
            w_at = builder.add(weights_at, builder.mul(column.index, width))
            weights = [self._fetch(_W, builder.add(w_at, offset)) for offset in self._offsets]
            for r, sums in enumerate(self._sums):
                number_at = builder.add(at, builder.add(builder.mul(self._constant(r), stride), column.index))
                number = builder.load(builder.gep(self._data[array], [number_at]))
                one = builder.insert_element(_UNDEFINED, number, _INDEX(0))
                x = builder.shuffle_vector(one, _UNDEFINED, ir.Constant(ir.VectorType(_INDEX, VECTOR), [0] * VECTOR))
                for weight, total in zip(weights, sums, strict=True):
                    builder.store(builder.fadd(builder.load(total), builder.fmul(x, weight)), total)

    def _constant(self, number: int) -> Any:
        return ir.Constant(self._number, number)

    def _place(self, array: int, at: Any, kind: Any) -> Any:
        return self._builder.bitcast(self._builder.gep(self._data[array], [at]), kind.as_pointer())

    def _fetch(self, array: int, at: Any) -> Any:
        return self._builder.load(self._place(array, at, _VECTOR), align=_BYTES)


def _product(vectors: int) -> Any:
    n = types.intp

    def typed(
        _typing: Any,
        x: Any,
        x_at: Any,
        x_stride: Any,
        x_columns: Any,
        y: Any,
        y_at: Any,
        y_stride: Any,
        y_columns: Any,
        weights: Any,
        weights_at: Any,
        b: Any,
        b_at: Any,
        width: Any,
        out: Any,
        out_at: Any,
        out_stride: Any,
    ) -> tuple[Any, Any]:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            _Code(vectors, context, builder, signature, arguments).write()
            return context.get_dummy_value()

        return types.void(x, n, n, n, y, n, n, n, weights, n, b, n, n, out, n, n), code

    return intrinsic(typed)


product_by_32: Any = _product(2)
"""For compiled functions: four rows of ``out`` become ``b`` plus those of ``x`` and ``y``, one behind the other, times
a matrix of ``width`` columns, a multiple of 32.

    product_by_32(x, x_at, x_stride, x_columns, y, y_at, y_stride, y_columns, weights, weights_at, b, b_at, width,
                  out, out_at, out_stride)

Arrays are float32 in C order, of any shape; each begins at ``_at``, and its next row is ``_stride`` numbers away. The
matrix has ``x_columns + y_columns`` rows. Nothing is checked.
"""
product_by_16: Any = _product(1)
"""The same for a matrix of 16 columns, or a multiple of them."""
