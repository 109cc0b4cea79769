"""Records as loggers in the field give them: short, of smooth inputs, of coarse sensors, with holes; in open loop.

The plant is lightly damped and has zeros, and is not at rest when the record begins.  Its input is one that a line of
its own past predicts nearly: noise of long memory, a few lines, ramps, slow sines.  What the logger lost is known here:
the whole input, also before the record and in lost rows, and the output without noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import replant as rp
from campaign.exact import Clock, forced, poles_apart
from campaign.plants import structure_of
from replant.numerics.arguments import BoolArray, FloatArray

ORDERS = {1: 0.15, 2: 0.4, 3: 0.25, 4: 0.2}  # their shares
DAMPING = (0.01, 0.3)
SPREAD = 8.0  # between the slowest and the fastest pole, at the most
FASTEST = (0.05, 0.6)  # magnitude of the fastest pole times the sampling time
SAMPLES = (300, 2000)
LEAST_SPAN = 10.0  # of the record, in time constants of the slowest pole
DECIBELS = (10.0, 30.0)
INPUTS = ("long memory", "few lines", "ramps", "slow sines")
NOISES = ("white", "AR(.9)", "drift")
BITS = (8, 12)
MISSING = (0.05, 0.2)
JITTER = (0.05, 0.3)  # largest, in sampling times
#: Shares of the records that have it.
QUANTISED, MISSES, JITTERS, LOSES, HALF = 0.6, 0.5, 0.4, 0.35, 0.2
LEAST_MEMORY = 10.0  # of the input "long memory", in samples
BEFORE = 400  # samples before the record
KICKED = 60  # the last of them, in which the plant is pushed


@dataclass(frozen=True, eq=False)
class FieldRecord:
    """A record of a known plant, and what its logger does not know.

    Attributes
    ----------
    number : int
        With the campaign's seed it makes the record.
    plant : TransferFunction
        Its dead time included.
    dt : float
    u, y : (K,) arrays
        As they were logged; a missing output is NaN.
    t : (K,) array or None
        Time stamps in s; None where the clock is regular and no row is lost.
    clean : (K,) array
        Output without noise, also where it is missing.
    all_t, all_u : (N,) arrays
        The input that the plant had, beginning before the record, lost rows included.
    input, noise : str
    decibels : float
        Of the output without noise over the noise.
    bits : int
        Of the sensor; 0 where it is not quantised.
    missing, jitter, lost : float
        Share of missing outputs; largest jitter in sampling times; share of lost rows.
    damping : float
        The least of the plant's poles.
    half : bool
        Whether the dead time lies between two samples.
    """

    number: int
    plant: rp.TransferFunction
    dt: float
    u: FloatArray
    y: FloatArray
    t: FloatArray | None
    clean: FloatArray
    all_t: FloatArray
    all_u: FloatArray
    input: str
    noise: str
    decibels: float
    bits: int
    missing: float
    jitter: float
    lost: float
    damping: float
    half: bool

    @property
    def structure(self) -> rp.Structure:
        """The plant's, without its dead time."""
        return structure_of(self.plant)

    @property
    def stamps(self) -> FloatArray:
        """The time (K,) of each row, in s."""
        return np.arange(self.u.size) * self.dt if self.t is None else self.t

    @property
    def what(self) -> str:
        """The record in words."""
        words = [
            f"{self.structure.poles} poles, {self.structure.zeros} zeros, damping {self.damping:.2g}",
            f"dead time {self.plant.delay / self.dt:g} samples, {self.input}, {self.noise} {self.decibels:.0f} dB",
            f"{self.u.size} rows",
        ]
        words += [f"{self.bits} bits"] if self.bits else []
        words += [f"{100.0 * self.missing:.0f} % missing"] if self.missing else []
        words += [f"jitter {self.jitter:.2f}"] if self.jitter else []
        words += [f"{100.0 * self.lost:.1f} % of the rows lost"] if self.lost else []
        return ", ".join(words)


