"""Prefetching of array rows in compiled kernels that read large arrays at random indices."""
# A load that misses the caches stalls a kernel for hundreds of nanoseconds. A prefetch some rows ahead hides this time.

from typing import no_type_check

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

LINE_BYTES = 64
"""Size of a line of the processor's cache, bytes."""
_READ, _KEEP, _DATA = 0, 3, 1
"""Arguments of the LLVM intrinsic: kind of access, locality (highest), kind of cache."""


@no_type_check
def prefetch(array, row, line):
    """Starts to load a part of a row of an array into the processor's caches; results do not change.

    Without compilation, the function does nothing.

    Args:
        array: The array, contiguous on all axes but the first.
        row: Index on the first axis, int64, within the array.
        line: Part of the row to load, int64: number of cache lines from the start of the row to this part.
    """


@intrinsic
@no_type_check
def _prefetch(typing_context, array, row, line):
    def generate(context, builder, signature, args):
        values, index, number = args
        view = context.make_array(signature.args[0])(context, builder, values)
        stride = cgutils.unpack_tuple(builder, view.strides, signature.args[0].ndim)[0]
        offset = builder.add(builder.mul(index, stride), builder.mul(number, stride.type(LINE_BYTES)))
        address, number_type = cgutils.pointer_add(builder, view.data, offset), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, *[number_type] * 3])
        function = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        builder.call(function, [address, *(number_type(number) for number in (_READ, _KEEP, _DATA))])
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64), generate


@overload(prefetch)
@no_type_check
def _compiled_prefetch(array, row, line):
    return lambda array, row, line: _prefetch(array, row, line)
