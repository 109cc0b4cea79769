"""What no linear model is right for: actuators that are not linear, gains that toggle, a hold that is another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import replant as rp
from campaign.outcome import GOOD, explained
from campaign.plants import drawn_plant, structure_of
from replant.numerics.arguments import FloatArray
from replant.signals import multisine, random_steps

SAMPLES = 6000
DECIBELS = 30.0
TOGGLES = 1000  # samples between two toggles of the gain
LOOKS = 100  # samples between two looks
FAR_OFF = 0.25  # part by which the gain is off
WRONG = 0.1  # part by which a coefficient is off


def saturated(u: FloatArray) -> FloatArray:
    """No more than a third of the way."""
    return np.clip(u, -0.35, 0.35)


def dead(u: FloatArray) -> FloatArray:
    """Nothing within a dead zone."""
    return np.sign(u) * np.maximum(np.abs(u) - 0.5, 0.0)


def loose(u: FloatArray) -> FloatArray:
    """Backlash of half of the stroke."""
    out, held = np.empty(u.size), 0.0
    for k, value in enumerate(u):
        held = min(max(held, float(value) - 0.5), float(value) + 0.5)
        out[k] = held
    return out


def lopsided(u: FloatArray) -> FloatArray:
    """Three times as strong one way as the other."""
    return np.where(u > 0.0, 1.5 * u, 0.5 * u)


ACTUATORS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "saturates": saturated, "dead zone": dead, "backlash": loose, "asymmetric gain": lopsided,
}  # fmt: skip


@dataclass(frozen=True)
class Trusted:
    """How often a model that is wrong was trusted.

    Attributes
    ----------
    wrong : int
        Models that are wrong.
    cases : tuple of str
        Those of them that were trusted.
    """

    wrong: int
    cases: tuple[str, ...]

    @property
    def trusted(self) -> int:
        """How many were."""
        return len(self.cases)


def behind_actuators(seed: int, each: int) -> Trusted:
    """Identify plants behind actuators that are not linear; a model that explains less than 90 % is wrong."""
    wrong, cases = 0, []
    for name, actuator in ACTUATORS.items():
        for number in range(each):
            rng = np.random.default_rng([seed, 1, number])
            plant, dt, u = _simple(rng)
            clean = plant.simulate(actuator(u), dt)
            ident = _identified(rng, plant, dt, u, clean)
            if ident.status == "starting" or explained(ident.transfer_function, u, clean, dt) >= GOOD:
                continue
            wrong += 1
            if ident.assess().status == "trusted":
                cases.append(f"{name} {number}")
    return Trusted(wrong, tuple(cases))


def toggling(seed: int, rigs: int) -> Trusted:
    """Look at plants whose gain toggles between one and two; a model whose static gain is 25 % off is wrong."""
    wrong, cases = 0, []
    for number in range(rigs):
        rng = np.random.default_rng([seed, 2, number])
        plant, dt, u = _simple(rng)
        doubled = np.arange(SAMPLES) // TOGGLES % 2 == 1
        y = plant.simulate(np.where(doubled, 2.0, 1.0) * u, dt)
        y = y + _noise(rng, y)
        ident, gain = rp.Identifier(structure_of(plant), dt), plant.num[-1] / plant.den[-1]
        for k in range(0, SAMPLES, LOOKS):
            ident.update_many(u[k : k + LOOKS], y[k : k + LOOKS])
            if ident.status == "starting":
                continue
            model = ident.transfer_function
            true = gain * (2.0 if doubled[k] else 1.0)
            if abs(model.num[-1] / model.den[-1] - true) > FAR_OFF * abs(true):
                wrong += 1
                if ident.assess().status == "trusted":
                    cases.append(f"rig {number}, sample {k + LOOKS}")
    return Trusted(wrong, tuple(cases))


def smooth_inputs(seed: int, rigs: int) -> Trusted:
    """Identify plants whose input is smooth between samples, taken as held; 10 % off in a coefficient is wrong.

    Trusted is what nothing is said of: neither that the input may run straight between its samples, nor that the
    coefficients are not known.
    """
    said = "straight between its samples", "the coefficients are not known"
    wrong, cases = 0, []
    for number in range(rigs):
        rng = np.random.default_rng([seed, 3, number])
        plant, dt, _ = _simple(rng)
        poles = np.abs(np.roots(plant.den))
        frequencies = np.geomspace(0.2 * poles.min(), min(3.0 * poles.max(), 1.0 / dt), 12) / (2.0 * np.pi)
        u = multisine(SAMPLES, dt, frequencies, amplitude=0.4)
        ident = _identified(rng, plant, dt, u, plant.simulate(u, dt, input_hold="foh"))
        truth = np.concatenate([plant.den[1:], plant.num])
        off = np.abs(ident.parameters[: truth.size] / truth - 1.0)
        if not off.max() <= WRONG:
            wrong += 1
            verdict = ident.assess()
            if verdict.status == "trusted" and not any(words in " ".join(verdict.reasons) for words in said):
                cases.append(f"rig {number}")
    return Trusted(wrong, tuple(cases))


def surplus_poles(seed: int, rigs: int) -> int:
    """Identify plants without noise with one pole too many; return how many have no model in the end."""
    silent = 0
    for number in range(rigs):
        rng = np.random.default_rng([seed, 4, number])
        plant, dt, u = _simple(rng)
        ident = rp.Identifier(rp.Structure(plant.den.size, plant.num.size - 1), dt)
        ident.update_many(u, plant.simulate(u, dt))
        ident.finish()
        silent += ident.status == "starting"
    return silent


def _simple(rng: np.random.Generator) -> tuple[rp.TransferFunction, float, FloatArray]:
    """Return a plant that the record can tell, its sampling time, and steps."""
    while True:
        plant, dt = drawn_plant(rng)
        poles = np.abs(np.roots(plant.den))
        if plant.den.size <= 3 and poles.max() <= 10.0 * poles.min():
            break
    longest = max(round(2.0 / (poles.min() * dt)), 2)
    seed = int(rng.integers(2**31))
    u = random_steps(SAMPLES, shortest=max(longest // 10, 1), longest=longest, low=-1.0, high=1.0, seed=seed)
    return plant, dt, u


def _noise(rng: np.random.Generator, clean: FloatArray) -> FloatArray:
    return clean.std() * 10.0 ** (-DECIBELS / 20.0) * rng.standard_normal(clean.size)


def _identified(
    rng: np.random.Generator, plant: rp.TransferFunction, dt: float, u: FloatArray, clean: FloatArray
) -> rp.Identifier:
    """Return the default after one pass over an output, with noise added, in the structure of ``plant``."""
    ident = rp.Identifier(structure_of(plant), dt)
    ident.update_many(u, clean + _noise(rng, clean))
    ident.finish()
    return ident
