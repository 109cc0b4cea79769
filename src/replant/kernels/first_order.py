"""The article's optimizers and their relatives: each consumes the drawn rows of the buffer, one update a row.

Every kernel has the same signature:

    kernel(theta, memory, settings, buffer, rows)

``theta`` (P,) and ``memory`` are changed in place; a row of ``buffer`` is [phi (P entries), y, 1/m^2], all scaled, so
the gradient (16) of a row is g = -(y - theta' phi) / m^2 * phi.  ``settings`` holds the optimizer's numbers in the
order that its class in `replant.optimizers` gives them.
"""

import math

from replant.kernels.compiled import part


@part
def normalized_error(theta, buffer, row):
    """Return epsilon_I of (13): (y - theta' phi) / m^2."""
    P = theta.size
    prediction = 0.0
    for i in range(P):
        prediction += theta[i] * buffer[row, i]
    return (buffer[row, P] - prediction) * buffer[row, P + 1]


@part
def gradient(theta, memory, settings, buffer, rows):
    """(17): theta += Tp gamma epsilon_I phi; settings [Tp gamma]."""
    gain = settings[0]
    for row in rows:
        step = gain * normalized_error(theta, buffer, row)
        for i in range(theta.size):
            theta[i] += step * buffer[row, i]


@part
def adam(theta, memory, settings, buffer, rows):
    """Algorithm 1; settings [alpha, beta1, beta2, epsilon], memory [beta1^t, beta2^t, (m_i, v_i) ...]."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        memory[0] *= beta1
        memory[1] *= beta2
        correction1 = 1.0 - memory[0]
        correction2 = 1.0 - memory[1]
        for i in range(theta.size):
            g = -error * buffer[row, i]
            m = beta1 * memory[2 + 2 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 + 2 * i] + (1.0 - beta2) * g * g
            memory[2 + 2 * i] = m
            memory[3 + 2 * i] = v
            theta[i] -= alpha * (m / correction1) / (math.sqrt(v / correction2) + epsilon)


@part
def amsgrad(theta, memory, settings, buffer, rows):
    """Algorithm 2, no bias correction; settings [alpha, beta1, beta2, epsilon], memory [(m_i, v_i, max v_i) ...]."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        for i in range(theta.size):
            g = -error * buffer[row, i]
            m = beta1 * memory[3 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 * i + 1] + (1.0 - beta2) * g * g
            largest = max(memory[3 * i + 2], v)
            memory[3 * i] = m
            memory[3 * i + 1] = v
            memory[3 * i + 2] = largest
            theta[i] -= alpha * m / (math.sqrt(largest) + epsilon)


@part
def adagrad(theta, memory, settings, buffer, rows):
    """Sum of squared gradients; settings [alpha, epsilon], memory [sum g_i^2 ...]."""
    alpha, epsilon = settings[0], settings[1]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        for i in range(theta.size):
            g = -error * buffer[row, i]
            memory[i] += g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@part
def rmsprop(theta, memory, settings, buffer, rows):
    """Moving mean of squared gradients; settings [alpha, rho, epsilon], memory [v_i ...]."""
    alpha, rho, epsilon = settings[0], settings[1], settings[2]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        for i in range(theta.size):
            g = -error * buffer[row, i]
            memory[i] = rho * memory[i] + (1.0 - rho) * g * g
            theta[i] -= alpha * g / (math.sqrt(memory[i]) + epsilon)


@part
def nadam(theta, memory, settings, buffer, rows):
    """Adam with Nesterov's look-ahead; settings and memory as `adam`."""
    alpha, beta1, beta2, epsilon = settings[0], settings[1], settings[2], settings[3]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        memory[0] *= beta1
        memory[1] *= beta2
        correction_now = 1.0 - memory[0]
        correction_next = 1.0 - beta1 * memory[0]
        correction2 = 1.0 - memory[1]
        for i in range(theta.size):
            g = -error * buffer[row, i]
            m = beta1 * memory[2 + 2 * i] + (1.0 - beta1) * g
            v = beta2 * memory[3 + 2 * i] + (1.0 - beta2) * g * g
            memory[2 + 2 * i] = m
            memory[3 + 2 * i] = v
            ahead = beta1 * m / correction_next + (1.0 - beta1) * g / correction_now
            theta[i] -= alpha * ahead / (math.sqrt(v / correction2) + epsilon)


@part
def adadelta(theta, memory, settings, buffer, rows):
    """Steps in the unit of theta; settings [alpha, rho, epsilon], memory [(mean g_i^2, mean step_i^2) ...]."""
    alpha, rho, epsilon = settings[0], settings[1], settings[2]
    for row in rows:
        error = normalized_error(theta, buffer, row)
        for i in range(theta.size):
            g = -error * buffer[row, i]
            squares = rho * memory[2 * i] + (1.0 - rho) * g * g
            step = math.sqrt(memory[2 * i + 1] + epsilon) / math.sqrt(squares + epsilon) * g
            memory[2 * i] = squares
            memory[2 * i + 1] = rho * memory[2 * i + 1] + (1.0 - rho) * step * step
            theta[i] -= alpha * step


@part
def integral_cost(theta, memory, settings, buffer, rows):
    """(19); settings [Tp, Gamma, beta], memory [R (P, P), Q (P,)].

    theta moves along the R and Q held before the row, then the row enters them, as the article's index t says.
    """
    P = theta.size
    period, gain, beta = settings[0], settings[1], settings[2]
    keep = 1.0 - period * beta
    for row in rows:
        y = buffer[row, P]
        weight = period * buffer[row, P + 1]
        for i in range(P):
            slope = memory[P * P + i]
            for j in range(P):
                slope += memory[i * P + j] * theta[j]
            memory[P * P + P + i] = slope
        for i in range(P):
            theta[i] -= period * gain * memory[P * P + P + i]
            weighted = weight * buffer[row, i]
            for j in range(P):
                memory[i * P + j] = keep * memory[i * P + j] + weighted * buffer[row, j]
            memory[P * P + i] = keep * memory[P * P + i] - weighted * y
