"""A fleet of simulated actuators as Parquet: second-order rigs that differ by a few percent, some of them odd.

    python benchmarks/fleet/generate.py FOLDER [--rigs 2000] [--samples 500000] [--odd 20] [--seed 1] [--files 40]

The column ``rig`` names the rig; its rows are row groups of their own, and a file holds several rigs.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import parquet

import replant as rp

DT = 0.01  # s
GAIN, FREQUENCY, DAMPING = 2.0, 12.0, 0.4  # of the usual rig; rad/s
SPREAD = 0.03  # standard deviation of each, relative
NOISE = 0.05  # of the output, beside its standard deviation
KINDS = ("stiffer", "slower", "stuck", "unit", "sign", "column")
GROUP_ROWS = 1 << 18


def name_of(number: int) -> str:
    """Return the name of a rig."""
    return f"rig-{number:06}"


def kind_of(number: int, rigs: int, odd: int) -> str:
    """Return how a rig is odd; empty for a usual one. The odd ones lie evenly among the others."""
    if not odd or (number * odd) % rigs >= odd:
        return ""
    return KINDS[(number * odd // rigs) % len(KINDS)]


def record(seed: int, number: int, samples: int, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, input and output (K,) of a rig."""
    rng = np.random.default_rng([seed, number])
    gain, frequency, damping = np.array([GAIN, FREQUENCY, DAMPING]) * np.exp(SPREAD * rng.standard_normal(3))
    if kind == "stiffer":
        gain, frequency = gain / 2.0, frequency * math.sqrt(2.0)
    if kind == "slower":
        frequency *= 0.6
    if kind == "sign":
        gain = -gain
    hold = 10
    u = np.repeat(rng.integers(0, 2, samples // hold + 1) * 2.0 - 1.0, hold)[:samples]
    plant = rp.TransferFunction([gain * frequency**2], [1.0, 2.0 * damping * frequency, frequency**2])
    y = plant.simulate(u, DT)
    y = 1.5 + y + NOISE * y.std() * rng.standard_normal(samples)
    if kind == "unit":
        y *= (1000.0, 180.0 / math.pi)[number // 100 % 4 < 2]
    if kind == "stuck":
        y[int(0.4 * samples) :] = y[int(0.4 * samples)]
    if kind == "column":  # a temperature
        y = 20.0 + np.cumsum(rng.standard_normal(samples)) * 0.01 + 0.1 * rng.standard_normal(samples)
    return DT * np.arange(samples), u, y


def write(folder: Path, rigs: int, samples: int, odd: int = 0, seed: int = 1, files: int = 40) -> dict[str, str]:
    """Write a fleet, and return the odd rigs with their kinds."""
    folder.mkdir(parents=True, exist_ok=True)
    kinds = {name_of(k): kind for k in range(rigs) if (kind := kind_of(k, rigs, odd))}
    for number, of in enumerate(np.array_split(np.arange(rigs), min(files, rigs))):
        writer = None
        for rig in of.tolist():
            t, u, y = record(seed, rig, samples, kinds.get(name_of(rig), ""))
            name = pyarrow.array([name_of(rig)] * samples).dictionary_encode()
            table = pyarrow.table({"rig": name, "t": t, "u": u.astype(np.float32), "y": y.astype(np.float32)})
            writer = writer or parquet.ParquetWriter(folder / f"part-{number:04}.parquet", table.schema)
            writer.write_table(table, row_group_size=GROUP_ROWS)
        if writer is not None:
            writer.close()
    return kinds


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a fleet, and print the odd rigs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, default in (("rigs", 2000), ("samples", 500_000), ("odd", 20), ("seed", 1), ("files", 40)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args(arguments)
    for rig, kind in write(
        options.folder, options.rigs, options.samples, options.odd, options.seed, options.files
    ).items():
        print(rig, kind)
    return 0


if __name__ == "__main__":
    sys.exit(main())
