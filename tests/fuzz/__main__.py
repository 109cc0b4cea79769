"""The long run: `make fuzz`; SECONDS= or ARGS="--first 0 --only calls --tries 5000" say how long and what.

SECONDS are those of all but the files, and a tenth of them those of each file format; of what --only names, all.

Each trial is a number, from which it follows; a worker takes one after the other in a process of its own, so that one
that crashes or hangs is found and counted, and the next one goes on behind it.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib.util
import math
import selectors
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

from fuzz.files import run_file
from fuzz.seeds_of_files import FORMATS

STILL = 120.0  # s without a word from a worker: it hangs
BY_COUNT = ["calls", "commands"]  # of which a number of trials says more than a time
PORTION = 500  # trials of a worker: what one leaves behind in memory goes with it


def main() -> int:
    """Run trials for so many seconds; print tries, time and findings, and return how many kinds of these there are."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--first", type=int, default=1_000_000)
    parser.add_argument(
        "--what", "--only", choices=["checkpoints", "plainly", "narrow", *BY_COUNT, *FORMATS, "all"], default="all"
    )
    parser.add_argument("--tries", type=int, help="so many trials, instead of so many seconds")
    parser.add_argument("--worker", type=int, nargs=2, metavar=("FIRST", "LAST"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        return work(options.what, *options.worker)
    shares = {"checkpoints": 0.7, "plainly": 0.1, "narrow": 0.05, "calls": 0.1, "commands": 0.05}
    shares |= dict.fromkeys(FORMATS, 0.1)
    shares = shares if options.what == "all" else {options.what: 1.0}
    found = 0
    for what, share in shares.items():
        seconds, tries = share * options.seconds, sys.maxsize
        if options.tries is not None:
            seconds, tries = math.inf, options.tries
        if what not in FORMATS:
            found += run(what, options.first, seconds, options.first + tries)
        elif missing := [package for package in FORMATS[what][2] if not _is_installed(package)]:
            print(f"{what}: left out, as {missing[0]} is not installed")
        else:
            found += run_file(what, options.first, seconds, options.tries)
    return min(found, 1)


def _is_installed(package: str) -> bool:
    return importlib.util.find_spec(package.partition(".")[0]) is not None


def run(what: str, number: int, seconds: float, end: int) -> int:
    """Let workers take trials from ``number`` to ``end``, for so many seconds; print what came of them."""
    begun, outcomes, findings = time.monotonic(), Counter[str](), {}
    while time.monotonic() - begun < seconds and number < end:
        left = seconds - (time.monotonic() - begun)
        number = _portion(what, number, min(number + PORTION, end), left, outcomes, findings)
    elapsed = time.monotonic() - begun
    told = ", ".join(f"{count:,} {outcome}" for outcome, count in sorted(outcomes.items()))
    print(f"{what}: {sum(outcomes.values()):,} tries in {elapsed:,.0f} s: {told}; {len(findings)} kinds of findings")
    for words, numbers in findings.items():
        print(f"  {len(numbers)} times, first in {numbers[0]}: {words}")
    return len(findings)


def _portion(
    what: str, number: int, end: int, seconds: float, outcomes: Counter[str], findings: dict[str, list[int]]
) -> int:
    """Let one worker take trials from ``number`` to ``end``; return the number of the next one."""
    command = [sys.executable, "-m", "fuzz", "--what", what, "--worker", str(number), str(end)]
    begun = time.monotonic()
    with (
        subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[1],
        ) as worker,
        selectors.DefaultSelector() as waiting,
    ):
        assert worker.stdout is not None
        assert worker.stderr is not None
        waiting.register(worker.stdout, selectors.EVENT_READ)
        while True:
            if not waiting.select(STILL):
                worker.kill()
                outcomes["finding"] += 1
                findings.setdefault("it hangs", []).append(number)
                return number + 1
            line = worker.stdout.readline()
            if not line:
                break
            outcome, _, words = line.rstrip("\n").partition("\t")
            outcomes[outcome] += 1
            if words:
                findings.setdefault(words, []).append(number)
                print(f"{what} {number}: {words}", flush=True)
            number += 1
            if time.monotonic() - begun > seconds:
                worker.kill()
                return number
        if worker.wait():
            outcomes["finding"] += 1
            words = f"it crashed ({worker.returncode}): {' | '.join(worker.stderr.read().split(chr(10))[:12])}"
            findings.setdefault(words[:600], []).append(number)
            print(f"{what} {number}: {words[:600]}", flush=True)
            return number + 1
    return number


def work(what: str, first: int, last: int) -> int:
    """Take trials, a line each."""
    faulthandler.enable()
    if what == "plainly":
        from fuzz.plainly import make_plain

        make_plain()
    from fuzz.trial import FindingError

    act = trial_of(what)
    for number in range(first, last):
        try:
            outcome = act(number)
        except FindingError as error:
            cause = error.__cause__
            place = ""
            if cause is not None and cause.__traceback__ is not None:
                trace = cause.__traceback__
                while trace.tb_next is not None:
                    trace = trace.tb_next
                place = f" at {Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
            outcome = f"finding\t{' '.join(str(error).split())[:200]}{place}"
        print(outcome, flush=True)
    return 0


def trial_of(what: str) -> Callable[[int], str]:
    """Return what makes one trial, by its number."""
    if what == "calls":
        from fuzz.calls import trial as call

        return call
    if what == "commands":
        from fuzz.commands import trial as command

        return command
    from fuzz.trial import narrow_trial, trial

    return narrow_trial if what == "narrow" else partial(trial, plainly=what == "plainly")


if __name__ == "__main__":
    sys.exit(main())
