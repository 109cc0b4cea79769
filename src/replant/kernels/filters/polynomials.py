r"""Location of the roots of a polynomial, and reflection of its unstable roots.

A polynomial s^n + a[0] s^(n-1) + ... + a[n-1] is given by its n lower coefficients.  Routh's array locates the roots
without computing them.

The denominator D is A with the unstable roots reflected in the imaginary axis: |A/D| = 1 on it, and 1/D is a stable
filter.  The roots come from the iteration of Aberth and Ehrlich, in real arithmetic: a root p is (re, im).

Source: Bini (1996), "Numerical computation of polynomial zeros by means of Aberth's method", Numerical Algorithms 13.
"""

import math

# float64 cannot distinguish a pole of 2^-200 of the others' magnitude from an integrator
HALVINGS = 200  # halvings after which a margin counts as zero [count]


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
    """Return a lower bound, within a factor of two, of the distance of the rightmost root from the imaginary axis."""
    # the real parts sum to -a[0], so this is an upper bound; it is halved until Routh's test passes
    margin = a[0] / a.size
    for _ in range(HALVINGS):
        if all_left_of(a, margin, work):
            return margin
        margin *= 0.5
    return 0.0


def bandwidth(a):
    """Return max |a_i|^(1/(i+1)), infinite for NaN: the largest root lies between an n-th and twice of it."""
    largest = 0.0
    for i in range(a.size):
        if math.isnan(a[i]):
            return math.inf
        largest = max(largest, abs(a[i]) ** (1.0 / (i + 1)))
    return largest


# simple roots take less than ten; the error of a multiple root halves with each
ITERATIONS = 200  # most iterations [count]
# a few times the precision of float64
STILL = 1e-15  # step of a root below which it has converged [part of the roots' size]
# guesses symmetric to the real axis would stay symmetric
ANGLE = 0.4  # angle by which the evenly spaced first guesses are rotated from the real axis [rad]


def reflect(a, margin, work):
    """Reflect the roots of s^n + a[0] s^(n-1) + .. to the left of -margin, in place; ``work`` holds 4 n + 2 numbers.

    If the roots overflow, all of them become minus their common bound.
    """
    n = a.size
    re, im, product = work[:n], work[n : 2 * n], work[2 * n :]
    size = 0.0  # half of an upper bound of the roots' magnitude
    for i in range(n):
        size = max(size, abs(a[i]) ** (1.0 / (i + 1)))
    if not size > 0.0:
        size = margin
    for i in range(n):
        angle = 2.0 * math.pi * i / n + ANGLE
        re[i], im[i] = math.cos(angle), math.sin(angle)
    for _ in range(ITERATIONS):
        largest = 0.0
        for i in range(n):
            x, y = re[i], im[i]
            p, q, dp, dq = 1.0, 0.0, 0.0, 0.0  # Horner's scheme: the value p + iq at the root, and the derivative
            scale = 1.0
            for k in range(n):
                scale *= size
                dp, dq = dp * x - dq * y + p, dp * y + dq * x + q
                p, q = p * x - q * y + a[k] / scale, p * y + q * x
            square = dp * dp + dq * dq
            if (p == 0.0 and q == 0.0) or not square > 0.0:
                continue
            u, v = (p * dp + q * dq) / square, (q * dp - p * dq) / square  # Newton's step
            s, t = 0.0, 0.0  # repulsion by the other roots
            for j in range(n):
                if j != i:
                    gx, gy = x - re[j], y - im[j]
                    gap = gx * gx + gy * gy
                    if gap > 0.0:
                        s += gx / gap
                        t -= gy / gap
            cx, cy = 1.0 - (u * s - v * t), -(u * t + v * s)
            square = cx * cx + cy * cy
            if not square > 0.0:
                continue
            sx, sy = (u * cx + v * cy) / square, (v * cx - u * cy) / square
            re[i], im[i] = x - sx, y - sy
            largest = max(largest, abs(sx) + abs(sy))
        if largest <= STILL:
            break
    known = True
    for i in range(n):
        known = known and math.isfinite(re[i]) and math.isfinite(im[i])
    for i in range(n):
        if not known:
            re[i], im[i] = -1.0, 0.0
        re[i], im[i] = min(-abs(re[i] * size), -margin), im[i] * size
    # the product of s - p, real and imaginary parts one after the other
    product[0], product[n + 1] = 1.0, 0.0
    for i in range(n):
        product[i + 1], product[n + 2 + i] = 0.0, 0.0
        for k in range(i + 1, 0, -1):
            before, behind = product[k - 1], product[n + k]
            product[k] -= re[i] * before - im[i] * behind
            product[n + 1 + k] -= re[i] * behind + im[i] * before
    for i in range(n):
        a[i] = product[i + 1]
