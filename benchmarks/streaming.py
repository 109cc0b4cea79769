"""Logs longer than memory: `replant run`'s passes over Parquet and CSV files beside `update_many` over the same rows.

Prints, and `measure` returns, for each format the time, its ratio to the rows in memory in the same run, and the peak
of resident memory of a process that does nothing else.  The rows of time, input and output are written as they are
made, into a folder that is removed afterwards: 10^7 of them take 340 MB on disk, 10^8 take 3.5 GB.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant.batches import Arrays
from replant.logs import open_recording
from replant.preprocess import Preprocess
from replant.response import Response
from replant.runs import CHUNK, run_source
from replant.score import FITTED
from replant.settings import Request

DT = 0.01
PLANT = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0])
STRUCTURE = rp.Structure(poles=2, zeros=1)
PREPROCESS = Preprocess("identity", "mean", "mean")  # as `replant run` has it
BLOCK = 1 << 18
MOST_IN_MEMORY = 20_000_000  # rows beyond which there is no comparison with memory
FORMATS = ("parquet", "csv")


def measure(rows: int = 10_000_000, repeats: int = 3) -> dict[str, Any]:
    """Return seconds, ratio and resident memory for each format, medians of ``repeats`` runs in turn."""
    seconds: dict[str, list[float]] = {name: [] for name in ("memory", *FORMATS)}
    resident: dict[str, list[float]] = {name: [] for name in FORMATS}
    with tempfile.TemporaryDirectory(prefix="replant-streaming-") as folder:
        write(Path(folder), rows)
        for _ in range(repeats):
            if rows <= MOST_IN_MEMORY:
                seconds["memory"].append(in_memory(rows))
            for name in FORMATS:
                found = in_own_process(Path(folder, f"log.{name}"))
                seconds[name].append(found["seconds"])
                resident[name].append(found["resident_mb"])
        sizes = {name: Path(folder, f"log.{name}").stat().st_size for name in FORMATS}
    result: dict[str, Any] = {"rows": rows, "repeats": repeats}
    for name, times in seconds.items():
        if not times:
            continue
        result[name] = {"seconds": statistics.median(times), "spread": [min(times), max(times)]}
        result[name]["samples_per_second"] = rows / result[name]["seconds"]
        if name in FORMATS:
            result[name] |= {"resident_mb": max(resident[name]), "file_mb": sizes[name] / 1e6}
            if seconds["memory"]:
                ratios = [one / other for one, other in zip(times, seconds["memory"], strict=True)]
                result[name] |= {"ratio": statistics.median(ratios), "ratio_spread": [min(ratios), max(ratios)]}
    return result


def record(rows: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield blocks of time, input and output of a plant under a random binary input, with output noise."""
    rng, response, level, done = np.random.default_rng(0), Response(PLANT, DT), 1.0, 0
    while done < rows:
        count = min(BLOCK, rows - done)
        u = level * np.where(np.cumsum(rng.random(count) < 0.02) % 2 == 0, 1.0, -1.0)
        y = response.output(u) + 0.01 * rng.standard_normal(count)
        yield np.round(DT * np.arange(done, done + count), 2), u, np.round(y, 6)
        level, done = float(u[-1]), done + count


def write(folder: Path, rows: int) -> None:
    """Write the record as Parquet and as CSV."""
    import pyarrow
    from pyarrow import csv, parquet

    schema = pyarrow.schema([(name, pyarrow.float64()) for name in "tuy"])
    with (
        parquet.ParquetWriter(folder / "log.parquet", schema) as one,
        csv.CSVWriter(folder / "log.csv", schema) as other,
    ):
        for t, u, y in record(rows):
            table = pyarrow.table({"t": t, "u": u, "y": y})
            one.write_table(table)
            other.write_table(table)


def in_memory(rows: int) -> float:
    """Return the time of `update_many` over the record in memory, in chunks as long as those of a run."""
    blocks = [(u, y) for _, u, y in record(rows)]
    u, y = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    ident = rp.Identifier(STRUCTURE, DT, preprocess=PREPROCESS)
    ident.clone().update_many(u[:5000], y[:5000])  # what is loaded at a first call is not the method's time
    begun = time.perf_counter()
    for start in range(0, rows, CHUNK):
        ident.update_many(u[start : start + CHUNK], y[start : start + CHUNK])
    return time.perf_counter() - begun


def in_own_process(path: Path) -> dict[str, float]:
    """Run over a file in a process of its own, so that its memory is its own."""
    command = [sys.executable, __file__, "--file", str(path)]
    found: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return found


def over_file(path: Path) -> dict[str, float]:
    """Return time and peak memory of the passes over a file: check, identification, test."""
    warm = [np.concatenate(parts) for parts in zip(*record(5000), strict=True)]
    run_source(Request(STRUCTURE, DT, preprocess=PREPROCESS), Arrays(*warm[1:]))
    begun = time.perf_counter()
    recording = open_recording(path, input="u", output="y", time="t")
    result = run_source(Request(STRUCTURE, recording.dt, preprocess=PREPROCESS), recording, newest=FITTED)
    elapsed = time.perf_counter() - begun
    if result.verdict.status != "trusted" or abs(result.parameters[1] - 5.0) > 0.1:
        raise SystemExit(f"{path}: not what the plant is: {result.parameters}")
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return {"seconds": elapsed, "resident_mb": int(peak.split()[1]) / 1024}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=lambda text: int(float(text)), default=10_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    found = over_file(arguments.file) if arguments.file else measure(arguments.rows, arguments.repeats)
    print(json.dumps(found, indent=None if arguments.file else 2))


if __name__ == "__main__":
    main()
