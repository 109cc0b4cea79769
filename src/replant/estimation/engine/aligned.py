"""Arrays that begin on a line of the processor's cache."""

import numpy as np

from replant.kernels.schema import LINE
from replant.numerics.arguments import FloatArray


def aligned(shape: tuple[int, ...]) -> FloatArray:
    """Return an array of zeros that begins on a cache line, so that no vector lies across two lines."""
    size = int(np.prod(shape))
    room = np.zeros(size + LINE // 8)
    skip = -room.ctypes.data % LINE // 8
    return room[skip : skip + size].reshape(shape)
