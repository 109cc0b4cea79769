"""``replant open``: the workbench, a local page for recorded logs."""

from __future__ import annotations

from pathlib import Path

import click

from replant.cli.live import address_of
from replant.workbench.start import start

PLACE = "127.0.0.1:8720"


@click.command(name="open")
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1, metavar="[LOG]...")
@click.option(
    "--at",
    "place",
    default=PLACE,
    show_default=True,
    metavar="HOST:PORT",
    help="Serve the page there; the next free port where another workbench has it.",
)
def open_command(logs: tuple[Path, ...], place: str) -> None:
    """Open LOGs on a local page: look at them, cut a range, try orders, compare, keep a model.

    LOG is a recorded log (csv, mat, parquet and more), the folder of a live session's --record, or a session that the
    page has saved (.workbench).  Without one, the session that was open last is opened again.  Ctrl-C ends it.
    """
    start(logs, *address_of("--at", place))
