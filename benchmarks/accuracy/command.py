"""`make accuracy`: Monte Carlo over scenarios and methods; tables, one page of Markdown, one file of JSON.

A run of some scenarios renews their rows in docs/accuracy/*.csv, and from the tables docs/accuracy.md and the measured
table of docs/methods.md.  With fewer runs of each the page and its tables lie beside the JSON.
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

from accuracy import guide, report, results, work
from accuracy.rigs import data_folder
from accuracy.scenarios import LETTERS, VERDICTS, chosen, experiments
from accuracy.summary import summarise
from replant.numerics.operating_system import ask_for_one_thread

ROOT = Path(__file__).resolve().parents[2]
DOCS, GUIDE = ROOT / "docs", "methods.md"
PAGE, TABLES, DATA = "accuracy.md", "accuracy", "accuracy.json"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write both files, print what is promised and what was measured."""
    options = read_options(arguments)
    console = Console(width=None if sys.stdout.isatty() else 200)
    ask_for_one_thread()
    letters = options.scenario or LETTERS
    asked = chosen(letters)
    if not data_folder().is_dir():
        left_out = [each.key for each in asked if each.reads_data]
        asked = [each for each in asked if not each.reads_data]
        if left_out:
            console.print(f"left out, no recorded logs at {data_folder()} (set REPLANT_DATA): {', '.join(left_out)}")
    if not asked and VERDICTS not in letters:
        return 2
    done = work.carry_out(asked, options.runs, VERDICTS in letters, options.on)
    summaries = [summarise(each, done.figures[each.key]) for each in asked]
    measured = results.tabulated(summaries, done.verdicts)
    results.write_json(summaries, done.verdicts, options.out / DATA)
    folder = options.out if options.runs else DOCS
    write(measured, folder, results.in_order(list(experiments())))
    met = show(console, measured["promises"])
    console.print(f"wrote {folder / PAGE}, {folder / TABLES} and {options.out / DATA}")
    return 0 if met else 1


def write(measured: results.Tables, folder: Path, order: Sequence[str]) -> None:
    """Renew the tables of a folder, and the pages that are made of them."""
    tables = results.renewed(results.read(folder / TABLES), measured, order)
    results.write(tables, folder / TABLES)
    (folder / PAGE).write_text(report.page(tables), encoding="utf-8")
    if (folder / GUIDE).is_file() and any(row["experiment"] in guide.EXPERIMENTS for row in measured["figures"]):
        guide.insert(folder / GUIDE, tables["figures"])


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


def show(console: Console, rows: Sequence[results.Row]) -> bool:
    """Print what is promised beside what was measured; return whether all of it is kept."""
    shown = Table(box=box.SIMPLE)
    for column in results.COLUMNS["promises"]:
        shown.add_column(column)
    broken = [row for row in rows if row["kept"] == "no" and not row["beside"]]
    for row in rows:
        shown.add_row(*row.values(), style="red" if row in broken else None)
    console.print(shown)
    return not broken
