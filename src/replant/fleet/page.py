"""The page of a fleet: verdicts, odd rigs, drift, histograms, and a table of all rigs, in one self-contained file."""

from __future__ import annotations

import html
import json
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.fleet.drift import Drift, drift_between
from replant.fleet.files import replacing, report_path
from replant.fleet.histogram import histogram
from replant.fleet.oddness import CHANCE, Oddness, oddness_of
from replant.fleet.quantities import Quantity, quantities_of
from replant.fleet.results import Fleet
from replant.fleet.store import FAILED, column
from replant.report.html.page import asset, heading, icon, section, style, today, words
from replant.report.number_format import number

PAGE = "report.html"
MOST_ROWS = 20_000  # rows of the page's table: more make a browser slow; rigs.parquet has all [rows]
MOST_LISTED = 100  # rigs that are listed with words above the table [count]
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
    found = oddness_of(table, fleet.structure)
    title = Path(fleet.logs).name or Path(fleet.logs).resolve().name or fleet.logs
    page = Template(asset("fleet.html")).substitute(
        title=html.escape(title),
        heading=heading(title),
        lede=html.escape(_lede(fleet, table)),
        css=style() + asset("fleet.css"),
        verdicts=_verdicts(fleet.verdicts),
        odd=_odd(fleet, table, found),
        drift="" if drift is None or compare is None else _drift(drift, compare),
        histograms=_histograms(fleet, table),
        table_note=html.escape(_table_note(table.num_rows)),
        data=_data(fleet, table, found),
        script=asset("fleet.js"),
        date=today(),
    )
    path = fleet.folder / PAGE
    with replacing(path) as new:
        new.write_text(page, encoding="utf-8")
    return path


def _lede(fleet: Fleet, table: Any) -> str:
    s, samples = fleet.structure, int(np.nansum(column(table, "samples")))
    zeros = f", {s.zeros} zero{'s' if s.zeros > 1 else ''}" if s.zeros else ""
    return (
        f"{fleet.input_name} → {fleet.output_name}, {s.poles} pole{'s' if s.poles > 1 else ''}{zeros}; "
        f"{table.num_rows:,} rigs by {fleet.by}, {samples:,} samples"
    )


def _verdicts(counts: dict[str, int]) -> str:
    total = sum(counts.values())
    rows = "".join(
        f"<dt>{icon(_GRAVITY.get(name, 'bad'))}{html.escape(name)}</dt><dd>{count:,}</dd>"
        f'<dd class="part" style="width:{100.0 * count / total:.2f}%"></dd>'
        for name, count in counts.items()
    )
    return f'<dl class="verdicts">{rows}</dl>'


def _odd(fleet: Fleet, table: Any, found: Oddness) -> str:
    """Return the section of odd rigs, and of those that failed."""
    rigs, reasons = table.column("rig").to_pylist(), table.column("reasons").to_pylist()
    verdicts = table.column("verdict").to_pylist()
    if not found.usual:
        note = "Too few rigs are trusted to say what is usual."
    else:
        note = (
            f"{int(found.odd.sum()):,} rigs are odd: they lie farther from the fleet than chance explains, or their "
            "signals show why they are not trusted. In a fleet without odd rigs one is named by chance with a "
            f"probability of {100.0 * CHANCE:g} %. The spread of the fleet and the uncertainty of each rig are taken "
            "into account, so that an uncertain rig is not an odd one."
        )
    rows = [row for row in found.order.tolist() if found.words[row] or verdicts[row] == FAILED][:MOST_LISTED]
    ranks = {row: rank for rank, row in enumerate(found.order.tolist(), 1)}
    items = "".join(
        f"<li><b>{_linked(fleet, rigs[row], ranks[row])}</b><span>"
        f"{words(found.words[row] or f'failed: {reasons[row]}')}</span></li>"
        for row in rows
    )
    listed = f'<ol class="oddities">{items}</ol>' if items else ""
    usual = "".join(_usual(*each) for each in found.usual)
    listed = f"<br>{listed}" if listed else ""
    told = f'<p class="note">Usual in this fleet: {usual[2:]}.</p>' if usual else ""
    return section("Odd rigs", f'<p class="note">{words(note)}</p>{told}', listed, anchor="odd")


def _usual(quantity: Quantity, middle: float, ratio: float) -> str:
    unit = f" {quantity.unit}" if quantity.unit else ""
    return f"; {words(quantity.name)} {number(middle)}{unit}, spread {100.0 * (ratio - 1.0):.2g}&nbsp;%"


