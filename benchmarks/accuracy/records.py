"""The records: known plants, inputs that an engineer would choose, noise from the run's own seed.

A run is a number: all that is random in it comes from `numpy.random.default_rng(run)`, so run 7 is the same for every
method, on every machine, however many processes share the work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.signals import prbs

#: Scenario A, with two real poles.
PLANT_A = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
#: Scenario B, the Rao-Garnier system: a slow and a fast, lightly damped pair, and a zero in the right half plane.
PLANT_B = rp.TransferFunction([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0])


@dataclass(frozen=True, eq=False)
class Measured:
    """A record as an estimator gets it.

    Attributes
    ----------
    u, y : (K,) arrays
    t : (K,) array or None
        Time stamps, where they are given.
    truth : (K, P) array or None
        The parameters at each sample, where they change.
    preprocess : Preprocess
        Input map and working point, where they are known.
    r : (K,) array or None
        The controller's reference, where there is one.
    """

    u: FloatArray
    y: FloatArray
    t: FloatArray | None = None
    truth: FloatArray | None = None
    preprocess: rp.Preprocess = rp.Preprocess()  # noqa: RUF009 - frozen
    r: FloatArray | None = None


def random_binary(generator: np.random.Generator, samples: int, hold: int) -> FloatArray:
    """Return -1 or 1 with equal chance (K,), drawn anew every ``hold`` samples."""
    values = generator.choice([-1.0, 1.0], -(-samples // hold))
    return np.repeat(values, hold)[:samples]


def noise(generator: np.random.Generator, clean: FloatArray, decibels: float, colour: float = 0.0) -> FloatArray:
    """Return normal noise (K,) whose variance lies ``decibels`` below that of ``clean``.

    ``colour`` is the pole of a first-order autoregression that makes it, 0 for white noise.
    """
    from scipy.signal import lfilter

    settle = 0 if colour == 0.0 else 600
    drawn = generator.standard_normal(clean.size + settle)
    coloured = lfilter([np.sqrt(1.0 - colour**2)], [1.0, -colour], drawn)[settle:]
    return np.asarray(coloured * clean.std() * 10.0 ** (-decibels / 20.0))


@dataclass(frozen=True)
class Excited:
    """Makes the records of a plant with a regular clock.

    Attributes
    ----------
    plant : TransferFunction
    dt : float
    samples : int
    decibels : float
        Signal-to-noise ratio; infinite for none.
    hold : int
        Samples that an input is held.
    bits : int
        Of the pseudorandom binary sequence; 0 for a random binary input, another one each run.
    colour : float
        See `noise`.
    """

    plant: rp.TransferFunction
    dt: float
    samples: int
    decibels: float
    hold: int
    bits: int = 0
    colour: float = 0.0

    def __call__(self, run: int) -> Measured:
        """Return the record of a run."""
        generator = np.random.default_rng(run)
        if self.bits:
            u = prbs(self.samples, bits=self.bits, hold=self.hold)
        else:
            u = random_binary(generator, self.samples, self.hold)
        clean = self.plant.simulate(u, self.dt)
        if np.isinf(self.decibels):
            return Measured(u, clean)
        return Measured(u, clean + noise(generator, clean, self.decibels, self.colour))


@dataclass(frozen=True)
class Irregular:
    """Scenario A with a clock that jitters and drops samples; each sample comes with its time stamp.

    Attributes
    ----------
    hold : int
        Samples that the input is held.
    bits : int
        As in `Excited`.
    switches_when_dropped : bool
        Whether the input goes on switching at the instants of which no sample is left: then nobody but the plant
        knows what it did there.  Otherwise it switches at recorded instants alone.
    dropped : float
        Part of the samples that is dropped.
    jitter : float
        Largest deviation of a stamp from the regular clock, in sampling times.
    """

    hold: int
    bits: int
    switches_when_dropped: bool
    dropped: float = 0.1
    jitter: float = 0.2
    samples: int = 2001
    dt: float = 0.05
    decibels: float = 10.0

    def __call__(self, run: int) -> Measured:
        """Return the record of a run."""
        generator = np.random.default_rng(run)
        if self.bits:
            u = prbs(self.samples, bits=self.bits, hold=self.hold)
        else:
            u = random_binary(generator, self.samples, self.hold)
        t = self.dt * (np.arange(self.samples) + generator.uniform(-self.jitter, self.jitter, self.samples))
        kept = generator.random(self.samples) >= self.dropped
        kept[0] = True
        if not self.switches_when_dropped:
            u = u[np.maximum.accumulate(np.where(kept, np.arange(self.samples), 0))]
        clean = simulate_at(PLANT_A, t, u)
        y = clean + noise(generator, clean, self.decibels)
        return Measured(u[kept], y[kept], t[kept])


def simulate_at(plant: rp.TransferFunction, t: FloatArray, u: FloatArray) -> FloatArray:
    """Return the output (K,) at the instants ``t`` (K,), from rest, u[k] being held from t[k] to t[k+1].

    Exact, by partial fractions: the poles must be distinct and none of them zero.
    """
    poles = plant.poles
    residues = np.polyval(plant.num, poles) / np.polyval(np.polyder(plant.den), poles)
    decay = np.exp(np.outer(np.diff(t), poles))
    drive = (decay - 1.0) / poles * u[:-1, None]
    states = np.zeros((t.size, poles.size), complex)
    for k in range(t.size - 1):
        states[k + 1] = decay[k] * states[k] + drive[k]
    return np.asarray((states @ residues).real)
