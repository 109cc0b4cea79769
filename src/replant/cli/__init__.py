"""The command line: one file for each command, imported only when it is called, and files that commands share."""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import click

from replant import __version__
from replant.cli.messages import TYPED, did_you_mean, replace_unencodable
from replant.errors import ReplantError, brief
from replant.numerics.operating_system import ask_for_one_thread, refusal

# For each command: the module of replant.cli that has it, as in ``fit_command``, and the command's line of help.
COMMANDS = {
    "open": ("live", "Open logs on a local page: look, cut, fit, compare, keep a model."),
    "look": ("look", "Show what is in a recorded log, and suggest a command to begin with."),
    "run": ("run_and_fit", "Identify G(s) online, in one pass over a recorded log."),
    "fit": ("run_and_fit", "Fit G(s) to a whole recorded log at once (batch); search structures."),
    "compare": ("look", "Compare saved models over a log, or methods on it."),
    "fleet": ("fleet", "Identify every rig of a fleet, on all cores or a cluster; one table and page."),
    "examples": ("look", "Write records of a motor to try the commands on."),
    "validate": ("look", "Compare a saved model with other logs."),
    "show": ("look", "Print a saved model."),
    "live": ("live", "Identify G(s) from live samples (serial, TCP, UDP, MQTT, pipe), with a dashboard."),
    "demo": ("demo", "Identify a simulated actuator while it runs, with plots."),
    "reproduce": ("demo", "Reproduce the article's tables, beside the published figures."),
}

# What a command's help shows, and how it is typed.
_OVERVIEW = (
    ("look, cut, fit and compare on a page", "replant open log.csv"),
    ("see what is in a log, and what to type next", "replant look log.csv"),
    ("fit two poles to all of it", "replant fit log.csv -i u -o y -p 2"),
    ("watch a simulated rig live, without hardware", "replant live demo --for 20s"),
)
_LINES = (
    ("a log on a page", "replant open log.csv"),
    ("the session that was open last", "replant open"),
    ("columns, clock, likely input and output", "replant look log.csv"),
    ("the same with a plot of the columns", "replant look log.csv --out plots"),
    ("for scripts", "replant look log.csv -i u --json"),
    ("two poles, online", "replant run log.csv -i u -o y -p 2"),
    ("a zero, plots and a report", "replant run log.csv -i u -o y -p 2 --zeros 1 --out plots"),
    ("by the article's AMSGrad", "replant run log.csv -i u -o y -p 1 --optimizer amsgrad"),
    ("two poles", "replant fit log.csv -i u -o y -p 2"),
    ("the number of poles chosen, and the dead time", "replant fit log.csv -i u -o y -p 1:3 --delay 0:0.2:0.1"),
    ("one model of two records", "replant fit log.csv log.csv -i u -o y -p 1"),
    ("the model kept", "replant fit log.csv -i u -o y -p 1 --save model.json"),
    ("for scripts", "replant fit log.csv -i u -o y -p 1 --json"),
    ("a saved model over a log", "replant compare model.json log.csv"),
    ("the usual methods", "replant compare log.csv -i u -o y -p 1"),
    ("two of them", "replant compare log.csv -i u -o y -p 1 --optimizer srivc --optimizer least-squares"),
    ("another log, with the columns that the model knows", "replant validate model.json log.csv"),
    ("a plot, and exit code 3 unless trusted", "replant validate model.json log.csv --out plots --require trusted"),
    ("the model as people read it", "replant show model.json"),
    ("as JSON", "replant show model.json --json"),
    ("each file a rig, on every core", "replant fleet '*.csv' --by file -i u -o y -p 2 --out fleet"),
    (
        "each folder a rig, by the fit of whole records",
        "replant fleet . --by folder -i u -o y -p 2 --method fit --on processes:2 --out fleet",
    ),
    ("records of a motor, into this folder", "replant examples"),
    ("a simulated rig, with a dashboard", "replant live demo --for 20s"),
    ("the same in the terminal, until it is trusted", "replant live demo --dashboard off --until trusted"),
    ("plots and a report", "replant demo --out plots"),
    ("one table", "replant reproduce table1"),
    ("for scripts", "replant reproduce table1 --json"),
)
#: For each command, and without one.
EXAMPLES = {"replant": _OVERVIEW} | {
    name: tuple(example for example in _LINES if example[1].split()[1] == name) for name in COMMANDS
}


