"""The mutants: single changes of a line, none of which is proved to do the same as the line."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import mutants


@every(
    ("line", "becomes"),
    [
        ("x < y", ["x <= y"]),
        ("x in y", ["x not in y"]),
        ("a + 2.5", ["a - 2.5", "5.0"]),
        ("not x", ["x"]),
        ("-x", ["x"]),
        ("True", ["False"]),
        ("7", ["8"]),
        ("0.0", ["1.0"]),
        ("a and b", ["a or b"]),
        ("f(zip(a, b, strict=True))", []),
        ("f'{x < 1}'", []),
        ("LIMIT = 7", []),
        ("raise ValueError(7)", []),
    ],
)
def test_what_a_line_becomes(line: str, becomes: list[str]) -> None:
    found = [ast.unparse(one) for node in mutants.expressions(ast.parse(line)) for one in mutants.mutants_of(node)]
    assert found == becomes


def test_no_proof_is_without_words_and_each_is_of_a_module() -> None:
    equivalent = mutants.proved()
    assert equivalent
    for name, of_module in mutants.tomllib.loads(mutants.EQUIVALENT.read_text(encoding="utf-8")).items():
        assert Path(name).suffix == ".py"
        assert all({*each} == {"line", "becomes", "proof"} and len(each["proof"]) > 40 for each in of_module)


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of two lines, of which one has a mutant that is proved to do the same."""
    module = tmp_path / mutants.SOURCE / "fleet" / "one.py"
    module.parent.mkdir(parents=True)
    module.write_text("def f(x):\n    y = x + 0\n    return y > 1\n", encoding="utf-8")
    proofs = tmp_path / "equivalent.toml"
    proofs.write_text('[["fleet/one.py"]]\nline = "y = x + 0"\nbecomes = "y = (x - 0)"\nproof = "x - 0 is x"\n')
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    monkeypatch.setattr(mutants, "EQUIVALENT", proofs)
    return module


def drawn_lines() -> set[str]:
    return {one["new"].strip() for seed in range(40) for one in mutants.drawn(2, seed, ["fleet"])}


def test_what_is_proved_to_do_the_same_is_not_drawn(small: Path) -> None:
    assert drawn_lines() == {"y = x + (1)", "return (y >= 1)", "return y > (2)"}
    mutants.EQUIVALENT.write_text("")
    assert "y = (x - 0)" in drawn_lines()


def test_a_proof_of_a_line_that_was_changed_is_named(small: Path) -> None:
    assert mutants.outdated(mutants.proved()) == []
    small.write_text(small.read_text().replace("x + 0", "0 + x"))
    assert mutants.outdated(mutants.proved()) == [("fleet/one.py", "y = x + 0", "y = (x - 0)")]


@pytest.mark.parametrize("near_only", [False, True])
def test_the_tests_nearest_to_a_change_run_first_and_all_of_them_last(small: Path, near_only: bool) -> None:
    folder = mutants.ROOT / "tests" / "fleet"
    folder.mkdir(parents=True)
    for name, text in {"one": "", "two": "from replant.fleet.one import f", "three": ""}.items():
        (folder / f"test_{name}.py").write_text(text)
    path = mutants.SOURCE / "fleet" / "one.py"
    first, *others = mutants.tests_for("fleet", path, near_only)
    assert first == [str(path), "tests/fleet/test_one.py", "tests/fleet/test_two.py"]
    whole = [] if near_only else [["tests", "src", "--ignore=tests/fleet"]]
    assert others == [["tests/fleet"], *whole]
