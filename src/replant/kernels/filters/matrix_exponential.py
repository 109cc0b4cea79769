"""The exponential of a small matrix: scaling and squaring on a Taylor series.

Here because the kernels need it while samples come in: when the filter follows the estimate, and for each interval
of an irregular clock.  At the norm of 1/4 that scaling leaves, twelve terms reach 1e-17.
"""

_TERMS = 12
"""Terms of the Taylor series [count].
Derivation: 0.25^13 / 13! is 2e-18, below the precision of float64.
"""

_LARGEST_NORM = 0.25
"""Norm up to which the series is taken as it is; a larger matrix is halved until it is below [norm].
Derivation: see _TERMS.
"""

_MOST_SQUARINGS = 1000
"""Halvings at the most, where the norm is not finite [count]."""


def _product(a, b, result, size):
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += a[i * size + k] * b[k * size + j]
            result[i * size + j] = total


def exponential(matrix, result, work, size):
    """Write exp(matrix) into ``result``; all are flat (size^2,), ``matrix`` is used up, ``work`` is work."""
    norm = 0.0
    for i in range(size):
        row = 0.0
        for j in range(size):
            row += abs(matrix[i * size + j])
        norm = max(norm, row)
    squarings = 0
    factor = 1.0
    while norm * factor > _LARGEST_NORM and squarings < _MOST_SQUARINGS:
        factor *= 0.5
        squarings += 1
    for i in range(size * size):
        matrix[i] *= factor
        result[i] = 0.0
    for i in range(size):
        result[i * size + i] = 1.0
    for term in range(_TERMS, 0, -1):  # Horner: result = I + matrix/term result
        _product(matrix, result, work, size)
        for i in range(size * size):
            result[i] = work[i] / term
        for i in range(size):
            result[i * size + i] += 1.0
    for _ in range(squarings):
        _product(result, result, work, size)
        for i in range(size * size):
            result[i] = work[i]
