"""``replant look``, ``examples``, ``show``, ``validate``, ``compare``: logs and saved models to look at and compare."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import click

from replant.cli import results
from replant.cli.messages import note, progress_bar, terminal
from replant.cli.option_types import JSON, Choice, column_option, command_line, flag, path_option, real
from replant.cli.run_fit_compare_options import (
    begin,
    check_said,
    compare_options,
    opened_as_python,
    read,
    request_of,
    structure_of,
)
from replant.errors import InvalidArgumentError, ModelFileError
from replant.examples import NAMES, path_of
from replant.fitting.log_inspection import inspect
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fitting.model_file import holds_model
from replant.fitting.several_outputs import MatrixModel, load_model
from replant.fitting.validation import Validation
from replant.model.interop import without_unit
from replant.numerics.operating_system import replacing
from replant.online.runs.run_log import METHODS, USUAL, compare
from replant.report import results_as_text as as_text
from replant.report.log_as_text import as_json as look_as_json
from replant.report.log_as_text import print_look


@click.command(name="look")
@click.argument("log", type=click.Path(path_type=Path))
@column_option("input", "Column of the input, if known: name, or number from 0.")
@column_option("output", "Column of the output, if known.")
@click.option("--time", "time_column", metavar="COL", help="Column of time, if known.")
@JSON
@path_option("--out", "DIR", "Write a plot of the columns (PNG) here.")
def look_command(log: Path, as_json: bool, out: Path | None, **columns: Any) -> None:
    """Show what is in LOG (csv, mat, parquet and more), and suggest a command to begin with.

    Columns with type, range, missing samples and resolution; the clock; which columns look like input, output and
    reference; and the delay between input and output.  Guesses are marked as such.
    """
    found = inspect(log, **{name.removesuffix("_column"): column for name, column in columns.items()})
    for left_out in found.table.notes:
        note(left_out)
    results.make_folder(out)
    if as_json:
        click.echo(json.dumps(look_as_json(found), allow_nan=False))
    else:
        print_look(terminal(), found)
    if out is not None:
        from replant.report.figures import save_columns

        with results.write_errors_reported(out):
            path = save_columns(out, found)
        results.print_written([] if as_json or path is None else [path])


@click.command(name="examples")
@path_option("--out", "DIR", "Folder.  [default: the current one]", default=".")
def examples_command(out: Path) -> None:
    """Write motor.csv and motor-step.csv, records of a DC motor, with their licence; a file that exists is kept."""
    results.make_folder(out)
    for name in NAMES:
        file = out / (name if name.endswith(".csv") else "motor-LICENSE")
        if file.exists():
            click.echo(f"kept {file}, which exists")
            continue
        with results.write_errors_reported(file), path_of(name) as source, replacing(file) as new:
            shutil.copyfile(source, new)
        click.echo(f"wrote {file}")


@click.command(name="show")
@click.argument("model", type=click.Path(path_type=Path))
@JSON
def show_command(model: Path, as_json: bool) -> None:
    """Print MODEL, a file that `--save` has written: G(s), its uncertainty, its verdict, and where it comes from."""
    loaded = load_model(model)
    if as_json:
        click.echo(loaded.to_json(), nl=False)
        return
    if isinstance(loaded, Model):
        as_text.print_kept_model(terminal(), loaded)
        return
    for row in loaded.rows if isinstance(loaded, MatrixModel) else (loaded,):
        as_text.print_row(terminal(), row)


@click.command(name="validate")
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("logs", type=click.Path(path_type=Path), nargs=-1)
@column_option("input", "Column of the input, or of each of several.  [default: the model's]", several=True)
@column_option("output", "Column of the output, or of each of several.  [default: the model's]", several=True)
@column_option("reference", "Column of the reference, if there is one, or of each of several.", several=True)
@click.option("--time", "time_column", metavar="COL", help="Column of time.")
@click.option("--dt", type=real, metavar="S", help="Sampling time in s.  [default: the log's, or the model's]")
@flag("--json", "Print a JSON list, an object a log.", "as_json")
@path_option("--out", "DIR", "Write a plot (PNG) a log here.")
@results.REQUIRE
def validate_command(
    model: Path, logs: tuple[Path, ...], as_json: bool, out: Path | None, required: str | None, **columns: Any
) -> None:
    """Compare MODEL with LOGS that it was not made from; only offset and initial state are estimated."""
    loaded = load_model(model)
    if not logs:
        raise click.UsageError(f"name the logs to compare the model with: replant validate {model} LOG")
    results.make_folder(out)
    found, rows = [], loaded.rows if isinstance(loaded, MatrixModel) else (loaded,)
    for name, path in results.by_name(logs):
        of_log = results.as_modelled(path, columns, loaded)
        for row, output in zip(rows, _outputs_of(loaded, of_log["output_column"]), strict=True):
            of_row = f"{name}, {row.output_name}" if isinstance(loaded, MatrixModel) else name
            found.append((of_row, results.validated(row, path, of_log | {"output_column": output})))
    if as_json:
        click.echo(json.dumps([as_text.validation_as_json(each, name) for name, each in found], allow_nan=False))
    else:
        results.print_validations(found)
    if out is not None:
        written = _plots(found, out)
        results.print_written([] if as_json else written)
    results.check_required(required, [(name, each.verdict) for name, each in found])


def _outputs_of(model: Model | RowModel | MatrixModel, named: Any) -> tuple[Any, ...]:
    """Return the column of the output of each row, of the columns that were named."""
    if not isinstance(model, MatrixModel):
        return (named,)
    if not isinstance(named, tuple) or len(named) != len(model.rows):
        raise click.UsageError(f"the model has {len(model.rows)} outputs: name a column for each, or none")
    return model.output_names if {*map(without_unit, named)} == {*map(without_unit, model.output_names)} else named


def _plots(found: list[tuple[str, Validation]], out: Path) -> list[Path]:
    """Write a plot for each log; return the files."""
    files: list[Path] = []
    with results.write_errors_reported(out):
        for name, each in found:
            stem = Path(name).stem
            taken = sum(file.name.startswith(f"{stem}-validation") for file in files)
            files.append(out / f"{stem}-validation{f'-{taken + 1}' if taken else ''}.png")
            each.plot()[0].figure.savefig(files[-1], dpi=110)
    return files


SHOWN = 7  # columns of the table that fit into a terminal [count]


def _compare_models(options: dict[str, Any]) -> None:
    """Compare the models in all files but the last over the log in the last one."""
    from replant.report.compared_page import HEADINGS, write_models
    from replant.report.compared_page import compare as compare_saved

    *saved, path = options["logs"]
    if holds_model(path) or not holds_model(saved[0]):
        raise click.UsageError("name the log behind the models: replant compare MODEL.json MODEL2.json LOG")
    if options["poles"] is not None:
        raise click.UsageError("--poles does not apply to saved models: leave it out")
    for twice in dict.fromkeys(each for each in saved if saved.count(each) > 1):
        note(f"{twice} is named {saved.count(twice)} times, and compared once")
    saved = list(dict.fromkeys(saved))
    stems = [each.stem for each in saved]
    models = {each.stem if stems.count(each.stem) == 1 else str(each): _of_one_input(each) for each in saved}
    out: Path | None = options["out"]
    results.make_folder(out)
    log = results.whole_log(path, results.as_modelled(path, options, next(iter(models.values()))))
    comparison = compare_saved(models, log)
    if options["as_json"]:
        all_of = {name: as_text.validation_as_json(each, path.name) for name, each in comparison.validations.items()}
        click.echo(json.dumps(all_of, allow_nan=False))
    else:
        console, plain = terminal(), str.maketrans({"±": "+-", "−": "-", "–": "-"})
        columns = [[cell.translate(plain) for cell in column] for column in zip(*comparison.rows, strict=True)]
        first = HEADINGS.index("poles")
        as_text.print_blocks(console, HEADINGS[:SHOWN], columns[:SHOWN], comparison.best, first=first)
        for name, found in comparison.validations.items():
            if found.verdict.status != "trusted" and found.verdict.reasons:
                console.print(f"\n{name}: {found.verdict.reasons[0]}", style="dim", highlight=False, markup=False)
    if out is not None:
        with results.write_errors_reported(out):
            comparison.plot()[0].figure.savefig(out / "models.png", dpi=110)
            written = [out / "models.png", write_models(out / "report.html", comparison, command_line())]
        results.print_written([] if options["as_json"] else written)


def _of_one_input(path: Path) -> Model:
    model = load_model(path)
    if not isinstance(model, Model):
        several = "inputs" if isinstance(model, RowModel) else "outputs"
        raise ModelFileError(
            f"{path}: it has several {several}, and replant compare takes models of one: use replant validate"
        )
    return model


@click.command(name="compare")
@compare_options
@click.option(
    "--optimizer",
    "methods",
    type=Choice(METHODS),
    multiple=True,
    default=USUAL,
    show_default=True,
    metavar="NAME",
    help=f"A method; repeat the option for several: {', '.join(METHODS)}.",
)
def compare_command(methods: tuple[str, ...], **options: Any) -> None:
    """Compare saved models over LOG: MODEL.json MODEL2.json LOG.  Or identify G(s) from LOG by several methods.

    An optimizer identifies online, in one pass, as `replant run` does; "default" is the method of `replant run` without
    options.  srivc and least_squares fit the whole log at once, as `replant fit` does.
    """
    check_said(options)
    if any(map(holds_model, options["logs"])):
        _compare_models(options)
        return
    begin(options, "replant compare takes one log, or saved models and a log")
    structure_of(options)  # before the log is read: a mistake costs no time
    log = read(options)
    request = request_of(options, log.dt)
    out: Path | None = options["out"]
    results.make_folder(out)
    methods = tuple(dict.fromkeys(methods))
    with progress_bar() as progress:
        task = progress.add_task("", total=len(methods))
        contenders = compare(
            request, log.input, log.output, methods,
            lambda name, part: progress.update(task, description=name, completed=methods.index(name) + part),
            reference=log.reference, t=log.stamps,
        )  # fmt: skip
    if all(entry.result is None for entry in contenders):
        raise InvalidArgumentError(f"no method found a model; {contenders[0].name}: {contenders[0].problem}")
    if options["as_json"]:
        named = {
            entry.name: {"problem": entry.problem} if (found := entry.result) is None
            else as_text.as_json(dataclasses.replace(found, model=results.kept(found.model, log)))
            for entry in contenders
        }  # fmt: skip
        click.echo(json.dumps(named, allow_nan=False))
    else:
        as_text.print_comparison(terminal(), contenders, request.structure, len(log))
    if out is not None:
        from replant.report.compared_page import save_figures, write_comparison

        with results.write_errors_reported(out):
            paths = save_figures(out, contenders, log, request.preprocess)
            told = command_line(), opened_as_python(options)
            paths.append(write_comparison(out / "report.html", contenders, log, request.preprocess, *told))
        results.print_written([] if options["as_json"] else paths)
