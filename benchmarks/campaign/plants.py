"""Random plants and the records of random experiments on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.signals import chirp, multisine, prbs, random_steps

ORDERS = (1, 2, 3, 4, 5)
DECADES = 2.0  # between the slowest and the fastest pole, at the most
DAMPING = (0.02, 1.0)
GAINS = (-4.0, 4.0)  # of the static gain, as powers of ten
FASTEST = (0.05, 0.5)  # magnitude of the fastest pole times the sampling time
SAMPLES = (3_000, 30_000)
DECIBELS = (0.0, 60.0)
INPUTS = ("PRBS", "steps", "chirp", "noise", "multisine")
#: Noises by name; their share of the records is the same.
NOISES = ("none", "white", "AR(.9)", "drift")
RESTS = 0.15  # share of the records whose input comes to rest
REST = (0.1, 0.4)  # part of such a record at its end


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record of a known plant.

    Attributes
    ----------
    number : int
        With the campaign's seed it makes the record.
    plant : TransferFunction
    dt : float
    u, y, clean : (K,) arrays
        Input, output, and output without noise.
    input, noise : str
    decibels : float
        Of the output without noise over the noise.
    rests : bool
        Whether the input comes to rest before the end.
    """

    number: int
    plant: rp.TransferFunction
    dt: float
    u: FloatArray
    y: FloatArray
    clean: FloatArray
    input: str
    noise: str
    decibels: float
    rests: bool

    @property
    def structure(self) -> rp.Structure:
        """The plant's."""
        return structure_of(self.plant)

    @property
    def truth(self) -> FloatArray:
        """The plant's coefficients (P,), as the structure orders them."""
        return np.concatenate([self.plant.den[1:], self.plant.num])


def structure_of(plant: rp.TransferFunction) -> rp.Structure:
    """Return the structure that a plant has."""
    return rp.Structure(plant.den.size - 1, plant.num.size - 1)


def drawn(seed: int, number: int) -> Experiment:
    """Return a record of the campaign; the same for the same two numbers.

    Examples
    --------
    >>> one, again = drawn(1, 7), drawn(1, 7)
    >>> one.plant == again.plant, bool((one.y == again.y).all())
    (True, True)
    """
    rng = np.random.default_rng([seed, number])
    plant, dt = drawn_plant(rng)
    samples = round(_log_uniform(rng, *SAMPLES))
    name, rests = str(rng.choice(INPUTS)), bool(rng.random() < RESTS)
    u = drawn_input(rng, name, plant, dt, samples)
    if rests:
        u[-round(rng.uniform(*REST) * samples) :] = u[0]
    clean = plant.simulate(u, dt)
    noise, decibels = str(rng.choice(NOISES)), float(rng.uniform(*DECIBELS))
    y = clean + clean.std() * 10.0 ** (-decibels / 20.0) * drawn_noise(rng, noise, samples)
    return Experiment(number, plant, dt, u, y, clean, name, noise, decibels, rests)


def drawn_plant(rng: np.random.Generator) -> tuple[rp.TransferFunction, float]:
    """Return a stable plant and a sampling time for it."""
    order = int(rng.choice(ORDERS))
    slowest = 10.0 ** rng.uniform(-2.0, 2.0)

    def magnitude() -> float:
        return slowest * float(10.0 ** rng.uniform(0.0, DECADES))

    poles: list[complex] = []
    while len(poles) < order:
        w = magnitude()
        if order - len(poles) > 1 and rng.random() < 0.5:
            damping = _log_uniform(rng, *DAMPING)
            pole = w * complex(-damping, np.sqrt(1.0 - damping**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-w, 0.0))
    zeros = [-magnitude() if rng.random() < 0.75 else magnitude() for _ in range(int(rng.integers(order)))]
    a, b = np.poly(poles).real, np.atleast_1d(np.poly(zeros)).real
    gain = float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(*GAINS)
    return rp.TransferFunction(gain * a[-1] / b[-1] * b, a), rng.uniform(*FASTEST) / float(np.abs(poles).max())


def drawn_input(rng: np.random.Generator, name: str, plant: rp.TransferFunction, dt: float, samples: int) -> FloatArray:
    """Return an input (K,) by its name, of about one, that reaches the plant's poles."""
    poles = np.abs(np.roots(plant.den))
    slow, fast = float(poles.min()), float(min(poles.max(), 1.0 / dt))
    longest = max(min(round(2.0 / (slow * dt)), samples // 20), 2)
    shortest = max(min(round(0.5 / (fast * dt)), longest), 1)
    seed = int(rng.integers(1, 2**18))
    if name == "PRBS":
        return prbs(samples, bits=12, hold=round(_log_uniform(rng, shortest, longest)), seed=seed)
    if name == "steps":
        return random_steps(samples, shortest=shortest, longest=longest, low=-1.0, high=1.0, seed=seed)
    if name == "noise":
        return rng.standard_normal(samples)
    first = max(0.3 * slow, 10.0 / (samples * dt)) / (2.0 * np.pi)
    last = max(3.0 * fast / (2.0 * np.pi), 3.0 * first)
    last = min(last, 0.4 / dt)
    if name == "chirp":
        return chirp(samples, dt, first, last)
    return multisine(samples, dt, np.geomspace(first, last, 12), amplitude=0.4)


def drawn_noise(rng: np.random.Generator, name: str, samples: int) -> FloatArray:
    """Return noise (K,) of standard deviation one by its name; "drift" has a spectrum of 1/f."""
    from scipy.signal import lfilter

    white = rng.standard_normal(samples)
    if name == "none":
        return np.zeros(samples)
    if name == "AR(.9)":
        white = np.asarray(lfilter([1.0], [1.0, -0.9], rng.standard_normal(samples + 200)))[200:]
    elif name == "drift":
        spectrum = np.fft.rfft(white)
        spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
        spectrum[0] = 0.0
        white = np.fft.irfft(spectrum, samples)
    return white / white.std()


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
