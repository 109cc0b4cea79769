"""Odd files through `fit`, `run` and `look`: the plant comes out, or one line says what is wrong."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

import numpy as np
import pytest

from replant.cli import main
from support.cases import every
from support.odd_files import ODD_FILES, OddFile

named = functools.partial(every, "file", ODD_FILES, ids=lambda file: file.name)


def test_there_are_sixty_and_each_has_its_name() -> None:
    assert len({file.name for file in ODD_FILES}) == len(ODD_FILES) >= 60


@named(quick=24)
@every("command", ["fit", "run"], quick=1)
def test_the_plant_comes_out_or_one_line_says_why_not(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, file: OddFile, command: str
) -> None:
    for package in file.packages:
        pytest.importorskip(package)
    path, (u, y) = file.write(tmp_path), file.columns
    words = [command, str(path), "-i", u, "-o", y, "-p", "1", "--quiet", "--json", *file.options]
    if file.refused:
        with pytest.raises(SystemExit) as ended:
            main(words)
        said = capsys.readouterr()
        assert (ended.value.code, said.out) == (2, "")
        assert said.err.count("\n") == 1, said.err
        assert re.search(file.refused, said.err), said.err
        return
    main(words)
    said = capsys.readouterr()
    found = {name: entry["value"] for name, entry in json.loads(said.out)["parameters"].items()}
    scale = 1000.0 if "thousands" in file.name else 1.0
    np.testing.assert_allclose([found["a0"], found["b0"] / scale], [2.0, 4.0], rtol=0.01)


@named(quick=15)
def test_look_shows_it_or_says_why_not(capsys: pytest.CaptureFixture[str], tmp_path: Path, file: OddFile) -> None:
    for package in file.packages:
        pytest.importorskip(package)
    path = file.write(tmp_path)
    code = 0
    try:
        main(["look", str(path)])
    except SystemExit as ended:
        code = int(ended.code or 0)
    said = capsys.readouterr()
    if code == 0:  # also a record that no fit can use is shown
        assert f"{path.name}: " in said.out.splitlines()[0]
        assert re.search(r"\nreplant fit .* -i .* -o .* -p [12]", said.out, re.DOTALL) or file.refused, said.out
    else:
        assert (code, bool(file.refused)) == (2, True), said.err
        assert said.err.strip().count("\n") == 0, said.err
