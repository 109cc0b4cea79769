"""The command line: one file a command, loaded only when it is called, so that ``--help`` is instant."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import click

from replant import __version__
from replant.cli.encoding import spare_the_streams
from replant.errors import ReplantError
from replant.system.refusals import refusal

# The commands by name: the module of replant.cli that holds the click command ``command``, and its line of help.
COMMANDS = {
    "run": ("run", "Identify G(s) online, one pass over a recorded log."),
    "fit": ("fit", "Fit G(s) to a whole recorded log at once, the batch reference."),
    "compare": ("compare", "Compare methods on the same recorded log."),
    "live": ("live", "Identify G(s) from live samples: serial, TCP, UDP, MQTT, a pipe; with a dashboard."),
    "demo": ("demo", "Identify a simulated actuator while it runs, with plots."),
    "reproduce": ("reproduce", "Reproduce the article's tables, beside the published figures."),
}


class _LazyGroup(click.Group):
    """A group that imports a command's module when the command is called, not before."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"replant.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=_LazyGroup,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="replant")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Identify continuous-time transfer functions while the plant runs."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        sys.exit(2)


def main(arguments: Sequence[str] | None = None) -> Any:
    """Run the command line; a user's mistake, or what the system refuses, ends in one line on stderr and code 2."""
    spare_the_streams()
    try:
        return cli.main(args=None if arguments is None else list(arguments), prog_name="replant", standalone_mode=False)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.Abort:
        _end("interrupted", code=130)
    except click.ClickException as mistake:
        _end(f"{mistake.format_message()}{_hint(mistake)}")
    except ReplantError as mistake:
        _end(str(mistake))
    except ImportError as mistake:  # the system may also refuse to load a library
        _end(f"{mistake}; install replant again, or see whether open files and memory are left")
    except (OSError, MemoryError, RuntimeError) as error:
        reason = refusal(error)
        if reason is None:
            raise
        _end(reason)


def _end(message: str, code: int = 2) -> NoReturn:
    """Say why in one line and exit.  What standard output could not take is given up, lest it fail again at exit."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        print(f"replant: {_one_line(message)}", file=sys.stderr)
    sys.exit(code)


def _hint(mistake: click.ClickException) -> str:
    """Return where to look up what is missing, or how it is called."""
    unknown = isinstance(mistake, click.MissingParameter | click.NoSuchOption) or "No such command" in mistake.message
    context = mistake.ctx if isinstance(mistake, click.UsageError) else None
    return f" See {context.command_path} --help" if unknown and context else ""


def _one_line(message: str) -> str:
    return " ".join(message.split())
