"""Sums of products over the samples of a record, of columns and of a residual, and what they tell of a change.

`WIDTH` samples are multiplied at a time, in SIMD registers.  BLAS takes as long, but NumPy holds the interpreter's lock
for a product with a small result, so that other threads wait.

The gain in fit if the model changes at each of some samples follows from the sums since each, see
`replant.estimation.solver.change_search`.
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


# far above the precision of float64, as sums of squares lose half the digits
SAME = 1e-9  # power left of a column by the others below which it depends on them linearly [part of its power]


def eliminate(matrix, j, least):
    """Eliminate column ``j`` from the rows below its pivot, if the pivot exceeds ``least``; return whether it does."""
    pivot, rows = matrix[j, j], matrix.shape[0]
    if not pivot > least:
        return False
    for i in range(j + 1, rows):
        part = matrix[i, j] / pivot
        for k in range(j, rows + 1):
            matrix[i, k] -= part * matrix[j, k]
    return True


@inlined
def place(i, size, T):
    """Return which of T columns is the i-th if the first ``size`` are moved to the end."""
    return size + i if size + i < T else size + i - T


@kernel(
    "sums.shape[0] > statistics.size and sums.shape[1] == sums.shape[2] and 0 <= size < sums.shape[1]",
    "matrix.shape[0] == 2 * (sums.shape[1] - 1) and matrix.shape[1] == matrix.shape[0] + 1",
)
def since_each(sums: Cube, size: int, statistics: Reals, matrix: Matrix):
    """Write g' C^-1 g of the first ``size`` columns since each of B samples, after elimination of the other columns.

    ``sums`` (B + 1, T + 1, T + 1) are sums of products of T columns and a residual: M and m over all samples, M_b and
    m_b over those since each.  Elimination of the first half of

        [ M    M_b | m   ]
        [ M_b  M_b | m_b ]

    leaves C = M_b - M_b M^-1 M_b and g = m_b - M_b M^-1 m in the second half, where the other columns are eliminated
    first.  ``matrix`` (2 T, 2 T + 1) is work.
    """
    T = sums.shape[1] - 1
    for b in range(statistics.size):
        for i in range(T):
            row = place(i, size, T)
            for j in range(T):
                column = place(j, size, T)
                matrix[i, j] = sums[0, row, column]
                matrix[i, T + j] = sums[b + 1, row, column]
                matrix[T + i, j] = sums[b + 1, row, column]
                matrix[T + i, T + j] = sums[b + 1, row, column]
            matrix[i, 2 * T] = sums[0, row, T]
            matrix[T + i, 2 * T] = sums[b + 1, row, T]
        statistics[b] = 0.0
        for i in range(T):
            row = place(i, size, T)
            eliminate(matrix, i, SAME * sums[0, row, row])
        for i in range(T):
            row, j = place(i, size, T), T + i
            if eliminate(matrix, j, SAME * sums[0, row, row]) and i >= T - size:
                statistics[b] += matrix[j, 2 * T] * matrix[j, 2 * T] / matrix[j, j]
