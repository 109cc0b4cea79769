"""`make accuracy`: Monte Carlo over scenarios and methods; one page of Markdown, one file of JSON.

A whole run writes docs/accuracy.md and the measured table of docs/methods.md; a part of it writes beside its JSON.
Exit code 1 says that a promise is not kept, 2 that there was nothing to measure.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from accuracy import guide, work
from accuracy.report import MARK, promised, write
from accuracy.rigs import data_folder
from accuracy.scenarios import LETTERS, VERDICTS, chosen
from accuracy.summary import summarise

ROOT = Path(__file__).resolve().parents[2]
PAGE, GUIDE = ROOT / "docs/accuracy.md", ROOT / "docs/methods.md"
PARTIAL, DATA = "accuracy.md", "accuracy.json"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write both files, print what is promised and what was measured."""
    options = read_options(arguments)
    console = Console(width=None if sys.stdout.isatty() else 200)
    work.prepare_environment()
    letters = options.scenario or LETTERS
    asked = chosen(letters)
    if not data_folder().is_dir():
        left_out = [each.key for each in asked if each.reads_data]
        asked = [each for each in asked if not each.reads_data]
        if left_out:
            console.print(f"left out, no recorded logs at {data_folder()} (set REPLANT_DATA): {', '.join(left_out)}")
    if not asked and VERDICTS not in letters:
        return 2
    results = work.carry_out(asked, options.runs, VERDICTS in letters, options.on)
    summaries = [summarise(each, results.figures[each.key]) for each in asked]
    whole = not options.scenario and not options.runs
    page = PAGE if whole else options.out / PARTIAL
    write(summaries, results.verdicts, page, options.out / DATA)
    if whole:
        guide.insert(GUIDE, summaries)
    met = show(console, list(promised(summaries, results.verdicts)))
    console.print(f"wrote {page} and {options.out / DATA}")
    return 0 if met else 1


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(prog="accuracy", description=__doc__)
    parser.add_argument("--scenario", nargs="+", choices=LETTERS, metavar="A", help=f"of {' '.join(LETTERS)}")
    parser.add_argument("--runs", type=int, metavar="N", help="at most so many of each")
    parser.add_argument(
        "--on", default=f"processes:{os.cpu_count()}", metavar="WHERE",
        help="threads:N, processes:N or dask://HOST:PORT; default: every core",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "out/accuracy", metavar="DIR")
    return parser.parse_args(arguments)


def show(console: Console, rows: Sequence[Sequence[str]]) -> bool:
    """Print what is promised beside what was measured; return whether all of it is kept."""
    shown = Table(box=box.SIMPLE)
    for column in ("experiment", "method", "bound", "measured", ""):
        shown.add_column(column)
    for row in rows:
        shown.add_row(*(cell.replace("**", "") for cell in row), style="red" if row[-1] == MARK[False] else None)
    console.print(shown)
    return all(row[-1] != MARK[False] for row in rows)
