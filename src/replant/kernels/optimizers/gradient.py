"""The article's optimizers and their relatives: each learns the drawn rows of the buffer, one update a row.

Every kernel has the same signature:

    kernel(theta, memory, settings, buffer, rows, batch, direction)

``theta`` (P,) and ``memory`` are changed in place; the first ``batch`` of ``rows`` are drawn.  A row of ``buffer`` is
[phi (P entries), y, 1/m^2], all scaled, followed by [zeta (P entries)] with instruments.  The gradient (16) of a row is
g = -(y - theta' phi) / m^2 * phi; with instruments zeta replaces the last phi.  ``direction`` is the column where this
vector begins, 0 or P + 2.  ``settings`` are in the order of the class in `replant.estimation.optimizers`.

Each loop has a code, which `learn` and checkpoints use: a number that no other optimizer has or had.  `OPTIMIZERS`
lists them; a loop gets a block of its memory by `block`.
"""

import math

from replant.kernels.lanes import prefetch
from replant.kernels.native import in_turn, inlined, short_loops, side_by_side
from replant.kernels.optimizers.memory import MATRIX, NOTHING, ONE, VECTOR, Memory, block, place

# 1 - 1e-100 is 1 in float64, and smaller powers would become denormal: some processors take a hundred cycles for each
# product of those
VANISHED = 1e-100  # least power of beta [number]

GRADIENT, ADAM, AMSGRAD, ADAGRAD, RMSPROP, NADAM, ADADELTA, INTEGRAL_COST = range(8)

MOMENTS = Memory(first=VECTOR, second=VECTOR, power1=ONE, power2=ONE)  # m, v, beta1^t, beta2^t
LARGEST_MOMENT = Memory(first=VECTOR, second=VECTOR, largest=VECTOR)  # m, v, max v
SQUARES = Memory(squares=VECTOR)  # sum or moving mean of g^2
SQUARES_AND_STEPS = Memory(squares=VECTOR, moved=VECTOR)  # moving means of g^2 and step^2
INTEGRALS = Memory(R=MATRIX, Q=VECTOR, slope=VECTOR)  # slope: R theta + Q

AT_SECOND, AT_POWER1, AT_POWER2 = (MOMENTS.begins[name] for name in ("second", "power1", "power2"))
AT_LARGEST, AT_MOVED = LARGEST_MOMENT.begins["largest"], SQUARES_AND_STEPS.begins["moved"]
AT_Q, AT_SLOPE = INTEGRALS.begins["Q"], INTEGRALS.begins["slope"]


@inlined
def telling_part(algorithm, P, memory):
    """Return a part of the memory that is not finite if any of the memory is not, while theta is finite."""
    if algorithm == AMSGRAD:
        # an infinite square stays the largest
        return block(memory, AT_LARGEST, P)
    if algorithm == INTEGRAL_COST:
        # the slope is a sum of products with every entry of R
        return block(memory, AT_SLOPE, P)
    return memory


@inlined
def drawn(theta, row, direction):
    """Return the vector that the update of a row follows, and epsilon_I of (13): (y - theta' phi) / m^2."""
    P = theta.size
    prediction = theta[0] * row[0]  # starting from zero would add one dependent sum
    for i in in_turn(1, P):
        prediction += theta[i] * row[i]
    return row[direction:], (row[P] - prediction) * row[P + 1]


@inlined
def gradient(theta, memory, settings, buffer, rows, batch, direction):
    """(17): theta += Tp gamma epsilon_I phi; settings [Tp gamma]."""
    P, gain = theta.size, settings[0]
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        step = gain * error
        for i in in_turn(0, P):
            theta[i] += step * along[i]  # (17)


@inlined
def adam(theta, memory, settings, buffer, rows, batch, direction):
    """Algorithm 1; settings [alpha, beta1, beta2, epsilon], memory `MOMENTS`."""
    P = theta.size
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    m, v = memory, block(memory, AT_SECOND, P)
    power1, power2 = memory[place(AT_POWER1, P)], memory[place(AT_POWER2, P)]
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        power1 = max(power1 * beta1, VANISHED)
        power2 = max(power2 * beta2, VANISHED)
        rate = alpha / (1.0 - power1)  # bias corrections outside the loop save two divisions an entry
        root = 1.0 / math.sqrt(1.0 - power2)
        for i in side_by_side(P):
            g = -error * along[i]  # (16)
            m[i] = beta1 * m[i] + (1.0 - beta1) * g  # lines 2 and 3
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g
            theta[i] -= rate * m[i] / (math.sqrt(v[i]) * root + epsilon)  # lines 4 to 6
    memory[place(AT_POWER1, P)], memory[place(AT_POWER2, P)] = power1, power2


@short_loops
def amsgrad(theta, memory, settings, buffer, rows, batch, direction):
    """Algorithm 2, no bias correction; settings [alpha, beta1, beta2, epsilon], memory `LARGEST_MOMENT`."""
    P = theta.size
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    m, v, largest = memory, block(memory, AT_SECOND, P), block(memory, AT_LARGEST, P)
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        for i in side_by_side(P):
            g = -error * along[i]
            m[i] = beta1 * m[i] + (1.0 - beta1) * g
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g
            largest[i] = max(largest[i], v[i])  # line 1 of Algorithm 2
            theta[i] -= alpha * m[i] / (math.sqrt(largest[i]) + epsilon)


@short_loops
def adagrad(theta, memory, settings, buffer, rows, batch, direction):
    """Sum of squared gradients; settings [alpha, epsilon], memory `SQUARES`."""
    P, alpha, epsilon = theta.size, settings[0], settings[1]
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        for i in side_by_side(P):
            g = -error * along[i]
            memory[i] += g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@short_loops
