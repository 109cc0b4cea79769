"""`replant fleet` on a generated fleet: samples a second beside `update_many` in memory, workers, memory, odd rigs.

    python benchmarks/fleet [--rigs 2000] [--samples 500000] [--odd 20] [--workers 2] [--repetitions 1] [--folder DIR]

A core's samples a second are those of its own time, so that what else the machine does counts little; both sides are
measured in the same run.  One worker and several take turns, ``--repetitions`` times each, and their times are added:
the speed of a virtual machine drifts by a fifth within minutes.  The whole fleet needs 12 GB of disk and some hours of
a core.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import replant as rp
from fleet.generate import DT, kind_of, name_of, record, write
from replant.fleet.catalogue import find_rigs
from replant.fleet.odd_rigs import oddness_of
from replant.online.runs.run_log import AT_REST

ALONE = 6  # rigs that update_many is measured with
EVERY = 0.2  # s between two looks at the memory


@dataclass(frozen=True)
class Measured:
    """One run of a fleet."""

    wall: float
    core: float
    memory: float
    growth: float
    fleet: rp.fleet.Fleet


def main(arguments: Sequence[str] | None = None) -> int:
    """Generate a fleet, identify it with one worker and with several, and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("rigs", 2000), ("samples", 500_000), ("odd", 20), ("workers", 2), ("repetitions", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--folder", type=Path, help="keep logs and results there")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        write(folder / "logs", options.rigs, options.samples, options.odd)
        compare(folder, options)
    return 0


def compare(folder: Path, options: argparse.Namespace) -> None:
    """Measure and print."""
    total = options.rigs * options.samples
    size = sum(path.stat().st_size for path in (folder / "logs").iterdir())
    print(f"{options.rigs:,} rigs, {total:,} samples, {size / total:.1f} bytes a sample")
    begun = time.perf_counter()
    find_rigs(folder / "logs", "rig")
    print(f"planned in {time.perf_counter() - begun:.2f} s")
    in_memory = alone(options)
    print(f"update_many in memory: {in_memory:,.0f} samples/s of a core")
    write(folder / "one", 1, 1000)
    starting = {count: identified(folder, count, "one").core for count in (1, options.workers)}
    runs: dict[int, list[Measured]] = {1: [], options.workers: []}
    for _ in range(options.repetitions):
        for count, of in runs.items():
            of.append(identified(folder, count, "logs"))
    walls = {count: sum(run.wall for run in of) / len(of) for count, of in runs.items()}
    rates = {count: total / (sum(run.core for run in of) / len(of) - starting[count]) for count, of in runs.items()}
    for count, of in runs.items():
        print(
            f"{count} worker(s): {walls[count]:.1f} s, {starting[count]:.1f} s of cores to start; "
            f"else {rates[count]:,.0f} samples/s of a core ({rates[count] / in_memory:.2f} of update_many), "
            f"{max(run.memory for run in of):.0f} MB a worker at most, "
            f"{max(run.growth for run in of):+.0f} MB over the second half"
        )
    by_wall = walls[1] / walls[options.workers]
    by_core = options.workers * rates[options.workers] / rates[1]
    print(
        f"{options.workers} workers are {by_wall:.2f} times as fast as 1; by the time of the cores {by_core:.2f} times"
    )
    results = {(run.fleet.folder / "rigs.parquet").read_bytes() for of in runs.values() for run in of}
    print(f"the same bytes: {'yes' if len(results) == 1 else 'NO'}")
    show_odd(runs[1][0].fleet, options)


def alone(options: argparse.Namespace) -> float:
    """Return the samples a second of `update_many`, its start-up included, on records in memory."""
    rigs = [record(1, k, options.samples, kind_of(k, options.rigs, options.odd)) for k in range(1, ALONE + 1)]
    spent = 0.0
    for number, (_, u, y) in enumerate([rigs[0], *rigs]):
        ident = rp.Identifier(poles=2, dt=DT, preprocess=AT_REST)
        begun = time.thread_time()
        ident.update_many(u, y)
        spent += (time.thread_time() - begun) * bool(number)  # the first one loads the kernels
    return ALONE * options.samples / spent


def identified(folder: Path, count: int, logs: str) -> Measured:
    """Identify a fleet anew with so many processes."""
    out = folder / f"out-{count}-{time.time_ns()}"
    seen: list[tuple[float, float]] = []
    begun, before = time.perf_counter(), _spent()
    with _memory_watched(seen):
        fleet = rp.fleet.fit(
            folder / logs, by="rig", input="u", output="y", poles=2, executor=f"processes:{count}", out=out
        )  # fmt: skip
    wall = time.perf_counter() - begun
    memory = [used for _, used in seen] or [0.0]
    later = memory[len(memory) // 2 :]
    return Measured(wall, _spent() - before, max(memory), max(later) - max(memory[: len(memory) // 2] or [0.0]), fleet)


def _spent() -> float:
    """Return the time of cores that the workers have spent, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def _memory_watched(seen: list[tuple[float, float]]) -> Iterator[None]:
    """Collect time and memory of the largest child, in MB."""
    done = threading.Event()

    def watch() -> None:
        while not done.wait(EVERY):
            try:
                sizes = [child.memory_info().rss for child in psutil.Process().children(recursive=True)]
            except psutil.Error:
                continue
            if sizes:
                seen.append((time.monotonic(), max(sizes) / 1e6))

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def show_odd(fleet: rp.fleet.Fleet, options: argparse.Namespace) -> None:
    """Print how many of the odd rigs are among the first ones by rank."""
    table = fleet.table()
    found, names = oddness_of(table, fleet.shape), table.column("rig").to_pylist()
    kinds = {name_of(k): kind for k in range(options.rigs) if (kind := kind_of(k, options.rigs, options.odd))}
    first = [names[row] for row in found.order[: round(1.25 * len(kinds))].tolist()]
    print(f"{sum(name in kinds for name in first)} of {len(kinds)} odd rigs are in the first {len(first)} rows")
    print(f"{int(found.odd.sum())} rigs are named:")
    for row in found.order.tolist():
        if found.odd[row]:
            print(f"  {names[row]} {kinds.get(names[row], 'usual'):8} {found.words[row]}")


if __name__ == "__main__":
    sys.exit(main())
