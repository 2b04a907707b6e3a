"""SIMD vectors of sixteen float32 for numba functions; the rasteriser uses one for a row of pixels of a tile.

In numba functions, use the functions of this module, the operators + - * / on vectors and float32, and the comparisons
>=, <= and &.
"""

import operator
from collections.abc import Callable
from typing import Any, no_type_check

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

# With vectors, sums over a tile stay in registers from one row of pixels to the next, unlike in a plain loop over
# pixels. They map to 512-bit registers if available, otherwise to several shorter ones.
LANES = 16
_FLOATS, _INTS, _BITS = (ir.VectorType(kind, LANES) for kind in (ir.FloatType(), ir.IntType(32), ir.IntType(1)))
_FLAGS = ("nsz", "arcp", "contract")  # not "reassoc", which would remove the rounding in `power_of_two`
_SHIFTER = 1.5 * (1 << 23)  # floats this large have no fractional bits, so adding it rounds
# 2 ** f on [-1/2, 1/2], lowest power first: the polynomial of degree five of least relative error.
_EXP2 = (1.0000001, 0.69314694, 0.2402212, 0.055507127, 0.00967554, 0.00132766)


class _Vector(types.Type):
    """Numba type of a vector of sixteen floats, or of a mask of sixteen bits."""


_LANES, _MASK = _Vector("Lanes"), _Vector("Mask")


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, _BITS if kind == _MASK else _FLOATS)


def _spread(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(_INTS, [0] * LANES))


@no_type_check
def _define(operation: Any, result: types.Type, inside: types.Type, build: Callable[..., ir.Value]) -> None:
    """Defines an operator on vectors of sixteen numbers for numba; a scalar operand is broadcast.

    Args:
        operation: Python operator, such as `operator.add`.
        result: Type of the result.
        inside: Type of the operands.
        build: Function that emits the LLVM instruction for two operands.
    """

    @type_callable(operation)
    def typer(context):
        def resolve(a, b):
            if inside in (a, b) and all(k == inside or (inside == _LANES and k == types.float32) for k in (a, b)):
                return result
            return None

        return resolve

    def lower(context, builder, signature, arguments):
        pairs = zip(signature.args, arguments, strict=True)
        return build(builder, *[v if k == inside else _spread(builder, v) for k, v in pairs])

    for kinds in ((inside, inside), (inside, types.float32), (types.float32, inside)):
        lower_builtin(operation, *kinds)(lower)


for _add in (operator.add, operator.iadd):
    _define(_add, _LANES, _LANES, lambda builder, a, b: builder.fadd(a, b, flags=_FLAGS))
_define(operator.sub, _LANES, _LANES, lambda builder, a, b: builder.fsub(a, b, flags=_FLAGS))
_define(operator.mul, _LANES, _LANES, lambda builder, a, b: builder.fmul(a, b, flags=_FLAGS))
_define(operator.truediv, _LANES, _LANES, lambda builder, a, b: builder.fdiv(a, b, flags=_FLAGS))
_define(operator.ge, _MASK, _LANES, lambda builder, a, b: builder.fcmp_ordered(">=", a, b))
_define(operator.le, _MASK, _LANES, lambda builder, a, b: builder.fcmp_ordered("<=", a, b))
_define(operator.and_, _MASK, _MASK, lambda builder, a, b: builder.and_(a, b))


@no_type_check
def _address(context, builder, array_type, array, index, kind=_FLOATS):
    values = context.make_array(array_type)(context, builder, array)
    return builder.bitcast(builder.gep(values.data, [index]), kind.as_pointer())


@intrinsic
@no_type_check
def load(typingctx, array, index):
    """Loads a vector: sixteen consecutive numbers of a flat float32 array, without bounds check.

    Args:
        typingctx: Typing context of numba; callers omit it.
        array: The array.
        index: Index of the first number.
    """

    def build(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature.args[0], *arguments), align=4)

    return _LANES(array, types.intp), build


@intrinsic
@no_type_check
def pick(typingctx, array, index):
    """Loads one number of a flat float32 array, without bounds check.

    Args:
        typingctx: Typing context of numba; callers omit it.
        array: The array.
        index: Index of the number.
    """

    def build(context, builder, signature, arguments):
        return builder.load(_address(context, builder, signature.args[0], *arguments, ir.FloatType()))

    return types.float32(array, types.intp), build


@intrinsic
@no_type_check
def store(typingctx, array, index, value):
    """Stores a vector into a flat float32 array, without bounds check.

    Args:
        typingctx: Typing context of numba; callers omit it.
        array: The array, changed in place.
        index: Index in the array of the first stored element.
        value: The vector.
    """

    def build(context, builder, signature, arguments):
        array, index, value = arguments
        builder.store(value, _address(context, builder, signature.args[0], array, index), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, _LANES), build


