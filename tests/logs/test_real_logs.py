"""Logs of real rigs, as their authors published them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.cases import every

LOGS = [
    ("un_dcmotor/DCmotor_prbs_open_exp.csv", {"input": "u", "output": "y"}, 4093, 0.02),
    ("un_dcmotor/DCmotor_profile_closed_exp.csv", {"input": "u", "output": "y"}, 201, 0.02),
    ("un_thermal/Thermal_prbs_open_exp.csv", {"input": "u", "output": "y"}, 1575, 0.8),
    ("un_thermal/dcmotor2_prbs_open_exp.csv", {"input": "u", "output": "y"}, 4093, 0.02),
    ("ayala_ballhoop/randomStepSequence.mat", {"input": "u", "output": "y"}, 8150, 0.1),
    ("ayala_ballhoop/fixedStepSequence.mat", {"input": "u", "output": "y"}, 2150, 0.1),
    ("tclab/tclab_kuntz_rawlings_2022.mat", {"input": "data.udat[:,0]", "output": "data.ydat[:,0]"}, 7140, 1.0),
    (
        "exchanger/exchanger_dat.mat",
        {"input": "exchanger_dat[:,1]", "output": "exchanger_dat[:,2]", "time": "exchanger_dat[:,0]"},
        4000,
        1.0,
    ),
]


@every(("name", "choice", "samples", "dt"), LOGS, ids=[name for name, *_ in LOGS])
def test_logs_have_their_length_and_sampling_time(
    datasets: Path, name: str, choice: dict[str, Any], samples: int, dt: float
) -> None:
    log = read_log(datasets / name, **choice)
    assert (len(log), log.dt) == (samples, dt)
    assert np.isfinite(log.input).all()
    assert np.isfinite(log.output).all()


def test_the_input_of_the_motor_has_two_levels(datasets: Path) -> None:
    log = read_log(datasets / "un_dcmotor/DCmotor_prbs_open_exp.csv", input="u", output="y")
    assert np.unique(log.input).tolist() == [0.35084835, 0.43567032]


def test_a_first_row_that_is_written_twice_counts_once(datasets: Path) -> None:
    path = datasets / "un_thermal/Thermal_profile_closed_exp.csv"
    with pytest.warns(
        UserWarning, match="a row repeats the previous one, with the same time stamp; repetitions are left out"
    ):
        log = read_log(path, input="u", output="y")
    assert (log.dt, len(log)) == (0.8, 251)
    assert len(read_log(path, input="u", output="y", dt=0.8)) == 252


def test_a_matrix_without_index_lists_its_columns(datasets: Path) -> None:
    table = read_columns(datasets / "exchanger/exchanger_dat.mat")
    with pytest.raises(LogError, match=r"there are: exchanger_dat\[:,0\], exchanger_dat\[:,1\], exchanger_dat\[:,2\]$"):
        table.column("exchanger_dat")
