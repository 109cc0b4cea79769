"""``replant reproduce`` and ``replant demo``: the article's tables and figures, and its actuator."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from replant.cli.messages import did_you_mean, progress_bar, terminal
from replant.cli.option_types import command_line, flag, path_option
from replant.cli.results import make_folder, write_errors_reported
from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers import AMSGrad
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import Request
from replant.fleet.executors import parsed
from replant.logs import Log
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.online.runs.result import Result
from replant.online.runs.run import run_online
from replant.paper import rendering
from replant.paper.figures import ACTUATOR, ACTUATOR_FIGURES, NAMES, Outcome, is_figure, run, save, steps
from replant.paper.rendering import as_element
from replant.paper.rendering import write_report as write_reproduction
from replant.plotting.numbers import off_by, true_parameters
from replant.report.figures import save_figures
from replant.report.result_page import write_report
from replant.report.results_as_text import print_result, table
from replant.rigs import Rig, deap_rig, deap_voltage

DEFAULT_FOLDER = Path("out/reproduce")


def _known(ctx: click.Context, parameter: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names without repetition; all names if none is given."""
    for name in names:
        if name not in NAMES:
            near = did_you_mean(name, NAMES, " ({})")
            raise click.UsageError(f"there is no {name!r} to reproduce{near}: choose from {', '.join(NAMES)}", ctx)
    return tuple(dict.fromkeys(names)) or NAMES


