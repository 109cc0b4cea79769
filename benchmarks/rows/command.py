"""`make rows`: several inputs, in families of records.

    python benchmarks/rows [--seed 1] [--family known] [--runs 100]

"known" has the four cases of `rows.known`, "feedback" the three of `rows.feedback`.  Of each method there are the
largest root mean square of a coefficient's error over that of maximum likelihood begun at the truth, the coverage of
95 % intervals pooled over coefficients, the joint statistic of the mean errors over its limit at 1 %, and how many runs
diverged and were trusted.

"public" has records of public repositories, read from clones in ``--mirror``, beside an output-error fit.

"random" has ``--records`` random plants of ``--inputs`` inputs, through the identifier; "starts" asks how
often the start of a random plant leads to the minimum near the truth.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replant.fleet import sweep
from replant.numerics.operating_system import ask_for_one_thread
from rows import campaign, feedback, known, public, speed
from rows.likelihood import scores


def main() -> int:
    """Run the families asked for and print their tables."""
    options = read_options()
    ask_for_one_thread()
    console = Console(width=None if sys.stdout.isatty() else 160)
    for family in [options.family] if options.family else FAMILIES:
        FAMILIES[family](options, console)
    return 0


def of_cases(family: Any, options: argparse.Namespace, console: Console) -> None:
    """Run every case of a family, and print the scores of its methods."""
    shown = Table("case", "method", "RMS", "coverage", "bias", "diverged", "trusted")
    begun = time.monotonic()
    for case in family.CASES:
        tasks = [(case, number) for number in range(options.runs)]
        runs = sweep(partial(family.carry_out, options.seed), tasks, options.on)
        methods = dict(zip(family.METHODS, zip(*runs, strict=True), strict=True))
        for one in scores(methods, family.TRUTH):
            shown.add_row(
                case, one.name, f"{one.ratio:.3f}", f"{one.coverage:.1f} %", f"{one.bias:.2f}", str(one.diverged),
                str(one.trusted),
            )  # fmt: skip
    shown.title = f"seed {options.seed}, {options.runs} runs, {time.monotonic() - begun:.0f} s"
    console.print(shown)


def of_random(options: argparse.Namespace, console: Console) -> None:
    """Run random plants, and print how many are explained and trusted, and those that are wrong."""
    begun, numbers = time.monotonic(), options.only or range(options.records)
    found = sweep(partial(campaign.judged, options.seed, options.inputs), numbers, options.on)
    shown = Table("", "measured", "wanted")
    for line in campaign.lines(found):
        shown.add_row(*line)
    seconds = time.monotonic() - begun
    shown.title = f"{options.inputs} inputs, seed {options.seed}, {len(found)} records, {seconds:.0f} s"
    console.print(shown)
    for one in found:
        if one.is_good != (one.status == "trusted") or options.only:
            console.print(f"  {one}", markup=False, soft_wrap=True)


def of_starts(options: argparse.Namespace, console: Console) -> None:
    """Print how often the start leads to the minimum near the truth."""
    for correlation in (0.0, 0.9):
        wanted = partial(campaign.is_started, options.seed, options.inputs, correlation)
        found = sweep(wanted, range(options.runs), options.on)
        lost = [number for number, is_started in enumerate(found) if not is_started]
        console.print(
            f"starts, {options.inputs} inputs, correlation {correlation}, seed {options.seed}: "
            f"{sum(found)} of {len(found)}; not {lost}",
        )


def of_public(options: argparse.Namespace, console: Console) -> None:
    """Print the simulated fits of the anchor, of `fit` and of the identifier on public records."""
    shown = Table("record", "output error", "fit", "Identifier", "verdict", title="simulated fits, in percent")
    for record in public.RECORDS:
        name, *fits, status = public.compared(options.mirror, record)
        shown.add_row(name, *(f"{each:.1f}" for each in fits), status)
    console.print(shown)


def of_speed(options: argparse.Namespace, console: Console) -> None:
    """Print the processor times of two inputs and of one, and their ratio."""
    shown = Table("noise", "two inputs", "one input", "ratio", "wanted", title=f"seed {options.seed}, in ms")
    for noise in speed.NOISES:
        runs = [speed.measured(options.seed, noise, number) for number in range(max(options.runs // 10, 1))]
        two, one = 1e3 * np.mean(runs, axis=0)
        shown.add_row(noise, f"{two:.0f}", f"{one:.0f}", f"{two / one:.2f}", f"at most {speed.LIMIT}")
    console.print(shown)


FAMILIES: dict[str, Callable[[argparse.Namespace, Console], None]] = {
    "known": partial(of_cases, known), "feedback": partial(of_cases, feedback), "random": of_random,
    "starts": of_starts, "public": of_public, "speed": of_speed,
}  # fmt: skip


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--family", choices=FAMILIES, help="this one alone; default: all")
    parser.add_argument("--runs", type=int, default=100, help="of each case, and starts; of speeds a tenth")
    parser.add_argument("--records", type=int, default=300, help="random plants")
    parser.add_argument("--inputs", type=int, default=2, help="of random plants")
    parser.add_argument("--mirror", type=Path, default=Path("out/mirror"), help="folder of git directories")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these random plants alone")
    parser.add_argument(
        "--on", default="processes:1", metavar="WHERE", help="threads:N, processes:N or dask://HOST:PORT"
    )
    return parser.parse_args()
