"""The page of a fleet: its table, histograms and odd rigs; and the reports of chosen rigs."""

from __future__ import annotations

import html
import json
from collections.abc import Iterable
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, ReplantError
from replant.fitting.miso_fit import RowFit
from replant.fleet.catalogue import find_rigs
from replant.fleet.executors import carried_out, workers
from replant.fleet.fit import Fleet
from replant.fleet.job import REPORTS, Job, Rig, replacing, report_path
from replant.fleet.odd_rigs import Drift, Oddness, drift_between, lost_samples_of, oddness_of
from replant.fleet.statistics import CHANCE, Quantity, quantities_of
from replant.fleet.store import FAILED, column, verdicts_of
from replant.fleet.worker import opened, result_of
from replant.logs.table import listed
from replant.numerics.arguments import FloatArray
from replant.plotting.numbers import number, rounded, with_unit
from replant.report import page_frame
from replant.report.page_frame import asset, filled, heading, icon, note, script, section, words
from replant.report.result_page import write_report

WIDTH, HEIGHT, FOOT = 300, 90, 22  # size of the picture, and height of its axis [px]
MOST_BARS = 40  # most bars; few rigs get fewer [count]
REACH = 6.0  # half-width of the axis; rigs beyond are counted in the caption [interquartile ranges]


def histogram(name: str, values: FloatArray, unit: str = "") -> str:
    """Return the histogram of a quantity over the rigs as a ``figure`` element."""
    known = np.sort(values[np.isfinite(values)])
    if not known.size:
        return ""
    middle, begin, end = _range(known)
    beyond = int((known < begin).sum() + (known > end).sum())
    bars = int(np.clip(np.sqrt(known.size), 8, MOST_BARS))
    counts, _ = np.histogram(known, bars, (begin, end))
    top, width = max(int(counts.max()), 1), WIDTH / bars
    drawn = "".join(
        f'<rect x="{k * width:.2f}" y="{HEIGHT * (1 - count / top):.2f}" width="{max(width - 1, 1):.2f}" '
        f'height="{HEIGHT * count / top:.2f}"/>'
        for k, count in enumerate(counts.tolist())
        if count
    )
    at = WIDTH * (middle - begin) / (end - begin)
    said = f"{name}: median {number(middle)}{f' {unit}' if unit else ''}"
    more = f"; {'one rig lies' if beyond == 1 else f'{beyond:,} rigs lie'} beyond the axis" if beyond else ""
    # as many digits as tell the ends of the axis apart
    low, high = next(ends for k in range(3, 18) if len({*(ends := (number(begin, k), number(end, k)))}) > 1)
    picture = (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT + FOOT}" role="img" aria-label="{html.escape(said + more)}">{drawn}'
        f'<path class="axis" d="M0 {HEIGHT}h{WIDTH}"/><path class="middle" d="M{at:.1f} 0v{HEIGHT}"/>'
        f'<text x="0" y="{HEIGHT + 16}">{low}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT + 16}" text-anchor="end">{high}</text></svg>'
    )
    label, told = html.escape(with_unit(name, unit)), html.escape(said.partition(": ")[2] + more)
    return f"<figure><figcaption>{label}<small>{told}</small></figcaption>{picture}</figure>"


def _range(known: FloatArray) -> tuple[float, float, float]:
    """Return the median, and the ends of the axis: the range of the values, limited to `REACH`."""
    low, middle, high = (float(value) for value in np.quantile(known, (0.25, 0.5, 0.75)))
    reach = REACH * (high - low)
    begin, end = max(float(known[0]), middle - reach), min(float(known[-1]), middle + reach)
    if not end > begin:
        width = 0.5 * abs(middle) or 0.5
        begin, end = middle - width, middle + width
    return middle, begin, end


PAGE = "report.html"
MOST_ROWS = 20_000  # most rows of the page's table: more make a browser slow; rigs.parquet has all [rows]
MOST_LISTED = 100  # most rigs in the lists of odd and drifted rigs [count]
_GRAVITY = {"trusted": "good", "converging": "warn", "not excited": "warn"}


def write_page(fleet: Fleet, compare: Fleet | None = None) -> Path:
    """Write the page of a fleet into its folder, and return its path.

    Parameters
    ----------
    fleet : Fleet
    compare : Fleet, optional
        An earlier identification of the same rigs: the page then shows what has drifted since.

    Raises
    ------
    InvalidArgumentError
        If the models of both have different structures, or both are the same results.
    LogError
        If the results cannot be read.
    """
    table = fleet.table()
    drift = None if compare is None else drift_between(compare, fleet)
    found = oddness_of(table, fleet.shape)
    body = {
        "verdicts": _verdicts(fleet.verdicts),
        "odd": _odd(fleet, table, found),
        "drift": "" if drift is None or compare is None else _drift(drift, compare),
        "histograms": _histograms(fleet, table),
        "table_note": html.escape(_table_note(table.num_rows)),
    }
    path = fleet.folder / PAGE
    with replacing(path) as new:
        page_frame.write_page(
            new,
            title=Path(fleet.logs).name or Path(fleet.logs).resolve().name or fleet.logs,
            eyebrow="Fleet",
            lede=_lede(fleet, table),
            body=filled("fleet.html", body),
            css=asset("fleet.css"),
            data=_data(fleet, table, found),
            scripts=[script("format.js", "fleet.js")],
        )
    return path