@click.command(name="reproduce", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("names", nargs=-1, metavar="[NAME]...", callback=_known)
@click.option(
    "--on",
    metavar="WHERE",
    help="Compute the tables on threads:N, processes:N or dask://HOST:PORT.  [default: here]",
)
@flag("--json", "Print one JSON object and nothing else.", "json_only")
@path_option(
    "--out",
    "DIR",
    f"Write figures (PNG, SVG), tables and report.html here.  [default: {DEFAULT_FOLDER} if there are figures]",
)
def reproduce_command(names: tuple[str, ...], on: str | None, json_only: bool, out: Path | None) -> None:
    """Reproduce the article's tables and figures, beside the published numbers.

    NAME is table1 to table4, fig1 to fig4, fig6 to fig8, or actuator: the table that compares the runs of Figures 7
    and 8, on a simulated rig.  Without a name everything is reproduced, and report.html shows all of it.

    In the tables, rows without a replay buffer are deterministic and compared in the three printed digits.  Rows with a
    buffer are run with 20 seeds, and compared by mean and standard deviation.
    """
    if out is None and any(is_figure(name) for name in names):
        out = DEFAULT_FOLDER
    if on is not None:
        parsed(on)
    deliver(names, out, json_only=json_only, report=names == NAMES, on=on)


def deliver(
    names: Sequence[str], out: Path | None, *, json_only: bool = False, report: bool = False, on: str | None = None
) -> None:
    """Reproduce tables and figures, print the tables, and write everything into a folder."""
    make_folder(out)
    drawn = [name for name in names if is_figure(name)]
    if drawn:
        from replant.plotting.style import blank_figure

        blank_figure(1.0, 1.0)  # raises without matplotlib, before the computation
    written, pictures = list[Path](), dict[str, str]()
    with progress_bar() as progress:
        task = progress.add_task("", total=steps(names) + len(drawn))
        outcome = run(names, lambda name: progress.update(task, description=name, advance=1), on)
        text = json.dumps(rendering.as_json(outcome), indent=2, allow_nan=False)
        if out is not None:
            with write_errors_reported(out):
                for name, canvas, paths in save(outcome, drawn, out) if drawn else ():
                    written += paths
                    pictures |= {name: as_element(canvas, name)} if report else {}
                    progress.update(task, description=name, advance=1)
                if outcome.tables or outcome.actuator:
                    written += [out / "tables.md", out / "tables.json"]
                    for path, content in zip(written[-2:], (rendering.as_markdown(outcome), f"{text}\n"), strict=True):
                        path.write_text(content, encoding="utf-8")
                if report:
                    written.append(write_reproduction(out / "report.html", outcome, pictures, command_line()))
    if json_only:
        click.echo(text)
    else:
        _show(outcome, written)


def _show(outcome: Outcome, written: Sequence[Path]) -> None:
    from rich.padding import Padding

    console = terminal(highlight=False, markup=False)
    if outcome.tables:
        console.print(rendering.SOURCE)
    for title, shown, notes, conclusions in rendering.for_terminal(outcome):
        console.print()
        console.print(title, style="bold")
        console.print(shown)
        for line in notes:
            console.print(Padding(line, (0, 0, 0, 2), expand=False), style="dim")
        if conclusions:
            console.print()
        for line in conclusions:
            console.print(line)
    for path in written:
        if path.suffix != ".svg":
            console.print(f"wrote {path}" + (" and .svg" if path.suffix == ".png" else ""), soft_wrap=True)


SAMPLES = 240_000  # length of the demo's record: 240 s at 1 kHz [samples]
VOLTAGE = 6  # seed of a voltage that still changes at the end, which the verdict on the newest samples needs [seed]
STRUCTURE = Structure(poles=3, zeros=1)
DEFAULT, ARTICLE = "replant's default", "the article's AMSGrad"
TITLE = "Dielectric elastomer actuator, simulated"
SIGNALS = ("voltage [kV]", "displacement [mm]")


@click.command(name="demo")
@path_option("--out", "DIR", "", default="out/demo", show_default=True)
@flag("--full", "Run the article's whole experiment instead: 12 methods compared, Figures 6-8.")
def demo_command(out: Path, full: bool) -> None:
    """Identify a simulated dielectric elastomer actuator while it runs: 240 s at 1 kHz, 1 um of laser noise.

    It is identified twice: with default settings, and by the article's method (state-variable filters, normalisation,
    AMSGrad, a replay buffer of 240000 samples).  Plots and report show the result of the default settings.
    """
    if full:
        deliver((*ACTUATOR_FIGURES, ACTUATOR), out, report=True)
        return
    make_folder(out)
    console = terminal()
    rig = deap_rig()
    u = deap_voltage(SAMPLES, seed=VOLTAGE)
    y = rig.measure(u)
    console.print("A dielectric elastomer actuator, simulated: squared voltage in kV to displacement in mm.")
    results = _identify(rig, u, y)
    print_result(console, results[DEFAULT], truth=rig.plant)
    _print_beside(console, results, true_parameters(rig.plant))
    for path in _write(out, results[DEFAULT], rig, u, y):
        click.echo(f"wrote {path}")


def _identify(rig: Rig, u: FloatArray, y: FloatArray) -> dict[str, Result]:
    """Run both methods over the record, with a progress bar."""
    article = {
        "filter": StateVariableFilter(cutoff=20.0),
        "optimizer": AMSGrad(step_size=3e-5),
        "replay": Replay(capacity=SAMPLES),
    }
    chosen: dict[str, dict[str, Any]] = {DEFAULT: {}, ARTICLE: article}
    results = {}
    with progress_bar(rate=True) as bar:
        for name, settings in chosen.items():
            task = bar.add_task(name, total=u.size)
            request = Request(STRUCTURE, rig.dt, preprocess=rig.preprocess, **settings)

            def show(done: int, task: Any = task) -> None:
                bar.update(task, completed=done)

            results[name] = run_online(request, u, y, show)
    return results


def _print_beside(console: Any, results: Mapping[str, Result], true: Sequence[float]) -> None:
    """Print the error of each method's coefficients, its fit and its verdict with the first reason."""
    from rich.text import Text

    rows = [
        (name, *(off_by(float(result.parameters[i]), target) for result in results.values()))
        for i, (name, target) in enumerate(zip(STRUCTURE.names, true, strict=True))
    ]
    rows.append(("simulated fit", *(f"{result.simulation.fit:.1f} %" for result in results.values())))
    rows.append(("verdict", *(result.verdict.status for result in results.values())))
    console.print()
    console.print(table(("off by", *results), rows, left=(0,), no_wrap=True))
    other = results[ARTICLE].verdict
    if other.status != "trusted":
        console.print(Text(f"{ARTICLE}: {other.reasons[0]}", "dim"))
    console.print()


def _write(out: Path, result: Result, rig: Rig, u: FloatArray, y: FloatArray) -> list[Path]:
    truth, log = true_parameters(rig.plant), Log(u, y, rig.dt, None, *SIGNALS)
    with write_errors_reported(out):
        labels = {"input_label": log.input_name, "output_label": log.output_name}
        paths = save_figures(out, result, u, y, rig.dt, truth=truth, **labels)
        paths.append(write_report(out / "report.html", result, log, truth=truth, command=command_line(), title=TITLE))
    return paths
