"""Random rows: plants of two or three inputs, each with poles, zeros and a dead time of its own, and their records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import replant as rp
from campaign.plants import drawn_input, drawn_noise
from replant.numerics.arguments import FloatArray

ORDERS = (1, 1, 2, 2, 3)
MOST_POLES = 6  # of all branches
DECADES = 2.0  # between the slowest and the fastest pole of all branches, at the most
DAMPING = (0.1, 1.0)
FASTEST = (0.05, 0.5)  # magnitude of the fastest pole times the sampling time
DEAD_TIME = 30.0  # sampling times, at the most; half of the branches have none
SHARES = (-0.5, 0.5)  # of the branches in the output: the powers of ten of their sizes
SAMPLES = (2_000, 8_000)
DECIBELS = (0.0, 60.0)
INPUTS = ("PRBS", "steps", "noise", "multisine")
NOISES = ("none", "white", "AR(.9)", "drift")
CORRELATED = 0.3  # share of the records whose inputs are correlated
CORRELATIONS = (0.5, 0.95)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record of a known row.

    Attributes
    ----------
    number : int
        With the seed it makes the record.
    plant : tuple of TransferFunction
    dt : float
    u : (K, q) array
    y, clean : (K,) arrays
    what : str
        In words.
    """

    number: int
    plant: tuple[rp.TransferFunction, ...]
    dt: float
    u: FloatArray
    y: FloatArray
    clean: FloatArray
    what: str

    @property
    def asked(self) -> dict[str, tuple[int | float, ...]]:
        """The orders and dead times of the plant, as `fit` and `Identifier` take them."""
        return {
            "poles": tuple(g.den.size - 1 for g in self.plant),
            "zeros": tuple(g.num.size - 1 for g in self.plant),
            "delay": tuple(g.delay for g in self.plant),
        }

    @property
    def truth(self) -> FloatArray:
        """The coefficients (P,), in the order of a row."""
        return np.concatenate([np.append(g.den[1:], g.num) for g in self.plant])


def drawn(seed: int, number: int, inputs: int = 2) -> Experiment:
    """Return a record; the same for the same numbers.

    Examples
    --------
    >>> one, again = drawn(1, 7), drawn(1, 7)
    >>> one.plant == again.plant, bool((one.y == again.y).all())
    (True, True)
    """
    rng = np.random.default_rng([seed, number, inputs])
    plant, dt = drawn_plant(rng, inputs)
    samples = round(float(np.exp(rng.uniform(*np.log(SAMPLES)))))
    names = rng.choice(INPUTS, inputs)
    columns = [drawn_input(rng, str(name), g, dt, samples) for name, g in zip(names, plant, strict=True)]
    correlation = float(rng.uniform(*CORRELATIONS)) if rng.random() < CORRELATED else 0.0
    u = np.column_stack([each / each.std() for each in columns])
    u[:, 1:] = correlation * u[:, :1] + np.sqrt(1.0 - correlation**2) * u[:, 1:]
    plant, parts = scaled(rng, plant, u, dt)
    clean = parts.sum(axis=1)
    noise, decibels = str(rng.choice(NOISES)), float(rng.uniform(*DECIBELS))
    y = clean + clean.std() * 10.0 ** (-decibels / 20.0) * drawn_noise(rng, noise, samples) + 3.0
    noisy = "no noise" if noise == "none" else f"{noise} {decibels:.0f} dB"
    orders = ", ".join(f"{g.den.size - 1}/{g.num.size - 1}" for g in plant)
    what = f"poles/zeros {orders}, {', '.join(names)}, correlation {correlation:.2f}, {noisy}, {samples} samples"
    return Experiment(number, plant, dt, u, y, clean, what)


def drawn_plant(
    rng: np.random.Generator, inputs: int, orders: Sequence[int] = ORDERS, zeros: int = 1
) -> tuple[tuple[rp.TransferFunction, ...], float]:
    """Return stable plants, one for each input, of these orders and at most so many zeros; a sampling time for them."""
    slowest, plants, poles = 10.0 ** rng.uniform(-2.0, 2.0), [], list[complex]()
    for left in range(inputs, 0, -1):
        order = min(int(rng.choice(orders)), MOST_POLES - len(poles) - (left - 1))
        each: list[complex] = []
        while len(each) < order:
            w = slowest * float(10.0 ** rng.uniform(0.0, DECADES))
            if order - len(each) > 1 and rng.random() < 0.5:
                damping = float(np.exp(rng.uniform(*np.log(DAMPING))))
                pole = w * complex(-damping, np.sqrt(1.0 - damping**2))
                each += [pole, pole.conjugate()]
            else:
                each.append(complex(-w, 0.0))
        places = -slowest * 10.0 ** rng.uniform(0.0, DECADES, int(rng.integers(min(order, zeros + 1))))
        a, b = np.poly(each).real, np.atleast_1d(np.poly(places)).real
        plants.append((a[-1] / b[-1] * b, a))
        poles += each
    dt = rng.uniform(*FASTEST) / float(np.abs(poles).max())
    delays = rng.uniform(0.0, DEAD_TIME, inputs) * (rng.random(inputs) < 0.5) * dt
    return tuple(rp.TransferFunction(b, a, float(d)) for (b, a), d in zip(plants, delays, strict=True)), dt


def scaled(
    rng: np.random.Generator,
    plant: tuple[rp.TransferFunction, ...],
    u: FloatArray,
    dt: float,
    shares: tuple[float, float] = SHARES,
) -> tuple[tuple[rp.TransferFunction, ...], FloatArray]:
    """Return plants with gains by which each branch has a share in the output, and those parts (K, q)."""
    parts = np.column_stack([g.simulate(each.copy(), dt) for g, each in zip(plant, u.T, strict=True)])
    sizes = 10.0 ** rng.uniform(*shares, len(plant)) * rng.choice([-1.0, 1.0], len(plant)) / parts.std(axis=0)
    whole = (rp.TransferFunction(g.num * size, g.den, g.delay) for g, size in zip(plant, sizes, strict=True))
    return tuple(whole), parts * sizes
