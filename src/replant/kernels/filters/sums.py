"""Sums of products over the samples of a record: of the columns of a matrix, and of a residual with its past.

`WIDTH` samples are multiplied at a time, in SIMD registers.  BLAS takes as long, but NumPy holds the interpreter's lock
for a product with a small result, so that other threads wait.
"""

from replant.kernels.native import Cube, Ints, Matrix, Reals, inlined, kernel, side_by_side

WIDTH = 16  # samples multiplied side by side: twice as many as the widest vector registers hold [count]


def clear(numbers):
    """Set all numbers to zero."""
    for i in range(numbers.shape[0]):
        for m in side_by_side(WIDTH):
            numbers[i, m] = 0.0


@inlined
def add(turned, parts):
    """Add the products of ``turned`` (T, WIDTH), a column for each sample, to ``parts`` (T T, WIDTH)."""
    T = turned.shape[0]
    for i in range(T):
        for j in range(i + 1):
            for m in side_by_side(WIDTH):
                parts[i * T + j, m] += turned[i, m] * turned[j, m]


def finish(parts, sums):
    """Write the totals of ``parts`` to ``sums`` (T, T)."""
    T = sums.shape[0]
    for i in range(T):
        for j in range(i + 1):
            total = 0.0
            for m in range(WIDTH):
                total += parts[i * T + j, m]
            sums[i, j] = total
            sums[j, i] = total


@kernel(
    "sums.shape[0] > edges.size and sums.shape[1] == columns.shape[1] and sums.shape[2] == columns.shape[1]",
    "turned.shape[0] == columns.shape[1] and turned.shape[1] == WIDTH",
    "parts.shape[0] == columns.shape[1] * columns.shape[1] and parts.shape[1] == WIDTH",
)
def products(columns: Matrix, edges: Ints, sums: Cube, turned: Matrix, parts: Matrix):
    """Write X' X (T, T) of the rows X of ``columns`` (K, T) before, between and after E edges into E + 1 ``sums``.

    Edges ascend.  ``turned`` (T, WIDTH) and ``parts`` (T T, WIDTH) are work.
    """
    T, first = columns.shape[1], 0
    for e in range(edges.size + 1):
        end = columns.shape[0]
        if e < edges.size:
            end = max(min(edges[e], end), first)
        clear(parts)
        while first < end:
            rows = min(WIDTH, end - first)
            if rows < WIDTH:
                clear(turned)
            for m in range(rows):
                for j in range(T):
                    turned[j, m] = columns[first + m, j]
            add(turned, parts)
            first += rows
        finish(parts, sums[e])


@kernel(
    "sums.shape[0] >= 1 and sums.shape[1] == sums.shape[0] and known.size >= error.size",
    "turned.shape[0] == sums.shape[0] and turned.shape[1] == WIDTH",
    "parts.shape[0] == sums.shape[0] * sums.shape[0] and parts.shape[1] == WIDTH",
)
def lagged_products(error: Reals, known: Ints, sums: Matrix, turned: Matrix, parts: Matrix):
    """Write the sums (P + 1, P + 1) of e_{k-i} e_{k-j} over samples with P ``known`` predecessors; return their count.

    ``error`` and ``known`` are (K,); ``turned`` (P + 1, WIDTH) and ``parts`` ((P + 1)^2, WIDTH) are work.
    """
    T, count, m = sums.shape[0], 0, 0
    clear(parts)
    clear(turned)
    for k in range(T - 1, error.size):
        if known[k] >= T - 1:
            for j in range(T):
                turned[j, m] = error[k - j]
            count += 1
            m += 1
            if m == WIDTH:
                add(turned, parts)
                clear(turned)
                m = 0
    add(turned, parts)
    finish(parts, sums)
    return count


@kernel("0 <= first and first + weights.size < columns.shape[1] and error.size == columns.shape[0]")
def explain(columns: Matrix, first: int, weights: Reals, error: Reals):
    """Subtract N columns from ``first`` on, times their weights (N,), from the last one of ``columns`` (K, T).

    Write the residual to ``error`` (K,) as well, and return the sum of its squares.
    """
    last, power = columns.shape[1] - 1, 0.0
    for k in range(error.size):
        left = columns[k, last]
        for j in range(weights.size):
            left -= columns[k, first + j] * weights[j]
        columns[k, last] = left
        error[k] = left
        power += left * left
    return power
