"""``replant reproduce``: the article's tables, ours beside the published figures."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from replant.paper import TABLES, TableResult, reproduce
from replant.paper.rendering import SOURCE, as_json, as_markdown, as_rich, notes, summary
from replant.paper.reproduction import runs


def _known(ctx: click.Context, parameter: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names without repetition, all of them for none."""
    for name in names:
        if name not in TABLES:
            raise click.UsageError(f"there is no {name!r} to reproduce: choose from {', '.join(TABLES)}", ctx)
    return tuple(dict.fromkeys(names)) or tuple(TABLES)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("names", nargs=-1, metavar=f"[{'|'.join(TABLES)}]...", callback=_known)
@click.option("--json", "json_only", is_flag=True, help="Print one JSON object and nothing else.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Also write tables.md and tables.json.")
def command(names: tuple[str, ...], json_only: bool, out: Path | None) -> None:
    """Reproduce the article's tables, beside the published figures.

    Without a name, all four.  Rows without a buffer are exact and compared by the printed three digits; rows with one
    are run over 20 seeds, and compared by their mean and standard deviation.
    """
    if out is not None:
        with _writable(out):  # before the work, not after it
            out.mkdir(parents=True, exist_ok=True)
    results = _run(names)
    text = json.dumps(as_json(results), indent=2)
    if out is not None:
        with _writable(out):
            (out / "tables.json").write_text(text + "\n", encoding="utf-8")
            (out / "tables.md").write_text(as_markdown(results), encoding="utf-8")
    if json_only:
        click.echo(text)
    else:
        _show(results, out)


@contextmanager
def _writable(out: Path) -> Iterator[None]:
    """Turn what the file system refuses into a line that names it."""
    try:
        yield
    except OSError as cause:
        where = cause.filename or out
        raise click.BadParameter(f"cannot write {where}: {cause.strerror}", param_hint="--out") from cause


def _run(names: Sequence[str]) -> list[TableResult]:
    """Run the tables, with a progress bar if a person sees stderr."""
    from rich.console import Console
    from rich.progress import Progress

    tables = [TABLES[name] for name in names]
    results = []
    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("", total=sum(runs(table) for table in tables))
        for table in tables:
            progress.update(task, description=table.title.partition(":")[0])
            results.append(reproduce(table, on_run=lambda: progress.advance(task)))
    return results


def _show(results: Sequence[TableResult], out: Path | None) -> None:
    from rich.console import Console
    from rich.padding import Padding

    console = Console(highlight=False, markup=False)
    console.print(SOURCE)
    for result in results:
        console.print()
        console.print(result.table.title, style="bold")
        console.print(as_rich(result))
        for note in notes(result):
            console.print(Padding(note, (0, 0, 0, 2), expand=False), style="dim")
    console.print()
    for line in summary(results):
        console.print(line)
    if out is not None:
        console.print(f"Written: {out / 'tables.md'}, {out / 'tables.json'}", soft_wrap=True)
