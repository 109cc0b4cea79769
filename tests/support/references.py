"""Naive twins of the kernels: the article's equations written out with plain matrices, sharing no code with replant.

They work in extended precision (80 bits on x86), so that what a comparison shows is the rounding of the kernel.  The
parameters stay in the article's own form theta_lambda = [a - lambda, b] of (4), which replant never uses.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray
Update = Callable[..., Array]  # (theta, phi, y) -> theta; with instruments zeta comes after y

GOLDEN, MIX1, MIX2, WORD = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB, (1 << 64) - 1


def extended(value: Any) -> Array:
    return np.asarray(value, np.longdouble)


# --- random stream


def splitmix64(seed: int, position: int) -> int:
    """The position-th 64-bit word of the stream (Steele, Lea, Flood, 2014)."""
    z = (seed + (position + 1) * GOLDEN) & WORD
    z = (z ^ (z >> 30)) * MIX1 & WORD
    z = (z ^ (z >> 27)) * MIX2 & WORD
    return z ^ (z >> 31)


def draw_below(seed: int, position: int, bound: int) -> int:
    return (splitmix64(seed, position) >> 32) * bound >> 32


# --- filters


def exponential(matrix: Array) -> Array:
    """Taylor's series of the halved-down matrix, squared up again."""
    halvings = 12
    small = matrix / 2**halvings
    power = term = np.eye(matrix.shape[0], dtype=np.longdouble)
    for k in range(1, 30):
        term = term @ small / k
        power = power + term
    for _ in range(halvings):
        power = power @ power
    return power


def inverse(matrix: Array) -> Array:
    """The double-precision inverse, polished by Newton's iteration."""
    guess = extended(np.linalg.inv(matrix.astype(np.float64)))
    for _ in range(3):
        guess = guess @ (2 * np.eye(matrix.shape[0]) - matrix @ guess)
    return guess


def appendix_a(denominator: Any) -> tuple[Array, Array]:
    """F and l of (29)."""
    lambdas = extended(denominator)[1:]
    n = lambdas.size
    F = np.vstack([-lambdas, np.eye(n - 1, n)])
    return F, extended(np.eye(n)[0])


