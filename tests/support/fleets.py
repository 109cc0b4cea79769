"""Fleets for tests: records of rigs with known plants, as files of every kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import parquet

import replant as rp

DT = 0.05


@dataclass(frozen=True)
class Recorded:
    """A record of one rig."""

    t: np.ndarray
    u: np.ndarray
    y: np.ndarray

    def part(self, begin: int, end: int) -> Recorded:
        return Recorded(self.t[begin:end], self.u[begin:end], self.y[begin:end])


def recorded(
    seed: int, samples: int = 600, gain: float = 2.0, frequency: float = 2.0, damping: float = 0.3, noise: float = 0.05
) -> Recorded:
    """A second-order rig, whose output has white noise of this part of its standard deviation."""
    rng = np.random.default_rng(seed)
    u = np.where(np.repeat(rng.integers(0, 2, samples // 15 + 1), 15)[:samples] > 0, 1.0, -1.0)
    plant = rp.TransferFunction([gain * frequency**2], [1.0, 2.0 * damping * frequency, frequency**2])
    y = plant.simulate(u, DT)
    return Recorded(DT * np.arange(samples), u, y + noise * y.std() * rng.standard_normal(samples))


def as_csv(path: Path, record: Recorded) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack([record.t, record.u, record.y])
    np.savetxt(path, table, delimiter=",", header="t,u,y", comments="", fmt="%.17g")
    return path


def as_table(record: Recorded, **columns: object) -> pyarrow.Table:
    return pyarrow.table({"t": record.t, "u": record.u, "y": record.y, **columns})


def as_parquet(path: Path, record: Recorded, **options: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(as_table(record), path, **options)
    return path


def small_fleet(folder: Path, rigs: int = 6) -> Path:
    """A folder of CSV files, one a rig, which differ."""
    for k in range(rigs):
        as_csv(folder / f"rig{k}.csv", recorded(k, gain=2.0 + 0.1 * k))
    return folder


def two_inputs(path: Path, seed: int, gains: tuple[float, float] = (2.0, 2.5), moves: float = 1.0) -> Path:
    """The log of a rig whose second input is multiplied by ``moves``: 600 samples, one in .1 s."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (60, 2)).repeat(10, axis=0) * [1.0, moves]
    first = rp.TransferFunction([gains[0]], [1.0, 1.0]).simulate(u[:, 0].copy(), 0.1)
    second = rp.TransferFunction([0.5 * gains[1]], [1.0, 0.5], delay=0.3).simulate(u[:, 1].copy(), 0.1)
    rows = np.column_stack([0.1 * np.arange(600), u, first + second + 0.05 * rng.standard_normal(600)])
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, rows, "%.9g", ",", header="t,Q1,Q2,T1", comments="")
    return path
