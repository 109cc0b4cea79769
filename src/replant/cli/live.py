"""``replant live``: identify a plant while it runs; ``replant open``: the workbench."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import click

from replant.cli import run_fit_compare_options as shared
from replant.cli.conditioning_options import seconds_of
from replant.cli.messages import note
from replant.cli.option_types import Choice, column_option, flag, parsed, path_option, real, structure_options
from replant.errors import InvalidArgumentError, ReplantError, needs
from replant.estimation.settings import Request
from replant.live.dashboard.server import PAGES_NEED
from replant.live.judge_process import DashboardAddress
from replant.live.progress import AnyRequest, Limits
from replant.live.session import run
from replant.live.streams import UY, Signals
from replant.live.streams.addresses import REPLAY, Address, parts_of
from replant.live.streams.source import REFERENCE
from replant.live.view import UNNAMED
from replant.logs.read import open_recording
from replant.numerics.operating_system import one_line
from replant.online.miso_identifier import RowIdentifier
from replant.rigs import Rig, deap_rig, motor_rig

DASHBOARD = "127.0.0.1:8710"
LONGEST_TOKEN = 1024  # longest token that is read from a file [characters]
DEMO = "demo"  # the source that needs no options, because its structure is known
LOOP = "loop=pi"  # its option for the motor under a controller


def _time(text: str) -> float:
    seconds = seconds_of(text)
    if not 0.0 < seconds < math.inf:
        raise ValueError(text)
    return seconds


time_of = parsed(_time, "is no length of time; write 60s, 10min or 24h")


class SourceCommand(click.Command):
    """A command whose SOURCE may be ``-?columns=n,t,u,y``, which click would parse as an option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Move such an argument behind ``--``, where click parses no options."""
        end = args.index("--") if "--" in args else len(args)
        sources = [argument for argument in args[:end] if argument.startswith("-?")]
        if sources:
            others = [argument for argument in args[:end] if not argument.startswith("-?")]
            args = [*others, "--", *sources, *args[end + 1 :]]
        return super().parse_args(ctx, args)


@click.command(name="live", cls=SourceCommand)
@click.argument("source")
@column_option("input", "Name of the input, or of each of several, in lines or columns.  [default: u]", several=True)
@column_option("output", "Name of the output there.  [default: y]")
@structure_options(
    "Number of poles, or of each input: 2,1.", "Number of zeros.  [default: 0]", "Dead time in s.  [default: 0]"
)
@click.option("--dt", type=real, metavar="S", help="Sampling time in s.")
@shared.BIAS
@shared.FEEDTHROUGH
@shared.INPUT_MAP
@shared.OPTIMIZER
@click.option(
    "--startup", type=int, default=500, show_default=True, metavar="N", help="Number of samples for the first model."
)
@click.option("--for", "seconds", type=time_of, metavar="TIME", help="End after this real time, such as 60s.")
@click.option("--samples", type=click.IntRange(min=1), metavar="N", help="End after N samples.")
@click.option("--until", type=Choice(["trusted"]), help="End as soon as the verdict is this one.")
@click.option(
    "--to",
    "sinks",
    multiple=True,
    metavar="ADDRESS",
    help="Send estimates to -, udp://HOST:PORT or mqtt://HOST/TOPIC; may be repeated.",
)
@path_option("--record", "DIR", "Record samples and estimates here (Parquet).")
@path_option("--checkpoint", "FILE", "Save the state here; resume from it.")
@click.option(
    "--every", type=time_of, default="10s", show_default=True, metavar="TIME", help="Time between checkpoints."
)
@click.option(
    "--dashboard",
    is_flag=False,
    flag_value=DASHBOARD,
    metavar="[HOST:PORT]",
    help=f"Serve the dashboard, by default at {DASHBOARD}.  The source demo serves it, too; off disables it.",
)
@click.option(
    "--token",
    envvar="REPLANT_TOKEN",
    metavar="WORD",
    help="Token that a browser must present; required if other machines can reach the dashboard.  Other users of this "
    "machine can read it in the list of processes: prefer REPLANT_TOKEN or --token-file.",
)
@path_option("--token-file", "FILE", "Read the token from the first line of a file.")
@click.option(
    "--ttl",
    type=time_of,
    metavar="TIME",
    help="Time for which an estimate stays trusted without an accepted sample.  [default: 5s, or 10 sampling times "
    "if that is longer]",
)
@flag("--background", "Solve the record again in a second process, so that no sample waits.")
@flag("--loop", "With the source demo: a motor under a PI controller, whose set-point is the reference.")
def live_command(source: str, loop: bool, **options: Any) -> None:
    """Identify G(s) from live samples of input u and output y, and of the reference r if a controller makes u.

    SOURCE is one of -, tcp://HOST:PORT, udp://HOST:PORT, serial:///dev/ttyUSB0?baud=115200, mqtt://HOST/TOPIC, a
    recorded log as in log.csv?input=u&output=y, or demo: a simulated rig that needs no other option.

    A line holds u,y or t,u,y or n,t,u,y (n: sequence number, t: time in s), or the columns that a header or ?columns=
    names, such as ?columns=t,u,y,r.  Ctrl-C ends the session and prints the result.

    Several inputs, each with -i, give a transfer function from each, with poles, zeros and a dead time of its own:
    -i Q1 -i Q2 -o T1 -p 2,1 --delay 0,0.3.  A line holds Q1,Q2,T1 instead of u,y.
    """
    if loop:
        source = looped(source)
    address, opener = parts_of(source)  # raises where there is no such source, before an option is missed
    demo = demo_of(source)
    if demo is not None:
        if _signals(options) != UY:
            raise InvalidArgumentError(f"{source}: the rig has one input and one output: leave -i and -o out")
        rig, _ = demo
        poles = options["poles"] or ((rig.plant.den.size - 1,),)
        zeros = min(rig.plant.num.size, poles[0][0]) - 1
        defaults = {"poles": poles, "zeros": ((zeros,),), "dt": rig.dt, "dashboard": DASHBOARD}
        options |= {name: value for name, value in defaults.items() if options[name] is None}
        options["input_map"] = rig.input_map
    page, token = options["dashboard"], _token(options)
    columns = _signals(options)
    if options["dt"] is None and opener == REPLAY:
        options["dt"] = _interval_of(address, columns)
    names = UNNAMED if columns == UY else columns
    trusted = run(
        source,
        _request(options),
        Limits(options["seconds"], options["samples"], options["until"] == "trusted"),
        dashboard=None if page in (None, "off") else DashboardAddress(*address_of("--dashboard", page), token),
        truth=None if demo is None else demo[0].plant,
        columns=columns,
        signals=names if demo is None else demo[1],
        to_fit=_to_fit(options, columns, address),
        **{name: options[name] for name in ("sinks", "record", "checkpoint", "every", "ttl", "background")},
    )
    if not trusted:
        sys.exit(1)


def looped(source: str) -> str:
    """Return the demo's address with the motor under a controller."""
    if demo_of(source) is None:
        raise InvalidArgumentError(f"--loop goes with the source demo, not with {source}; give r as a column instead")
    return source if LOOP in source else f"{source}{'&' if '?' in source else '?'}{LOOP}"


