"""The parser process reads the same as this process, in every format with a library."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from fuzz.seeds_of_files import FORMATS, path_of, seeds_of
from replant.errors import LogError
from replant.logs import read_columns
from replant.logs.table import Table
from replant.numerics.arguments import FloatArray
from support.cases import every
from support.forks import is_isolated

APART = [name for name in FORMATS if is_isolated(path_of(Path(), name))]


def column_of(table: Table, name: str) -> FloatArray | str:
    """A column, or why it cannot be read."""
    try:
        return table.column(name)
    except LogError as reason:
        return str(reason)


@every("name", APART, quick=5)
def test_what_is_read_apart_is_what_is_read_here(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in FORMATS[name][2]:
        if importlib.util.find_spec(package.partition(".")[0]) is None:
            pytest.skip(f"{package} is not installed")
    path = path_of(tmp_path, name)
    path.write_bytes(seeds_of(name)[0])
    apart = read_columns(path)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    here = read_columns(path)
    assert apart.names == here.names
    for column in here.names:
        read, expected = column_of(apart, column), column_of(here, column)
        assert isinstance(read, str) == isinstance(expected, str)
        np.testing.assert_array_equal(read, expected)
