"""The records that a changed constant is tried on, and what is measured of each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import replant as rp
from sensitivity.outcome import Outcome

DT = 0.05
SECOND = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
FIRST = rp.TransferFunction([2.0], [1.0, 0.5])
THIRD = rp.TransferFunction([1.0, 5.0], [1.0, 3.0, 7.0, 5.0])
PIECE = 50
"""Samples between two looks at the verdict after a failure or change [samples]."""


@dataclass
class Case:
    """A record, the plant at its end, and what should be noticed in it."""

    plant: rp.TransferFunction
    u: np.ndarray
    y: np.ndarray
    t: np.ndarray | None = None
    event: int | None = None  # the sample from which on the verdict must not be "trusted"
    zeros: int = 0
    poles: int | None = None  # asked for, where that is not the plant's
    faulty: bool = False  # whether it must not be trusted at the end either
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def structure(self) -> rp.Structure:
        return rp.Structure(self.poles or self.plant.den.size - 1, self.zeros)

    @property
    def true(self) -> np.ndarray:
        return np.concatenate([self.plant.den[1:], self.plant.num])


def _binary(seed: int, samples: int, hold: int = 8) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], -(-samples // hold)), hold)[:samples]


def _noise(seed: int, size: int, pole: float = 0.0) -> np.ndarray:
    white = np.random.default_rng(1000 + seed).standard_normal(size)
    if pole == 0.0:
        return white
    slow = np.empty(size)
    last = 0.0
    for k in range(size):
        slow[k] = last = pole * last + math.sqrt(1.0 - pole**2) * white[k]
    return slow


def _clean(seed: int, samples: int, level: float, plant: rp.TransferFunction = SECOND, pole: float = 0.0) -> Case:
    u = _binary(seed, samples)
    y = plant.simulate(u, DT)
    return Case(plant, u, y + level * y.std() * _noise(seed, samples, pole), zeros=plant.num.size - 1)


def _changed(seed: int, plant: rp.TransferFunction, samples: int = 4000, at: int = 2500) -> Case:
    case = _clean(seed, samples, 0.1)
    before, after = case.plant.simulate(case.u, DT), plant.simulate(case.u, DT)
    # the new plant goes on from where the old one is: the difference of the two free runs dies out by the new one
    y = np.concatenate(
        [before[:at], after[at:] + (before[at - 1] - after[at - 1]) * np.exp(-(np.arange(samples - at)) * DT)]
    )
    y += 0.1 * before.std() * _noise(seed, samples)
    return Case(plant, case.u, y, event=at)


def _outliers(seed: int) -> Case:
    case = _clean(seed, 2500, 0.1)
    rng = np.random.default_rng(seed)
    case.y[rng.choice(2500, 40, replace=False)] += (
        rng.choice([-1.0, 1.0], 40) * rng.uniform(3.0, 300.0, 40) * case.y.std()
    )
    return case


def _stuck(seed: int, digits: int) -> Case:
    case = _clean(seed, 3000, 0.05)
    case.y = np.round(case.y, digits)
    case.y[2500:] = case.y[2500]
    case.event, case.faulty = 2500, True
    return case


def _saturated(seed: int) -> Case:
    case = _clean(seed, 2500, 0.05)
    case.y = np.minimum(case.y, 0.6 * case.y.max())
    case.event, case.faulty = 0, True
    return case


def _coarse(seed: int) -> Case:
    case = _clean(seed, 2500, 0.02)
    step = 0.1 * case.y.std()
    case.y = step * np.round(case.y / step)
    return case


def _gaps(seed: int) -> Case:
    case = _clean(seed, 3000, 0.1)
    t = DT * np.arange(3000)
    kept = np.ones(3000, bool)
    for begin in (1200, 2000):
        kept[begin : begin + 60] = False
    kept[np.random.default_rng(seed).choice(3000, 60, replace=False)] = False
    case.u, case.y, case.t = case.u[kept], case.y[kept], t[kept]
    return case


def _jittered(seed: int) -> Case:
    u = _binary(seed, 1500)
    rng = np.random.default_rng(seed)
    fine = SECOND.simulate(np.repeat(u, 10), DT / 10)
    offset = rng.integers(0, 4, 1500)
    y = fine[10 * np.arange(1500) + offset]
    case = Case(SECOND, u, y + 0.1 * y.std() * _noise(seed, 1500), DT * np.arange(1500) + DT / 10 * offset)
    case.options = {"filter": rp.RefinedFilter(input_hold="zoh")}
    return case


def _stepping_load(seed: int) -> Case:
    case = _clean(seed, 3500, 0.1)
    case.y[2000:] += 0.8 * (1.0 - np.exp(-np.arange(1500) * DT))
    return case


def _resting(seed: int) -> Case:
    u = _binary(seed, 3000)
    u[1500:] = u[1499]
    y = SECOND.simulate(u, DT)
    return Case(SECOND, u, y + 0.1 * y.std() * _noise(seed, 3000), event=1700, faulty=True, options={
        "optimizer": rp.RecursiveLeastSquares(0.998)})  # fmt: skip


def _nonlinear(seed: int, share: float) -> Case:
    u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, -(-2500 // 8)), 8)[:2500]
    y = SECOND.simulate(u + share * u**2, DT)
    return Case(
        SECOND, u, y + 0.05 * y.std() * _noise(seed, 2500), event=0 if share > 0.5 else None, faulty=share > 0.5
    )


def _of_low_order(seed: int) -> Case:
    case = _clean(seed, 2500, 0.02, THIRD)
    return Case(THIRD, case.u, case.y, event=0, poles=1, faulty=True)


def _short(seed: int) -> Case:
    return _clean(seed, 300, 0.2)


def _of_article(seed: int) -> Case:
    case = _clean(seed, 2500, 0.1)
    case.options = {"optimizer": "amsgrad", "instruments": True}
    return case


CASES: dict[str, Callable[[], Case]] = {
    "white 1 %": lambda: _clean(1, 2000, 0.01),
    "white 10 %": lambda: _clean(2, 2000, 0.1),
    "white 30 %": lambda: _clean(3, 2500, 0.3),
    "white 100 %": lambda: _clean(4, 4000, 1.0),
    "third order": lambda: _clean(5, 2500, 0.1, THIRD),
    "noise of 1 s": lambda: _clean(6, 3000, 0.2, pole=0.95),
    "slow noise": lambda: _clean(7, 3500, 0.3, FIRST, pole=0.995),
    "outliers": lambda: _outliers(8),
    "stuck, fine scale": lambda: _stuck(9, 6),
    "stuck, coarse scale": lambda: _stuck(10, 1),
    "saturated": lambda: _saturated(11),
    "coarse scale": lambda: _coarse(12),
    "gaps": lambda: _gaps(13),
    "jitter": lambda: _jittered(14),
    "gain doubled": lambda: _changed(15, rp.TransferFunction([4.0], [1.0, 4.0, 3.0])),
    "gain 20 % up": lambda: _changed(16, rp.TransferFunction([2.4], [1.0, 4.0, 3.0])),
    "load step": lambda: _stepping_load(17),
    "input rests": lambda: _resting(18),
    "a little nonlinear": lambda: _nonlinear(19, 0.05),
    "nonlinear": lambda: _nonlinear(20, 1.0),
    "too few poles": lambda: _of_low_order(21),
    "short": lambda: _short(22),
    "amsgrad": lambda: _of_article(23),
}


def outcome(case: Case) -> Outcome:
    """Identify a record, look at the verdict every `PIECE` samples after its event, and at the end."""
    ident = rp.Identifier(case.structure, DT, **case.options)
    late, alarmed, begin = math.inf, 0, 0
    for end in _ends(case):
        some = slice(begin, end)
        ident.update_many(case.u[some], case.y[some], None if case.t is None else case.t[some])
        begin = end
        if case.event is not None and end > case.event and math.isinf(late) and ident.assess().status != "trusted":
            late = float(end - case.event)
        alarmed += int(ident._settings is not None and ident._state.alarm != 0)
    ident.finish()
    state, found = ident._state, ident.parameters[: case.structure.size]
    noticed = state.outliers + state.stuck + alarmed if case.event is None else 0
    error = math.nan
    if case.poles is None:
        error = float(np.sqrt(np.mean((found[: case.true.size] / case.true - 1.0) ** 2)))
    verdict = ident.assess()
    figures = [value for value in dataclasses.asdict(verdict).values() if isinstance(value, float)]
    return Outcome(error, verdict.status, late, int(noticed), case.faulty, repr(figures))


def _ends(case: Case) -> Iterator[int]:
    """Yield where to look: every `PIECE` samples, six times after the event; every 500 samples without one."""
    size = case.u.size
    if not case.event:
        yield from (*range(500, size, 500), size)
        return
    yield case.event
    yield from (*range(case.event + PIECE, min(size, case.event + 7 * PIECE), PIECE), size)