def demo_of(source: str) -> tuple[Rig, Signals] | None:
    """Return the simulated rig whose address the source is, and the names of its signals; None if it is none."""
    name, _, options = source.partition("?")
    if name != DEMO:
        return None
    if LOOP in options.split("&"):
        return motor_rig(), Signals(("voltage [V]",), "speed [rad/s]")
    return deap_rig(), Signals(("voltage [kV]",), "displacement [mm]")


def _token(options: dict[str, Any]) -> str | None:
    """Return the token from the environment, the command line or a file."""
    path: Path | None = options["token_file"]
    if path is None:
        token: str | None = options["token"]
        return token
    source = click.get_current_context().get_parameter_source("token")
    if options["token"] is not None and source is click.core.ParameterSource.COMMANDLINE:
        raise InvalidArgumentError("--token and --token-file: give one of them")
    try:
        with path.open(encoding="utf-8") as file:
            token = file.readline(LONGEST_TOKEN).strip()
    except (OSError, ValueError) as error:
        raise InvalidArgumentError(f"--token-file {path}: {one_line(error)}") from None
    if not token:
        raise InvalidArgumentError(f"--token-file {path}: its first line is empty; write the token there")
    return token


def _signals(options: dict[str, Any]) -> Signals:
    """Return the names that lines and columns give to the signals."""
    inputs, output = options["input_column"] or UY.inputs, options["output_column"] or UY.output
    return Signals((inputs,) if isinstance(inputs, str) else inputs, output)


