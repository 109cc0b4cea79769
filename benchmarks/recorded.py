"""`make recorded`: every recorded log whose input moves, through `run` and `fit`, side by side.

    python benchmarks/recorded.py

Both simulate their model over the whole log, offset and initial state estimated.  Ends with exit code 1 where `run`
falls more than a point of fit below `fit`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from rich.console import Console
from rich.table import Table

import replant as rp
from accuracy.rigs import TCLAB, data_folder
from replant.estimation.settings import Request
from replant.logs import read_log
from replant.online.runs.run import run_online
from replant.verdict import simulate

MOST = 1.0  # points of fit by which `run` may fall below `fit`
BALL, MOTOR, HEATER = "ayala_ballhoop", "un_dcmotor", "un_thermal"
COLUMNS = {
    f"{BALL}/closedLoop.mat": (("u", "y", 0.1),),
    f"{BALL}/fixedStepSequence.mat": (("u", "y", 0.1),),
    f"{BALL}/randomStepSequence.mat": (("u", "y", 0.1),),
    "exchanger/exchanger_dat.mat": (("exchanger_dat[:,1]", "exchanger_dat[:,2]", 1.0),),
    TCLAB: tuple((f"data.udat[:,{k}]", f"data.ydat[:,{k}]", 1.0) for k in (0, 1)),
    f"{MOTOR}/DCmotor_prbs_open_exp.csv": (("u", "y", 0.02),),
    f"{MOTOR}/DCmotor_step_open_exp.csv": (("u", "y", 0.02),),
    f"{MOTOR}/DCmotor_profile_closed_exp.csv": (("u", "y", 0.02),),
    f"{MOTOR}/DCmotor_stairs_closed_exp.csv": (("u", "y", 0.02),),
    f"{MOTOR}/DCmotor_step_closed_exp.csv": (("u", "y", 0.02),),
    f"{HEATER}/Thermal_prbs_open_exp.csv": (("u", "y", 0.8),),
    f"{HEATER}/Thermal_profile_closed_exp.csv": (("u", "y", 0.8),),
    f"{HEATER}/Thermal_step_closed_exp.csv": (("u", "y", 0.8),),
    f"{HEATER}/dcmotor2_prbs_open_exp.csv": (("u", "y", 0.02),),
    f"{HEATER}/dcmotor2_step_open_exp.csv": (("u", "y", 0.02),),
}
STRUCTURES = (rp.Structure(1), rp.Structure(2), rp.Structure(2, 1))


def rows() -> Iterator[tuple[str, float, float, str]]:
    """Yield log and structure, the simulated fits of `run` and `fit` in percent, and the verdict of `run`."""
    for file, signals in COLUMNS.items():
        for column_in, column_out, dt in signals:
            log = read_log(data_folder() / file, input=column_in, output=column_out, dt=dt)
            for structure in STRUCTURES:
                request = Request(structure, dt, preprocess=rp.Preprocess("identity", "mean", "mean"))
                result = run_online(request, log.input, log.output)
                fitted = rp.fit(log.input, log.output, dt, structure)
                simulated = [
                    simulate(model, log.input, log.output, dt).fit
                    for model in (result.transfer_function, fitted.transfer_function)
                ]
                size = f"{structure.poles} pole{'s' * (structure.poles > 1)}, {structure.zeros} zeros"
                yield f"{file} {column_out}, {size}", *simulated, result.verdict.status


def main() -> int:
    """Print the table; return 1 where `run` falls too far below `fit`."""
    table, behind = Table(title="simulated fit of recorded logs, %"), 0
    for column in ("log, structure", "run", "fit", "verdict of run"):
        table.add_column(column)
    for name, online, offline, verdict in rows():
        mark = "" if offline - online <= MOST else "  NO"
        behind += bool(mark)
        table.add_row(name, f"{online:.1f}{mark}", f"{offline:.1f}", verdict)
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    return int(behind > 0)


if __name__ == "__main__":
    sys.exit(main())
