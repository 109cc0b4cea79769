"""The measured table of docs/methods.md: a line a method, the figures that decide."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from accuracy.linear import DEFAULT, LEAST_SQUARES, OFFLINE
from accuracy.results import Row, number
from accuracy.rigs import KALMAN

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"

#: What the page calls a method, and what the experiments call it.
LINES: dict[str, tuple[str, ...]] = {
    "`Identifier(structure, dt)`, the default": (DEFAULT,),
    '`fit(method="srivc")`, offline': (OFFLINE,),
    "`KalmanTracking`": (KALMAN, "Kalman tracking"),
    "`RecursiveLeastSquares(time_constant=30)`": ("RLS, memory of 30 s",),
    "`RecursiveLeastSquares`, a fixed filter, instruments": ("RLS, fixed filter, with instruments",),
    "buffered `AMSGrad`, instruments": (
        "buffered AMSGrad, (s + 2)^n, with instruments",
        "buffered AMSGrad, (s + 20)^n, with instruments",
        "buffered AMSGrad, with instruments",
    ),
    "buffered `AMSGrad`, no instruments": (
        "buffered AMSGrad, (s + 2)^n, no instruments",
        "buffered AMSGrad, (s + 20)^n, no instruments",
        "buffered AMSGrad, no instruments",
        "article: buffered AMSGrad, exact filters",
    ),
    "the article's, its filters": ("article: buffered AMSGrad, gbt filters",),
    '`fit(method="least_squares")`, offline': (LEAST_SQUARES,),
}
CONSTANT = {"A prbs": "A, 2nd order, 10 dB", "B 10dB": "B, 4th order, 10 dB", "D actuator": "D, the actuator"}
CHANGING = "C hold-10"
EXPERIMENTS = (*CONSTANT, CHANGING)
COEFFICIENT = r"(?:rms )?[ab]\d+"


def insert(page: Path, figures: Sequence[Row]) -> None:
    """Put the table between its marks in the page."""
    text = page.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    _, tail = rest.split(END)
    page.write_text("\n".join([head + BEGIN, "", *lines(figures), "", END + tail]), encoding="utf-8")


def lines(figures: Sequence[Row]) -> list[str]:
    """Return the table as Markdown."""
    header = ["method"]
    header += [f"{words}: bias" for words in CONSTANT.values()]
    header += [f"{words}: RMSE" for words in CONSTANT.values()]
    header += ["C, changing: RMSE of a1, a0, b0", "coverage, A"]
    return [
        f"| {' | '.join(header)} |",
        f"|{'---|' * len(header)}",
        *(f"| {' | '.join(row)} |" for row in _rows(figures)),
    ]


def _rows(figures: Sequence[Row]) -> Iterator[Sequence[str]]:
    for words, names in LINES.items():
        constant = [_find(figures, key, names) for key in CONSTANT]
        bias = [_largest(abs(float(row["bias_percent"])) for row in found) for found in constant]
        rmse = [_largest(100.0 * float(row["rmse"]) / abs(float(row["truth"])) for row in found) for found in constant]
        tracked = [row["mean"] for row in _find(figures, CHANGING, names) if row["figure"].startswith("rms")]
        inside = [float(row["coverage_percent"]) for row in constant[0] if row["coverage_percent"]]
        coverage = f"{min(inside):.0f} to {max(inside):.0f} %" if inside else "-"
        yield words, *bias, *rmse, ", ".join(number(float(mean), 2) for mean in tracked) or "-", coverage


def _find(figures: Sequence[Row], experiment: str, names: Sequence[str]) -> list[Row]:
    """Return the coefficients, or the errors, that the first of these methods has in an experiment."""
    rows = [row for row in figures if row["experiment"] == experiment and re.fullmatch(COEFFICIENT, row["figure"])]
    found = ([row for row in rows if row["method"] == name] for name in names)
    return next(filter(None, found), [])


def _largest(percent: Iterable[float]) -> str:
    return next((f"{number(each, 2)} %" for each in sorted(percent, reverse=True)), "-")
