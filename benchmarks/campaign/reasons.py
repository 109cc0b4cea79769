"""The table of reasons: how often each was the first one for no trust, in a good model and in a bad one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

from rich.table import Table

VERDICT = Path(__file__).resolve().parents[2] / "docs" / "verdict.md"
FIGURE = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")
LONGEST = 70  # of a reason that the page does not have [characters]

Said = Iterable[tuple[str, bool]]  # the first reason for no trust, and whether the model is good


@cache
def documented() -> dict[str, re.Pattern[str]]:
    """Return the reasons of docs/verdict.md with their patterns, the longest first; x stands for a figure."""
    rows = [line.split("|")[1].strip() for line in VERDICT.read_text(encoding="utf-8").splitlines() if line[:2] == "| "]
    patterns = {row: re.sub(r"\bx\b", r"\\S+", re.escape(row)) for row in rows if row != "reason"}
    return {row: re.compile(patterns[row]) for row in sorted(patterns, key=len, reverse=True)}


def kind_of(reason: str) -> str:
    """Return a reason as docs/verdict.md has it; one that it does not have without figures."""
    said = (row for row, pattern in documented().items() if pattern.search(reason))
    return next(said, FIGURE.sub("x", reason)[:LONGEST])


def table(ways: Mapping[str, Said]) -> Table:
    """Return the table over some ways to a model: false alarms are those of good models, true ones of bad models."""
    counts = {way: Counter((kind_of(reason), good) for reason, good in said) for way, said in ways.items()}
    shown = Table("first reason for no trust", title="reasons: said of good models, of bad models")
    for way in ways:
        shown.add_column(way, justify="right")
    of_kind = Counter(kind for count in counts.values() for kind, _ in count.elements())
    for kind, _ in of_kind.most_common():
        shown.add_row(kind, *(f"{count[kind, True]}, {count[kind, False]}" for count in counts.values()))
    return shown