def _request(options: dict[str, Any]) -> AnyRequest:
    inputs = _signals(options).inputs
    poles = "--poles 2" if len(inputs) == 1 else f"--poles {','.join('1' * len(inputs))}"
    for name, example in (("poles", poles), ("dt", "--dt 0.001")):
        if options[name] is None:
            raise InvalidArgumentError(f"--{name} is missing; give it, as in {example}")
    if len(inputs) > 1:
        shared.refuse_not_yet(options)
        orders: dict[str, Any] = shared.numbers_of(shared.orders_of(options, inputs))
        return RowIdentifier(**orders, dt=options["dt"], startup=options["startup"], input_names=inputs).request
    structure, more = shared.structure_of(options), {name: options[name] for name in ("optimizer", "startup")}
    return Request(structure, options["dt"], preprocess=shared.preprocess_of(options), **more)


def _interval_of(address: Address, signals: Signals) -> float:
    """Return the sampling time of a recorded log; raise InvalidArgumentError with the reason if it tells none."""
    given = address.options
    keys = (given.get("input", "u"), given.get("output", "y")) if signals == UY else (signals.inputs, signals.output)
    named: dict[str, Any] = {"input": keys[0], "output": keys[1], "time": given.get("time"), "dt": address.number("dt")}
    try:
        dt = open_recording(address.path, **named).dt
    except ReplantError as error:
        raise InvalidArgumentError(f"--dt is missing, and the log does not tell it: {error}") from error
    note(f"--dt {dt:g}: the interval of {address.path}")
    return dt


def _to_fit(options: dict[str, Any], signals: Signals, address: Address) -> list[str]:
    """Return the options of `replant fit` for the record of the session: without them it fits another model."""
    words = [word for name in signals.inputs for word in ("-i", name)] + ["-o", signals.output]
    for name in ("poles", "zeros", "delay"):
        orders = [figure for each in options[name] or () for figure in each]
        words += [f"--{name}", ",".join(f"{figure:.15g}" for figure in orders)] if any(orders) else []
    words += [f"--{name}" for name in ("bias", "feedthrough") if options[name]]
    words += ["--input-map", options["input_map"]] if options["input_map"] != "identity" else []
    named = address.options.get("columns", "").replace(" ", "").split(",")
    has_reference = REFERENCE in named or {"loop", "reference"} & {*address.options}
    return [*words, *(["--reference", REFERENCE] if has_reference else [])]


def address_of(option: str, text: str) -> tuple[str, int]:
    """Return host and port of a page."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        off = ", or off" if option == "--dashboard" else ""
        raise InvalidArgumentError(f"{option} {text}: write HOST:PORT, as in {DASHBOARD}{off}")
    return host.strip("[]"), int(port)


PLACE = "127.0.0.1:8720"


@click.command(name="open")
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1, metavar="[LOG]...")
@click.option(
    "--at",
    "place",
    default=PLACE,
    show_default=True,
    metavar="HOST:PORT",
    help="Serve the page there; on the next free port if that one is in use.",
)
def open_command(logs: tuple[Path, ...], place: str) -> None:
    """Open LOGs on a local page: look at them, cut a range, try orders, compare, keep a model.

    LOG is a recorded log (csv, mat, parquet and more), the folder of a live session's --record, or a session that the
    page has saved (.workbench).  Without one, the session that was open last is opened again.  Ctrl-C ends it.
    """
    with needs(PAGES_NEED, "live"):
        from replant.workbench.app import start
    start(logs, *address_of("--at", place))