def rmsprop(theta, memory, settings, buffer, rows, batch, direction):
    """Moving mean of squared gradients; settings [alpha, rho, epsilon], memory `SQUARES`."""
    P, alpha, rho, epsilon = theta.size, settings[0], settings[1], settings[2]
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        for i in side_by_side(P):
            g = -error * along[i]
            memory[i] = rho * memory[i] + (1.0 - rho) * g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@inlined
def nadam(theta, memory, settings, buffer, rows, batch, direction):
    """Adam with Nesterov's look-ahead; settings and memory as `adam`."""
    P = theta.size
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    m, v = memory, block(memory, AT_SECOND, P)
    power1, power2 = memory[place(AT_POWER1, P)], memory[place(AT_POWER2, P)]
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        power1 = max(power1 * beta1, VANISHED)
        power2 = max(power2 * beta2, VANISHED)
        now = alpha * (1.0 - beta1) / (1.0 - power1)
        ahead = alpha * beta1 / (1.0 - beta1 * power1)
        root = 1.0 / math.sqrt(1.0 - power2)
        for i in side_by_side(P):
            g = -error * along[i]
            m[i] = beta1 * m[i] + (1.0 - beta1) * g
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g
            theta[i] -= (ahead * m[i] + now * g) / (math.sqrt(v[i]) * root + epsilon)
    memory[place(AT_POWER1, P)], memory[place(AT_POWER2, P)] = power1, power2


@short_loops
def adadelta(theta, memory, settings, buffer, rows, batch, direction):
    """Steps in the unit of theta; settings [alpha, rho, epsilon], memory `SQUARES_AND_STEPS`."""
    P = theta.size
    alpha, rho, epsilon = settings[0], settings[1], settings[2]
    squares, moved = memory, block(memory, AT_MOVED, P)
    for k in range(batch):
        along, error = drawn(theta, buffer[rows[k]], direction)
        for i in side_by_side(P):
            g = -error * along[i]
            squares[i] = rho * squares[i] + (1.0 - rho) * g * g
            step = math.sqrt(moved[i] + epsilon) / math.sqrt(squares[i] + epsilon) * g
            moved[i] = rho * moved[i] + (1.0 - rho) * step * step
            theta[i] -= alpha * step


@inlined
def integral_cost(theta, memory, settings, buffer, rows, batch, direction):
    """(19); settings [Tp, Gamma, beta], memory `INTEGRALS`.

    theta moves with R and Q from before the row, then the row is added to them, as the article's index t implies.  So
    the slope for the next row is found in the same pass: R is read once a row.
    """
    for k in range(batch - 1):  # the hardware cannot predict random rows; the last one is the newest sample
        prefetch(buffer, rows[k], 0)
        prefetch(buffer, rows[k], theta.size + 1)
    P, period, gain, beta = theta.size, settings[0], settings[1], settings[2]
    keep, Q, slope = 1.0 - period * beta, block(memory, AT_Q, P), block(memory, AT_SLOPE, P)
    for k in range(batch):
        phi = buffer[rows[k]]
        enter_row(P, theta, memory, Q, slope, period * gain, keep, period * phi[P + 1], phi, phi[direction:])


@inlined
def enter_row(P, theta, R, Q, slope, step, keep, weight, phi, along):
    """Step along the slope, add a row of the buffer to R and Q, and compute the slope R theta + Q: (19), line by line.

    Two rows of R are processed at once, as each addition depends on the previous one of the same sum.  The step is part
    of the first pass over theta: a separate pass would store numbers that this one then waits for.
    """
    y, pairs = phi[P], P - P % 2
    for i in range(0, pairs, 2):
        row0, row1 = R[i * P :], R[i * P + P :]
        weight0, weight1 = weight * along[i], weight * along[i + 1]
        sum0, sum1 = keep * Q[i] - weight0 * y, keep * Q[i + 1] - weight1 * y
        Q[i], Q[i + 1] = sum0, sum1
        for j in range(P):
            entry0, entry1 = keep * row0[j] + weight0 * phi[j], keep * row1[j] + weight1 * phi[j]
            row0[j], row1[j] = entry0, entry1
            now = theta[j]
            if i == 0:
                now -= step * slope[j]
                theta[j] = now
            sum0 += entry0 * now
            sum1 += entry1 * now
        slope[i], slope[i + 1] = sum0, sum1
    for i in range(pairs, P):
        row, weighted = R[i * P :], weight * along[i]
        total = keep * Q[i] - weighted * y
        Q[i] = total
        for j in range(P):
            if i == 0:
                theta[j] -= step * slope[j]
            row[j] = keep * row[j] + weighted * phi[j]
            total += row[j] * theta[j]
        slope[i] = total


#: Code of each optimizer, its loop, the layout of its memory, the least number of its settings.
OPTIMIZERS = (
    (GRADIENT, gradient, NOTHING, 1),
    (ADAM, adam, MOMENTS, 4),
    (AMSGRAD, amsgrad, LARGEST_MOMENT, 4),
    (ADAGRAD, adagrad, SQUARES, 2),
    (RMSPROP, rmsprop, SQUARES, 3),
    (NADAM, nadam, MOMENTS, 4),
    (ADADELTA, adadelta, SQUARES_AND_STEPS, 3),
    (INTEGRAL_COST, integral_cost, INTEGRALS, 3),
)
MEMORY = {code: memory for code, _, memory, _ in OPTIMIZERS}


@inlined
def learn(algorithm, theta, memory, settings, buffer, rows, batch, direction, interval):
    """Let the optimizer with this code learn the first ``batch`` of the drawn rows; ``interval`` is not used."""
    for code, loop, _, _ in OPTIMIZERS:
        if algorithm == code:
            loop(theta, memory, settings, buffer, rows, batch, direction)
            return
