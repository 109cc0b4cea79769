"""The results as tables, docs/accuracy/*.csv, and as accuracy.json.

A run renews the rows of what it measured, and leaves the others: `renewed`.
"""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from accuracy.bounds import COVERAGE
from accuracy.feedback import MOST_WRONG, Outcome, compared
from accuracy.summary import Promise, Summary, is_covered
from accuracy.verdicts import KINDS, LEAST_TRUSTED, TRUSTED
from accuracy.work import RIGHT, WRONG, Assessed

Verdicts = dict[str, list[Assessed]]
Row = dict[str, str]
Tables = dict[str, list[Row]]

#: The columns of each table.
COLUMNS = {
    "experiments": ("experiment", "runs", "record"),
    "promises": ("experiment", "method", "promise", "measured", "kept", "beside"),
    "figures": (
        "experiment", "method", "figure", "truth", "mean", "std", "bias_percent", "rmse", "printed_std", "failed",
        "coverage_percent", "least_std",
    ),
    "loops": (
        "experiment", "method", "worst", "bias_percent", "bias_se", "rms_percent", "rms_over_anchor",
        "coverage_percent", "failed", "diverged", "right", "right_and_trusted", "wrong_and_trusted",
    ),
}  # fmt: skip
KEPT = {True: "yes", False: "no", None: ""}
FEWEST_RUNS = 100  # from which a coverage is judged


def tabulated(summaries: Sequence[Summary], verdicts: Verdicts) -> Tables:
    """Return the rows of every table."""
    rows = {
        "experiments": ((each.experiment.key, str(_runs(each)), each.experiment.title) for each in summaries),
        "promises": promised(summaries, verdicts),
        "figures": _figures([each for each in summaries if not each.experiment.feedback]),
        "loops": _loops([each for each in summaries if each.experiment.feedback]),
    }
    return {name: [dict(zip(COLUMNS[name], row, strict=True)) for row in found] for name, found in rows.items()}


def renewed(kept: Tables, measured: Tables, known: Sequence[str]) -> Tables:
    """Return the kept rows with those of the measured experiments in their place, in the order of what is known.

    Rows of experiments that are not known any more go.

    Examples
    --------
    >>> old = {"loops": [{"experiment": "A", "right": "1"}, {"experiment": "B", "right": "2"}]}
    >>> renewed(old, {"loops": [{"experiment": "A", "right": "3"}]}, ["A", "B"])["loops"]
    [{'experiment': 'A', 'right': '3'}, {'experiment': 'B', 'right': '2'}]
    """
    anew = {row["experiment"] for rows in measured.values() for row in rows}
    both = {
        name: [row for row in kept.get(name, []) if row["experiment"] not in anew] + rows
        for name, rows in measured.items()
    }
    return {
        name: sorted(
            (row for row in rows if row["experiment"] in known), key=lambda row: known.index(row["experiment"])
        )
        for name, rows in both.items()
    }


def read(folder: Path) -> Tables:
    """Return the tables of a folder; none where it has none."""
    found: Tables = {}
    for name in COLUMNS:
        path = folder / f"{name}.csv"
        if path.is_file():
            with path.open(encoding="utf-8", newline="") as file:
                found[name] = list(csv.DictReader(file))
    return found


