"""The options that `run`, `fit` and `compare` share, and the request that follows from them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import click
import numpy as np

from replant.cli.conditioning_options import (
    condition_options,
    conditioned,
    conditioning_as_python,
    input_hold_of,
    is_conditioned,
    stretch_options,
)
from replant.cli.messages import note
from replant.cli.option_types import (
    JSON,
    STRUCTURE,
    Candidates,
    Choice,
    check_complete,
    column_option,
    flag,
    group,
    optimizer_of,
    path_option,
    real,
    structure_options,
    typed,
)
from replant.errors import InvalidArgumentError
from replant.estimation.optimizers import OPTIMIZERS
from replant.estimation.settings import AUTO, Request, filter_for
from replant.fitting.log_inspection import with_others
from replant.logs import Log, Recording, open_recording
from replant.logs.columns import contradicted
from replant.logs.log import check_one_reference
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.report.python_programs import opening

BIAS = flag("--bias", "Also identify a constant added to the output of G(s).")
FEEDTHROUGH = flag("--feedthrough", "Allow as many zeros as poles: the output jumps with the input.")
INPUT_MAP = click.option(
    "--input-map",
    type=Choice(["identity", "square"]),
    default="identity",
    show_default=True,
    help="Input of G(s): the measured input, or its square.",
)
OPTIMIZER = click.option(
    "--optimizer",
    type=optimizer_of,
    default="auto",
    metavar="NAME[:SETTING=X,...]",
    show_default=True,
    help="Method of updating the estimate; auto is recursive least squares with instruments.  Others: "
    f"{', '.join(OPTIMIZERS)}.  Settings behind a colon, as in amsgrad:step_size=0.001; else they are chosen from the "
    "data.",
)
_STAMPS_COUNT = "each sample counts at its own time (--dt S instead would take the clock for regular)"
_LOGS = click.argument("logs", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="LOG...")
_INPUT = column_option("input", "Column of the input: name, or number from 0.")
_INPUTS = column_option(
    "input", "Column of the input: name, or number from 0; repeat it for several inputs.", several=True
)
_OUTPUT = column_option("output", "Column of the output.")
_OUTPUTS = column_option("output", "Column of the output; repeat it for several outputs.", several=True)
_OF_REFERENCE = "Column of the reference, if a controller makes the input: the set-point, or a dither"
_REFERENCE = column_option("reference", f"{_OF_REFERENCE}.")
_REFERENCES = column_option("reference", f"{_OF_REFERENCE}; repeat it for several references.", several=True)
_STRUCTURE = structure_options("Number of poles.", "Number of zeros.  [default: 0]", "Dead time in s.  [default: 0]")
_LIKEWISE = "Number of zeros, likewise.  [default: 0]", "Dead time in s, likewise.  [default: 0]"
_OF_INPUTS = structure_options("Number of poles; for several inputs one each: 2,1.", *_LIKEWISE)
_EACH = structure_options(
    "Number of poles, or a range such as 1:4, whose structures learn side by side; for several inputs one each: 2,1.",
    *_LIKEWISE,
)
_STRUCTURES = structure_options(
    "Number of poles, or a range such as 1:4; for several inputs a number or a range for each, as in 2,1 or 1:3,1:2.",
    "Number of zeros, or a range.  [default: 0; with a range of poles, every number below that of the poles]",
    "Dead time in s, or a range such as 0:1:0.1.  [default: 0]",
)
_REST = group(
    click.option(
        "--time",
        "time_column",
        metavar="COL",
        help="Column of time, in s or the unit in its name; it must increase.  "
        "[default: the column named t, time or timestamp]",
    ),
    click.option("--dt", type=real, metavar="S", help="Sampling time in s of a regular clock, without a time column."),
    click.option(
        "--from", "begin", type=real, metavar="S", help="Leave out all samples before S, in s from the first sample."
    ),
    click.option("--to", "end", type=real, metavar="S", help="Leave out S and all samples after it."),
    BIAS,
    FEEDTHROUGH,
    INPUT_MAP,
    flag("--quiet", "Print the result and errors only: no notes, no progress."),
    flag("--progress", "Print progress in lines if standard error is not a terminal."),
    JSON,
)
_OUT = path_option("--out", "DIR", "Write plots (PNG) and report.html here.")
_REST_OF_LOGS = group(condition_options, stretch_options, _REST, _OUT)
run_options = group(_LOGS, _INPUTS, _OUTPUTS, _REFERENCES, _EACH, _REST_OF_LOGS)
fit_options = group(_LOGS, _INPUTS, _OUTPUTS, _REFERENCES, _STRUCTURES, _REST_OF_LOGS)
#: Those of a command with one structure.
compare_options = group(_LOGS, _INPUT, _OUTPUT, _REFERENCE, _STRUCTURE, condition_options, _REST, _OUT)
#: Those of a fleet, whose logs are many, and its results a folder.
fleet_options = group(click.argument("logs"), _INPUTS, _OUTPUT, _REFERENCES, _OF_INPUTS, _REST, OPTIMIZER)


def begin(given: dict[str, Any], several: str = "") -> None:
    """Check the options before the command does its work; ``several`` is the message that refuses several logs."""
    check_said(given)
    if isinstance(given["logs"], tuple):
        if several and len(given["logs"]) > 1:
            raise click.UsageError(several)
        given["log"] = given["logs"][0]
    check_complete(given)
    asked = typed("--delay")
    ends = asked.split(":")
    if len(ends) == 2 and "," not in asked and float(ends[0]) < float(ends[1]):  # a range without a step
        tried, tenth = len(given["delay"][0]), 0.1 * (float(ends[1]) - float(ends[0]))
        note(f"--delay {asked}: in steps of 1 s, {tried} in all; give another step as in {asked}:{tenth:g}")


def check_said(given: dict[str, Any]) -> None:
    """Raise UsageError where a command is to be quiet and to print its progress."""
    if given["quiet"] and given["progress"]:
        raise click.UsageError("--quiet and --progress: give one of them")


def read_several(options: dict[str, Any]) -> list[Log]:
    """Read the logs that the options name, which are fitted together; say where two hold the same samples."""
    logs = [read(options | {"log": path}) for path in options["logs"]]
    for (path, log), (again, other) in combinations(zip(options["logs"], logs, strict=True), 2):
        pairs = (log.output, other.output), (log.inputs, other.inputs)
        if all(np.array_equal(*pair, equal_nan=True) for pair in pairs):
            note(
                f"{again}: the same samples as in {path}: they count twice, and make standard deviations too small; "
                "leave one out"
            )
    return logs


def request_of(options: dict[str, Any], dt: float) -> Request:
    """Return the request that the options describe, for a log with sampling time ``dt`` in s."""
    structure = structure_of(options)
    state_filter = filter_for(input_hold_of(options))
    optimizer = options.get("optimizer", AUTO)
    return Request(structure, dt, preprocess=preprocess_of(options), filter=state_filter, optimizer=optimizer)


def recording_of(options: dict[str, Any], progress: Callable[[int, int], None]) -> Recording:
    """Check the log that the options name, which may be of any length, and open it; see `open_recording`."""
    structure_of(options)
    if not is_conditioned(options):
        return _opened(options, progress=progress)
    whole = _opened(options, progress=progress, most_held=sys.maxsize)
    return whole.of_log(conditioned(whole.held, options))


def read(options: dict[str, Any]) -> Log:
    """Read the log that the options name."""
    log = conditioned(_opened(options, most_held=sys.maxsize).held, options)
    return replace(log, input_hold=input_hold_of(options))


def _opened(options: dict[str, Any], **how: Any) -> Recording:
    """Open the log that the options name, and print notes: what was left out, and doubts about its clock."""
    recording = open_recording(options["log"], **columns_of(options), **how)
    for found_in_file in recording.table.notes:
        note(found_in_file)
    if recording.irregular:
        note(f"{recording.irregularity}; {_STAMPS_COUNT}")
    if contradiction := contradicted(recording.table, options["dt"]):
        note(contradiction)
    if recording.doubt:
        note(f"{options['log']}: {recording.doubt}")
    return with_others(recording)


def columns_of(options: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a log, its clock and its part, as `open_recording` takes them."""
    named = {role: options[f"{role}_column"] for role in ("input", "output", "time", "reference")}
    return named | {name: options[name] for name in ("dt", "begin", "end")}