def _linked(fleet: Fleet, rig: str, rank: int) -> str:
    """Return the name of a rig, as a link to its report, or where there is none to its row of the table."""
    path = report_path(rig)
    target = html.escape(path) if (fleet.folder / path).exists() else f"#rig-{rank}"
    return f'<a href="{target}">{heading(rig)}</a>'


def _drift(drift: Drift, before: Fleet) -> str:
    said = [
        f"{drift.compared:,} rigs were trusted in {before.folder} and are now; {len(drift.drifted):,} of them have "
        "changed by more than the uncertainty of both estimates explains."
    ]
    if not drift.common:
        said = [f"No rig of {before.folder} has the name of one of this fleet: there is nothing to compare."]
    if drift.fleet:
        said.append(f"The fleet as a whole: {'; '.join(drift.fleet)}.")
    for rigs, what in ((drift.lost, "no longer trusted"), (drift.gone, "no longer there"), (drift.new, "new")):
        if rigs:
            more = f" and {len(rigs) - 10:,} more" if len(rigs) > 10 else ""
            said.append(f"{what.capitalize()}: {', '.join(rigs[:10])}{more}.")
    paragraphs = "".join(f'<p class="note">{words(text)}</p>' for text in said)
    items = "".join(
        f"<li><b>{heading(each.rig)}</b><span>{words(each.words)}</span></li>" for each in drift.drifted[:MOST_LISTED]
    )
    listed = f'<br><ol class="oddities">{items}</ol>' if items else ""
    return section("Drift", paragraphs, listed, anchor="drift")


def _histograms(fleet: Fleet, table: Any) -> str:
    trusted = np.asarray(table.column("verdict").to_pylist(), object) == "trusted"
    if not trusted.any():
        return ""
    drawn = [histogram(quantity.name, values[trusted], quantity.unit) for quantity, values in _quantities(fleet, table)]
    drawn += [histogram(name, column(table, name)[trusted]) for name in fleet.structure.names]
    note = f'<p class="note">Of the {int(trusted.sum()):,} trusted rigs; the line is the median.</p><br>'
    return section("Distributions", note, f'<div class="histograms">{"".join(drawn)}</div>', anchor="distributions")


def _quantities(fleet: Fleet, table: Any) -> list[tuple[Quantity, FloatArray]]:
    """Return the physical quantities of all rigs; NaN where one has none."""
    found = []
    with np.errstate(all="ignore"):
        for quantity in quantities_of(fleet.structure):
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
        f"fleet in standard deviations. A click on a heading sorts.{more} Names that are links lead to reports, which "
        f"--reports writes for the first {MOST_LISTED}."
    )


def _data(fleet: Fleet, table: Any, found: Oddness) -> str:
    """Return the rows of the table as JSON that may stand in a page."""
    order = found.order[:MOST_ROWS]
    verdicts, reasons = (table.column(name).to_pylist() for name in ("verdict", "reasons"))
    why = [
        found.words[row] or ("" if verdicts[row] == "trusted" else reasons[row]) for row in range(table.num_rows)
    ]  # fmt: skip
    numbers = [(f"{q.name} [{q.unit}]" if q.unit else q.name, values) for q, values in _quantities(fleet, table)]
    numbers += [(name, column(table, name)) for name in fleet.structure.names]
    numbers += [("fit [%]", column(table, "fit")), ("samples", column(table, "samples"))]
    columns: list[dict[str, Any]] = [
        {"name": "rig", "text": True}, {"name": "rank"}, {"name": "verdict", "text": True},
        {"name": "distance [std]", "down": True}, {"name": "why", "text": True, "long": True},
        *({"name": name} for name, _ in numbers),
    ]  # fmt: skip
    rigs = table.column("rig").to_pylist()
    rounded = [_rounded(values) for _, values in numbers]
    distance = _rounded(found.distance)
    rows = []
    for rank, row in enumerate(order.tolist(), 1):
        path = report_path(rigs[row])
        link = path if rank <= MOST_LISTED and (fleet.folder / path).exists() else ""
        rows.append([rigs[row], rank, verdicts[row], distance[row], why[row], *(of[row] for of in rounded), link])
    return json.dumps({"columns": columns, "rows": rows}, separators=(",", ":")).replace("<", "\\u003c")


def _rounded(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]
