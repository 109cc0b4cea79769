"""What `run` and `fit` do with their model: save it, validate it on another log, demand a verdict."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from replant.assessment.verdict import Verdict
from replant.cli.conditioning_options import NAMES as STRETCH_NAMES
from replant.cli.nearest_word import Choice
from replant.cli.notes import note
from replant.cli.options import read
from replant.data.logs import Log, read_columns
from replant.data.logs.recording import digest
from replant.data.logs.sampling_time import time_candidates
from replant.errors import InvalidArgumentError
from replant.identified.model import Model
from replant.identified.model_file import check_target
from replant.identified.validation import Validation

NOT_REQUIRED = 3  # exit code where a verdict is not the one that `--require` asks for [number]

REQUIRE = click.option(
    "--require",
    "required",
    type=Choice(["trusted"]),
    help="Exit with code 3 where a verdict is another one.",
)
OPTIONS: list[Callable[[Any], Any]] = [
    click.option(
        "--validate",
        "other_logs",
        type=click.Path(path_type=Path),
        multiple=True,
        metavar="LOG2",
        help="Compare the model with another log of the same columns; repeat the option for several.",
    ),
    click.option("--save", "saved", type=click.Path(path_type=Path), metavar="FILE", help="Write the model (.json)."),
    REQUIRE,
]


def keeping_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a click command with the options of this module, which `Keeping` takes."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


@dataclass(frozen=True)
class Keeping:
    """What is to be done with a model.

    Attributes
    ----------
    saved : Path or None
        File to write it to.
    other_logs : tuple of Path
        Logs to validate it on.
    required : str or None
        The verdict that is asked for.
    columns : dict
        The options that name the columns and the clock of the logs.
    """

    saved: Path | None
    other_logs: tuple[Path, ...]
    required: str | None
    columns: dict[str, Any]

    @classmethod
    def of(cls, options: dict[str, Any]) -> Keeping:
        """Take the options of this module out of those of a command."""
        saved, logs, required = (options.pop(name) for name in ("saved", "other_logs", "required"))
        if saved is not None:
            check_target(saved)
        for path in logs:
            if not path.exists():
                raise InvalidArgumentError(f"--validate {path}: no such file")
        return cls(saved, logs, required, dict(options))

    def validated(self, model: Model) -> list[tuple[str, Validation]]:
        """Return the model's validation on each of the other logs, by the name of the log."""
        path: Path = self.columns["log"]
        stretches = []
        for begin, end in self.columns.get("validate_on") or ():
            part = {"begin": begin, "end": end if math.isfinite(end) else None}
            name = f"{path.name}, {begin:g} s to {f'{end:g} s' if math.isfinite(end) else 'the end'}"
            stretches.append((name, model.validate(read(self._columns | part))))
        return stretches + validated(model, self.other_logs, self._columns)

    @property
    def _columns(self) -> dict[str, Any]:
        return {**self.columns, **dict.fromkeys(STRETCH_NAMES)}


def validated(model: Model, paths: Sequence[Path], columns: dict[str, Any]) -> list[tuple[str, Validation]]:
    """Return a model's validation on logs, by their names, or by their paths where names repeat."""
    names = [path.name for path in paths]
    found = []
    for path, name in zip(paths, names, strict=True):
        validation = model.validate(whole_log(path, columns))
        if model.provenance.sha256 and digest(path) == model.provenance.sha256:
            note(f"{path}: it is the log that the model was made from; another one tells more")
        found.append((str(path) if names.count(name) > 1 else name, validation))
    return found


def check_required(required: str | None, verdicts: Sequence[Verdict]) -> None:
    """Exit with code 3 where a verdict is not the one that was asked for."""
    if required is None or all(verdict.status == required for verdict in verdicts):
        return
    found = ", ".join(verdict.status for verdict in verdicts)
    click.echo(f"replant: the verdict is {found}, --require asks for {required}", err=True)
    sys.exit(NOT_REQUIRED)


def whole_log(path: Path, columns: dict[str, Any]) -> Log:
    """Read another log with the same columns, all of it."""
    return read({**columns, "begin": None, "end": None, "log": path})


def model_clock(path: Path, columns: dict[str, Any], dt: float) -> dict[str, Any]:
    """Return the model's sampling time where neither the log nor an option tells one."""
    told = columns["dt"] is not None or columns["time_column"] is not None
    return {} if told or time_candidates(read_columns(path).names) else {"dt": dt}


def kept(model: Model, log: Log) -> Model:
    """Return a model with the names of a log's signals, and the name and digest of its file."""
    return model.of_log(log.input_name, log.output_name, log.path.name, digest(log.path))
