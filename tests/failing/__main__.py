"""Let the calls of a live session fail, one a session: ``python tests/failing``; prints tries and findings."""

from __future__ import annotations

import argparse
import errno
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1])]

import conftest  # noqa: E402, F401 - names the kernels' cache
from failing.cases import ERRORS, LARGE, Fault, Mother, Outcome, findings, mother  # noqa: E402

LASTING = 6  # cases of a kind in which all later calls fail, too


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=ERRORS, default=list(ERRORS), help="all by default")
    parser.add_argument("--roles", nargs="+", choices=("session", "observer"), default=["session", "observer"])
    parser.add_argument("--first", type=int, default=50, help="of each kind all calls up to this one")
    parser.add_argument("--most", type=int, default=100, help="of the later ones so many, drawn at random")
    parser.add_argument("--least", type=int, default=LARGE, help="bytes from which on an allocation counts")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="print what held, too")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, mother(Path(folder)) as running:
        return exhaust(running, chosen)


def exhaust(running: Mother, chosen: argparse.Namespace) -> int:
    generator, begun, wrong = random.Random(chosen.seed), time.monotonic(), 0
    clean = running.run(Fault("alloc", 0, errno.ENOMEM, least=chosen.least))  # fails nothing, counts as the others do
    show("role", "kind", "calls", "tries", "failed", "went on", "ended", "findings")
    for role in chosen.roles:
        for kind in chosen.kinds:
            calls, row = clean.counts[role][kind], [0] * 5
            for fault in faults(kind, role, calls, chosen, generator):
                outcome = running.run(fault)
                found = findings(outcome, fault)
                counts = (True, outcome.fired > 0, outcome.code == 0, outcome.code not in (0, None), bool(found))
                row = [total + one for total, one in zip(row, counts, strict=True)]
                if found or chosen.verbose:
                    say(fault, outcome, found)
            wrong += row[-1]
            show(role, kind, calls, *row)
    print(f"{wrong} findings in {time.monotonic() - begun:.0f} s")
    return int(wrong > 0)


def show(*cells: object) -> None:
    print("".join(f"{cell!s:>10}" for cell in cells), flush=True)


def say(fault: Fault, outcome: Outcome, found: list[str]) -> None:
    """Print what came of a case, with the last thing that it said on standard error."""
    result = "; ".join(found) or f"{outcome.seconds:.0f} s, exit code {outcome.code}"
    word = (outcome.said or outcome.err.splitlines() or [""])[-1]
    print(f"{'!' if found else ' '} {fault} ({outcome.call}): {result}: {word!r}", flush=True)


def faults(kind: str, role: str, calls: int, chosen: argparse.Namespace, generator: random.Random) -> list[Fault]:
    """Return each call's failure, and what lasts from then on; errors take turns."""
    numbers = list(range(1, min(calls, chosen.first) + 1))
    numbers += sorted(generator.sample(range(len(numbers) + 1, calls + 1), min(calls - len(numbers), chosen.most)))
    errors, least = ERRORS[kind], chosen.least if kind == "alloc" else 0
    once = [Fault(kind, n, errors[k % len(errors)], role=role, least=least) for k, n in enumerate(numbers)]
    lasting = [Fault(kind, n, errors[0], True, role, least) for n in numbers[:: max(len(numbers) // LASTING, 1)]]
    return once + lasting


if __name__ == "__main__":
    sys.exit(main())
