"""The gain in fit if the model changes at each of some samples, see `replant.estimation.solver.change_search`."""

from replant.kernels.native import Cube, Matrix, Reals, inlined, kernel

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
