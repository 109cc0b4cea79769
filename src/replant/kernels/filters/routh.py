"""Where the roots of a polynomial lie, without computing them: Routh's array.

A polynomial s^n + a[0] s^(n-1) + ... + a[n-1] is given by its n lower coefficients.
"""

import math

HALVINGS = 200
"""Halvings of a margin until it counts as nought [count].
Derivation: 2^-200 of a pole's magnitude is far below what float64 tells from an integrator.
"""


def all_left_of(a, margin, work):
    """Return whether every root has a real part below -margin; ``work`` holds 3 (n + 2) numbers."""
    n = a.size
    width = n + 2
    shifted, upper, lower = work[:width], work[width : 2 * width], work[2 * width : 3 * width]
    shifted[0] = 1.0
    for i in range(n):
        if not math.isfinite(a[i]):
            return False
        shifted[i + 1] = a[i]
    for j in range(n):  # s -> s - margin, by repeated synthetic division
        for i in range(1, n + 1 - j):
            shifted[i] -= margin * shifted[i - 1]
    for i in range(width):
        upper[i] = 0.0
        lower[i] = 0.0
    for i in range(n + 1):
        if i % 2 == 0:
            upper[i // 2] = shifted[i]
        else:
            lower[i // 2] = shifted[i]
    for _ in range(n):
        if not lower[0] > 0.0:
            return False
        factor = upper[0] / lower[0]
        for i in range(n):
            below = upper[i + 1] - factor * lower[i + 1]
            upper[i] = lower[i]
            lower[i] = below
        upper[n] = 0.0
        lower[n] = 0.0
    return True


def slowest_decay(a, work):
    """Return the distance of the rightmost root from the imaginary axis, within a factor of two from below.

    The real parts sum to -a[0], so the rightmost lies no further left than a[0]/n: halved until Routh agrees.
    """
    margin = a[0] / a.size
    for _ in range(HALVINGS):
        if all_left_of(a, margin, work):
            return margin
        margin *= 0.5
    return 0.0


def bandwidth(a):
    """Return max |a_i|^(1/(i+1)): no root is larger than twice this, the largest not smaller than an n-th of it.

    Infinite where a coefficient is no number.
    """
    largest = 0.0
    for i in range(a.size):
        if math.isnan(a[i]):
            return math.inf
        largest = max(largest, abs(a[i]) ** (1.0 / (i + 1)))
    return largest