def opened_as_python(options: dict[str, Any]) -> str:
    """Return the begin of the Python program of a result: it reads and conditions the logs as the options say."""
    columns = {
        name: (list(given) if len(given) > 1 else given[0]) if isinstance(given, tuple) else given
        for name, given in columns_of(options).items()
    }
    return opening(options.get("logs") or [options["log"]], columns, conditioning_as_python(options))


def preprocess_of(options: dict[str, Any]) -> Preprocess:
    """Return input map and working point, which is the record's mean: a rig is rarely at rest at zero."""
    return Preprocess(options["input_map"], "mean", "mean")


# --- structures: an option of the structure has the candidates of each input


def structure_of(options: dict[str, Any]) -> Structure:
    """Return the one structure that the options describe, of one input; an impossible one is refused."""
    check_one_input(options)
    for name in STRUCTURE:
        if is_range(options[name]):
            raise InvalidArgumentError(
                f"--{name} must be one number here: a range learns side by side in `replant run`, and `replant fit` "
                "searches it"
            )
    zeros = options["zeros"][0][0] if options["zeros"] else 0
    return Structure(options["poles"][0][0], zeros, options["delay"][0][0], options["bias"], options["feedthrough"])


def structures_of(options: dict[str, Any]) -> list[Structure]:
    """Return the structures that ranges describe, but for impossible ones."""
    check_one_input(options)
    if options["feedthrough"]:
        raise InvalidArgumentError("a range of structures is taken without --feedthrough: give one number of each")
    (poles,), (zeros,), (delays,) = options["poles"], options["zeros"] or ((0,),), options["delay"]
    pairs = [(n, m) for n in poles for m in zeros if m < n]
    if not pairs:
        raise InvalidArgumentError("--zeros must be fewer than --poles")
    return [Structure(n, m, delay, options["bias"]) for n, m in pairs for delay in delays]


