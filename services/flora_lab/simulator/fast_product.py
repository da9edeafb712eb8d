"""Short rows of float32 times a matrix, with sums that stay in registers, for compiled functions.

Of a product of matrices compilers keep the sums in memory, and fetch and store them all the time. This one is written
in vectors of 16 numbers, which stand for one register or for several narrower ones, and takes as many columns at a time
as the processor has room for (:mod:`flora_lab.lanes`). Every sum goes on in one order, each product is rounded before
it is added, and no number has to do with its neighbours: what comes out is that of a plain loop, to the bit, on every
processor.
"""

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from flora_lab.lanes import lanes

LANES: Final = lanes(cpu_target.target_context.codegen().magic_tuple()[-1])
"""Columns at a time, of matrices that have so many or a multiple of them."""
VECTOR: Final = 16
"""Numbers in a vector."""
ROWS: Final = 4
"""Rows at a time: what is fetched of the matrix is used so often."""
_BYTES: Final = 4
_VECTOR: Final = ir.VectorType(ir.FloatType(), VECTOR)
_INDEX: Final = ir.IntType(32)
_UNDEFINED: Final = ir.Constant(_VECTOR, ir.Undefined)
_FIRST: Final = ir.Constant(ir.VectorType(_INDEX, VECTOR), [0] * VECTOR)


