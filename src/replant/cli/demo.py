"""``replant demo``: the main job on the simulated actuator."""

from __future__ import annotations

from pathlib import Path

import click

from replant.cli.output import command_line
from replant.cli.reproduce import deliver
from replant.filters import StateVariableFilter
from replant.logs import Log
from replant.optimizers import AMSGrad
from replant.paper.everything import ACTUATOR, ACTUATOR_FIGURES
from replant.replay import Replay
from replant.report.figures import save_figures
from replant.report.html import write_report
from replant.report.summary import print_result, true_parameters
from replant.rigs import deap_rig, deap_voltage
from replant.runs import run_online
from replant.settings import Request
from replant.structure import Structure

SAMPLES = 240_000  # 240 s at 1 kHz


@click.command(name="demo")
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True, metavar="DIR")
@click.option("--full", is_flag=True, help="Instead, the article's whole experiment: 12 methods compared, Figures 6-8.")
def command(out: Path, full: bool) -> None:
    """Identify a simulated dielectric elastomer actuator while it runs: 240 s at 1 kHz, 1 um of laser noise.

    The article's method throughout: state-variable filters, normalisation, AMSGrad, a replay buffer of 240000.
    """
    if full:
        deliver((*ACTUATOR_FIGURES, ACTUATOR), out, report=True)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console()
    rig = deap_rig()
    u = deap_voltage(SAMPLES, seed=6)  # one that still moves at the end, for a verdict on samples held out
    y = rig.measure(u)
    request = Request(
        Structure(poles=3, zeros=1),
        rig.dt,
        filter=StateVariableFilter(cutoff=20.0),
        optimizer=AMSGrad(step_size=3e-5),
        replay=Replay(capacity=SAMPLES),
        preprocess=rig.preprocess,
    )
    console.print("A dielectric elastomer actuator, simulated: squared voltage in kV to displacement in mm.")
    columns = (TextColumn("identifying"), BarColumn(), TextColumn("{task.completed:,.0f} samples"), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=SAMPLES)
        result = run_online(request, u, y, lambda done: progress.update(task, completed=done))
    print_result(console, result, truth=rig.plant)
    console.print()
    names = ("voltage [kV]", "displacement [mm]")
    truth = true_parameters(rig.plant)
    paths = save_figures(out, result, u, y, rig.dt, truth=truth, input_label=names[0], output_label=names[1])
    log = Log(u, y, rig.dt, None, *names, Path())
    title = "Dielectric elastomer actuator, simulated"
    paths.append(write_report(out / "report.html", result, log, truth=truth, command=command_line(), title=title))
    for path in paths:
        click.echo(f"wrote {path}")
