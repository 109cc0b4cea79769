"""`make campaign`: the online default and `replant.fit` on two families of random plants.

    python benchmarks/campaign [--seed 1] [--family random|field] [--records N] [--only NUMBER ...]

"random" has long records of rich inputs, beside the Cramer-Rao bound; "field" short ones of smooth inputs, of coarse
sensors and with holes, beside an output-error fit that begins at the truth (`campaign.field`).  Without ``--family``
both are run.  Another seed gives other records.  ``--only`` runs single records again, by their numbers.  Ends with
exit code 1 where the table of "random" misses what is wanted.

What came of each field record stands in out/campaign/outcomes, its anchor beside it: a second run finds the anchors.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from campaign import actuators, field, field_outcome, reasons
from campaign.field_table import FieldTable
from campaign.outcome import judged
from campaign.plants import drawn
from campaign.table import Campaign, Line
from replant.fleet import sweep
from replant.numerics.operating_system import ask_for_one_thread

OUT = Path(__file__).resolve().parents[2] / "out" / "campaign"
ACTUATORS, TOGGLING, SMOOTH, SURPLUS = 15, 10, 30, 12  # records, rigs
SPECIAL: dict[str, tuple[Callable[[int, int], Any], int]] = {
    "behind actuators": (actuators.behind_actuators, ACTUATORS),
    "toggling": (actuators.toggling, TOGGLING),
    "smooth inputs": (actuators.smooth_inputs, SMOOTH),
    "surplus poles": (actuators.surplus_poles, SURPLUS),
}


def main() -> int:
    """Run the campaign, print its tables and its worst records."""
    options = read_options()
    ask_for_one_thread()
    console = Console(width=None if sys.stdout.isatty() else 160)
    families = [options.family] if options.family else ["random"] if options.only else list(FAMILIES)
    return max([FAMILIES[family](options, console) for family in families])


def of_random(options: argparse.Namespace, console: Console) -> int:
    """Run the family "random"; return 1 where what is wanted is missed."""
    special = [] if options.only else list(SPECIAL)
    numbers = options.only or range(options.records or 1000)
    found, seconds = carried_out(carry_out, [*special, *numbers], options)
    others, outcomes = found[: len(special)], found[len(special) :]
    if options.only:
        console.print(*outcomes, sep="\n")
        return 0
    campaign = Campaign(outcomes, *others, SURPLUS)
    lines = list(campaign.lines())
    console.print(table_of(f"seed {options.seed}, {len(outcomes)} records, {seconds:.0f} s", lines))
    console.print(reasons.table({"online": [(one.reason, one.is_good) for one in outcomes if one.status != "trusted"]}))
    for worst in campaign.worst():
        console.print(f"  {worst}", markup=False)
    return 0 if all(line.kept is not False for line in lines) else 1


def of_field(options: argparse.Namespace, console: Console) -> int:
    """Run the family "field"; return 0."""
    outcomes, seconds = carried_out(carry_out_field, options.only or range(options.records or 500), options)
    if options.only:
        console.print(*outcomes, sep="\n")
        return 0
    found = FieldTable(outcomes)
    title = f"field records, seed {options.seed}, {len(outcomes)} records, {seconds:.0f} s"
    console.print(table_of(title, list(found.lines())))
    console.print(found.by_feature())
    console.print(found.by_reason())
    for lost in found.losing():
        console.print(lost, markup=False, soft_wrap=True)
    return 0


FAMILIES = {"random": of_random, "field": of_field}


def carried_out(
    function: Callable[[int, Any], Any], tasks: Sequence[Any], options: argparse.Namespace
) -> tuple[list[Any], float]:
    """Return what a function of the seed gives for each task, and the time in s that it took."""
    begun = time.monotonic()
    with Progress(console=Console(stderr=True)) as shown:
        bar = shown.add_task("records", total=len(tasks))
        found = sweep(
            partial(function, options.seed), tasks, options.on, lambda done, of: shown.update(bar, completed=done)
        )
    return found, time.monotonic() - begun


def table_of(title: str, lines: Sequence[Line]) -> Table:
    """Return the lines as a table."""
    shown = Table(title=title)
    for column in ("", "measured", "wanted", ""):
        shown.add_column(column)
    for line in lines:
        mark = "" if line.kept is None else "yes" if line.kept else "NO"
        shown.add_row(line.what, line.measured, line.wanted, mark)
    return shown


def carry_out(seed: int, task: int | str) -> Any:
    """Make one record by its number and identify it, or those of `SPECIAL` by their name."""
    if isinstance(task, str):
        make, count = SPECIAL[task]
        return make(seed, count)
    return judged(drawn(seed, task))


def carry_out_field(seed: int, number: int) -> field_outcome.FieldOutcome:
    """Make one field record by its number and identify it."""
    name = f"{seed}-{number}.json"
    outcome = field_outcome.judged(field.drawn(seed, number), OUT / "anchors" / name)
    (OUT / "outcomes").mkdir(exist_ok=True)
    (OUT / "outcomes" / name).write_text(json.dumps(asdict(outcome)))
    return outcome


def read_options() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--family", choices=FAMILIES, help="this one alone; default: both, with --only random")
    parser.add_argument("--records", type=int, help="of each family; default: 1,000 random, 500 field")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="these records alone")
    parser.add_argument(
        "--on", default=f"processes:{os.cpu_count()}", metavar="WHERE",
        help="threads:N, processes:N or dask://HOST:PORT; default: every core",
    )  # fmt: skip
    return parser.parse_args()