class _Sums:
    """Writes the code of sums of four rows that stay in registers, of one call.

    Args:
        columns: at a time; a multiple of :data:`VECTOR`.
        context, builder, signature, arguments: numba's.
    """

    def __init__(self, columns: int, context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        self._builder, self._number = builder, context.get_value_type(types.intp)
        self._data = {
            k: context.make_array(kind)(context, builder, argument).data
            for k, (kind, argument) in enumerate(zip(signature.args, arguments, strict=True))
            if isinstance(kind, types.Array)
        }
        self._offsets = [self.constant(first) for first in range(0, columns, VECTOR)]
        self.block = self.constant(columns)
        room: Any = cgutils.alloca_once
        self._sums = [[room(builder, _VECTOR) for _ in self._offsets] for _ in range(ROWS)]

    def begin(self, array: int, at: Any) -> None:
        """With the same numbers of an array in every row."""
        for v, offset in enumerate(self._offsets):
            start = self._fetch(array, self._builder.add(at, offset))
            for sums in self._sums:
                self._builder.store(start, sums[v])

    def begin_alike(self, array: int, at: Any) -> None:
        """Each row with a number of an array, all along it."""
        for r, sums in enumerate(self._sums):
            start = self._repeated(array, self._builder.add(at, self.constant(r)))
            for total in sums:
                self._builder.store(start, total)

    def add(self, array: int, at: Any, stride: Any, columns: Any, matrix: int, matrix_at: Any, width: Any) -> None:
        """What so many numbers of each row make of a matrix of this width, one after the other."""
        builder = self._builder
        with cgutils.for_range(builder, columns) as column:
            w_at = builder.add(matrix_at, builder.mul(column.index, width))
            weights = [self._fetch(matrix, builder.add(w_at, offset)) for offset in self._offsets]
            for r, sums in enumerate(self._sums):
                x = self._repeated(array, builder.add(self._row(at, r, stride), column.index))
                for weight, total in zip(weights, sums, strict=True):
                    builder.store(builder.fadd(builder.load(total), builder.fmul(x, weight)), total)

    def keep(self, array: int, at: Any, stride: Any) -> None:
        """Write them into an array."""
        for r, sums in enumerate(self._sums):
            row_at = self._row(at, r, stride)
            for offset, total in zip(self._offsets, sums, strict=True):
                to = self._place(array, self._builder.add(row_at, offset))
                self._builder.store(self._builder.load(total), to, align=_BYTES)

    def constant(self, number: int) -> Any:
        return ir.Constant(self._number, number)

    def _row(self, at: Any, row: int, stride: Any) -> Any:
        return self._builder.add(at, self._builder.mul(self.constant(row), stride))

    def _place(self, array: int, at: Any) -> Any:
        return self._builder.bitcast(self._builder.gep(self._data[array], [at]), _VECTOR.as_pointer())

    def _repeated(self, array: int, at: Any) -> Any:
        number = self._builder.load(self._builder.gep(self._data[array], [at]))
        one = self._builder.insert_element(_UNDEFINED, number, _INDEX(0))
        return self._builder.shuffle_vector(one, _UNDEFINED, _FIRST)

    def _fetch(self, array: int, at: Any) -> Any:
        return self._builder.load(self._place(array, at), align=_BYTES)


def _product(at_once: int) -> Any:
    n = types.intp
    x_is, y_is, w_is, b_is, out_is = 0, 4, 8, 10, 13

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
            _, x_at, x_stride, told, _, y_at, y_stride, more, _, w_at, _, b_at, width, _, out_at, out_stride = arguments
            sums = _Sums(at_once, context, builder, signature, arguments)
            y_weights_at = builder.add(w_at, builder.mul(told, width))
            with cgutils.for_range(builder, builder.sdiv(width, sums.block)) as blocks:
                first = builder.mul(blocks.index, sums.block)
                sums.begin(b_is, builder.add(b_at, first))
                sums.add(x_is, x_at, x_stride, told, w_is, builder.add(w_at, first), width)
                sums.add(y_is, y_at, y_stride, more, w_is, builder.add(y_weights_at, first), width)
                sums.keep(out_is, builder.add(out_at, first), out_stride)
            return context.get_dummy_value()

        return types.void(x, n, n, n, y, n, n, n, weights, n, b, n, n, out, n, n), code

    return intrinsic(typed)


def _of_tile(width: int) -> Any:
    n = types.intp
    x_is, b_is, matrix_is, out_is = 0, 4, 6, 8

    def typed(
        _typing: Any,
        x: Any,
        x_at: Any,
        x_stride: Any,
        columns: Any,
        b: Any,
        b_at: Any,
        matrix: Any,
        matrix_at: Any,
        out: Any,
        out_at: Any,
    ) -> tuple[Any, Any]:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            _, x_at, x_stride, columns, _, b_at, _, matrix_at, _, out_at = arguments
            sums = _Sums(width, context, builder, signature, arguments)
            sums.begin_alike(b_is, b_at)
            sums.add(x_is, x_at, x_stride, columns, matrix_is, matrix_at, sums.block)
            sums.keep(out_is, out_at, sums.block)
            return context.get_dummy_value()

        return types.void(x, n, n, n, b, n, matrix, n, out, n), code

    return intrinsic(typed)


product_by_32: Any = _product(min(LANES, 32))
"""For compiled functions: four rows of ``out`` become ``b`` plus those of ``x`` and ``y``, one behind the other, times
a matrix of ``width`` columns, a multiple of 32.

    product_by_32(x, x_at, x_stride, x_columns, y, y_at, y_stride, y_columns, weights, weights_at, b, b_at, width,
                  out, out_at, out_stride)

Arrays are float32 in C order, of any shape; each begins at ``_at``, and its next row is ``_stride`` numbers away. The
matrix has ``x_columns + y_columns`` rows. Nothing is checked.
"""
product_by_16: Any = _product(16)
"""The same for a matrix of 16 columns, or a multiple of them."""
product_of_tile: Any = _of_tile(LANES)
"""For compiled functions: four rows of ``out``, :data:`LANES` numbers each, become one number of ``b`` each plus those
of ``x`` times a matrix of so many columns, which is a tile of so many plants.

    product_of_tile(x, x_at, x_stride, columns, b, b_at, matrix, matrix_at, out, out_at)

Rows of ``matrix`` and ``out`` stand one behind the other; for the rest see :data:`product_by_32`.
"""