def drawn(seed: int, number: int) -> FieldRecord:
    """Return a record of the family; the same for the same two numbers."""
    rng = np.random.default_rng([seed, 5, number])
    samples = round(_log_uniform(rng, *SAMPLES))
    den, num, dt = drawn_plant(rng, samples)
    half = bool(rng.random() < HALF)
    delay = (int(rng.integers(0, 5)) + (0.5 if half else 0.0)) * dt
    plant = rp.TransferFunction(num, den, delay)
    name = str(rng.choice(INPUTS))
    v = drawn_input(rng, name, np.abs(np.roots(den)) * dt, BEFORE + samples)
    v[BEFORE - int(rng.integers(10, KICKED)) :][:5] += rng.uniform(-3.0, 3.0) * v.std()  # it is pushed
    jitter = float(rng.uniform(*JITTER)) if rng.random() < JITTERS else 0.0
    all_t = (np.arange(v.size) - BEFORE + jitter * rng.uniform(-1.0, 1.0, v.size)) * dt
    clock = Clock.of(all_t, v, delay, all_t[BEFORE:])
    clean = forced(poles_apart(np.roots(den)), num.size - 1, clock) @ num
    noise, decibels = str(rng.choice(NOISES)), float(rng.uniform(*DECIBELS))
    y = clean + clean.std() * 10.0 ** (-decibels / 20.0) * drawn_noise(rng, noise, samples)
    y = y + rng.normal(0.0, 3.0) * clean.std()
    bits = int(rng.integers(BITS[0], BITS[1] + 1)) if rng.random() < QUANTISED else 0
    y = quantised(rng, y, bits) if bits else y
    missing = float(rng.uniform(*MISSING)) if rng.random() < MISSES else 0.0
    y[holes(rng, samples, missing)] = np.nan
    kept = ~lost_rows(rng, samples) if rng.random() < LOSES else np.ones(samples, bool)
    u = v + rng.normal(0.0, 3.0) * v.std()
    stamped = bool(jitter) or not kept.all()
    poles = np.roots(den)
    damping = float((-poles.real / np.abs(poles)).min())
    return FieldRecord(
        number, plant, dt, u[BEFORE:][kept], y[kept], all_t[BEFORE:][kept] if stamped else None, clean[kept], all_t, v,
        name, noise, decibels, bits, missing, jitter, float(1.0 - kept.mean()), damping, half,
    )  # fmt: skip


def drawn_plant(rng: np.random.Generator, samples: int) -> tuple[FloatArray, FloatArray, float]:
    """Return denominator and numerator of a stable plant, and a sampling time for it."""
    order = int(rng.choice(list(ORDERS), p=list(ORDERS.values())))
    slowest, dt = 1.0, 0.0
    while slowest * dt * samples < LEAST_SPAN:
        slowest, spread = 10.0 ** rng.uniform(-2.0, 2.0), _log_uniform(rng, 1.0, SPREAD)
        dt = rng.uniform(*FASTEST) / (slowest * spread)

    def magnitude() -> float:
        return slowest * _log_uniform(rng, 1.0, spread)

    poles: list[complex] = []
    while len(poles) < order:
        if order - len(poles) > 1 and rng.random() < 0.8:
            poles += _pair(magnitude(), _log_uniform(rng, *DAMPING))
        else:
            poles.append(complex(-magnitude(), 0.0))
    zeros: list[complex] = []
    wanted = int(rng.integers(order))
    while len(zeros) < wanted:
        if wanted - len(zeros) > 1 and rng.random() < 0.6:
            zeros += _pair(magnitude(), _log_uniform(rng, *DAMPING))
        else:
            zeros.append(complex(-magnitude() if rng.random() < 0.75 else magnitude(), 0.0))
    den, num = np.poly(poles).real, np.atleast_1d(np.poly(zeros)).real
    gain = float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(-2.0, 2.0)
    return den, gain * den[-1] / num[-1] * num, dt


