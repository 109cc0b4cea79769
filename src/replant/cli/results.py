"""Output of a command: a table or JSON, plots and a report; a model saved and validated on other logs."""

from __future__ import annotations

import dataclasses
import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from replant.cli.advice import OTHER_LOG, NextStep, next_step
from replant.cli.conditioning_options import STRETCHES
from replant.cli.messages import is_given, note, terminal
from replant.cli.option_types import Choice, command_line, group, path_option
from replant.cli.run_fit_compare_options import read
from replant.errors import InvalidArgumentError
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fitting.model_file import check_target
from replant.fitting.search_result import SearchResult
from replant.fitting.several_outputs import MatrixModel
from replant.fitting.validation import Validation
from replant.logs import Log, read_columns
from replant.logs.log import logs_in
from replant.logs.recording import digest
from replant.logs.sampling_time import time_columns
from replant.model.interop import without_unit
from replant.numerics.limits import typed_path
from replant.online.runs.result import Clock, Result
from replant.plotting.numbers import wrapped
from replant.report import results_as_text as as_text
from replant.report.python_programs import identifier_as_python
from replant.verdict.verdict import Verdict

NOT_REQUIRED = 3  # exit code where a verdict is not the one that `--require` asks for [number]
REQUIRE = click.option(
    "--require", "required", type=Choice(["trusted"]), help="Exit with code 3 if a verdict is another one."
)
OTHER_LOGS = "Compare the model with another log of the same columns; repeat the option for several."
#: The options that `Delivery` takes, but for those that commands without a model have, too.
keeping_options = group(
    path_option("--validate", "LOG2", OTHER_LOGS, "other_logs", multiple=True),
    path_option("--save", "FILE", "Write the model (.json).", "saved"),
    REQUIRE,
)


@dataclass(frozen=True)
class Delivery:
    """What is to be done with a result and its model."""

    as_json: bool
    out: Path | None  # folder for plots and report
    saved: Path | None  # file to write the model to
    other_logs: tuple[Path, ...]  # logs to validate it on
    required: str | None  # the verdict that is asked for
    columns: dict[str, Any]  # the options that name the columns and the clock of the logs

    @classmethod
    def of(cls, options: dict[str, Any]) -> Delivery:
        """Take these options out of those of a command."""
        taken = {name: options.pop(name) for name in ("as_json", "out", "saved", "other_logs", "required")}
        found = cls(**taken, columns=dict(options))
        if found.saved is not None:
            check_target(found.saved)
        for path in found.other_logs:
            if not path.exists():
                raise InvalidArgumentError(f"--validate {path}: no such file")
        return found

    def validated(self, model: Model | RowModel, **others: Any) -> list[tuple[str, Validation]]:
        """Return the model's validation on each stretch and log, by name; ``others`` are other columns."""
        path, columns = self.columns["log"], self.columns | dict.fromkeys(STRETCHES) | others
        stretches = []
        for begin, end in self.columns.get("validate_on") or ():
            name = f"{path.name}, {begin:g} s to {'the end' if end is None else f'{end:g} s'}"
            stretches.append((name, model.validate(read(columns | {"begin": begin, "end": end}))))
        return stretches + [(name, validated(model, log, columns)) for name, log in by_name(self.other_logs)]

    def finish(
        self,
        model: Model | RowModel | MatrixModel,
        verdicts: Sequence[tuple[str, Verdict]],
        validations: Sequence[tuple[str, Validation]],
        step: NextStep | None,
        write: Callable[[Path], list[Path]],
    ) -> None:
        """Save a model that was printed, ``write`` plots and a report into the folder, and say what to do next."""
        if self.saved is not None:
            model.save(self.saved)
            print_written([] if self.as_json else [self.saved])
        if self.out is not None:
            with write_errors_reported(self.out):
                paths = write(self.out)
            print_written([] if self.as_json else paths)
        if step is not None and not self.as_json:
            click.echo("\n".join(["", *wrapped(f"Next: {step.words}:", terminal().width), step.command]))
        of_logs = [(f"validation on {name}", each.verdict) for name, each in validations]
        check_required(self.required, [*verdicts, *of_logs])


def by_name(paths: Sequence[Path]) -> list[tuple[str, Path]]:
    """Return logs with their names, or with their paths where names repeat."""
    names = [path.name for path in paths]
    return [(str(path) if names.count(path.name) > 1 else path.name, path) for path in paths]


def validated(model: Model | RowModel, path: Path, columns: dict[str, Any]) -> Validation:
    """Return a model's validation on a log; on the log that it was made from, the model keeps its own verdict.

    A validation takes its samples for unseen.
    """
    found = model.validate(_as_named(model, whole_log(path, columns)))
    if model.provenance.sha256 and digest(path) == model.provenance.sha256:
        note(f"{path}: the model was made from this log, and keeps its verdict; validate it on another one")
        return dataclasses.replace(found, verdict=model.verdict)
    return found


def _as_named(model: Model | RowModel, log: Log) -> Log:
    """Return a log, without references, whose inputs are named as a model's are, where they share no name."""
    given, names = log.inputs.T, model.input_names if isinstance(model, RowModel) else ()
    shared = {*map(without_unit, names)} & {*map(without_unit, log.input_names)}
    if not names or shared or len(given) != len(names):
        return log
    others = {**log.others, **dict(zip(names[1:], given[1:], strict=True))}
    return dataclasses.replace(log, input_name=names[0], others=others, more_inputs=names[1:], more_references=())


