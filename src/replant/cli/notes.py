"""What a command says beside its result, on standard error: notes and progress; nothing with --quiet."""

from __future__ import annotations

import click

QUIET = "replant.quiet"


def silence() -> None:
    """Have the command that is running say nothing beside its result and its errors."""
    click.get_current_context().meta[QUIET] = True


def is_quiet() -> bool:
    """Return whether the command that is running was called with --quiet.

    Examples
    --------
    >>> is_quiet()
    False
    """
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(QUIET))


def note(text: str) -> None:
    """Print a note in one line to standard error."""
    if not is_quiet():
        click.echo(f"replant: note: {text}", err=True)