def check_one_input(options: dict[str, Any]) -> None:
    """Raise InvalidArgumentError where references, poles, zeros or dead time are those of several inputs."""
    if isinstance(options.get("reference_column"), tuple):
        check_one_reference(len(options["reference_column"]))
    for name in STRUCTURE:
        if len(options[name] or ()) > 1:
            one = f", {options['input_column']}" if options["input_column"] else ""
            raise InvalidArgumentError(
                f"--{name} has {len(options[name])} numbers, and there is one input{one}: name the others, each with -i"
            )
    if options["poles"]:
        Structure(max(options["poles"][0]))  # refuses too many by the last of a range, not by the first too many


def is_range(given: Candidates | None) -> bool:
    """Return whether an input has several candidates."""
    return any(len(each) > 1 for each in given or ())


def are_ranges(options: dict[str, Any]) -> bool:
    """Return whether poles, zeros or dead time of one input are a range."""
    return any(is_range(options[name]) for name in STRUCTURE)


def are_several(options: dict[str, Any]) -> bool:
    """Return whether the options name several inputs or outputs."""
    return any(isinstance(options[name], tuple) for name in ("input_column", "output_column"))


#: Options that one input takes, and several do not, with what they are without them.
NOT_YET = {
    "bias": False, "feedthrough": False, "input_map": "identity", "method": "auto",
    "optimizer": "auto", "full_trace": None, "background": False,
}  # fmt: skip


def refuse_not_yet(options: dict[str, Any], several: str = "inputs") -> None:
    """Raise InvalidArgumentError for an option that several inputs, or outputs, do not take yet."""
    for name, usual in NOT_YET.items():
        if options.get(name, usual) != usual:
            raise InvalidArgumentError(f"several {several} take no --{name.replace('_', '-')} yet")


def orders_of(options: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, Candidates]:
    """Return poles, zeros and dead time of each of several inputs; 0, or a range, stands for all."""
    asked = {name: options[name] or ((0,),) for name in STRUCTURE}
    for name, given in asked.items():
        if len(given) == 1 and (is_range(given) or (name != "poles" and given == ((0,),))):
            asked[name] = given * len(inputs)
        elif len(given) != len(inputs):
            got = f"{len(given)} numbers" if len(given) > 1 else "one number"
            raise InvalidArgumentError(
                f"--{name} must have a number for each of {len(inputs)} inputs ({', '.join(inputs)}), as in "
                f"{','.join('1' * len(inputs))}: got {got}"
            )
    return asked


def numbers_of(asked: dict[str, Candidates]) -> dict[str, tuple[Any, ...]]:
    """Return poles, zeros and dead time of each input as numbers; a range is refused."""
    if any(map(is_range, asked.values())):
        raise InvalidArgumentError("a range is searched by replant fit: give a number for each input here")
    return {name: tuple(number for (number,) in each) for name, each in asked.items()}