def drawn_input(rng: np.random.Generator, name: str, sizes: FloatArray, samples: int) -> FloatArray:
    """Return a smooth input (N,) by its name, for poles of these magnitudes, in rad a sample."""
    slow, fast, k = float(sizes.min()), float(sizes.max()), np.arange(samples)
    lowest = 4.0 * np.pi / (samples - BEFORE)  # two periods in the record
    if name == "long memory":
        from scipy.signal import lfilter

        pole = np.exp(-min(slow * _log_uniform(rng, 0.3, 3.0), 1.0 / LEAST_MEMORY))
        u = np.asarray(lfilter([1.0], np.poly([pole, pole]), rng.standard_normal(samples + 2000)))[2000:]
    elif name == "ramps":
        longest = max(samples // 12, 6)
        shortest = min(max(1.0 / slow, 5.0), longest / 2.0)
        knots = np.cumsum([0.0, *rng.uniform(shortest, min(6.0 * shortest, longest), samples)])
        knots = knots[: int(np.searchsorted(knots, samples)) + 1]
        levels = rng.uniform(-1.0, 1.0, knots.size)
        plateaus = 1 + np.flatnonzero(rng.random(knots.size - 1) < 0.3)
        levels[plateaus] = levels[plateaus - 1]
        u = np.interp(k, knots, levels)
    else:
        few = name == "few lines"
        low, high = (max(0.3 * slow, lowest), 1.5 * fast) if few else (lowest, 0.8 * slow)
        lines = int(rng.integers(2, 6) if few else rng.integers(3, 6))
        frequencies = [_log_uniform(rng, low, max(high, 2.0 * low)) for _ in range(lines)]
        u = np.sum([rng.uniform(0.3, 1.0) * np.sin(w * k + rng.uniform(0.0, 2.0 * np.pi)) for w in frequencies], axis=0)
    return np.asarray(u / u.std() * 10.0 ** rng.uniform(-1.0, 1.0))


def drawn_noise(rng: np.random.Generator, name: str, samples: int) -> FloatArray:
    """Return noise (K,) of standard deviation one by its name; "drift" is a random walk."""
    from scipy.signal import lfilter

    noise = rng.standard_normal(samples + 200)
    if name == "AR(.9)":
        noise = np.asarray(lfilter([1.0], [1.0, -0.9], noise))
    elif name == "drift":
        noise = np.cumsum(noise)
    noise = noise[200:] - noise[200:].mean()
    return np.asarray(noise / noise.std())


def quantised(rng: np.random.Generator, y: FloatArray, bits: int) -> FloatArray:
    """Return an output as a sensor of so many bits reads it, whose range is one to two times what is used."""
    step = float(np.ptp(y)) * rng.uniform(1.0, 2.0) / 2**bits
    return np.asarray(step * np.round(y / step))


def holes(rng: np.random.Generator, samples: int, share: float) -> BoolArray:
    """Return which outputs (K,) are missing: one by one, or several in a row."""
    missing, wanted = np.zeros(samples, bool), int(share * samples)
    longest = 1 if rng.random() < 0.5 else 10
    while (left := wanted - int(missing.sum())) > 0:
        begin = int(rng.integers(samples))
        missing[begin : begin + min(int(rng.integers(1, longest + 1)), left)] = True
    return missing


def lost_rows(rng: np.random.Generator, samples: int) -> BoolArray:
    """Return which rows (K,) are lost: single ones here and there, or some stretches; never the first or the last."""
    lost = np.zeros(samples, bool)
    if rng.random() < 0.5:
        lost = rng.random(samples) < rng.uniform(0.01, 0.05)
    else:
        for _ in range(int(rng.integers(1, 5))):
            begin = int(rng.integers(1, samples - 1))
            lost[begin : begin + int(rng.integers(2, 31))] = True
    lost[[0, 1, -2, -1]] = False
    return lost


def _pair(size: float, damping: float) -> list[complex]:
    root = size * complex(-damping, np.sqrt(1.0 - damping**2))
    return [root, root.conjugate()]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
