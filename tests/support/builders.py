"""Plants, inputs and identifiers that many tests share; every one follows from its seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

import replant as rp
from replant.estimation.engine.state import State
from replant.estimation.optimizers import OPTIMIZERS
from replant.kernels.schema import STATE_ARRAYS
from replant.online.runs.result import Result
from support.cases import every

#: The article's G1 and G2, (20) and (22).
G1 = rp.TransferFunction([1.25], [1.0, 0.5])
G2 = rp.TransferFunction([7.5, -12.5], [1.0, 15.0, 100.0])


class Thing:
    """An object that is nothing numeric; it prints alike in every process, as names of tests must."""

    def __repr__(self) -> str:
        return "Thing()"


def random_plant(seed: int, poles: int, zeros: int = 0, delay: float = 0.0) -> rp.TransferFunction:
    """A stable plant: poles of 0.5 to 3 rad/s, damped by 0.3 at least, zeros alike, a static gain of 0.5 to 2."""
    generator = np.random.default_rng(seed)
    den, num = np.ones(1), np.ones(1)
    while den.size <= poles:
        speed = generator.uniform(0.5, 3.0)
        if poles - den.size >= 1 and generator.random() < 0.5:
            den = np.polymul(den, [1.0, 2 * generator.uniform(0.3, 1.0) * speed, speed**2])
        else:
            den = np.polymul(den, [1.0, speed])
    for _ in range(zeros):
        num = np.polymul(num, [1.0, generator.choice([-1.0, 1.0]) * generator.uniform(1.0, 4.0)])
    return rp.TransferFunction(num * generator.uniform(0.5, 2.0) * den[-1] / num[-1], den, delay)


def binary(seed: int, samples: int, hold: int = 1) -> np.ndarray:
    """A random binary input of -1 and 1, each value held for ``hold`` samples, at rest for the first of them."""
    values = np.random.default_rng(seed).choice([-1.0, 1.0], -(-samples // hold))
    values[0] = 0.0
    return np.repeat(values, hold)[:samples]


def record(
    plant: rp.TransferFunction, seed: int, samples: int, dt: float, *, hold: int = 5, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """A binary input and the plant's output, with white noise of standard deviation ``noise``."""
    u = binary(seed, samples, hold)
    return u, plant.simulate(u, dt) + noise * np.random.default_rng(seed + 1).standard_normal(samples)


