"""A short, seeded slice of `make fuzz` over each file format: mutants are read or refused in one line."""

from __future__ import annotations

import importlib.util

import pytest

from fuzz.files import run_file
from fuzz.seeds_of_files import FORMATS
from support.cases import every

TRIES, MORE = 2, 5  # in `make test` and in `make slow`; as many as one likes in `make fuzz`


@pytest.mark.slow
@every("name", FORMATS)
def test_mutants_of_a_format(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    mutants(name, MORE, capsys)


def mutants(name: str, tries: int, capsys: pytest.CaptureFixture[str]) -> None:
    for package in FORMATS[name][2]:
        if importlib.util.find_spec(package.partition(".")[0]) is None:
            pytest.skip(f"{package} is not installed")
    assert run_file(name, 0, 0.0, tries) == 0, capsys.readouterr().out
