"""Simulated rigs: a plant with a nonlinear input, a working point, slow creep and a noisy sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.model.preprocess import Preprocess
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, finite, instance, keep, not_negative, one_of, vector
from replant.numerics.limits import count, duration
from replant.signals import random_steps, white_noise

#: The article's G1, (20).
G1 = TransferFunction([1.25], [1.0, 0.5])
#: The article's G2, (22).
G2 = TransferFunction([7.5, -12.5], [1.0, 15.0, 100.0])
#: The dielectric elastomer actuator with the parameters of Table 6, in mm per kV^2; (25) misprints its denominator.
DEAP = TransferFunction([51.47, 7.722], [1.0, 3.292, 5891.0, 595.7])
#: A direct-current motor, in rad/s per V: time constants of 0.5 s, of the rotor, and 20 ms, of the winding.
MOTOR = TransferFunction([1000.0], [1.0, 52.0, 100.0])


@dataclass(frozen=True)
class Rig:
    """A simulated rig: y = y_R + G (map(u) - map(u_R)) + creep + noise.

    Attributes
    ----------
    plant : TransferFunction
        The true plant G.
    dt : float
        Sampling time in s; the input is held between samples.
    input_map : {"identity", "square"}
    input_rest, output_rest : float
        Working point: the input at rest u_R, before the map, and the output y_R that it gives.
    noise : float
        Standard deviation of the sensor's white noise, in the unit of y.
    creep : float
        Creep of the output for each decade of time, in the unit of y: creep * log10(1 + t / 1 s).
    """

    plant: TransferFunction
    dt: float
    input_map: str = "identity"
    input_rest: float = 0.0
    output_rest: float = 0.0
    noise: float = 0.0
    creep: float = 0.0

    def __post_init__(self) -> None:
        keep(self, "plant", instance, TransferFunction)
        keep(self, "dt", duration)
        keep(self, "input_map", one_of, ("identity", "square"))
        keep(self, "noise", not_negative)
        for name in ("input_rest", "output_rest", "creep"):
            keep(self, name, finite)

    @property
    def preprocess(self) -> Preprocess:
        """The input map and the working point that an identifier needs to find the linear plant."""
        rest = Preprocess(self.input_map).map_input(np.array([self.input_rest]))[0]
        return Preprocess(self.input_map, float(rest), self.output_rest)

    def measure(self, u: FloatArray, seed: int = 0) -> FloatArray:
        """Return the measured output (K,) for the input ``u`` (K,), from rest.

        Examples
        --------
        >>> Rig(G1, dt=0.1, output_rest=3.0).measure(np.zeros(2))
        array([3., 3.])
        """
        u, preprocess = vector("u", u), self.preprocess
        moved = preprocess.map_input(u) - float(preprocess.input_offset)
        still = self.output_rest + self.plant.simulate(moved, self.dt) + white_noise(u.size, self.noise, seed)
        return still + self.crept(u.size) if self.creep else still

    def crept(self, samples: int) -> FloatArray:
        """Return the creep (K,) of the output.

        Examples
        --------
        >>> Rig(G1, dt=9.0, creep=0.5).crept(2)
        array([0. , 0.5])
        """
        t = self.dt * np.arange(count("samples", samples, 0, 4))
        return np.asarray(self.creep * np.log10(1.0 + t))


def deap_rig(noise: float = 1e-3, creep: float = 0.0) -> Rig:
    """Return the dielectric elastomer actuator of the article's section 4, simulated.

    A pre-stretched VHB membrane (1 mm before, 200 um after stretching; plate 120 mm, disc 20 mm, Table 5) carries a
    mass; the voltage u_A [kV] softens it, and a laser measures the displacement y_L [mm] at 1 kHz.  The true plant has
    one slow pole at -0.101 rad/s and a lightly damped pair at 12.2 Hz.

    Parameters
    ----------
    noise : float
        Standard deviation of the laser's noise in mm.
    creep : float
        Creep of the membrane under its mass, in mm for each decade of time.

    Examples
    --------
    >>> [round(mode.frequency, 3) for mode in deap_rig().plant.modes]
    [0.016, 12.215]
    """
    return Rig(DEAP, dt=1e-3, input_map="square", input_rest=4.0, output_rest=1.5, noise=noise, creep=creep)


def motor_rig(noise: float = 0.2) -> Rig:
    """Return a direct-current motor: voltage [V] in, speed [rad/s] out, measured at 100 Hz.

    Parameters
    ----------
    noise : float
        Standard deviation of the tachometer's noise in rad/s.

    Examples
    --------
    >>> [round(mode.time_constant, 6) for mode in motor_rig().plant.modes]
    [0.5, 0.02]
    """
    return Rig(MOTOR, dt=0.01, noise=noise)


def deap_voltage(samples: int, seed: int = 0) -> FloatArray:
    """Return an exciting voltage (K,) in kV for `deap_rig`: steps of 10 ms to 20 s between 2 and 5.5 kV.

    Parameters
    ----------
    samples : int
        Number of samples K.
    seed : int
        Seed of the random steps.

    Examples
    --------
    >>> u = deap_voltage(1000)
    >>> bool((u >= 2.0).all() and (u <= 5.5).all())
    True
    """
    return random_steps(samples, shortest=10, longest=20_000, low=2.0, high=5.5, seed=seed)
