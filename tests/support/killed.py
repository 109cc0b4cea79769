"""Processes that save in a loop and are killed at random moments; run as a script, warmed once for all of them.

    python killed.py FILE KILLS SEED

Each goes on from what the one before it left.  Prints one JSON object: how many kills came during a saving, how often
the previous file had to be used, and whether all that was loaded equals an identifier that was never interrupted.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from pathlib import Path

import numpy as np

import replant as rp
from replant.online import saving

DT = 0.05
LONGEST = 0.02  # s from the first saving to the kill: some savings later


def save_until_killed(file: Path, ident: rp.Identifier, u: np.ndarray, y: np.ndarray, ready: int) -> None:
    for k in range(ident.samples, u.size):
        ident.update(u[k], y[k])
        ident.save(file, {"sequence": k + 1})
        if ready:
            os.write(ready, b"!")
            os.close(ready)
            ready = 0


def kill_one(file: Path, ident: rp.Identifier, u: np.ndarray, y: np.ndarray, delay: float) -> None:
    """Let a process save from ``ident`` on, and kill it ``delay`` s after its first saving."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            save_until_killed(file, ident, u, y, writer)
        finally:
            os._exit(1)
    os.close(writer)
    os.read(reader, 1)
    os.close(reader)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def main(file: Path, kills: int, seed: int) -> None:
    generator = random.Random(seed)
    plant, u = rp.TransferFunction([1.0, 4.0], [1.0, 2.0, 4.0]), np.repeat([1.0, -1.0, -1.0, 1.0, -1.0], 20_000)
    u = np.random.default_rng(seed).permutation(u)
    y = plant.simulate(u, DT)
    ident = rp.Identifier(rp.Structure(2, 1), DT)
    ident.update_many(u[:999], y[:999])
    ident.update(u[999], y[999])  # now both kernels are loaded: each process would do so by itself
    whole, taken = ident.clone(), 1_000
    during = previous = different = 0
    for _ in range(kills):
        kill_one(file, ident, u, y, generator.uniform(0.0, LONGEST))
        during += Path(f"{file}.new").exists() or Path(f"{file}.old").exists()
        loaded = saving.load(file)
        ident = loaded.identifier
        previous += loaded.used_previous is not None
        sequence = int(loaded.progress["sequence"])
        whole.update_many(u[taken:sequence], y[taken:sequence])
        taken = sequence
        different += whole.to_bytes() != ident.to_bytes()
    print(json.dumps({"during": during, "previous": previous, "different": different, "samples": taken}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
