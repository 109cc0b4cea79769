"""``replant demo``: identifies the simulated actuator, by default settings and by the article's method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from replant.arguments import FloatArray
from replant.cli.output import make_folder, write_errors_reported
from replant.cli.reproduce import deliver
from replant.cli.typed_command import command_line
from replant.data.logs import Log
from replant.model.structure import Structure
from replant.optimizers import AMSGrad
from replant.optimizers.optimizer import Replay
from replant.paper.catalogue import ACTUATOR, ACTUATOR_FIGURES
from replant.regressor.filters import StateVariableFilter
from replant.report.figures import save_figures
from replant.report.html.report import write_report
from replant.report.number_format import off_by
from replant.report.terminal.summary import print_result, true_parameters
from replant.rigs import Rig, deap_rig, deap_voltage
from replant.runs.result import Result
from replant.runs.run import run_online
from replant.settings import Request

SAMPLES = 240_000  # length of the demo's record: 240 s at 1 kHz [samples]
VOLTAGE = 6  # seed of a voltage that still changes at the end, which the verdict on the newest samples needs [seed]
STRUCTURE = Structure(poles=3, zeros=1)
DEFAULT, ARTICLE = "replant's default", "the article's AMSGrad"
TITLE = "Dielectric elastomer actuator, simulated"
SIGNALS = ("voltage [kV]", "displacement [mm]")


@click.command(name="demo")
@click.option("--out", type=click.Path(path_type=Path), default="out/demo", show_default=True, metavar="DIR")
@click.option(
    "--full", is_flag=True, help="Run the article's whole experiment instead: 12 methods compared, Figures 6-8."
)
def demo_command(out: Path, full: bool) -> None:
    """Identify a simulated dielectric elastomer actuator while it runs: 240 s at 1 kHz, 1 um of laser noise.

    It is identified twice: with default settings, and by the article's method (state-variable filters, normalisation,
    AMSGrad, a replay buffer of 240000 samples).  Plots and report show the result of the default settings.
    """
    if full:
        deliver((*ACTUATOR_FIGURES, ACTUATOR), out, report=True)
        return
    from rich.console import Console

    make_folder(out)
    console = Console()
    rig = deap_rig()
    u = deap_voltage(SAMPLES, seed=VOLTAGE)
    y = rig.measure(u)
    console.print("A dielectric elastomer actuator, simulated: squared voltage in kV to displacement in mm.")
    results = _identify(rig, u, y, console)
    print_result(console, results[DEFAULT], truth=rig.plant)
    _print_beside(console, results, true_parameters(rig.plant))
    for path in _write(out, results[DEFAULT], rig, u, y):
        click.echo(f"wrote {path}")


def _identify(rig: Rig, u: FloatArray, y: FloatArray, console: Any) -> dict[str, Result]:
    """Run both methods over the record, with a progress bar."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    article = {
        "filter": StateVariableFilter(cutoff=20.0),
        "optimizer": AMSGrad(step_size=3e-5),
        "replay": Replay(capacity=SAMPLES),
    }
    chosen: dict[str, dict[str, Any]] = {DEFAULT: {}, ARTICLE: article}
    columns = (
        TextColumn("{task.description:21}"), BarColumn(), TextColumn("{task.completed:,.0f} samples"),
        TimeElapsedColumn(),
    )  # fmt: skip
    results = {}
    with Progress(*columns, console=console) as progress:
        for name, settings in chosen.items():
            request = Request(STRUCTURE, rig.dt, preprocess=rig.preprocess, **settings)
            results[name] = run_online(request, u, y, _counter(progress, name, u.size))
    return results


def _counter(progress: Any, name: str, total: int) -> Callable[[int], None]:
    task = progress.add_task(name, total=total)
    return lambda done: progress.update(task, completed=done)


def _print_beside(console: Any, results: Mapping[str, Result], true: Sequence[float]) -> None:
    """Print the error of each method's coefficients, its fit and its verdict with the first reason."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0))
    for heading in ("off by", *results):
        table.add_column(heading, justify="left" if heading == "off by" else "right", no_wrap=True)
    for i, (name, target) in enumerate(zip(STRUCTURE.names, true, strict=True)):
        table.add_row(Text(name), *(off_by(float(result.parameters[i]), target) for result in results.values()))
    table.add_row("simulated fit", *(f"{result.simulation.fit:.1f} %" for result in results.values()))
    table.add_row("verdict", *(result.verdict.status for result in results.values()))
    console.print()
    console.print(table)
    other = results[ARTICLE].verdict
    if other.status != "trusted":
        console.print(Text(f"{ARTICLE}: {other.reasons[0]}", "dim"))
    console.print()


def _write(out: Path, result: Result, rig: Rig, u: FloatArray, y: FloatArray) -> list[Path]:
    truth = true_parameters(rig.plant)
    labels = dict(zip(("input_label", "output_label"), SIGNALS, strict=True))
    log = Log(u, y, rig.dt, None, *SIGNALS, Path())
    with write_errors_reported(out):
        paths = save_figures(out, result, u, y, rig.dt, truth=truth, **labels)
        paths.append(write_report(out / "report.html", result, log, truth=truth, command=command_line(), title=TITLE))
    return paths
