"""Small arrays on the stack of a compiled function, and rows of arrays that are only looked at.

The former cost nothing, and the compiler knows that they overlap with nothing, without which it does not turn loops
over several of them into SIMD code. The latter cost an addition, where a slice counts references, which takes longer
than many a loop over it.
"""

from __future__ import annotations

from typing import Any, Final

from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

_REGISTER_BYTES: Final = 64


def _scratch(_typing: Any, dtype: Any, size: Any) -> tuple[Any, Any]:
    array = types.Array(dtype.dtype, 1, "C")
    room = size.literal_value

    def code(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        number = context.get_data_type(array.dtype)
        data = cgutils.alloca_once(builder, number, size=room)  # type: ignore[no-untyped-call]
        data.align = _REGISTER_BYTES
        bytes_each = context.get_constant(types.intp, context.get_abi_sizeof(number))
        shape = [context.get_constant(types.intp, room)]
        made = make_array(array)(context, builder)  # type: ignore[no-untyped-call]
        strides = [bytes_each]
        populate_array(made, data, shape, strides, bytes_each, None)  # type: ignore[no-untyped-call]
        return made._getvalue()

    return array(dtype, size), code


scratch: Any = intrinsic(prefer_literal=True)(_scratch)
"""For compiled functions: ``scratch(np.float64, SIZE)`` is an array of SIZE numbers; SIZE is a constant of the module.

It lives as long as the function that asks for it, and must not be returned. What is in it at first is not defined.
Asked for in a loop, it is the same one each time.
"""


def _row(_typing: Any, array: Any, index: Any) -> tuple[Any, Any]:
    row = types.Array(array.dtype, array.ndim - 1, "C")

    def code(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole = make_array(array)(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        shape = cgutils.unpack_tuple(builder, whole.shape)  # type: ignore[no-untyped-call]
        strides = cgutils.unpack_tuple(builder, whole.strides)  # type: ignore[no-untyped-call]
        at = builder.mul(context.cast(builder, arguments[1], index, types.intp), strides[0])
        data = cgutils.pointer_add(builder, whole.data, at)  # type: ignore[no-untyped-call]
        made = make_array(row)(context, builder)  # type: ignore[no-untyped-call]
        populate_array(made, data, shape[1:], strides[1:], whole.itemsize, None)  # type: ignore[no-untyped-call]
        return made._getvalue()

    return row(array, index), code


row_of: Any = intrinsic(_row)
"""For compiled functions: ``row_of(array, index)`` is ``array[index]`` of a C-ordered array, for an index from 0.

Nobody counts it as a reference: it must not outlive the array, nor be returned.
"""