def check_required(required: str | None, verdicts: Sequence[tuple[str, Verdict]]) -> None:
    """Exit with code 3 where a verdict, each with the name of what it is on, is not the one that was asked for."""
    if required is None or all(verdict.status == required for _, verdict in verdicts):
        return
    found = ", ".join(f"{verdict.status} ({name})" for name, verdict in verdicts)
    click.echo(f"replant: the verdict is {found}, --require asks for {required}", err=True)
    sys.exit(NOT_REQUIRED)


def whole_log(path: Path, columns: dict[str, Any]) -> Log:
    """Read another log with the same columns, all of it."""
    return read({**columns, "begin": None, "end": None, "log": path})


def as_modelled(path: Path, columns: dict[str, Any], model: Model | RowModel | MatrixModel) -> dict[str, Any]:
    """Return columns with those of the model, and its sampling time, where neither an option nor the log tells them."""
    named = {"input_column": model.input_name, "output_column": model.output_name}
    found = columns | {role: columns[role] or name for role, name in named.items()}
    if columns["dt"] is None and columns["time_column"] is None:
        table = read_columns(path)
        found["dt"] = model.dt if table.dt is None and not time_columns(table) else None
    return found


def kept(model: Model, log: Log) -> Model:
    """Return a model with the names of a log's signals, and the name and digest of its file."""
    return model.of_log(log.input_name, log.output_name, log.path.name, digest(log.path))


def deliver(
    to: Delivery, result: Result, log: Log, *, tried: SearchResult | None = None, more: dict[str, Any], **report: Any
) -> None:
    """Print a result, write its plots and its report, save and validate its model.

    ``tried`` are structures among which it was chosen, ``more`` goes into its JSON and ``report`` onto its page.
    """
    result = dataclasses.replace(result, model=kept(result.model, log))
    validations = to.validated(result.model)
    logs, step = logs_in(log), None
    # the time between logs is no interval of a clock
    clocks = [] if len(logs) == 1 else [Clock.of(each.dt, each.stamps) for each in logs]
    if not (is_given("quiet") or validations):
        if to.saved is not None and result.verdict.status == "trusted":
            command = shlex.join(["replant", "validate", typed_path(to.saved), OTHER_LOG])
            step = NextStep("check the model on another log", command)
        else:
            path = str(click.get_current_context().params["logs"][0])
            step = next_step(result, log, path, is_searched=tried is not None)
    if to.as_json:
        structures = {} if tried is None else {"candidates": as_text.candidates_as_json(tried)}
        echo_json(as_text.as_json(result, clocks) | structures | more, validations)
    else:
        if tried is not None:
            as_text.print_candidates(terminal(), tried)
        record = as_text.record_line(len(log) - log.rest, log.dt, log.duration, len(logs))
        lead = "" if step is None else step.words
        as_text.print_result(terminal(), result, record=record, lead=lead, clocks=clocks)
        if result.settings is not None:
            click.echo(f"\nSettings chosen from the data; in Python:\n{identifier_as_python(result.settings)}")
        print_validations(validations)

    def write(out: Path) -> list[Path]:
        from replant.report.figures import save_figures
        from replant.report.result_page import write_report

        advice = None if step is None else (step.words, step.command)
        about = {"candidates": tried, "validations": validations, "advice": advice, "command": command_line()}
        names: Any = {"input_label": log.input_name, "output_label": log.output_name}
        paths = save_figures(out, result, log.input, log.output, log.dt, **names)
        return [*paths, write_report(out / "report.html", result, log, **(report | about))]

    to.finish(result.model, [("model", result.verdict)], validations, step, write)


def echo_json(whole: dict[str, Any], validations: Sequence[tuple[str, Validation]]) -> None:
    """Print a result, and its model's validations if there are some, as one JSON object."""
    if validations:
        whole = whole | {"validations": [as_text.validation_as_json(each, name) for name, each in validations]}
    click.echo(json.dumps(whole, allow_nan=False))


def print_validations(validations: Sequence[tuple[str, Validation]]) -> None:
    """Print the validations of a model."""
    for name, found in validations:
        as_text.print_validation(terminal(), found, name)


def print_written(paths: Sequence[Path]) -> None:
    """Print the files that were written."""
    for path in paths:
        click.echo(f"wrote {path}")


@contextmanager
def write_errors_reported(out: Path) -> Iterator[None]:
    """Turn errors of the file system into `click.BadParameter`, which names ``out``, or the file in that folder."""
    try:
        yield
    except OSError as cause:
        words = f"cannot write {(cause.filename if out.is_dir() else None) or out}: {cause.strerror}"
        if click.get_current_context().get_parameter_source("out") is ParameterSource.DEFAULT:
            raise click.ClickException(words) from cause
        raise click.BadParameter(words, param_hint="--out") from cause


#: Suffixes of files, which no folder for results is meant to have.
OF_FILES = (".csv", ".htm", ".html", ".json", ".pdf", ".png", ".svg", ".txt")


def make_folder(out: Path | None) -> None:
    """Make the folder for results, before the computation, so that a mistake costs no time.

    It is removed if it is empty when the command ends.
    """
    if out is None:
        return
    if out.exists() and not out.is_dir():
        raise click.BadParameter(f"{out} is a file; name a folder", param_hint="--out")
    if out.suffix.lower() in OF_FILES and not out.exists():
        raise click.BadParameter(f"{out} is the name of a file; report.html comes into a folder", param_hint="--out")
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    click.get_current_context().call_on_close(lambda: _remove_empty(made))
    with write_errors_reported(out):
        out.mkdir(parents=True, exist_ok=True)


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders that are empty, the innermost first."""
    with suppress(OSError):  # one has files, or was not made
        for folder in folders:
            folder.rmdir()
