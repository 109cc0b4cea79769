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
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

from rich.console import Console
from rich.progress import track
from rich.table import Table

from accuracy.work import prepare_environment
from campaign import actuators
from campaign.outcome import Outcome, judged
from campaign.plants import drawn
from campaign.table import Campaign

ACTUATORS, TOGGLING, SMOOTH, SURPLUS = 15, 10, 30, 12  # records, rigs


def main() -> int:
    """Run the campaign, print its table and its worst records."""
    options = read_options()
    prepare_environment()
    console = Console(width=None if sys.stdout.isatty() else 160)
    numbers = options.only or range(options.records)
    begun = time.monotonic()
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        special = [] if options.only else [
            pool.submit(actuators.behind_actuators, options.seed, ACTUATORS),
            pool.submit(actuators.toggling, options.seed, TOGGLING),
            pool.submit(actuators.smooth_inputs, options.seed, SMOOTH),
            pool.submit(actuators.surplus_poles, options.seed, SURPLUS),
        ]  # fmt: skip
        results = pool.map(partial(carry_out, options.seed), numbers, chunksize=4)
        outcomes = list(track(results, "records", len(numbers), console=Console(stderr=True)))
        if options.only:
            for one in outcomes:
                console.print(one)
            return 0
        others = [each.result() for each in special]
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


def carry_out(seed: int, number: int) -> Outcome:
    """Make one record and identify it, in a process of its own."""
    return judged(drawn(seed, number))


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--records", type=int, default=1000)
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these records alone")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="default: every core")
    return parser.parse_args()
