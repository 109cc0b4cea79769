"""Plants, inputs and identifiers that many tests share; every one follows from its seed."""

from __future__ import annotations

from typing import Any

import numpy as np

import replant as rp

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


def true_parameters(plant: rp.TransferFunction, zeros: int) -> np.ndarray:
    """The plant's coefficients in the order of ``Structure.names``."""
    return np.concatenate([plant.den[1:], plant.num[plant.num.size - zeros - 1 :]])


def identifier(optimizer: Any = rp.AMSGrad(step_size=0.01), **changes: Any) -> rp.Identifier:  # noqa: B008 - frozen
    """A small identifier that is ready at once: nothing is left to "auto"."""
    settings: dict[str, Any] = {
        "filter": rp.StateVariableFilter(cutoff=5.0),
        "scaling": None,
        "optimizer": optimizer,
        "replay": rp.Replay(capacity=50, batch_size=4, warmup=4),
    }
    structure, dt = changes.pop("structure", rp.Structure(poles=2, zeros=1)), changes.pop("dt", 0.05)
    return rp.Identifier(structure, dt, **{**settings, **changes})


def state(ident: rp.Identifier) -> dict[str, bytes]:
    """The whole running state, to the bit."""
    return {name: getattr(ident, name).tobytes() for name in ("_ints", "_reals", "_buffer")}