def irregular_record(
    plant: rp.TransferFunction,
    seed: int,
    samples: int,
    dt: float,
    *,
    jitter: float = 0.2,
    dropped: float = 0.0,
    hold: int = 5,
    input_hold: str = "zoh",
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input, output and stamps of a clock that jitters by a part of dt; the input changes at stamps alone.

    Exact: simulated on a regular grid fifty times as fine, of which the stamps are a choice.  A part of the samples is
    ``dropped`` afterwards.
    """
    fine, generator = 50, np.random.default_rng([seed, 1])
    at = fine * np.arange(samples) + generator.integers(-int(jitter * fine / 2), int(jitter * fine / 2) + 1, samples)
    at -= at[0]
    u, grid = binary(seed, samples, hold), np.arange(at[-1] + 1)
    held = u[np.searchsorted(at, grid, side="right") - 1]
    between = held if input_hold == "zoh" else np.interp(grid, at, u)
    y = plant.simulate(between, dt / fine, input_hold=input_hold)[at]
    kept = np.append(True, generator.random(samples - 1) >= dropped)
    return u[kept], y[kept], at[kept] * dt / fine


def true_parameters(plant: rp.TransferFunction, zeros: int) -> np.ndarray:
    """The plant's coefficients in the order of ``Structure.names``."""
    return np.concatenate([plant.den[1:], plant.num[plant.num.size - zeros - 1 :]])


def identifier(optimizer: Any = rp.AMSGrad(step_size=0.01), **changes: Any) -> rp.Identifier:  # noqa: B008 - frozen
    """A small identifier that is ready at once: nothing is left to "auto"; replay where the optimizer can have it."""
    kind = OPTIMIZERS.get(optimizer) if isinstance(optimizer, str) else optimizer
    keeps_covariance = getattr(kind, "keeps_covariance", False)
    settings: dict[str, Any] = {
        "filter": rp.StateVariableFilter(cutoff=5.0),
        "scaling": None,
        "optimizer": optimizer,
        "replay": None if keeps_covariance else rp.Replay(capacity=50, batch_size=4, warmup=4),
        "instruments": False,
    }
    structure, dt = changes.pop("structure", rp.Structure(poles=2, zeros=1)), changes.pop("dt", 0.05)
    return rp.Identifier(structure, dt, **{**settings, **changes})


def engine_state(ident: rp.Identifier) -> State:
    """The arrays that the kernels work on; identifiers keep them private, and tests get at them here alone."""
    return ident._state


def state(ident: rp.Identifier) -> dict[str, bytes]:
    """The whole running state, to the bit, but for work space: it is written anew before it is read."""
    arrays = engine_state(ident.clone())
    if len(arrays.reals):
        arrays.backup[:] = 0.0
        arrays.work[:] = 0.0
    return {name: getattr(arrays, name).tobytes() for name in STATE_ARRAYS}


def is_finite(arrays: State) -> bool:
    """Whether every number of a running state is finite, but for the times that may be infinite: "never"."""
    reals = np.delete(arrays.reals, [State.ready_at.index, State.longest_gap.index])
    return all(np.isfinite(array).all() for array in (reals, arrays.banks, arrays.buffer, arrays.recent))


def with_and_without(replay: rp.Replay) -> Callable[[Any], Any]:
    """Every optimizer alone, and with a buffer those that can have one."""
    pairs: list[tuple[str, rp.Replay | None]] = [(name, None) for name in OPTIMIZERS]
    pairs += [(name, replay) for name, kind in OPTIMIZERS.items() if not kind.keeps_covariance]
    return every(("name", "replay"), pairs, ids=[f"{name}-{'replay' if buffer else 'plain'}" for name, buffer in pairs])


DT = 0.05  # s, of the plants below


def two_modes(frequency: float, damping: float) -> np.ndarray:
    return np.array([1.0, 2 * damping * frequency, frequency**2])


#: Structure and plant, each with what makes it awkward.
AWKWARD = {
    **{f"order {n}": (rp.Structure(n, n - 1), random_plant(40 + n, n, n - 1)) for n in range(1, 5)},
    "order 4, no zeros": (rp.Structure(4), random_plant(50, 4)),
    "non-minimum phase": (rp.Structure(2, 1), rp.TransferFunction([-1.0, 3.0], two_modes(2.0, 0.4))),
    "two zeros on the right": (rp.Structure(4, 2), rp.TransferFunction([1.0, -3.0, 5.0], random_plant(7, 4).den)),
    "integrator": (rp.Structure(2), rp.TransferFunction([1.5], [1.0, 2.0, 0.0])),
    "damping 0.001": (rp.Structure(2, 1), rp.TransferFunction([0.3, 4.0], two_modes(2.0, 0.001))),
    "slow and lightly damped": (
        rp.Structure(4, 1),
        rp.TransferFunction([-6.0, 3.0], np.polymul(two_modes(0.5, 0.8), two_modes(4.0, 0.01))),
    ),
    "feedthrough": (rp.Structure(2, 2, feedthrough=True), rp.TransferFunction([2.0, 1.0, 3.0], two_modes(2.0, 0.5))),
    "static gain and a lag": (rp.Structure(1, 1, feedthrough=True), rp.TransferFunction([0.5, 3.0], [1.0, 1.0])),
    "delay of 3 samples": (rp.Structure(2, delay=3 * DT), rp.TransferFunction([4.0], two_modes(2.0, 0.5), 3 * DT)),
    "delay of 2.37 samples": (
        rp.Structure(2, 1, delay=2.37 * DT),
        rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5), 2.37 * DT),
    ),
}


def with_model(result: Result, **changes: Any) -> Result:
    """The same result with some fields of its model changed."""
    return dataclasses.replace(result, model=dataclasses.replace(result.model, **changes))
