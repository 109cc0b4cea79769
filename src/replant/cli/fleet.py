"""``replant fleet``: a model of every rig of a fleet, and one page about all of them."""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

import click

from replant.cli import run_fit_compare_options as shared
from replant.cli.messages import note, progress_bar
from replant.cli.option_types import Choice, path_option
from replant.errors import LogError
from replant.fleet.executors import Progress, parsed
from replant.fleet.fit import Fleet, fit, load
from replant.fleet.job import METHODS, MODELS, TABLE, Shape, job_key, wanted
from replant.fleet.odd_rigs import check_comparable, lost_samples_of, oddness_of
from replant.fleet.page import MOST_REPORTS, write_page, write_reports
from replant.fleet.store import FAILED
from replant.logs.table import listed

NAMED = 5  # rigs of a kind that the terminal names [count]


@click.command(name="fleet")
@shared.fleet_options
@click.option(
    "--by",
    default="file",
    show_default=True,
    metavar="file|folder|COLUMN",
    help="What a rig is: a file, a folder, or the value of a column of Parquet files or of folders COLUMN=rig.",
)
@click.option(
    "--method",
    type=Choice(METHODS),
    default="run",
    show_default=True,
    help="Identify as replant run or replant fit does.",
)
@click.option(
    "--on", metavar="WHERE", help="threads:N, processes:N or dask://HOST:PORT.  [default: processes, one a core]"
)
@path_option("--compare", "OLD_DIR", "Show what has drifted since the results in OLD_DIR.")
@click.option(
    "--reports",
    type=click.IntRange(1, MOST_REPORTS),
    metavar="N",
    help="Also write the reports of the first N rigs by rank.",
)
@path_option("--out", "DIR", "Write the results here.", required=True)
def fleet_command(method: str, on: str | None, compare: Path | None, out: Path, **options: Any) -> None:
    """Identify every rig of a fleet from LOGS, a folder or a pattern such as 'logs/*.parquet'.

    Each rig gets a row of DIR/rigs.parquet; DIR/report.html names the rigs that lie far from the fleet.  Started again,
    what is done stays done; a rig whose files have changed is done again.  Several inputs are named as for run and fit.
    """
    shared.begin(options)
    on = on or f"processes:{os.cpu_count() or 1}"
    parsed(on)
    inputs = options["input_column"]
    if isinstance(inputs, tuple):
        shared.refuse_not_yet(options)
        structure = wanted(inputs, None, **shared.numbers_of(shared.orders_of(options, inputs)))
    else:
        structure = shared.structure_of(options)
    before = None if compare is None else load(compare)
    if before is not None:
        check_comparable(before, Shape.of(structure, inputs), out)
    if out.exists() and not out.is_dir():
        raise click.BadParameter(f"{out} is a file; name a folder", param_hint="--out")
    key_before = job_key(out)
    with progress_bar(rate=True) as bar:
        task = bar.add_task("planning", total=None)

        def show(state: Progress) -> None:
            failures = f", {state.failed} failed" if state.failed else ""
            shown = f"{state.done:,} of {state.rigs:,} rigs{failures}"
            total = state.samples / state.part if state.samples else None  # so that rate and time left are right
            bar.update(task, description=shown, completed=state.samples, total=total, stage=f"{state.rigs:,} rigs")

        found = fit(
            options["logs"], structure=structure, method=method, executor=on, out=out, progress=show,
            **{name: options[name] for name in ("by", "input_map", "optimizer")}, **shared.columns_of(options),
        )  # fmt: skip
        if options["reports"]:
            bar.update(task, description="reports", total=None)
            write_reports(found, options["reports"], on)
        bar.update(task, description="page", total=None)
        page = write_page(found, before)
    if key_before and found.job is not None and key_before != found.job.key:
        note(f"{out}: held the results of other options, which these replace; name another folder (--out) to keep both")
    if found.left_out:
        these = _plain(listed(found.left_out))
        note(f"left out, as {'it holds' if len(found.left_out) == 1 else 'they hold'} no rows of numbers: {these}")
    if set(found.verdicts) == {FAILED}:
        counted, _, reason = _usual_failure(found)
        raise LogError(f"none of {len(found)} rigs could be identified; {counted}the first: {reason}")
    _show(found, page, as_json=options["as_json"])


def _usual_failure(found: Fleet) -> tuple[str, str, str]:
    """Return how many rigs failed for the most frequent reason, the first of them, and the reason.

    The first is a text with a comma, empty if all failed for it, or each for a reason of its own.
    """
    rows = [row for row in found.table().to_pylist() if row["verdict"] == FAILED]
    # a reason names its rig's file
    reasons = [row["reasons"].replace(row["source"], "") for row in rows]
    reason, count = Counter(reasons).most_common(1)[0]
    first = rows[reasons.index(reason)]
    counted = f"{count:,} of them for one reason, " if 1 < count < len(rows) else ""
    return counted, _plain(first["rig"]), _plain(first["reasons"])


def _plain(text: str) -> str:
    r"""Return a name in one line, without what would move the cursor of a terminal or colour it."""
    return "".join(sign if sign.isprintable() else "?" for sign in text)


def _name(rigs: list[tuple[str, str]]) -> None:
    for rig, why in rigs[:NAMED]:
        click.echo(_plain(f"  {rig}: {why}"))
    if len(rigs) > NAMED:
        click.echo(f"  ... {len(rigs) - NAMED:,} more on the page")


def _show(found: Fleet, page: Path, *, as_json: bool) -> None:
    table, verdicts = found.table(), found.verdicts
    names, all_odd = table.column("rig").to_pylist(), oddness_of(table, found.shape)
    odd = [(names[row], all_odd.words[row]) for row in all_odd.order.tolist() if all_odd.odd[row]]  # the farthest first
    if as_json:
        said = [{"rig": rig, "why": why} for rig, why in odd]
        whole = {"rigs": len(found), "verdicts": verdicts, "odd": said, "left_out": found.left_out}
        click.echo(json.dumps(whole | {"folder": str(found.folder)}))
        return
    click.echo(f"{len(found):,} rigs: " + ", ".join(f"{count:,} {verdict}" for verdict, count in verdicts.items()))
    if odd:
        click.echo(f"{len(odd):,} {'is' if len(odd) == 1 else 'are'} odd, farther from the fleet than chance explains:")
    _name(odd)
    lost = [(name, why) for name, why in zip(names, lost_samples_of(table), strict=True) if why]
    if lost:
        click.echo(f"{len(lost):,} {'has' if len(lost) == 1 else 'have'} many rejected samples:")
    _name(lost)
    for path in (found.folder / TABLE, found.folder / MODELS, page):
        click.echo(f"wrote {path}")
    if FAILED in verdicts:
        count, (counted, rig, reason) = verdicts[FAILED], _usual_failure(found)
        first = "1 rig failed," if count == 1 else f"{count:,} rigs failed, {counted}the first of them"
        note(f"{first} {rig}: {reason}")
