"""The long run over file formats: mutants of small files, each read in a fork with the limits of one that reads.

A finding is a raw exception, a warning, a message that is not one line, a hang, or memory or time outside the bounds;
in a format that a user's process reads itself, a crash too.
"""

from __future__ import annotations

import random
import tempfile
import time
from collections import Counter
from pathlib import Path

from fuzz.damage import mutant
from fuzz.seeds_of_files import FORMATS, path_of, seeds_of
from support.forks import Forks, Outcome, is_isolated

MOST_MEMORY = 300.0  # MiB beyond what the libraries take: the mutants hold a few samples
MOST_SECONDS = 10.0


def run_file(name: str, first: int, seconds: float, tries: int | None = None) -> int:
    """Try mutants of a format for so many seconds, or so many; print a line, and return the number of findings."""
    counts: Counter[str] = Counter()
    findings: dict[str, list[int]] = {}
    memory = longest = 0.0
    begun, number = time.monotonic(), first
    with tempfile.TemporaryDirectory(prefix="replant-fuzz-") as folder, Forks(*FORMATS[name][2]) as forks:
        path, seeds = path_of(Path(folder), name), seeds_of(name)
        for seed in seeds:
            path.write_bytes(seed)
            outcome = forks.read(path)
            assert outcome.kind == "read", f"{name}: a valid file is not read: {outcome}"
        while number - first < tries if tries else time.monotonic() - begun < seconds:
            path.write_bytes(mutant(name, seeds, random.Random(number)))
            outcome = forks.read(path)
            counts[outcome.kind] += 1
            memory, longest = max(memory, outcome.memory), max(longest, outcome.seconds)
            words = finding(path, outcome)
            if words:
                findings.setdefault(words[:150], []).append(number)
            number += 1
    told = ", ".join(f"{count:,} {kind}" for kind, count in sorted(counts.items()))
    print(
        f"{name}: {number - first:,} tries in {time.monotonic() - begun:,.0f} s: {told}; worst {memory:.0f} MiB, "
        f"{longest:.1f} s; {len(findings)} kinds of findings",
        flush=True,
    )
    for words, numbers in findings.items():
        print(f"  {len(numbers)} times, first in {numbers[0]}: {words}", flush=True)
    return len(findings)


def finding(path: Path, outcome: Outcome) -> str:
    """What must not have happened; empty if all is well."""
    if outcome.kind in ("raw", "hung"):
        return f"{outcome.kind} {outcome.words}".replace(str(path), "PATH")
    if outcome.kind in ("crashed", "out of time") and not is_isolated(path):
        return f"{outcome.kind} {outcome.words}"
    if outcome.memory > MOST_MEMORY:
        return f"{outcome.memory:.0f} MiB"
    if outcome.seconds > MOST_SECONDS + 1.0:  # the system counts whole seconds
        return f"{outcome.seconds:.0f} s"
    return ""
