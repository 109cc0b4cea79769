"""Controlled motor: a motor under a PI controller, with a set-point that steps and a load that nobody measures."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from replant.arguments import FloatArray
from replant.model import state_space
from replant.rigs import Rig, motor_rig
from replant.signals import random_steps, white_noise

BLOCK = 1 << 12
"""Samples simulated at once: each block has its own set-point, load and noise, a function of the seed and its number
alone [samples].
"""

PROPORTIONAL = 0.3
"""Proportional gain of the controller [V per rad/s].
Derivation: with the integral part it cancels the slow pole; the loop's poles are then at -7 and -43 rad/s.
"""
INTEGRAL = 0.6  # integral gain of the controller [V per rad]
LOWEST, HIGHEST = 30.0, 70.0  # range of the set-point [rad/s]
SHORTEST, LONGEST = 50, 400  # shortest and longest step of the set-point [samples]
DITHER = 1.0  # dither of the set-point, up and down: it excites the loop while the set-point stands still [rad/s]
DITHER_HOLD = 5  # samples that each value of it lasts [samples]
LOAD = 0.4  # standard deviation of the load, as the voltage that would do the same [V]
LOAD_TIME = 0.5  # time constant with which the load wanders [s]


def controlled(seed: int, skip: int = 0) -> Iterator[tuple[int, FloatArray, FloatArray, FloatArray]]:
    """Yield blocks of `BLOCK` samples: the number of the first one, voltage in V, speed and reference in rad/s.

    At each sample the controller reads the speed and sets the voltage, which the motor gets until the next one:

        u_k = 0.3 (r_k - y_k) + integral of 0.6 (r - y),    y = G(s) (u + load) + noise.

    The first ``skip`` blocks are simulated but not yielded: the motor starts from rest at sample 0, so a block is the
    same wherever the iteration begins.

    Examples
    --------
    >>> first, u, y, r = next(controlled(seed=0))
    >>> first, u.size == y.size == r.size == BLOCK
    (0, True)
    >>> bool(abs(y[2000:] - r[2000:]).mean() < 10.0)  # the speed follows the set-point
    True
    """
    rig, number = motor_rig(), 0
    state = np.zeros(4)
    while True:
        draw = int(np.random.SeedSequence([seed, number, 1]).generate_state(1, np.uint64)[0])
        r = set_point(BLOCK, draw)
        u, y, state = _one_block(rig, r, state, draw)
        if number >= skip:
            yield number * BLOCK, u, y, r
        number += 1


def set_point(samples: int, seed: int) -> FloatArray:
    """Return a reference (K,) in rad/s: steps of 0.5 to 4 s between 30 and 70 rad/s, with a dither added.

    Examples
    --------
    >>> r = set_point(1000, seed=0)
    >>> bool((r >= 29.0).all() and (r <= 71.0).all())
    True
    """
    steps = random_steps(samples, shortest=SHORTEST, longest=LONGEST, low=LOWEST, high=HIGHEST, seed=seed)
    signs = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], -(-samples // DITHER_HOLD))
    return steps + DITHER * np.repeat(signs, DITHER_HOLD)[:samples]


def _one_block(rig: Rig, r: FloatArray, state: FloatArray, draw: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return voltage and speed (K,) under the reference ``r`` (K,), and the state after it.

    The state is that of the motor (2,), the load and the integral.
    """
    model = state_space.companion(rig.plant.den)
    transition, column, _ = state_space.exact(model.matrix, model.column, rig.dt, "zoh")
    (a, b), (c, d) = transition.tolist()
    to_first, to_second = column.tolist()
    gain = float(rig.plant.num[0] / model.scale[-1])
    keep = math.exp(-rig.dt / LOAD_TIME)
    kicks = white_noise(r.size, LOAD * math.sqrt(1.0 - keep * keep), draw + 1).tolist()
    first, second, load, integral = state.tolist()
    voltages, speeds = [], []
    for set_to, noise, kick in zip(r.tolist(), white_noise(r.size, rig.noise, draw + 2).tolist(), kicks, strict=True):
        speed = gain * second + noise
        voltage = PROPORTIONAL * (set_to - speed) + integral
        voltages.append(voltage)
        speeds.append(speed)
        integral += INTEGRAL * rig.dt * (set_to - speed)
        acts = voltage + load
        first, second = a * first + b * second + to_first * acts, c * first + d * second + to_second * acts
        load = keep * load + kick
    return np.array(voltages), np.array(speeds), np.array([first, second, load, integral])