def write(tables: Tables, folder: Path) -> None:
    """Write every table."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, columns in COLUMNS.items():
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(tables[name])


def write_json(summaries: Sequence[Summary], verdicts: Verdicts, data: Path) -> None:
    """Write the figures of every run's statistics."""
    document = {
        "experiments": {each.experiment.key: _as_json(each) for each in summaries},
        "verdicts": {key: [asdict(case) for case in cases] for key, cases in verdicts.items()},
    }
    data.parent.mkdir(parents=True, exist_ok=True)
    data.write_text(json.dumps(_finite(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def number(value: float, digits: int = 4) -> str:
    """Return a value to so many digits, without an exponent where it can be; nothing for NaN.

    Examples
    --------
    >>> number(1234567.0), number(0.1195), number(float("nan"))
    ('1234567', '0.1195', '')
    """
    if math.isnan(value):
        return ""
    if value == 0.0 or not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{decimals}f}"


def _finite(value: Any) -> Any:
    """Return the same with None for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _runs(summary: Summary) -> int:
    return max(each.runs for figures in summary.covered.values() for each in figures.values())


def promised(summaries: Sequence[Summary], verdicts: Verdicts) -> Iterator[Sequence[str]]:
    """Yield a row for each promise."""
    for summary in summaries:
        for promise in summary.promises:
            yield _line(promise)
        yield from _kept_in_loops(summary)
    yield from _seldom_wrong(summaries)
    for summary in summaries:
        for method in summary.experiment.covered:
            inside = [each.coverage for each in summary.covered[method].values()]
            words = f"coverage {COVERAGE[0]:g} to {COVERAGE[1]:g} %"
            measured = f"{min(inside):.1f} to {max(inside):.1f} %"
            if _runs(summary) < FEWEST_RUNS:
                yield summary.experiment.key, method, words, f"{measured} of fewer than {FEWEST_RUNS} runs", "", ""
            else:
                yield summary.experiment.key, method, words, measured, KEPT[all(map(is_covered, inside))], ""
    if verdicts:
        yield from _judged(verdicts)


def _line(promise: Promise) -> Sequence[str]:
    measured = ", ".join(f"{name} {number(value, 3)}" for name, value in promise.measured.items())
    beside = "beside" if promise.experiment.beside else ""
    return promise.experiment.key, promise.bound.method, promise.bound.words, measured, KEPT[promise.is_met], beside


def _kept_in_loops(summary: Summary) -> Iterator[Sequence[str]]:
    """Yield a row for each promise on a plant under a controller."""
    feedback = summary.experiment.feedback
    for method in feedback.promised if feedback else ():
        assert feedback is not None
        for words, measured, kept in compared(feedback, summary.outcomes, method):
            yield summary.experiment.key, method, words, measured, KEPT[kept], ""


def _seldom_wrong(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    """Yield a row for each family of loops: how many of all its runs are wrong and trusted."""
    families: dict[tuple[str, str], list[Outcome]] = {}
    for summary in summaries:
        if summary.experiment.feedback:
            for method, family in summary.experiment.feedback.families.items():
                families.setdefault((family, method), []).append(summary.outcomes[method])
    for (family, method), found in families.items():
        wrong, runs = sum(each.wrong_and_trusted for each in found), sum(each.runs for each in found)
        words = f"wrong and trusted in {MOST_WRONG:g} % of all runs at most"
        yield f"K all {family}", method, words, f"{wrong} of {runs}", KEPT[100.0 * wrong <= MOST_WRONG * runs], ""


def _judged(verdicts: Verdicts) -> Iterator[Sequence[str]]:
    """Yield how many right models are trusted, and how many of each kind of wrong ones."""
    statuses = [case.status for case in verdicts.get(RIGHT, [])]
    enough = statuses.count(TRUSTED) >= math.ceil(LEAST_TRUSTED * len(statuses) / 30)
    yield RIGHT, "assess()", f"{LEAST_TRUSTED} of 30 trusted", _told(statuses), KEPT[enough], ""
    for kind in KINDS:
        statuses = [case.status for case in verdicts.get(WRONG, []) if case.kind == kind]
        if statuses:
            kept = KEPT[TRUSTED not in statuses]
            yield f"{WRONG}: {kind}", "assess()", "none trusted", _told(statuses), kept, ""


def _told(statuses: Sequence[str]) -> str:
    others = Counter(status for status in statuses if status != TRUSTED).most_common()
    words = f" ({', '.join(f'{count} {status}' for status, count in others)})" if others else ""
    return f"{statuses.count(TRUSTED)} of {len(statuses)}{words}"


def in_order(keys: Sequence[str]) -> list[str]:
    """Return what the rows are called, in their order: the experiments, all loops of a family, verdicts."""
    from accuracy.scenarios import experiments

    loops = [each.feedback for each in experiments().values() if each.feedback]
    families = dict.fromkeys(family for feedback in loops for family in feedback.families.values())
    return [*keys, *(f"K all {family}" for family in families), RIGHT, *(f"{WRONG}: {kind}" for kind in KINDS)]


def _figures(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    for summary in summaries:
        for method, figures in summary.table.items():
            for name, each in figures.items():
                known = math.isfinite(each.truth) and each.truth != 0.0
                yield (
                    summary.experiment.key,
                    method,
                    name,
                    number(each.truth, 6),
                    number(each.mean, 6),
                    number(each.std, 5),
                    number(each.bias_percent, 5) if known else "",
                    number(each.rmse, 5),
                    number(each.printed, 5),
                    str(each.failed),
                    _rounded(summary.covered[method][name].coverage, 1),
                    number(summary.experiment.least_std.get(name, math.nan), 5),
                )


def _loops(summaries: Sequence[Summary]) -> Iterator[Sequence[str]]:
    for summary in summaries:
        assert summary.experiment.feedback is not None
        anchor = summary.outcomes.get(summary.experiment.feedback.anchor)
        for method, seen in summary.outcomes.items():
            yield (
                summary.experiment.key,
                method,
                seen.worst,
                _rounded(seen.bias[seen.worst], 1),
                _rounded(seen.standard_error[seen.worst], 1),
                _rounded(seen.largest_rms, 1),
                _rounded(seen.largest_rms / anchor.largest_rms, 2) if anchor else "",
                _rounded(seen.coverage, 0),
                str(seen.failed),
                str(seen.diverged),
                str(seen.right),
                str(seen.right_and_trusted) if seen.judges else "",
                str(seen.wrong_and_trusted) if seen.judges else "",
            )


def _rounded(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else ""


def _as_json(summary: Summary) -> dict[str, Any]:
    experiment = summary.experiment
    return {
        "title": experiment.title,
        "runs": _runs(summary),
        "figures": {
            method: {
                name: asdict(each) | {"bias": each.bias, "coverage": summary.covered[method][name].coverage}
                for name, each in figures.items()
            }
            for method, figures in summary.table.items()
        },
        "least_std": dict(experiment.least_std),
        "in feedback": {method: asdict(each) for method, each in summary.outcomes.items()},
        "bounds": [
            {
                "method": promise.bound.method,
                "bound": promise.bound.words,
                "limits": dict(promise.bound.limits),
                "measured": dict(promise.measured),
                "met": promise.is_met,
            }
            for promise in summary.promises
        ],
    }
