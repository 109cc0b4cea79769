"""The command line, called in this process, and a log for it."""

from __future__ import annotations

from pathlib import Path

from replant.cli import main
from replant.model.transfer_function import TransferFunction
from replant.signals import prbs


def call(capsys, *arguments: object) -> tuple[int, str, str]:
    """Run the command line in this process; return exit code, stdout and stderr."""
    try:
        main([str(argument) for argument in arguments])
        code = 0
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def log_of_a_lag(folder: Path) -> Path:
    """Return a log of 2/(s + 0.5) under a PRBS, with a working point."""
    u = 3.0 + prbs(2000, hold=10)
    y = 7.0 + TransferFunction([2.0], [1.0, 0.5]).simulate(u - 3.0, dt=0.05)
    path = folder / "log.csv"
    rows = [f"{0.05 * k:.2f},{u[k]:.17g},{y[k]:.17g}" for k in range(u.size)]
    path.write_text("t,u,y\n" + "\n".join(rows) + "\n")
    return path
