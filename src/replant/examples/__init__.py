"""Records of a real motor as CSV files, to try the package with.

They are `DCmotor_prbs_open_exp.csv` and `DCmotor_step_open_exp.csv` of the UNDCMotor kit, github.com/nebisman/UNDCMotor
(MIT licence, copyright 2024 Leonardo Bermeo): time ``t`` in s, voltage ``u`` in V, speed ``y`` in deg/s, every 20 ms.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib import resources
from pathlib import Path

from replant.logs import read_log
from replant.logs.log import Log

NAMES = ("motor.csv", "motor-step.csv", "LICENSE")


def motor() -> Log:
    """Return the record of a motor with a random binary voltage: 82 s.

    Examples
    --------
    >>> len(motor()), motor().dt
    (4093, 0.02)
    """
    with path_of("motor.csv") as path:
        return read_log(path, input="u", output="y")


def motor_step() -> Log:
    """Return the record of the same motor on another day, with voltage steps: 10 s.

    Examples
    --------
    >>> len(motor_step()), motor_step().dt
    (502, 0.02)
    """
    with path_of("motor-step.csv") as path:
        return read_log(path, input="u", output="y")


def path_of(name: str) -> AbstractContextManager[Path]:
    """Return a context manager that gives the path of one of the files."""
    return resources.as_file(resources.files(__name__).joinpath(name))