def epilog_of(command: str) -> str:
    r"""Return the examples of a command as click's epilog, whose lines stay as they are."""
    lines = [line for what, typed in EXAMPLES[command] for line in (f"  # {what}", f"  {typed}")]
    return "\n".join(["\b", "Examples:", *lines])


class _LazyGroup(click.Group):
    """A group that imports a command's module only when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"replant.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        command.epilog = epilog_of(cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, ctx.meta[TYPED] = args[0], args[1:]
        if name not in COMMANDS and not name.startswith("-"):
            ctx.fail(f"No such command {name!r}" + (did_you_mean(name, list(COMMANDS), "; {}") or "."))
        found = super().resolve_command(ctx, args)
        if found[1] is not None:
            refuse_twice(found[1], ctx, found[2])
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


def refuse_twice(command: click.Command, parent: click.Context, typed: list[str]) -> None:
    """Raise UsageError for an option that takes one value and is given twice: click would take the last one."""
    context = click.Context(command, parent=parent, info_name=command.name, resilient_parsing=True)
    words = [word for word in typed if not word.startswith("-?")]  # the source of `replant live`
    _, _, given = command.make_parser(context).parse_args(words)
    for option in given:
        if isinstance(option, click.Option) and not (option.multiple or option.is_flag) and given.count(option) > 1:
            raise click.UsageError(f"{'/'.join(option.opts)} is given twice: give it once", parent)


@click.group(
    cls=_LazyGroup,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=epilog_of("replant"),
)
@click.version_option(__version__, prog_name="replant")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Identify continuous-time transfer functions while the plant runs."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        sys.exit(2)


def main(arguments: Sequence[str] | None = None) -> Any:
    """Run the command line; a user's mistake, or a refusal of the system, is one line and exit code 2."""
    replace_unencodable()
    ask_for_one_thread()
    try:
        return cli.main(args=None if arguments is None else list(arguments), prog_name="replant", standalone_mode=False)
    except click.exceptions.Exit as stop:
        sys.exit(stop.exit_code)
    except click.Abort:
        _end("interrupted", code=130)
    except click.ClickException as mistake:
        _end(_message(mistake))
    except ReplantError as mistake:
        _end(str(mistake))
    except ImportError as mistake:  # the system may also refuse to load a library
        _end(f"{mistake}; install replant again, or check the limits on open files and memory")
    except (OSError, MemoryError, RuntimeError) as error:
        reason = refusal(error)
        if reason is None:
            raise
        _end(reason)


def _end(message: str, code: int = 2) -> NoReturn:
    """Print the reason in one line and exit.  Standard output is flushed here, where a failure can be ignored."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        print(f"replant: {brief(message)}", file=sys.stderr)
    sys.exit(code)


def _message(mistake: click.ClickException) -> str:
    """Return what is wrong: of an option of another command, which one takes it; of an unknown word, where help is."""
    wrong, context = mistake.format_message(), mistake.ctx if isinstance(mistake, click.UsageError) else None
    if isinstance(mistake, click.NoSuchOption) and context is not None:
        for name in COMMANDS:
            command = cli.get_command(context, name)
            if command is not None and any(mistake.option_name in option.opts for option in command.params):
                wrong = f"{mistake.message.rstrip('.')}; replant {name} takes it."
                break
    unknown = isinstance(mistake, click.MissingParameter | click.NoSuchOption) or "No such command" in mistake.message
    return f"{wrong} See {context.command_path} --help" if unknown and context else wrong
