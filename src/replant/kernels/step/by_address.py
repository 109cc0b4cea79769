"""The step kernels with one address in the place of five arrays: what `Identifier.update` calls.

A call with five arrays takes longer than most kernels: Numba looks up the type of each array and reads its fields.  The
arrays of a state do not move, so a table of their addresses replaces them.  The compiled entry for one int and four
floats is called directly, without a look at the types.

The caller keeps the table and the arrays alive, and passes one int and four floats, nothing else.
"""

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]  # its hints leave carray out
from numba.extending import intrinsic

from replant.kernels import schema as at
from replant.kernels.step import collecting, covariance, fixed_filter, gradient

INTS, REALS, BANKS, BUFFER, RECENT, GATE, SIZE = 0, 2, 4, 7, 10, 13, 14
"""Places in the table of addresses and shapes: those of the five arrays, the gate, and its size [index]."""
OPEN, SHUT = 0, 1
"""Values of the gate: samples are taken, or refused because another call is under way [number]."""


def table_of(ints, reals, banks, buffer, recent):
    """Return the table (SIZE,) int64 of addresses and shapes, its gate shut.

    Parameters
    ----------
    ints : (I,) int64 array
    reals : (R,) array
    banks : (3, size) array
    buffer : (capacity, width) array
    recent : (R, 3), (R, 5) or (R, 6) array
        The arrays of a `replant.engine.state.State`, each in C order.
    """
    numbers = []
    for array in (ints, reals, banks, buffer, recent):
        assert array.flags.c_contiguous
        numbers += [array.ctypes.data, *array.shape]
    return np.array([*numbers, SHUT], np.int64)


def entry_of(kernel_at):
    """Return the compiled entry of one of the kernels below."""
    signature = (types.int64, *[types.float64] * 4)
    if signature not in kernel_at.overloads:
        kernel_at.compile(signature)
    return kernel_at.overloads[signature].entry_point


def _pointer(kind):
    @intrinsic
    def pointer(typing_context, address):
        """Convert an address to a pointer to numbers of this type."""

        def build(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), build

    return pointer


ints_at, reals_at = _pointer(types.int64), _pointer(types.float64)


#: Arrays are made here, which kernels without reference counts may not.  The interpreter is not set free meanwhile: to
#: let go of it and take it back would be a tenth of the whole call.
direct = njit(cache=True, error_model="numpy")


@direct
def must_wait(address):
    """Return whether no sample may be taken now: the gate is shut, or the identifier has something to do first.

    The interpreter is not free between the look and the sample, so that no other thread comes between.
    """
    table = ints_at(address)
    return table[GATE] == SHUT or ints_at(table[INTS])[at.ATTENTION] == 1


@direct
def arrays_at(address):
    """Return the arrays of the table at this address."""
    table = carray(ints_at(address), (SIZE,))
    return (
        carray(ints_at(table[INTS]), (table[INTS + 1],)),
        carray(reals_at(table[REALS]), (table[REALS + 1],)),
        carray(reals_at(table[BANKS]), (table[BANKS + 1], table[BANKS + 2])),
        carray(reals_at(table[BUFFER]), (table[BUFFER + 1], table[BUFFER + 2])),
        carray(reals_at(table[RECENT]), (table[RECENT + 1], table[RECENT + 2])),
    )


@direct
def covariance_step_at(address, u, y, t, r):
    """Take one sample as `covariance.step` does; raise Attention, and take none, where something comes before it.

    Python looks for an exception after every call, so that one costs nothing until it comes.
    """
    if must_wait(address):
        raise at.Attention
    ints, reals, banks, buffer, recent = arrays_at(address)
    error = covariance.step(ints, reals, banks, buffer, recent, u, y, t, r)
    if ints[at.HELD_AT] == at.BELIEVED:  # one that was held back
        raise at.Attention
    return error


@direct
def gradient_step_at(address, u, y, t, r):
    """Take one sample as `gradient.step` does; raise Attention, and take none, where something comes before it."""
    if must_wait(address):
        raise at.Attention
    ints, reals, banks, buffer, recent = arrays_at(address)
    error = gradient.step(ints, reals, banks, buffer, recent, u, y, t, r)
    if ints[at.HELD_AT] == at.BELIEVED:  # one that was held back
        raise at.Attention
    return error


@direct
def collecting_step_at(address, u, y, t, r):
    """Take one sample as `collecting.step` does; raise Attention, and take none, where something comes before it.

    One with which the start-up may end is left as well: its error is known once that has ended.
    """
    if must_wait(address):
        raise at.Attention
    ints, reals, banks, buffer, recent = arrays_at(address)
    if ints[at.SAMPLES] + 1 == ints[at.ATTENTION_AT]:
        raise at.Attention
    error = collecting.step(ints, reals, banks, buffer, recent, u, y, t, r)
    if ints[at.HELD_AT] == at.BELIEVED:  # one that was held back
        raise at.Attention
    return error


@direct
def fixed_filter_step_at(address, u, y, t, r):
    """Take one sample as `fixed_filter.step` does; raise Attention, and take none, where something comes before it."""
    if must_wait(address):
        raise at.Attention
    ints, reals, banks, buffer, recent = arrays_at(address)
    return fixed_filter.step(ints, reals, banks, buffer, recent, u, y, t, r)


WITHOUT_ARRAYS = {
    collecting.step: collecting_step_at,
    covariance.step: covariance_step_at,
    gradient.step: gradient_step_at,
    fixed_filter.step: fixed_filter_step_at,
}
