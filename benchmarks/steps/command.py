"""`make steps`: the structure search and `fit` on step tests, the records that control engineers make most.

    python benchmarks/steps [--seed 1] [--runs 10]

Six plants of one and two poles, of which each test tells the search a range of orders and of dead times alone; one
textbook case with the order given; and the time of a search over 42 structures.  Of a step test:

* dead time found: within two sampling times of the plant's;
* order told apart: the best model with one pole less, fitted to the output without noise by output error, is expected
  to cost more than `APART` in log-likelihood: its error's sum of squares over twice the noise's variance;
* known: every coefficient lies within 10 % and three standard deviations of the plant's;
* right: known, or the output without noise explained to 95 %, the model run from rest.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from replant.fleet import sweep
from replant.numerics.operating_system import ask_for_one_thread
from steps.cases import APART, CASES, TEXTBOOK, TEXTBOOK_SAMPLES
from steps.outcome import LONG, STRUCTURES, Outcome, carry_out, long_search

Which = Callable[[Outcome], bool]
#: What is counted: its words, whether a test is one, and of which tests.
COUNTS: dict[str, tuple[Which, Which]] = {
    "dead time": (lambda one: one.is_delay_found, lambda one: True),
    "order, of those apart": (lambda one: one.is_order_right, lambda one: one.nats > APART),
    "order, of the others": (lambda one: one.is_order_right, lambda one: one.nats <= APART),
    "search: right": (lambda one: one.searched.is_right, lambda one: True),
    "search: trusted, of the right": (lambda one: one.searched.is_trusted, lambda one: one.searched.is_right),
    "search: trusted, of the wrong": (lambda one: one.searched.is_trusted, lambda one: not one.searched.is_right),
    "`fit`: right": (lambda one: one.fitted.is_right, lambda one: True),
    "`fit`: known": (lambda one: one.fitted.known, lambda one: True),
    "`fit`: trusted, of the right": (lambda one: one.fitted.is_trusted, lambda one: one.fitted.is_right),
    "`fit`: trusted, of the wrong": (lambda one: one.fitted.is_trusted, lambda one: not one.fitted.is_right),
}


def counted(tests: Sequence[Outcome], which: Which, of: Which) -> str:
    """Return how many of some tests are so, in words."""
    group = [one for one in tests if of(one)]
    return f"{sum(map(which, group))}/{len(group)}" if group else "-"


def table_of(title: str, groups: dict[str, Sequence[Outcome]]) -> Table:
    """Return a table with a column for each group."""
    table = Table("", *groups, title=title)
    for name, count in COUNTS.items():
        table.add_row(name, *(counted(group, *count) for group in groups.values()))
    for name, way in (("search", "searched"), ("`fit`", "fitted")):
        times = [sum(getattr(one, way).seconds for one in group) / max(len(group), 1) for group in groups.values()]
        table.add_row(f"{name}: processor time, s each", *(f"{seconds:.3f}" for seconds in times))
    return table


def main() -> int:
    """Run the step tests, print their tables and those that failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=10, help="of each plant")
    parser.add_argument("--on", default=f"processes:{os.cpu_count()}", metavar="WHERE", help="as in the campaign")
    options = parser.parse_args()
    ask_for_one_thread()
    console = Console(width=None if sys.stdout.isatty() else 160)
    runs = range(options.runs)
    tasks = [(case, number, 0) for case in range(len(CASES)) for number in runs]
    tasks += [(CASES.index(TEXTBOOK), number, samples) for samples in TEXTBOOK_SAMPLES for number in runs]
    with Progress(console=Console(stderr=True)) as shown:
        bar = shown.add_task("step tests", total=len(tasks))
        found = sweep(
            partial(carry_out, options.seed), tasks, options.on, lambda done, of: shown.update(bar, completed=done)
        )
    names = [*(case.name.partition(":")[0] for case in CASES), *(f"{size} samples" for size in TEXTBOOK_SAMPLES)]
    groups = {name: found[k * len(runs) : (k + 1) * len(runs)] for k, name in enumerate(names)}
    count = len(CASES) * len(runs)
    six, textbook = dict(list(groups.items())[: len(CASES)]), dict(list(groups.items())[len(CASES) :])
    console.print(table_of(f"seed {options.seed}: poles 1 to 3, dead time unknown", six | {"all": found[:count]}))
    console.print(table_of(f"{TEXTBOOK.name}: -p 1 --delay 0:6:1", textbook | {"all": found[count:]}))
    seconds, words = long_search(options.seed)
    console.print(f"{STRUCTURES} structures on {LONG} samples: {seconds:.1f} s of processor time ({words})")
    for one in found:
        if not (one.is_delay_found and one.is_order_right and one.fitted.is_right and one.fitted.is_trusted):
            console.print(in_words(one), markup=False, soft_wrap=True)
    return 0


def in_words(one: Outcome) -> str:
    """Return what came of a test in a line."""
    searched, fitted = one.searched, one.fitted
    return (
        f"  {CASES[one.case].name} {one.number} ({one.what}, {one.nats:.1f} nats): search {searched.poles} poles, "
        f"{searched.zeros} zeros, dead time {searched.delay_off:+.1f} samples off, {searched.fit:.1f} % "
        f"{searched.status}; `fit` {fitted.fit:.1f} % {fitted.status}" + (f"; {one.problem}" if one.problem else "")
    )
