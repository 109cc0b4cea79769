"""Scenario H: thirty records whose model is right, thirty that no model of the asked structure may be trusted for.

Every plant here can be told from 4000 samples of its input at 5 dB: the relative uncertainty of the offline estimate
is below 0.15 (`tests/test_accuracy.py` holds that).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import replant as rp
from accuracy.records import PLANT_A, PLANT_B, noise, random_binary
from replant.numerics.arguments import FloatArray
from replant.online.identifier import Identifier

CASES = 30  # of each
SAMPLES = 4000
TRUSTED = "trusted"
#: Right cases that must end trusted; of the wrong ones none may.
LEAST_TRUSTED = 27


@dataclass(frozen=True)
class Rig:
    """A plant with its sampling time and the samples that an input is held."""

    plant: rp.TransferFunction
    dt: float
    hold: int

    @property
    def structure(self) -> rp.Structure:
        """The right one."""
        return rp.Structure(self.plant.den.size - 1, self.plant.num.size - 1)


RIGS = (
    Rig(PLANT_A, 0.05, 8),
    Rig(PLANT_B, 0.01, 7),
    Rig(rp.TransferFunction([1.25], [1.0, 0.5]), 0.2, 7),
    Rig(rp.TransferFunction([30.0], [1.0, 2.0, 25.0]), 0.02, 9),
    Rig(rp.TransferFunction([12.0], [1.0, 7.0, 16.0, 12.0]), 0.05, 9),
)
DECIBELS = (10.0, 20.0, 5.0, 30.0)


@dataclass(frozen=True, eq=False)
class Case:
    """A record with the structure that is asked for.

    Attributes
    ----------
    kind : str
        "right", or what is wrong.
    rig : Rig
    structure : Structure
    dt : float
        As the user gives it.
    u, y : (K,) arrays
    t : (K,) array or None
    freeze_at : int
        After how many samples the estimator is frozen; 0 for never.
    """

    kind: str
    rig: Rig
    structure: rp.Structure
    dt: float
    u: FloatArray
    y: FloatArray
    t: FloatArray | None = None
    freeze_at: int = 0

    @property
    def assessed(self) -> tuple[str, tuple[str, ...]]:
        """The verdict of the default identifier after one pass: its status and its reasons."""
        ident = Identifier(self.structure, self.dt)
        stamps = (None, None) if self.t is None else (self.t[: self.freeze_at], self.t[self.freeze_at :])
        if self.freeze_at:
            ident.update_many(self.u[: self.freeze_at], self.y[: self.freeze_at], stamps[0])
            ident.freeze()
        ident.update_many(self.u[self.freeze_at :], self.y[self.freeze_at :], stamps[1])
        verdict = ident.assess()
        return verdict.status, tuple(verdict.reasons)


def right(number: int) -> Case:
    """Return one of the cases that are to be trusted: every plant at 5 to 30 dB."""
    rig = RIGS[number % len(RIGS)]
    generator = np.random.default_rng(number)
    u = random_binary(generator, SAMPLES, rig.hold)
    clean = rig.plant.simulate(u, rig.dt)
    y = clean + noise(generator, clean, DECIBELS[number // len(RIGS) % len(DECIBELS)])
    return Case("right", rig, rig.structure, rig.dt, u, y)


def wrong(number: int) -> Case:
    """Return one of the cases that are not to be trusted: the kinds in turn, the plants in turn."""
    kind = tuple(KINDS)[number % len(KINDS)]
    return replace(KINDS[kind](number), kind=kind)


def _base(number: int) -> tuple[Case, np.random.Generator, FloatArray]:
    """Return a right case to be spoilt, a generator for more chance, and the output without its noise."""
    case = right(1000 + number // len(KINDS) + number)
    return case, np.random.default_rng(2000 + number), case.rig.plant.simulate(case.u, case.dt)


def _constant_after_start(number: int) -> Case:
    """The input moves for a tenth of the record and then stands still."""
    case, _, clean = _base(number)
    u = case.u.copy()
    u[SAMPLES // 10 :] = 1.0
    return replace(case, u=u, y=case.rig.plant.simulate(u, case.dt) + case.y - clean)


def _order_too_low(number: int) -> Case:
    """Two poles fewer than the plant has."""
    rigs = [rig for rig in RIGS if rig.structure.poles > 2]
    rig = rigs[number // len(KINDS) % len(rigs)]
    generator = np.random.default_rng(2000 + number)
    u = random_binary(generator, SAMPLES, rig.hold)
    clean = rig.plant.simulate(u, rig.dt)
    poles = rig.structure.poles - 2
    structure = rp.Structure(poles, min(rig.structure.zeros, poles - 1))
    return Case("", rig, structure, rig.dt, u, clean + noise(generator, clean, 10.0))


def _saturated_sensor(number: int) -> Case:
    """The sensor ends at one standard deviation below and 0.8 above its middle."""
    case, _, clean = _base(number)
    return replace(case, y=np.clip(case.y, -clean.std(), 0.8 * clean.std()))


def _swapped_columns(number: int) -> Case:
    """Output for input."""
    case, _, _ = _base(number)
    return replace(case, u=case.y, y=case.u)


def _wrong_dead_time(number: int) -> Case:
    """The plant has a dead time of half its slowest time constant, the structure has none."""
    case, _, clean = _base(number)
    slowest = 1.0 / np.abs(case.rig.plant.poles).min()
    plant = rp.TransferFunction(case.rig.plant.num, case.rig.plant.den, max(3 * case.dt, 0.5 * slowest))
    return replace(case, y=plant.simulate(case.u, case.dt) + case.y - clean)


def _dt_off_by_ten(number: int) -> Case:
    """The sampling time given is ten times the true one; the log has time stamps, without which nobody could tell."""
    case, _, _ = _base(number)
    return replace(case, dt=10.0 * case.dt, t=case.dt * np.arange(SAMPLES))


def _pure_noise(number: int) -> Case:
    """The output has nothing to do with the input."""
    case, generator, clean = _base(number)
    return replace(case, y=clean.std() * generator.standard_normal(SAMPLES))


def _drifting_plant(number: int) -> Case:
    """The estimator is frozen halfway; then the plant's poles and gain move away, by 60 and 30 % in the end."""
    case, _, clean = _base(number)
    plant, half = case.rig.plant, SAMPLES // 2
    orders = np.arange(plant.den.size)
    later = rp.TransferFunction(0.7 * plant.num * 1.6 ** orders[-1], plant.den * 1.6**orders)
    share = np.clip((np.arange(SAMPLES) - half) / half, 0.0, 1.0)
    drifted = clean * (1.0 - share) + later.simulate(case.u, case.dt) * share
    return replace(case, y=drifted + case.y - clean, freeze_at=half)


KINDS: dict[str, Callable[[int], Case]] = {
    "constant input after start": _constant_after_start,
    "order too low by 2": _order_too_low,
    "saturated sensor": _saturated_sensor,
    "swapped columns": _swapped_columns,
    "wrong dead time": _wrong_dead_time,
    "dt off by 10": _dt_off_by_ten,
    "pure noise": _pure_noise,
    "drifting plant, frozen estimator": _drifting_plant,
}
