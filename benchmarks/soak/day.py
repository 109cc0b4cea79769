"""A day of rig time through a session in fast replay: memory flat, estimate within its bands, checkpoint of one size.

The demo's rig at 1 kHz, 86.4 million samples, simulated as fast as they are learned.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from replant.errors import CheckpointError
from replant.online import saving
from replant.rigs import DEAP

DAY = 86_400_000
EVERY = 10.0  # s between two looks
SETTLED = 20.0  # s that memory gets to settle
GROWTH = 5.0  # MB that it may grow then
COUNTERS = 64  # bytes by which checkpoints may differ: the digits of what is counted
SIGMAS = 4.0  # of its own standard deviations that a coefficient may be off: one of five in 30,000 runs is


def resident(pid: int) -> float:
    """Return the resident memory of a process in MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


def sizes_of(path: Path) -> set[int]:
    return {found.stat().st_size for found in (path, path.with_name(path.name + ".previous")) if found.exists()}


def watch(process: subprocess.Popen[str], path: Path) -> tuple[list[float], set[int]]:
    """Print a line now and then; return memory since it has settled, and the sizes of the checkpoints."""
    begun, memory, sizes = time.monotonic(), [], set()
    while process.poll() is None:
        time.sleep(EVERY)
        gone = time.monotonic() - begun
        try:
            size, kept = resident(process.pid), saving.load(path)
        except (OSError, ValueError, IndexError, CheckpointError):
            continue
        taken = int(kept.progress["taken"])
        if gone > SETTLED and size > 0.0:  # a process that has just ended has none
            memory.append(size)
            sizes |= sizes_of(path)
        print(
            f"{gone:6.0f} s  {taken / 3.6e6:6.2f} h of rig time  {taken / gone:9,.0f} samples/s  {size:6.1f} MB",
            flush=True,
        )
    return memory, sizes


def complaints(path: Path, samples: int, memory: list[float], sizes: set[int]) -> list[str]:
    """Return what is not as it should be."""
    identifier = saving.load(path).identifier
    true = np.concatenate([DEAP.den[1:], DEAP.num])
    distance = np.abs(identifier.parameters - true) / identifier.uncertainty.std
    for name, value, std, off in zip(
        identifier.names, identifier.parameters, identifier.uncertainty.std, distance, strict=True
    ):
        print(f"{name}: {value:.8g} +- {std:.2g}, off by {off:.1f} sigma")
    growth = memory[-1] - memory[0] if memory else float("nan")
    print(
        f"memory grew by {growth:.1f} MB; checkpoints of {sorted(sizes)} bytes; verdict: {identifier.assess().status}"
    )
    found = []
    if identifier.samples != samples:
        found.append(f"{identifier.samples:,} of {samples:,} samples were learned")
    if not growth < GROWTH:
        found.append("memory grew")
    if not (distance < SIGMAS).all():
        found.append("the estimate has left its bands")
    if max(sizes, default=0) - min(sizes, default=0) > COUNTERS:
        found.append("the checkpoint changed its size")
    return found


def run(samples: int) -> list[str]:
    """Run so many samples through a session; return what is not as it should be."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "soak")
        command = [
            sys.executable, "-m", "replant", "live", "demo?speed=max", "--samples", str(samples),
            "--checkpoint", str(path), "--every", "5s", "--dashboard", "127.0.0.1:0",
        ]  # fmt: skip
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        threading.Thread(target=process.stderr.read, daemon=True).start()
        try:
            memory, sizes = watch(process, path)
        finally:
            process.kill()
        return complaints(path, samples, memory, sizes)
