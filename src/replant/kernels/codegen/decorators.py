"""Decorators of the kernels: how each is compiled and inlined, which makes them as fast as C.

* No reference counts (``_nrt=False``).  Numba counts the owners of an array in atomic instructions, at every slice and
  every call; in the kernel of one sample they took most of the time.  A kernel without them may look only into arrays
  that its caller keeps, may not return one, and cannot allocate: the compiler refuses, which is as it should be.
* Parts melt into their caller (``forceinline``), so that arrays travel in registers.  What is called as a function
  within a sample takes a `pointer` for each array: an array travels as seven numbers, on the stack.
* Every quantity is an array of its own, cut from its flat home once a call and indexed by the variable of a ``range``,
  or a `pointer`.
  For ``reals[offset + i]`` Numba, unsure of the sign, provides for an index that counts from the end, and the loop
  cannot be vectorised.
* No check before a division (``error_model="numpy"``); the interpreter is free meanwhile (``nogil``).  Never
  ``fastmath``: NaN must stay visible, results must repeat.

What is compiled is kept on the disk for the next start.  A disk that is full, gone or read-only costs that alone: the
kernels are compiled again then, and `TROUBLE` says why.
"""

import contextlib
from typing import Any

from replant.kernels.codegen.numba_internals import njit

TROUBLE: list[str] = []  # why kernels could not be kept; empty where they could


def compiled(**how):
    """Return the decorator that compiles a kernel so, and as ``how`` says."""
    # Numba's own parts use _nrt; its type hints leave it out.  What does not say so inherits forceinline from its first
    # caller: all that a part calls would melt into the part, whole matrix exponentials into every sample.
    settings: dict[str, Any] = {"forceinline": False, "_nrt": False, "nogil": True, "error_model": "numpy"}
    settings |= {"no_cfunc_wrapper": True} | how

    def compile_when_called(function):
        try:
            kernel = njit(cache=True, **settings)(function)
        except RuntimeError as error:  # Numba found no folder that can be written to
            TROUBLE.append(str(error))
            return njit(**settings)(function)
        if hasattr(kernel, "_cache"):  # else Numba was told to leave the function as it is (NUMBA_DISABLE_JIT)
            _go_on_without(kernel._cache)
        return kernel

    return compile_when_called


def _go_on_without(cache):
    """Let a kernel do without its cache where that is damaged, or cannot be read or written."""
    load, save = cache.load_overload, cache.save_overload

    def load_or_compile(signature, context):
        try:
            return load(signature, context)
        except OSError:
            return None
        except Exception:  # half an index, as after a power cut: begun anew, it can be written to again
            with contextlib.suppress(OSError):
                cache.flush()
            return None

    def save_or_leave(signature, compiled_now):
        try:
            save(signature, compiled_now)
        except OSError as error:
            TROUBLE.append(error.strerror or str(error))

    cache.load_overload, cache.save_overload = load_or_compile, save_or_leave


#: What Python calls.
kernel = compiled()

#: Inlined by LLVM: what many kernels need in their innermost loops.
inline_llvm = compiled(forceinline=True)

#: Inlined by Numba, which copies the source into the caller: what returns an array, or has one caller alone.
inline_source = compiled(inline="always")

#: Compiled by itself and called as a function: a stage of the kernel of one sample.
outlined = compiled()

#: The same, not optimised: what runs once in many samples, where optimising takes longer than all of its calls.  It
#: calls nothing compiled itself: what is left of such names, unoptimised, forbids the cache.
cold = compiled(_dbg_optnone=True)
