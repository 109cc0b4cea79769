"""The measured table of docs/methods.md: a line a method, the figures that decide."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from accuracy.bounds import Statistics
from accuracy.linear import DEFAULT, LEAST_SQUARES, OFFLINE
from accuracy.report import number, table
from accuracy.rigs import KALMAN
from accuracy.summary import Summary

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


def insert(page: Path, summaries: Sequence[Summary]) -> None:
    """Put the table between its marks in the page."""
    text = page.read_text(encoding="utf-8")
    head, rest = text.split(BEGIN)
    _, tail = rest.split(END)
    page.write_text("\n".join([head + BEGIN, "", *lines(summaries), "", END + tail]), encoding="utf-8")


def lines(summaries: Sequence[Summary]) -> list[str]:
    """Return the table as Markdown."""
    header = ["method"]
    header += [f"{words}: bias" for words in CONSTANT.values()]
    header += [f"{words}: RMSE" for words in CONSTANT.values()]
    return table([*header, "C, changing: RMSE of a1, a0, b0", "coverage, A"], _rows(summaries))


def _rows(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    tables = {each.experiment.key: each for each in summaries}
    for words, names in LINES.items():
        constant = [_find(tables.get(key), names) for key in CONSTANT]
        bias = [_largest({name: abs(each.bias_percent) for name, each in found.items()}) for found in constant]
        rmse = [
            _largest({name: 100.0 * each.rmse / abs(each.truth) for name, each in found.items()}) for found in constant
        ]
        changing = _find(tables.get(CHANGING), names)
        tracked = ", ".join(number(each.mean, 2) for name, each in changing.items() if name.startswith("rms"))
        inside = [each.coverage for each in constant[0].values() if math.isfinite(each.coverage)]
        coverage = f"{min(inside):.0f} to {max(inside):.0f} %" if inside else "-"
        yield words, *bias, *rmse, tracked or "-", coverage


def _find(summary: Summary | None, names: Sequence[str]) -> Mapping[str, Statistics]:
    """Return the figures of the first of these methods that an experiment has; of those with a truth the parameters."""
    if summary is None:
        return {}
    for name in names:
        if name in summary.table:
            asked = summary.experiment.structure.names
            figures = summary.table[name]
            return {figure: figures[figure] for figure in asked} if summary.experiment.truth else figures
    return {}


def _largest(percent: Mapping[str, float]) -> str:
    return f"{number(max(percent.values()), 2)} %" if percent else "-"
