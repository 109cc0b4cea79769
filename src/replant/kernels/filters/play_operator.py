"""The play operator: what a part with backlash makes of the motion that pushes it.

Source: Brokate and Sprekels (1996), "Hysteresis and Phase Transitions", chapter 2.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def play(v, width):
    """Return the output (K,) of a play of half a ``width`` behind a signal (K,): it follows where it is pushed.

    y(k) = min(max(y(k-1), v(k) - width), v(k) + width), from y = 0 before the record; in the unit of v.
    """
    output, held = np.empty(v.size), 0.0
    for k in range(v.size):
        held = min(max(held, v[k] - width), v[k] + width)
        output[k] = held
    return output
