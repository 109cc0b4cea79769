"""`make rows`: several inputs, in families of records.

    python benchmarks/rows [--seed 1] [--family known] [--runs 100]

"known" has the four cases of `rows.known`.  Of each method there are the largest root mean square of a coefficient's
error over that of maximum likelihood begun at the truth, the coverage of 95 % intervals pooled over coefficients, the
joint statistic of the mean errors over its limit at 1 %, and how many runs diverged and were trusted.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from accuracy.work import prepare_environment
from replant.fleet import sweep
from rows import known
from rows.likelihood import scores


def main() -> int:
    """Run the families asked for and print their tables."""
    options = read_options()
    prepare_environment()
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


FAMILIES: dict[str, Callable[[argparse.Namespace, Console], None]] = {"known": partial(of_cases, known)}


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--family", choices=FAMILIES, help="this one alone; default: all")
    parser.add_argument("--runs", type=int, default=100, help="of each case")
    parser.add_argument(
        "--on", default="processes:1", metavar="WHERE", help="threads:N, processes:N or dask://HOST:PORT"
    )
    return parser.parse_args()