@intrinsic
@no_type_check
def spread(typingctx, value):
    """Returns a vector with sixteen copies of one number.

    Args:
        typingctx: Typing context of numba; callers omit it.
        value: The number, float32.
    """

    def build(context, builder, signature, arguments):
        return _spread(builder, arguments[0])

    return _LANES(types.float32), build


@intrinsic
@no_type_check
def choose(typingctx, mask, yes, no):
    """Selects elements of two vectors by a mask.

    Args:
        typingctx: Typing context of numba; callers omit it.
        mask: The mask.
        yes: Elements where the mask is set.
        no: Elements elsewhere.
    """

    def build(context, builder, signature, arguments):
        return builder.select(*arguments)

    return _LANES(_MASK, _LANES, _LANES), build


@intrinsic
@no_type_check
def smaller(typingctx, a, b):
    """Returns the element-wise minimum of two vectors.

    Args:
        typingctx: Typing context of numba; callers omit it.
        a: First vector.
        b: Second vector.
    """

    def build(context, builder, signature, arguments):
        return builder.select(builder.fcmp_ordered("<", *arguments), *arguments)

    return _LANES(_LANES, _LANES), build


@intrinsic
@no_type_check
def power_of_two(typingctx, power):
    """Returns 2 ** power for each element, with relative error 2e-7, for powers in [-126, 127].

    Args:
        typingctx: Typing context of numba; callers omit it.
        power: Vector of exponents.
    """

    def build(context, builder, signature, arguments):
        (power,) = arguments

        def constant(value):
            return ir.Constant(_FLOATS, [value] * LANES)

        shifted = builder.fadd(power, constant(_SHIFTER))
        f = builder.fsub(power, builder.fsub(shifted, constant(_SHIFTER)))
        result = constant(_EXP2[-1])
        for coefficient in reversed(_EXP2[:-1]):
            result = builder.fadd(builder.fmul(result, f, flags=_FLAGS), constant(coefficient), flags=_FLAGS)
        exponent = builder.shl(builder.bitcast(shifted, _INTS), ir.Constant(_INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(result, _INTS), exponent), _FLOATS)

    return _LANES(_LANES), build


@intrinsic
@no_type_check
def pairs(typingctx, a, b):
    """Adds adjacent elements within each of two vectors: returns eight sums from `a`, then eight sums from `b`.

    Args:
        typingctx: Typing context of numba; callers omit it.
        a: First vector.
        b: Second vector.
    """

    def build(context, builder, signature, arguments):
        sides = [builder.shuffle_vector(*arguments, ir.Constant(_INTS, [*range(s, 2 * LANES, 2)])) for s in (0, 1)]
        return builder.fadd(*sides, flags=_FLAGS)

    return _LANES(_LANES, _LANES), build


@intrinsic
@no_type_check
def store_first(typingctx, array, index, value, count):
    """Stores the first elements of a vector in a flat float32 array.

    Args:
        typingctx: Typing context of numba; callers omit it.
        array: The array, changed in place.
        index: Index in the array of the first stored element.
        value: The vector.
        count: Number of elements to store, a compile-time constant.
    """
    if not isinstance(count, types.IntegerLiteral):
        return None

    def build(context, builder, signature, arguments):
        array, index, value, _ = arguments
        address, at = _address(context, builder, signature.args[0], array, index, ir.FloatType()), 0
        for width in (8, 4, 2, 1):
            if count.literal_value & width:
                picked = ir.Constant(ir.VectorType(ir.IntType(32), width), [*range(at, at + width)])
                part = builder.shuffle_vector(value, value, picked)
                pointer = builder.gep(address, [ir.Constant(ir.IntType(64), at)])
                builder.store(part, builder.bitcast(pointer, part.type.as_pointer()), align=4)
                at += width
        return context.get_dummy_value()

    return types.none(array, types.intp, _LANES, count), build


@intrinsic
@no_type_check
def prefetch(typingctx, array, index):
    """Starts to load the memory at `index` of a flat array into the processor's cache, before it is needed.

    Args:
        typingctx: Typing context of numba; callers omit it.
        array: The array.
        index: Index of an element.
    """

    def build(context, builder, signature, arguments):
        byte, number = ir.IntType(8), ir.IntType(32)
        address = _address(context, builder, signature.args[0], *arguments, byte)
        kind = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte.as_pointer()], kind)
        builder.call(function, [address, *(ir.Constant(number, n) for n in (0, 3, 1))])  # read, high locality, data
        return context.get_dummy_value()

    return types.none(array, types.intp), build
