"""A row of units below the names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from replant.logs import read_columns, read_log
from replant.logs.text_cells import units_in
from support.cases import every

Write = Callable[..., Path]

UNITS = {
    "brackets": "t;u;y\n[s];[V];[mm]\n",
    "round brackets": "t;u;y\n(s);(V);(mm)\n",
    "bare": "t;u;y\ns;V;mm\n",
    "after a comment": "t;u;y\n# recorded in May\ns;V;mm\n",
    "some in the names": "t [s];u;y\n;V;mm\n",
    "delimiter at the end": "t;u;y;\ns;V;mm;\n",
}


@every("head", UNITS.values(), ids=UNITS)
@every("row", ["{};1,5;2\n", "{};1.5;2\n"])
def test_a_row_of_units_joins_the_names(write: Write, head: str, row: str) -> None:
    path = write(head + row.format(0) + row.format(1))
    assert read_columns(path).names == ("t [s]", "u [V]", "y [mm]")
    log = read_log(path, input="u", output="Y")
    assert (log.dt, log.input_name, log.output_name, log.input.tolist()) == (1.0, "u [V]", "y [mm]", [1.5, 1.5])


def test_the_unit_of_the_time_counts(write: Write) -> None:
    path = write("t,u,y\nms,V,-\n0,1,2\n20,1,2\n")
    assert read_log(path, input="u", output="y").dt == 0.02
    assert read_columns(path).names == ("t [ms]", "u [V]", "y")


def test_a_name_without_its_unit_must_be_of_one_column(write: Write) -> None:
    table = read_columns(write("u [V],u [mV],y [mm]\n1,2,3\n2,3,4\n"))
    assert table.find("y") == 2
    with pytest.raises(ValueError, match=r"column 'u' could be any of 0 \('u \[V\]'\), 1 \('u \[mV\]'\)"):
        table.find("u")


@every("row", ["0,V,mm", "RUN,STOP,OFF", "x,x,x", ",,", "nan,na,null", "1,2,3", "u,y,z", "1.5x,2,V"])
def test_rows_that_are_none_of_units(row: str) -> None:
    assert units_in(row.split(",")) is None


@every("unit", ["m/s^2", "N*m", "kg m^2", "°C", "U/min", "%", "mV/V", "µs", "nA", "rad/s", "m³/h"])
def test_known_units_are_recognized(unit: str) -> None:
    assert units_in(["s", unit]) == ["s", unit]
