"""Logs longer than memory: `replant run`'s passes over Parquet and CSV files beside `update_many` over the same rows.

Prints, and `measure` returns, for each format the time, its ratio to the rows in memory in the same run, the same for
the processor time of all threads (which other programs on the machine hardly change), and the peak of resident memory
of a process that does nothing else.  The rows of time, input and output are written as they are
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
from replant.estimation.settings import Request
from replant.estimation.simulation.fitted_run import FITTED
from replant.logs import open_recording
from replant.model.preprocess import Preprocess
from replant.model.state_space import Response
from replant.online.runs.run import CHUNK, Arrays, run_source

DT = 0.01
PLANT = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0])
STRUCTURE = rp.Structure(poles=2, zeros=1)
PREPROCESS = Preprocess("identity", "mean", "mean")  # as `replant run` has it
BLOCK = 1 << 18
MOST_IN_MEMORY = 20_000_000  # rows beyond which there is no comparison with memory
FORMATS = ("parquet", "csv")
MOST_RATIO, MOST_RESIDENT = {"parquet": 1.5, "csv": 2.5}, 500.0  # to rows in memory; MB


def measure(rows: int = 10_000_000, repeats: int = 3) -> dict[str, Any]:
    """Return seconds, ratio and resident memory for each format, medians of ``repeats`` runs in turn."""
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in ("memory", *FORMATS)}
    with tempfile.TemporaryDirectory(prefix="replant-streaming-") as folder:
        write(Path(folder), rows)
        for _ in range(repeats):
            if rows <= MOST_IN_MEMORY:
                runs["memory"].append(in_memory(rows))
            for name in FORMATS:
                runs[name].append(in_own_process(Path(folder, f"log.{name}")))
        sizes = {name: Path(folder, f"log.{name}").stat().st_size / 1e6 for name in FORMATS}
    result: dict[str, Any] = {"rows": rows, "repeats": repeats}
    for name, found in runs.items():
        result[name] = {key: spread([run[key] for run in found]) for key in (found[0] if found else ())}
        result[name]["samples_per_second"] = spread([rows / run["seconds"] for run in found])
        if name in FORMATS:
            result[name]["file_mb"] = sizes[name]
            pairs = list(zip(found, runs["memory"], strict=False))
            for key, ratio in (("seconds", "ratio"), ("processor_seconds", "processor_ratio")):
                result[name][ratio] = spread([one[key] / other[key] for one, other in pairs])
    result["holds"] = all(
        result[name]["resident_mb"]["most"] <= MOST_RESIDENT
        and result[name]["ratio"].get("median", 0.0) <= MOST_RATIO[name]
        for name in FORMATS
    )
    return result


def spread(values: list[float]) -> dict[str, float]:
    """Return the median of a few figures, the least and the largest."""
    return {"median": statistics.median(values), "least": min(values), "most": max(values)} if values else {}


def record(rows: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield blocks of time, input and output of a plant under a random binary input, with output noise."""
    rng, response, level, done = np.random.default_rng(0), Response(PLANT, DT), 1.0, 0
    while done < rows:
        count = min(BLOCK, rows - done)
        u = level * np.where(np.cumsum(rng.random(count) < 0.02) % 2 == 0, 1.0, -1.0)
        y = response.take(u).output + 0.01 * rng.standard_normal(count)
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


def in_memory(rows: int) -> dict[str, float]:
    """Return the times of `update_many` over the record in memory, in chunks as long as those of a run."""
    blocks = [(u, y) for _, u, y in record(rows)]
    u, y = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    ident = rp.Identifier(STRUCTURE, DT, preprocess=PREPROCESS)
    ident.clone().update_many(u[:5000], y[:5000])  # what is loaded at a first call is not the method's time
    begun = time.perf_counter(), time.process_time()
    for start in range(0, rows, CHUNK):
        ident.update_many(u[start : start + CHUNK], y[start : start + CHUNK])
    return {"seconds": time.perf_counter() - begun[0], "processor_seconds": time.process_time() - begun[1]}


def in_own_process(path: Path) -> dict[str, float]:
    """Run over a file in a process of its own, so that its memory is its own."""
    command = [sys.executable, __file__, "--file", str(path)]
    found: dict[str, float] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return found


def over_file(path: Path) -> dict[str, float]:
    """Return time and peak memory of the passes over a file: check, identification, test."""
    warm = [np.concatenate(parts) for parts in zip(*record(5000), strict=True)]
    run_source(Request(STRUCTURE, DT, preprocess=PREPROCESS), Arrays(*warm[1:]))
    begun = time.perf_counter(), time.process_time()
    recording = open_recording(path, input="u", output="y", time="t")
    result = run_source(Request(STRUCTURE, recording.dt, preprocess=PREPROCESS), recording, newest=FITTED)
    elapsed = {"seconds": time.perf_counter() - begun[0], "processor_seconds": time.process_time() - begun[1]}
    if result.verdict.status != "trusted" or abs(result.parameters[1] - 5.0) > 0.1:
        raise SystemExit(f"{path}: not what the plant is: {result.parameters}")
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return {**elapsed, "resident_mb": int(peak.split()[1]) / 1024}


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
