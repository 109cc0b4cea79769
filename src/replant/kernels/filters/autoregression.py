r"""Autoregressions of every order up to the largest, by least squares on sums of products.

Over samples whose predecessors are all known, G[i, j] is the sum of e_{k-i} e_{k-j}.  The model of order j minimises
the sum of (e_k + d_1 e_{k-1} + .. + d_j e_{k-j})^2: G[1:j+1, 1:j+1] d = -G[1:j+1, 0].  One factorisation L D L' of
G[1:, 1:] serves all orders, as its leading parts are those of the smaller ones.

Autocovariances would do with fewer numbers, but the ends of their window leak: where the residual is smooth, as behind
a disturbance of the plant's input, their innovation is 40 to 400 times too large.

Source: Ljung (1999), "System Identification: Theory for the User", sections 10.1 and 16.4.
"""

import math

from replant.kernels.native import Matrix, Reals, kernel

ROUNDING = 1e-13
"""Part of a sum that is left after the smaller orders, below which it is rounding [part].
Derivation: some hundred times the precision of float64.
"""


@kernel(
    "variances.size >= 1 and sums.shape[0] >= variances.size and sums.shape[1] >= variances.size",
    "models.shape[0] >= variances.size and models.shape[1] >= variances.size",
    "work.size >= variances.size * variances.size + variances.size",
)
def nested_models(sums: Matrix, count: float, models: Matrix, variances: Reals, work: Reals):
    """Fill the models of orders 0 .. P - 1 and the variances of their residuals; return the order with the least BIC.

    ``sums`` (P, P): the lower triangle of G; ``count``: samples summed; ``models`` (P, P): row j is 1, d_1 .. d_j,
    0 ..; ``variances`` (P,); ``work`` holds P P + P numbers.
    """
    P = variances.size
    top = P - 1
    at_scaled = P * P  # forward solution, scaled by the pivots
    least = max(ROUNDING * sums[0, 0], 1e-300)
    power = max(sums[0, 0], least)
    for i in range(P):
        for j in range(P):
            models[i, j] = 0.0
    usable = True
    best, lowest = 0, math.inf
    for order in range(P):
        if order > 0:
            i = order - 1  # its row in the factors
            for j in range(i + 1):
                total = sums[order, j + 1]
                for k in range(j):
                    total -= work[i * top + k] * work[j * top + k] * work[k * top + k]
                if j < i:
                    work[i * top + j] = total / work[j * top + j]
                else:
                    work[i * top + i] = total
            pivot = work[i * top + i]
            usable = usable and pivot > ROUNDING * sums[order, order] and pivot > 1e-300
            if usable:
                total = -sums[order, 0]
                for k in range(i):
                    total -= work[i * top + k] * work[k * top + k] * work[at_scaled + k]
                work[at_scaled + i] = total / pivot
                power = max(power - total * total / pivot, least)
                for j in range(i, -1, -1):
                    solution = work[at_scaled + j]
                    for k in range(j + 1, order):
                        solution -= work[k * top + j] * models[order, k + 1]
                    models[order, j + 1] = solution
            else:  # what is left is rounding: the smaller order does as well
                for j in range(P):
                    models[order, j] = models[order - 1, j]
                work[i * top + i] = 1.0
        models[order, 0] = 1.0
        variances[order] = power / max(count, 1.0)
        criterion = count * math.log(power) + order * math.log(max(count, 1.0))
        if criterion < lowest:
            best, lowest = order, criterion
    return best