def _lede(fleet: Fleet, table: Any) -> str:
    samples, each = int(np.nansum(column(table, "samples"))), []
    for name, _, s in fleet.shape.branches:
        zeros = f", {s.zeros} zero{'s' if s.zeros > 1 else ''}" if s.zeros else ""
        poles = f"{s.poles} pole{'s' if s.poles > 1 else ''}{zeros}"
        each.append(f"{name or fleet.input_name} → {fleet.output_name}, {poles}")
    told = f"{'; '.join(each)}; {table.num_rows:,} rigs by {fleet.by}, {samples:,} samples"
    return f"{told}; texts left out: {listed(fleet.left_out)}" if fleet.left_out else told


def _verdicts(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    rows = "".join(
        f"<dt>{icon(_GRAVITY.get(name, 'bad'))}{html.escape(name)}</dt><dd>{count:,}</dd>"
        f'<dd class="part" style="width:{100.0 * count / total:.2f}%"></dd>'
        for name, count in counts.items()
    )
    return f'<dl class="verdicts">{rows}</dl>'


def _odd(fleet: Fleet, table: Any, found: Oddness) -> str:
    """Return the sections of odd rigs, of those that failed, and of those with many rejected samples."""
    rigs, verdicts, reasons = (table.column(name).to_pylist() for name in ("rig", "verdict", "reasons"))
    if not found.usual:
        told = "Too few rigs are trusted to determine what is usual."
    else:
        count = int(found.odd.sum())
        are, they, their = ("1 rig is", "it is", "its") if count == 1 else (f"{count:,} rigs are", "they are", "their")
        told = (
            f"{are} odd: {they} farther from the fleet than chance explains, or {their} signals show why {they} not "
            "trusted. In a fleet without odd rigs, one is named by chance with a probability of "
            f"{100.0 * CHANCE:g} %. The test accounts for the spread of the fleet and the uncertainty of each rig, so "
            "that an uncertain rig is not odd."
        )
    ranked = list(enumerate(found.order.tolist(), 1))
    odd = [(_linked(fleet, rigs[row], rank), found.words[row]) for rank, row in ranked if found.words[row]]
    failed = [(heading(rigs[row]), reasons[row]) for _, row in ranked if verdicts[row] == FAILED]
    usual = "; ".join(
        f"{words(quantity.label)} {number(middle)}{f' {quantity.unit}' if quantity.unit else ''}, "
        f"spread {100.0 * (ratio - 1.0):.2g}&nbsp;%"
        for quantity, middle, ratio in found.usual
    )
    middles = f'<p class="note">Usual in this fleet: {usual}.</p>' if usual else ""
    shown = section("Odd rigs", note(told), middles, _listed(odd[:MOST_LISTED]), anchor="odd")
    if failed:
        shown += section("Failed rigs", _listed(failed[:MOST_LISTED]), anchor="failed")
    lost = lost_samples_of(table)
    rejected = [(_linked(fleet, rigs[row], rank), lost[row]) for rank, row in ranked if lost[row]]
    if rejected:
        shown += section("Rejected samples", _listed(rejected[:MOST_LISTED]), anchor="rejected")
    return shown


def _listed(rigs: Iterable[tuple[str, str]]) -> str:
    """Return a list of rigs, each with its name as HTML and a text; empty without rigs."""
    items = "".join(f"<li><b>{name}</b><span>{words(said)}</span></li>" for name, said in rigs)
    return f'<br><ol class="oddities">{items}</ol>' if items else ""


def _linked(fleet: Fleet, rig: str, rank: int) -> str:
    """Return the name of a rig as a link to its report or, if there is none, to its row of the table."""
    path = report_path(rig)
    target = html.escape(path) if (fleet.folder / path).exists() else f"#rig-{rank}"
    return f'<a href="{target}">{heading(rig)}</a>'


def _drift(drift: Drift, before: Fleet) -> str:
    said = [
        f"{drift.compared:,} rigs were trusted in {before.folder} and are now; {len(drift.drifted):,} of them have "
        "changed by more than the uncertainty of both estimates explains."
    ]
    if not drift.common:
        said = [f"{before.folder} and this fleet have no rig name in common: there is nothing to compare."]
    if drift.fleet:
        said.append(f"The fleet as a whole: {'; '.join(drift.fleet)}.")
    for rigs, what in ((drift.lost, "no longer trusted"), (drift.gone, "no longer there"), (drift.new, "new")):
        if rigs:
            more = f" and {len(rigs) - 10:,} more" if len(rigs) > 10 else ""
            said.append(f"{what.capitalize()}: {', '.join(rigs[:10])}{more}.")
    listed = _listed((heading(each.rig), each.words) for each in drift.drifted[:MOST_LISTED])
    return section("Drift", *map(note, said), listed, anchor="drift")


def _histograms(fleet: Fleet, table: Any) -> str:
    trusted = verdicts_of(table) == "trusted"
    if not trusted.any():
        return ""
    drawn = [histogram(each.label, values[trusted], each.unit) for each, values in _quantities(fleet, table)]
    drawn += [histogram(name, column(table, name)[trusted]) for name in fleet.shape.names]
    told = note(f"Of the {int(trusted.sum()):,} trusted rigs; the line is the median.")
    return section("Distributions", told, f'<br><div class="histograms">{"".join(drawn)}</div>', anchor="distributions")


def _quantities(fleet: Fleet, table: Any) -> list[tuple[Quantity, FloatArray]]:
    """Return the physical quantities of all rigs; NaN if a rig has none."""
    found = []
    with np.errstate(all="ignore"):
        for quantity in quantities_of(fleet.shape):
            values = np.full(table.num_rows, quantity.factor)
            for name, weight in quantity.weights:
                of = column(table, name)
                base = of if weight in (1.0, -1.0) else np.where(of > 0.0, of, np.nan)
                values = values * np.power(base, weight)
            found.append((quantity, np.where(np.isfinite(values), values, np.nan)))
    return found


def _table_note(rows: int) -> str:
    more = f" The first {MOST_ROWS:,} of {rows:,} by rank; rigs.parquet has all." if rows > MOST_ROWS else ""
    return (
        "By rank: odd rigs first, then those that failed, those not trusted, and the others by their distance from the "
        f"fleet in standard deviations. A click on a heading sorts.{more} Names with a link lead to reports, which "
        f"--reports writes for up to {MOST_LISTED} rigs."
    )


def _data(fleet: Fleet, table: Any, found: Oddness) -> dict[str, Any]:
    """Return the rows of the table for the page's script."""
    order = found.order[:MOST_ROWS]
    rigs, verdicts, reasons = (table.column(name).to_pylist() for name in ("rig", "verdict", "reasons"))
    lost = lost_samples_of(table)
    why = [found.words[row] or (lost[row] if verdicts[row] == "trusted" else reasons[row]) for row in range(len(rigs))]
    numbers = [(with_unit(each.label, each.unit), values) for each, values in _quantities(fleet, table)]
    numbers += [(name, column(table, name)) for name in fleet.shape.names]
    numbers += [("fit [%]", column(table, "fit")), ("samples", column(table, "samples"))]
    columns: list[dict[str, Any]] = [
        {"name": "rig", "text": True}, {"name": "rank"}, {"name": "verdict", "text": True},
        {"name": "distance [std]", "down": True}, {"name": "why", "text": True, "long": True},
        *({"name": name} for name, _ in numbers),
    ]  # fmt: skip
    figures, distance = [rounded(values, 5) for _, values in numbers], rounded(found.distance, 5)
    rows = []
    for rank, row in enumerate(order.tolist(), 1):
        path = report_path(rigs[row])
        link = path if rank <= MOST_LISTED and (fleet.folder / path).exists() else ""
        rows.append([rigs[row], rank, verdicts[row], distance[row], why[row], *(of[row] for of in figures), link])
    return {"columns": columns, "rows": rows}


MOST_REPORTS = 100  # most reports: each takes some seconds [count]


def write_reports(fleet: Fleet, count: int, executor: Executor | str | None = None) -> int:
    """Write the reports of the first rigs by rank; return their number, without rigs that cannot be identified."""
    if fleet.job is None:
        raise InvalidArgumentError("a loaded fleet has no options: call fit again, which keeps the finished rigs")
    table = fleet.table()
    names = table.column("rig").to_pylist()
    first = {names[row] for row in oddness_of(table, fleet.shape).order[: min(count, MOST_REPORTS)].tolist()}
    rigs = [rig for rig in find_rigs(fleet.logs, fleet.by, leave_out=fleet.folder) if rig.name in first]
    (fleet.folder / REPORTS).mkdir(exist_ok=True)
    write = partial(_write_report, fleet.job, fleet.folder.absolute())
    with workers(executor) as found:
        return sum(done for _, done in carried_out(found, write, rigs))


def _write_report(job: Job, folder: Path, rig: Rig) -> int:
    """Write the report of a rig; return 1, or 0 if the rig cannot be identified."""
    try:
        recording = opened(rig, job)
        result = result_of(recording, job, with_history=True)
    except ReplantError:
        return 0
    log, shown = recording.held, None if isinstance(result, RowFit) else result.overview
    if shown is not None:
        log = recording.newest(shown.newest_input, shown.newest_output, shown.newest_times)
    assert log is not None
    program = (  # loads the rig's model from the results of the fleet
        f"import replant as rp\n\nfleet = rp.fleet.load({str(folder)!r})\n"
        f"model = fleet.model({json.dumps(rig.name, ensure_ascii=False)})\nprint(model)"
    )
    about: dict[str, Any] = {"title": rig.name, "python": program}
    with replacing(folder / report_path(rig.name)) as new:
        resolved = job.method == "fit" and not isinstance(result, RowFit)
        about["preprocess"] = job.preprocess.resolve(log.input, log.output) if resolved else None
        write_report(new, result, log, **about)
    return 1
