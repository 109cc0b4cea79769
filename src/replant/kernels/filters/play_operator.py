"""The play operator: what a part with backlash makes of the motion that pushes it.

Source: Brokate and Sprekels (1996), "Hysteresis and Phase Transitions", chapter 2.
"""

import numpy as np

from replant.kernels.native import Reals, kernel


@kernel("output.size >= v.size")
def fill_play(v: Reals, width: float, output: Reals):
    """Write what `play` returns into ``output`` (K,)."""
    held = 0.0
    for k in range(v.size):
        held = min(max(held, v[k] - width), v[k] + width)
        output[k] = held


def play(v: Reals, width: float) -> Reals:
    """Return the output (K,) of a play of half a ``width`` behind a signal (K,): it follows where it is pushed.

    y(k) = min(max(y(k-1), v(k) - width), v(k) + width), from y = 0 before the record; in the unit of v.
    """
    v = np.ascontiguousarray(v, float)
    output = np.empty(v.size)
    fill_play(v, width, output)
    return output
