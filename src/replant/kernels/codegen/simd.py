"""SIMD type: `LANES` float64, one lane for each member of an ensemble.

Numba has no such type.  With it a kernel written for one identifier compiles, without a change, to one that steps
sixteen: ``theta[i]`` is the i-th parameter of sixteen members, and each of ``+ - * /``, ``sqrt`` and ``max`` is two to
eight instructions, depending on the processor.  IEEE 754 rounds every lane by itself, so a member gets the same bits as
in the kernel for one identifier.  LLVM does not vectorise over members by itself: the loop over members would have to
be the innermost one of every sum, with all intermediate values in memory and a check that no two arrays overlap.

Two vectors cannot be compared, and there is no branch on a vector.  What depends on the data of one member is done lane
by lane, where `all_within` finds a lane out of range.
"""

import math
import operator
from typing import Any

from numba import types
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model, type_callable

from replant.kernels.codegen.numba_internals import (
    Conversion,
    cgutils,
    impl_ret_borrowed,
    ir,
)
from replant.kernels.schema import LINE

LANES = 16
"""Members side by side. Twice as many as the widest processors take at once: while an instruction waits for the first
half, the second is under way, and what is the same for all, loops and counters, is spread over more of them [count].
"""


class Vector(types.Type):
    """The type of `LANES` float64; a single float64 beside one stands for as many equal ones."""

    def __init__(self) -> None:
        super().__init__(f"Vector({LANES})")  # the cache of compiled kernels knows a type by its name

    def can_convert_from(self, typingctx, other):
        """Let a float64 become a vector."""
        return Conversion.safe if isinstance(other, types.Float) else None

    def unify(self, typingctx, other):
        """Make a variable that is a float64 at first, like a sum, a vector throughout."""
        return self if isinstance(other, types.Float) else None


VECTOR = Vector()
_CODE = ir.VectorType(ir.DoubleType(), LANES)


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _CODE)


@lower_cast(types.Float, Vector)
def _broadcast(context, builder, fromty, toty, value):
    index, anything = ir.IntType(32), ir.Constant(_CODE, ir.Undefined)
    first = builder.insert_element(anything, value, ir.Constant(index, 0))
    return builder.shuffle_vector(first, anything, ir.Constant(ir.VectorType(index, LANES), [0] * LANES))


def _pair(context):
    """Type an operation of two vectors, or of a vector and a float64."""

    def result(a, b):
        known = all(each == VECTOR or isinstance(each, types.Float) for each in (a, b))
        return VECTOR if known and VECTOR in (a, b) else None

    return result


def _binary(instruction, *operators):
    """Let these operators be one instruction."""

    def lower(context, builder, signature, args):
        return instruction(builder, *(context.cast(builder, *each, VECTOR) for each in zip(args, signature.args)))

    for each in operators:
        type_callable(each)(_pair)
        for pair in ((Vector, Vector), (Vector, types.Float), (types.Float, Vector)):
            lower_builtin(each, *pair)(lower)


def _unary(instruction, function):
    """Let this function of a vector be one instruction."""

    @type_callable(function)
    def typer(context):
        return lambda a: VECTOR if a == VECTOR else None

    @lower_builtin(function, VECTOR)
    def lower(context, builder, signature, args):
        return instruction(builder, *args)


def _larger(builder, a, b):
    """Return what Python's max(a, b) does: b where it is larger, else a."""
    return builder.select(builder.fcmp_ordered(">", b, a), b, a)


def _root(builder, a):
    kind = ir.FunctionType(_CODE, [_CODE])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.sqrt.v{LANES}f64"), [a])


_binary(ir.IRBuilder.fadd, operator.add, operator.iadd)
_binary(ir.IRBuilder.fsub, operator.sub, operator.isub)
_binary(ir.IRBuilder.fmul, operator.mul, operator.imul)
_binary(ir.IRBuilder.fdiv, operator.truediv, operator.itruediv)
_binary(_larger, max)
_unary(ir.IRBuilder.fneg, operator.neg)
_unary(_root, math.sqrt)


def _vectors(typingctx, array):
    if array.layout != "C" or array.dtype != types.float64:
        return None  # Numba then names the call and the type that came
    kind = types.Array(VECTOR, array.ndim - 1, "C", aligned=False)  # aligned to a float64, no more

    def code(context, builder, signature, args):
        source = context.make_array(signature.args[0])(context, builder, args[0])
        view = context.make_array(kind)(context, builder)
        size = source.nitems.type
        view.data = builder.bitcast(source.data, view.data.type)
        view.nitems = builder.sdiv(source.nitems, ir.Constant(size, LANES))
        view.itemsize = ir.Constant(size, 8 * LANES)
        view.shape = cgutils.pack_array(builder, cgutils.unpack_tuple(builder, source.shape)[:-1])
        view.strides = cgutils.pack_array(builder, cgutils.unpack_tuple(builder, source.strides)[:-1])
        view.meminfo, view.parent = source.meminfo, source.parent
        return impl_ret_borrowed(context, builder, signature.return_type, view._getvalue())

    return kind(array), code


#: In kernels: return the float64 array (..., LANES), in C order, as an array (...) of vectors, of the same memory.
vectors: Any = intrinsic(_vectors)


def _every(typingctx, numbers, limit):
    if numbers != VECTOR or not isinstance(limit, types.Float):
        return None

    def code(context, builder, signature, args):
        bound = context.cast(builder, args[1], signature.args[1], VECTOR)
        kind = ir.FunctionType(_CODE, [_CODE])
        size = builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{LANES}f64"), args[:1])
        within = builder.bitcast(builder.fcmp_ordered("<=", size, bound), ir.IntType(LANES))  # a bit a lane
        return builder.icmp_signed("==", within, ir.Constant(ir.IntType(LANES), -1))

    return types.boolean(numbers, limit), code


#: In kernels: say whether the magnitude of every lane is at most this float64; that of NaN is not.
all_within: Any = intrinsic(_every)


def _load(typingctx, array, row, column):
    def code(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(context, builder, signature.args[0], view, args[1:])
        return builder.load(builder.bitcast(place, _CODE.as_pointer()), align=8)

    return VECTOR(array, types.intp, types.intp), code


#: In kernels: return `LANES` neighbours in a row of a matrix, from this one on, as a vector.
load: Any = intrinsic(_load)


def _store(typingctx, array, row, column, vector):
    if vector != VECTOR:
        return None

    def code(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(context, builder, signature.args[0], view, args[1:3])
        builder.store(args[3], builder.bitcast(place, _CODE.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, vector), code


#: In kernels: write a vector to `LANES` neighbours in a row of a matrix, from this one on.
store: Any = intrinsic(_store)


def _prefetch(typingctx, array, row, column):
    def code(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(context, builder, signature.args[0], view, args[1:])
        anywhere, whole = cgutils.voidptr_t, ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [anywhere, whole, whole, whole])
        function = builder.module.declare_intrinsic("llvm.prefetch", [anywhere], kind)
        to_read, and_to_keep, data = (ir.Constant(whole, number) for number in (0, 3, 1))
        first = builder.bitcast(place, anywhere)
        for line in range(0, 8 * LANES if array.dtype == VECTOR else 8, LINE):
            next_line = builder.gep(first, [ir.Constant(ir.IntType(64), line)])
            builder.call(function, [next_line, to_read, and_to_keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp), code


#: In kernels: ask the memory for one element of a matrix, a number or a vector, ahead of its use.
prefetch: Any = intrinsic(_prefetch)
