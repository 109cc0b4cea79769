"""`make campaign`: the online default on random plants, beside `replant.fit` and the Cramer-Rao bound.

    python benchmarks/campaign [--seed 1] [--records 1000] [--only NUMBER ...]

Another seed gives other records.  ``--only`` runs single records again, by their numbers.  Ends with exit code 1 where
the table misses what is wanted.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from accuracy.work import prepare_environment
from campaign import actuators
from campaign.outcome import judged
from campaign.plants import drawn
from campaign.table import Campaign
from replant.fleet import sweep

ACTUATORS, TOGGLING, SMOOTH, SURPLUS = 15, 10, 30, 12  # records, rigs
SPECIAL: dict[str, tuple[Callable[[int, int], Any], int]] = {
    "behind actuators": (actuators.behind_actuators, ACTUATORS),
    "toggling": (actuators.toggling, TOGGLING),
    "smooth inputs": (actuators.smooth_inputs, SMOOTH),
    "surplus poles": (actuators.surplus_poles, SURPLUS),
}


def main() -> int:
    """Run the campaign, print its table and its worst records."""
    options = read_options()
    prepare_environment()
    console = Console(width=None if sys.stdout.isatty() else 160)
    numbers = options.only or range(options.records)
    begun = time.monotonic()
    special = [] if options.only else list(SPECIAL)
    with Progress(console=Console(stderr=True)) as shown:
        bar = shown.add_task("records", total=len(special) + len(numbers))
        found = sweep(
            partial(carry_out, options.seed), [*special, *numbers], options.on,
            lambda done, of: shown.update(bar, completed=done),
        )  # fmt: skip
    others, outcomes = found[: len(special)], found[len(special) :]
    if options.only:
        for one in outcomes:
            console.print(one)
        return 0
    campaign = Campaign(outcomes, *others, SURPLUS)
    shown = Table(title=f"seed {options.seed}, {len(outcomes)} records, {time.monotonic() - begun:.0f} s")
    for column in ("", "measured", "wanted", ""):
        shown.add_column(column)
    lines = list(campaign.lines())
    for line in lines:
        mark = "" if line.kept is None else "yes" if line.kept else "NO"
        shown.add_row(line.what, line.measured, line.wanted, mark)
    console.print(shown)
    for worst in campaign.worst():
        console.print(f"  {worst}", markup=False)
    return 0 if all(line.kept is not False for line in lines) else 1


def carry_out(seed: int, task: int | str) -> Any:
    """Make one record by its number and identify it, or those of `SPECIAL` by their name."""
    if isinstance(task, str):
        make, count = SPECIAL[task]
        return make(seed, count)
    return judged(drawn(seed, task))


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--records", type=int, default=1000)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these records alone")
    parser.add_argument(
        "--on", default=f"processes:{os.cpu_count()}", metavar="WHERE",
        help="threads:N, processes:N or dask://HOST:PORT; default: every core",
    )  # fmt: skip
    return parser.parse_args()
