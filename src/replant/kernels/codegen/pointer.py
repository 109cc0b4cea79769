"""Pointers into arrays, as in C: what the loops of the general kernels work on.

Numba passes an array as seven numbers, a pointer as one, in a register.  For ``array[i]`` and ``array[start : stop]``
it also emits code for negative indices and for bounds; for a pointer it does not.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic

from replant.kernels.codegen.numba_internals import cgutils, impl_ret_borrowed


def _kind_of(array):
    """Return the type of a pointer into this type of array; None where there is none."""
    if isinstance(array, types.CPointer):
        return array
    if isinstance(array, types.Array) and array.layout == "C" and array.ndim == 1:
        return types.CPointer(array.dtype) if array.aligned else array
    return None  # Numba then names the call and the types that came


def _pointer(typingctx, array, start):
    kind = _kind_of(array)

    def code(context, builder, signature, args):
        if array == kind and not isinstance(array, types.Array):
            return builder.gep(args[0], [args[1]])
        source = context.make_array(array)(context, builder, args[0])
        first = builder.gep(source.data, [args[1]])
        if array != kind:
            return first
        view, left = context.make_array(kind)(context, builder), builder.sub(source.nitems, args[1])
        view.data, view.nitems, view.itemsize = first, left, source.itemsize
        view.shape, view.strides = cgutils.pack_array(builder, [left]), source.strides
        view.meminfo, view.parent = source.meminfo, source.parent
        return impl_ret_borrowed(context, builder, signature.return_type, view._getvalue())

    return None if kind is None else (kind(array, types.intp), code)


#: In kernels: return where the number ``start`` of a one-dimensional array, or behind a pointer, lies; what is returned
#: is indexed as the array is.  An array of vectors, which need not lie where the processor has them, stays an array.
pointer: Any = intrinsic(_pointer)