def straight_line(F: Array, column: Array, duration: Any) -> tuple[Array, Array, Array]:
    """Ad, B0, B1 of w(h) = Ad w(0) + B0 x(0) + B1 x(h), x straight in between.

    x and its slope are two more states of one exponential: x' = slope, slope' = 0.
    """
    n = column.size
    system = np.zeros((n + 2, n + 2), np.longdouble)
    system[:n, :n], system[:n, n], system[n, n + 1] = F, column, 1
    power = exponential(system * duration)
    value, slope = power[:n, n], power[:n, n + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        end = np.where(duration > 0, slope / duration, 0)
    return power[:n, :n], value - end, end


def bilinear(F: Array, column: Array, dt: Any, alpha: Any) -> tuple[Array, Array]:
    """Fd and ld of (7): s = (z - 1) / (alpha z + 1 - alpha) / dt put into w' = F w + l x, the input taken at t_k."""
    identity = np.eye(column.size)
    left = inverse(identity - alpha * dt * F)
    return left @ (identity + (1 - alpha) * dt * F), left @ (dt * column)


def filtered(x: Any, denominator: Any, dt: float, delay: float, hold: str, alpha: float = 0.5) -> Array:
    """The states (K, n) s^(n-1)/Lambda x .. 1/Lambda x at the sampling instants; x stood at x[0] before the record."""
    F, column = appendix_a(denominator)
    x, h = extended(x), extended(dt)
    samples = extended(delay) / h
    whole = int(np.floor(samples + 1e-12))
    part = max(samples - whole, extended(0))

    def at(index: int) -> Array:
        return x[max(0, index - whole)]

    w = np.zeros((x.size, column.size), np.longdouble)
    if hold == "gbt":
        Fd, ld = bilinear(F, column, h, extended(alpha))
        for k in range(x.size - 1):
            w[k + 1] = Fd @ w[k] + ld * ((1 - part) * at(k) + part * at(k - 1))
        return w
    early, late = straight_line(F, column, part * h), straight_line(F, column, (1 - part) * h)
    for k in range(1, x.size):
        older, old, new = at(k - 2), at(k - 1), at(k)
        if hold == "zoh":
            pieces = [(early, older, older), (late, old, old)]
        else:
            pieces = [(early, old - part * (old - older), old), (late, old, old + (1 - part) * (new - old))]
        state = w[k - 1]
        for (Ad, B0, B1), begin, end in pieces:
            state = Ad @ state + B0 * begin + B1 * end
        w[k] = state
    return w


def filtered_at(x: Any, t: Any, denominator: Any, delay: float, hold: str) -> Array:
    """As `filtered`, with time stamps t (K,): every piece between two corners of the delayed signal by itself."""
    F, column = appendix_a(denominator)
    x, t, delay = extended(x), extended(t), extended(delay)
    corners = t + delay

    def value(moment: Any, side: int) -> Array:
        """The delayed signal at a moment, seen from before (-1) or after (1) it where it jumps."""
        near = extended(1e-12)
        j = int(np.searchsorted(corners, moment + side * near, side="right")) - 1
        if j < 0:
            return x[0]
        if hold == "zoh" or j + 1 >= x.size:
            return x[j]
        return x[j] + (x[j + 1] - x[j]) * (moment - corners[j]) / (corners[j + 1] - corners[j])

    w = np.zeros((x.size, column.size), np.longdouble)
    for k in range(1, x.size):
        inside = corners[(corners > t[k - 1] + 1e-12) & (corners < t[k] - 1e-12)]
        moments = [t[k - 1], *inside, t[k]]
        state = w[k - 1]
        for begin, end in itertools.pairwise(moments):
            Ad, B0, B1 = straight_line(F, column, end - begin)
            state = Ad @ state + B0 * value(begin, 1) + B1 * value(end, -1)
        w[k] = state
    return w


# --- optimizers: each twin is made for P parameters, and is a rule theta, phi, y (, zeta) -> theta


def gradient_of(theta: Array, phi: Array, y: Array, normalize: bool, zeta: Array | None = None) -> Array:
    """(13) and (16); instruments stand where the regressor gives the direction, and its length."""
    along = phi if zeta is None else zeta
    m2 = 1 + along @ along if normalize else 1
    return -(y - theta @ phi) / m2 * along


def settings_of(optimizer: Any, *names: str) -> list[Array]:
    return [extended(getattr(optimizer, name)) for name in names]


def gradient(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """(17)."""
    (gain,) = settings_of(optimizer, "gain")
    return lambda theta, phi, y, zeta=None: theta - extended(dt) * gain * gradient_of(theta, phi, y, normalize, zeta)


def adam(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Algorithm 1."""
    alpha, beta1, beta2, epsilon = settings_of(optimizer, "step_size", "beta1", "beta2", "epsilon")
    m, v, t = extended(np.zeros(P)), extended(np.zeros(P)), 0

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal m, v, t
        t += 1
        g = gradient_of(theta, phi, y, normalize, zeta)
        m = beta1 * m + (1 - beta1) * g
        v = beta2 * v + (1 - beta2) * g**2
        m_hat, v_hat = m / (1 - beta1**t), v / (1 - beta2**t)
        return theta - alpha * m_hat / (np.sqrt(v_hat) + epsilon)

    return update


def amsgrad(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Algorithm 2, the first lines being those of Algorithm 1."""
    alpha, beta1, beta2, epsilon = settings_of(optimizer, "step_size", "beta1", "beta2", "epsilon")
    m, v, v_hat = extended(np.zeros(P)), extended(np.zeros(P)), extended(np.zeros(P))

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal m, v, v_hat
        g = gradient_of(theta, phi, y, normalize, zeta)
        m = beta1 * m + (1 - beta1) * g
        v = beta2 * v + (1 - beta2) * g**2
        v_hat = np.maximum(v_hat, v)
        return theta - alpha * m / (np.sqrt(v_hat) + epsilon)

    return update


def integral_cost(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """(19)."""
    gain, beta = settings_of(optimizer, "gain", "forgetting_rate")
    Tp, R, Q = extended(dt), extended(np.zeros((P, P))), extended(np.zeros(P))

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal R, Q
        along = phi if zeta is None else zeta
        m2 = 1 + along @ along if normalize else 1
        theta = theta - Tp * gain * (R @ theta + Q)
        R = R + Tp * (-beta * R + np.outer(along, phi) / m2)
        Q = Q + Tp * (-beta * Q - y * along / m2)
        return theta

    return update


def adagrad(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Duchi, Hazan and Singer (2011), diagonal form."""
    alpha, epsilon = settings_of(optimizer, "step_size", "epsilon")
    gradients: list[Array] = []

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        gradients.append(gradient_of(theta, phi, y, normalize, zeta))
        return theta - alpha * gradients[-1] / (np.sqrt(np.sum(np.square(gradients), axis=0)) + epsilon)

    return update


def rmsprop(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Tieleman and Hinton (2012)."""
    alpha, rho, epsilon = settings_of(optimizer, "step_size", "rho", "epsilon")
    v = extended(np.zeros(P))

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal v
        g = gradient_of(theta, phi, y, normalize, zeta)
        v = rho * v + (1 - rho) * g**2
        return theta - alpha * g / (np.sqrt(v) + epsilon)

    return update


def nadam(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Dozat (2016) with a constant momentum: the m_hat of Algorithm 1 looks one step ahead."""
    alpha, beta1, beta2, epsilon = settings_of(optimizer, "step_size", "beta1", "beta2", "epsilon")
    m, v, t = extended(np.zeros(P)), extended(np.zeros(P)), 0

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal m, v, t
        t += 1
        g = gradient_of(theta, phi, y, normalize, zeta)
        m = beta1 * m + (1 - beta1) * g
        v = beta2 * v + (1 - beta2) * g**2
        m_bar = beta1 * m / (1 - beta1 ** (t + 1)) + (1 - beta1) * g / (1 - beta1**t)
        return theta - alpha * m_bar / (np.sqrt(v / (1 - beta2**t)) + epsilon)

    return update


def adadelta(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Zeiler (2012), Algorithm 1, the step times alpha."""
    alpha, rho, epsilon = settings_of(optimizer, "step_size", "rho", "epsilon")
    squared_gradient, squared_step = extended(np.zeros(P)), extended(np.zeros(P))

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal squared_gradient, squared_step
        g = gradient_of(theta, phi, y, normalize, zeta)
        squared_gradient = rho * squared_gradient + (1 - rho) * g**2
        delta = -np.sqrt(squared_step + epsilon) / np.sqrt(squared_gradient + epsilon) * g
        squared_step = rho * squared_step + (1 - rho) * delta**2
        return theta + alpha * delta

    return update


def joseph(P: Array, K: Array, zeta: Array, noise: Array) -> Array:
    """The covariance after an observation along zeta with the gain K: a sum of two squares, whatever the rounding."""
    rest = np.eye(zeta.size) - np.outer(K, zeta)
    return rest @ P @ rest.T + noise * np.outer(K, K)


def unit_upper(P: Array) -> tuple[Array, Array]:
    """U, unit upper triangular, and the diagonal D with U D U' = P, from the last row up."""
    size = P.shape[0]
    U, D = extended(np.eye(size)), extended(np.zeros(size))
    for j in range(size - 1, -1, -1):
        D[j] = P[j, j] - sum((U[j, k] ** 2 * D[k] for k in range(j + 1, size)), extended(0))
        for i in range(j):
            U[i, j] = (P[i, j] - sum((U[i, k] * D[k] * U[j, k] for k in range(j + 1, size)), extended(0))) / D[j]
    return U, D


def recursive_least_squares(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """Young (2011), chapter 5, in Joseph's form; forgetting lets no entry of D outgrow the initial covariance."""
    start = extended(optimizer.initial_covariance)
    factor, time_constant = optimizer.forgetting_factor, optimizer.time_constant
    mu = extended(factor) if time_constant is None else np.exp(-extended(dt) / extended(time_constant))
    covariance = start * np.eye(P)

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal covariance
        along = phi if zeta is None else zeta
        K = covariance @ along / (mu + along @ covariance @ along)
        theta = theta + K * (y - theta @ phi)
        covariance = joseph(covariance, K, along, mu) / mu
        if mu < 1:
            U, D = unit_upper(covariance)
            covariance = U @ np.diag(np.minimum(D, start)) @ U.T
        return theta

    return update


def kalman_tracking(optimizer: Any, P: int, dt: float, normalize: bool) -> Update:
    """The Kalman filter of theta' = theta + w, in Joseph's form, with a tracked variance R of the residual."""
    h = extended(dt)
    walk = extended(optimizer.process_noise) * h * np.eye(P)
    share = min(h / extended(optimizer.noise_time_constant), extended(1))
    covariance, R = extended(optimizer.initial_covariance) * np.eye(P), extended(1)

    def update(theta: Array, phi: Array, y: Array, zeta: Array | None = None) -> Array:
        nonlocal covariance, R
        along = phi if zeta is None else zeta
        covariance = covariance + walk
        expected = R + along @ covariance @ along
        error = y - theta @ phi
        K = covariance @ along / expected
        covariance = joseph(covariance, K, along, R)
        R = R + share * (error**2 * R / expected - R)
        return theta + K * error

    return update


@dataclass(frozen=True)
class Twin:
    """A twin, and settings of the optimizer (by its constructor's names) under which the two are compared."""

    rule: Callable[[Any, int, float, bool], Update]
    settings: dict[str, float]


#: By the names of `replant.estimation.optimizers.OPTIMIZERS`; a new optimizer needs its line here.
TWINS = {
    "gradient": Twin(gradient, {"gain": 4.0}),
    "adam": Twin(adam, {"step_size": 0.02, "beta1": 0.85, "beta2": 0.99}),
    "amsgrad": Twin(amsgrad, {"step_size": 0.02, "beta1": 0.85, "beta2": 0.99}),
    "integral-cost": Twin(integral_cost, {"gain": 3.0, "forgetting_rate": 0.2}),
    "adagrad": Twin(adagrad, {"step_size": 0.05}),
    "rmsprop": Twin(rmsprop, {"step_size": 0.01, "rho": 0.8}),
    "nadam": Twin(nadam, {"step_size": 0.02, "beta1": 0.85, "beta2": 0.99}),
    "adadelta": Twin(adadelta, {"step_size": 2.0, "rho": 0.9, "epsilon": 1e-5}),
    "recursive-least-squares": Twin(recursive_least_squares, {"forgetting_factor": 0.97, "initial_covariance": 50.0}),
    "kalman-tracking": Twin(
        kalman_tracking, {"process_noise": 0.01, "noise_time_constant": 3.0, "initial_covariance": 50.0}
    ),
}


# --- the identification schema


def regressor(u: Any, y: Any, *, structure: Any, state_filter: Any, dt: float) -> Array:
    """phi_uy (K, P) of (28), with the constant of (24) for a bias."""
    n, denominator = structure.poles, state_filter.polynomial(structure.poles)
    exact = state_filter.method == "exact"
    output_hold, input_hold = ("foh", state_filter.input_hold) if exact else ("gbt", "gbt")
    phi_y = -filtered(y, denominator, dt, 0.0, output_hold, state_filter.alpha)
    phi_u = filtered(u, denominator, dt, structure.delay, input_hold, state_filter.alpha)[:, n - structure.zeros - 1 :]
    return np.hstack([phi_y, phi_u] + ([np.ones((len(u), 1))] if structure.bias else []))


def identify(
    u: Any,
    y: Any,
    *,
    structure: Any,
    state_filter: Any,
    scaling: Any,
    update: Update,
    replay: Any,
    normalize: bool = True,
    dt: float,
) -> tuple[Array, Array]:
    """The physical parameters (K, P) after each sample and the a-priori output errors (K,): (10)-(14), Algorithm 3."""
    phi_uy = regressor(u, y, structure=structure, state_filter=state_filter, dt=dt)
    lambdas = np.zeros(structure.size, np.longdouble)
    lambdas[: structure.poles] = extended(state_filter.polynomial(structure.poles))[1:]
    sigma_y, sigma = extended(scaling.output), extended(scaling.regressor)
    scaled_y, scaled_phi = extended(y) / sigma_y, phi_uy / sigma
    theta = -lambdas * sigma / sigma_y  # a = b = 0
    buffer: list[int] = []  # which sample lies in which row
    drawn = 0
    parameters, errors = np.zeros_like(phi_uy), np.zeros_like(scaled_y)
    for k in range(len(u)):
        errors[k] = sigma_y * (scaled_y[k] - theta @ scaled_phi[k])
        batch = [k]
        if replay is not None:
            if len(buffer) < replay.capacity:
                buffer.append(k)
            else:
                buffer[k % replay.capacity] = k
            if len(buffer) > replay.warmup or len(buffer) == replay.capacity:
                others = range(drawn, drawn + replay.batch_size - 1)
                batch = [buffer[draw_below(replay.seed, i, len(buffer))] for i in others] + [k]
                drawn += len(others)
        for row in batch:
            theta = update(theta, scaled_phi[row], scaled_y[row])
        parameters[k] = theta * sigma_y / sigma + lambdas
    return parameters, errors


# --- the path of an estimate


def kept_samples(samples: int, room: int) -> list[int]:
    """Of the samples 1, 2 .. those that are kept: every one, and each time that the room is full every second."""
    kept, step = [], 1
    for k in range(1, samples + 1):
        if k % step == 0:
            kept.append(k)
        if len(kept) == room:
            kept, step = kept[1::2], 2 * step
    return kept


# --- the guard


def gate(state: Any, error: float, zeta: Array, covariance: Array, noise: float) -> tuple[bool, float]:
    """Whether an a-priori error is an outlier, and its variance over the residual's; ``state`` tells what is usual."""
    ratio = 1.0 + zeta @ extended(covariance) @ zeta / noise
    moves = (1.0 - 1.0 / ratio) * error  # by so much learning it would move the modelled output
    usual = max(state["spread"], state["usual"])
    harmful = error**2 > state["peak"] or moves**2 > 0.02**2 * state["peak"]
    return bool(harmful and abs(error) > 8.0 * np.sqrt(usual * ratio)), float(ratio)
