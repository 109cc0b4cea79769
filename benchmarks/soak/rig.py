"""A simulated rig that goes on for as long as one likes: random plant, random input, noise; all of it may change."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import signal

from replant import Structure, TransferFunction
from replant.numerics.arguments import FloatArray

DT = 1.0 / 64.0  # s; a power of two, so that time stamps are multiples of it to the bit
SLOWEST, FASTEST = 0.3, 6.0  # rad/s, of the poles
FREQUENCIES = 60
EXCITED = 0.01  # of the largest power density of the plant's output: frequencies below that are not looked at


@dataclass
class Rig:
    """A plant of one to three poles behind random steps of the input, with a noisy sensor.

    Attributes
    ----------
    rng : Generator
    dt : float
    now : float
        Time stamp of the newest sample in s.
    load : float
        Added to the output.
    held : float or None
        The input, where it stands still.
    """

    rng: np.random.Generator
    dt: float = DT
    now: float = 0.0
    load: float = 0.0
    held: float | None = None
    gain: float = 1.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        rng = self.rng
        poles = _random_poles(rng)
        corner = float(np.exp(np.mean(np.log(np.abs(poles)))))
        self._poles, self.order = poles, len(poles)
        self._zero = corner * rng.uniform(1.5, 4.0) if self.order > 1 and rng.random() < 0.3 else None
        self._hold = max(2, round(rng.uniform(0.3, 1.5) / corner / self.dt))
        self._stored = np.zeros(self.order)
        self._size = 10.0 ** rng.uniform(-3.0, 3.0)
        self._rest = self._size * rng.uniform(-5.0, 5.0)
        self._u = 0.0
        self.noise = 0.0
        self._arrange()
        settled = self._run(self._steps(20_000))
        self.spread = float(settled.std())
        self.noise = self.spread * 10.0 ** rng.uniform(-2.5, -1.0)

    @property
    def structure(self) -> Structure:
        """What is to be identified."""
        return Structure(self.order, 0 if self._zero is None else 1)

    @property
    def plant(self) -> TransferFunction:
        """The truth, as it is now."""
        den = np.poly(self.speed * self._poles).real
        num = np.ones(1) if self._zero is None else np.array([1.0 / self._zero, 1.0])
        return TransferFunction(self.gain * self._size * den[-1] * num, den)

    def change(self, *, gain: float = 1.0, speed: float = 1.0) -> None:
        """Multiply the plant's gain and its poles; what it has stored stays."""
        self.gain *= gain
        self.speed *= speed
        self._arrange()

    def take(self, samples: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the next samples: input, measured output and time stamp, (K,) each."""
        u = np.full(samples, self.held) if self.held is not None else self._steps(samples)
        self._u = float(u[-1])
        y = self._run(u) + self._rest + self.load + self.noise * self.rng.standard_normal(samples)
        t = self.now + self.dt * np.arange(1, samples + 1)
        self.now = float(t[-1])
        return u, y, t

    def skip(self, seconds: float) -> None:
        """Let time pass of which no sample tells."""
        self.take(max(1, round(seconds / self.dt)))

    def error(self, model: TransferFunction) -> float:
        """Return the largest error of abs G, as a part of it, over the frequencies that the input excites.

        Of `FREQUENCIES`, evenly spaced in the logarithm from a tenth of the slowest corner to Nyquist's, those at which
        the power density of the plant's output, abs(G)^2 times that of the steps, is at least `EXCITED` of its largest.
        """
        plant = self.plant
        omega = np.geomspace(0.1 * float(np.abs(plant.poles).min()), math.pi / self.dt, FREQUENCIES)
        true = np.abs(plant.response(omega))
        power = (true * np.sinc(omega * self._hold * self.dt / math.tau)) ** 2
        excited = power >= EXCITED * power.max()
        return float(np.abs(np.abs(model.response(omega[excited])) / true[excited] - 1.0).max())

    def _arrange(self) -> None:
        plant = self.plant
        numerator, self._den, _ = signal.cont2discrete((plant.num, plant.den), self.dt)
        self._num = numerator.ravel()

    def _run(self, u: FloatArray) -> FloatArray:
        y, self._stored = signal.lfilter(self._num, self._den, u, zi=self._stored)
        return np.asarray(y)

    def _steps(self, samples: int) -> FloatArray:
        levels = self.rng.uniform(-1.0, 1.0, -(-samples // self._hold))
        return np.repeat(levels, self._hold)[:samples]


def _random_poles(rng: np.random.Generator) -> FloatArray:
    """Return one to three poles, rad/s: real ones, or a pair that is not damped much."""
    order = int(rng.integers(1, 4))
    sizes = np.exp(rng.uniform(math.log(SLOWEST), math.log(FASTEST), order))
    if order == 1 or rng.random() < 0.5:
        return -sizes.astype(np.complex128)
    damping = rng.uniform(0.1, 0.7)
    pair = sizes[0] * (-damping + 1j * math.sqrt(1.0 - damping**2))
    return np.array([pair, pair.conjugate(), *-sizes[2:]])
