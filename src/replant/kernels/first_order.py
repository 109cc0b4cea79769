"""The article's optimizers and their relatives: each consumes the drawn rows of the buffer, one update a row.

Every kernel has the same signature:

    kernel(theta, memory, settings, buffer, rows, direction)

``theta`` (P,) and ``memory`` are changed in place; a row of ``buffer`` is [phi (P entries), y, 1/m^2], all scaled, and
[zeta (P entries)] after it where there are instruments.  The gradient (16) of a row is g = -(y - theta' phi) / m^2 *
phi, or with zeta in the place of the last phi: ``direction`` is the column where that vector begins, 0 or P + 2.
``settings`` holds the optimizer's numbers in the order that its class in `replant.optimizers` gives them.
"""

import math

from replant.kernels.compiled import part, rare


@part
def normalized_error(theta, buffer, row):
    """Return epsilon_I of (13): (y - theta' phi) / m^2."""
    P, entries = theta.size, buffer[row]
    prediction = 0.0
    for i in range(theta.size):
        prediction += theta[i] * entries[i]
    return (entries[P] - prediction) * entries[P + 1]


@rare
def gradient(theta, memory, settings, buffer, rows, direction):
    """(17): theta += Tp gamma epsilon_I phi; settings [Tp gamma]."""
    gain = settings[0]
    for row in rows:
        step = gain * normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        for i in range(theta.size):
            theta[i] += step * along[i]


@rare
def adam(theta, memory, settings, buffer, rows, direction):
    """Algorithm 1; settings [alpha, beta1, beta2, epsilon], memory [beta1^t, beta2^t, (m_i, v_i) ...]."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        memory[0] *= beta1
        memory[1] *= beta2
        correction1 = 1.0 - memory[0]
        correction2 = 1.0 - memory[1]
        for i in range(theta.size):
            g = -error * along[i]
            m = beta1 * memory[2 + 2 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 + 2 * i] + (1.0 - beta2) * g * g
            memory[2 + 2 * i] = m
            memory[3 + 2 * i] = v
            theta[i] -= alpha * (m / correction1) / (math.sqrt(v / correction2) + epsilon)


@rare
def amsgrad(theta, memory, settings, buffer, rows, direction):
    """Algorithm 2, no bias correction; settings [alpha, beta1, beta2, epsilon], memory [(m_i, v_i, max v_i) ...]."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        for i in range(theta.size):
            g = -error * along[i]
            m = beta1 * memory[3 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 * i + 1] + (1.0 - beta2) * g * g
            largest = max(memory[3 * i + 2], v)
            memory[3 * i] = m
            memory[3 * i + 1] = v
            memory[3 * i + 2] = largest
            theta[i] -= alpha * m / (math.sqrt(largest) + epsilon)


@rare
def adagrad(theta, memory, settings, buffer, rows, direction):
    """Sum of squared gradients; settings [alpha, epsilon], memory [sum g_i^2 ...]."""
    alpha, epsilon = settings[0], settings[1]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        for i in range(theta.size):
            g = -error * along[i]
            memory[i] += g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@rare
def rmsprop(theta, memory, settings, buffer, rows, direction):
    """Moving mean of squared gradients; settings [alpha, rho, epsilon], memory [v_i ...]."""
    alpha, rho, epsilon = settings[0], settings[1], settings[2]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        for i in range(theta.size):
            g = -error * along[i]
            memory[i] = rho * memory[i] + (1.0 - rho) * g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@rare
def nadam(theta, memory, settings, buffer, rows, direction):
    """Adam with Nesterov's look-ahead; settings and memory as `adam`."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        memory[0] *= beta1
        memory[1] *= beta2
        correction_now = 1.0 - memory[0]
        correction_next = 1.0 - beta1 * memory[0]
        correction2 = 1.0 - memory[1]
        for i in range(theta.size):
            g = -error * along[i]
            m = beta1 * memory[2 + 2 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 + 2 * i] + (1.0 - beta2) * g * g
            memory[2 + 2 * i] = m
            memory[3 + 2 * i] = v
            ahead = beta1 * m / correction_next + (1.0 - beta1) * g / correction_now
            theta[i] -= alpha * ahead / (math.sqrt(v / correction2) + epsilon)


@rare
def adadelta(theta, memory, settings, buffer, rows, direction):
    """Steps in the unit of theta; settings [alpha, rho, epsilon], memory [(mean g_i^2, mean step_i^2) ...]."""
    alpha, rho, epsilon = settings[0], settings[1], settings[2]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        along = buffer[row, direction:]
        for i in range(theta.size):
            g = -error * along[i]
            squares = rho * memory[2 * i] + (1.0 - rho) * g * g
            step = math.sqrt(memory[2 * i + 1] + epsilon) / math.sqrt(squares + epsilon) * g
            memory[2 * i] = squares
            memory[2 * i + 1] = rho * memory[2 * i + 1] + (1.0 - rho) * step * step
            theta[i] -= alpha * step


@rare
def integral_cost(theta, memory, settings, buffer, rows, direction):
    """(19); settings [Tp, Gamma, beta], memory [R (P, P), Q (P,)].

    theta moves along the R and Q held before the row, then the row enters them, as the article's index t says.
    """
    P = theta.size
    period, gain, beta = settings[0], settings[1], settings[2]
    keep = 1.0 - period * beta
    Q, slope = memory[P * P : P * P + P], memory[P * P + P : P * P + 2 * P]
    for row in rows:
        phi, along = buffer[row], buffer[row, direction:]
        y = phi[P]
        weight = period * phi[P + 1]
        for i in range(theta.size):
            R = memory[i * P : i * P + P]
            total = Q[i]
            for j in range(theta.size):
                total += R[j] * theta[j]
            slope[i] = total
        for i in range(theta.size):
            theta[i] -= period * gain * slope[i]
            weighted = weight * along[i]
            R = memory[i * P : i * P + P]
            for j in range(theta.size):
                R[j] = keep * R[j] + weighted * phi[j]
            Q[i] = keep * Q[i] - weighted * y
