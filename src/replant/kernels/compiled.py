"""How the kernels are compiled, and what makes them as fast as C.

* No reference counts (``_nrt=False``).  Numba counts the owners of an array in atomic instructions, at every slice and
  every call; in the kernel of one sample they took most of the time.  A kernel without them may look only into arrays
  that its caller keeps, may not return one, and cannot allocate: the compiler refuses, which is as it should be.
* Parts melt into their caller (``forceinline``), so that arrays travel in registers.
* Every quantity is an array of its own, cut from its flat home and indexed by the variable of a ``range``.
  For ``reals[offset + i]`` Numba, unsure of the sign, provides for an index that counts from the end, and the loop
  cannot be vectorised.
* No check before a division (``error_model="numpy"``); the interpreter is free meanwhile (``nogil``).  Never
  ``fastmath``: NaN must stay visible, results must repeat.
"""

from numba import njit

#: What Python calls.
kernel = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)

#: What a kernel is made of; Python can call it too.
part = njit(cache=True, nogil=True, error_model="numpy", _nrt=False, forceinline=True)

#: What a kernel needs now and then only: compiled once, called as a function.
rare = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)

#: A part that returns an array: its source is copied into the caller, so that nothing is returned in truth.
cut = njit(cache=True, nogil=True, error_model="numpy", _nrt=False, inline="always")
