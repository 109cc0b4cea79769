"""The examples at the end of each help page, as they stand."""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path

import click
import numpy as np
import pytest

import replant as rp
from replant.cli import COMMANDS, EXAMPLES, cli
from replant.model.transfer_function import TransferFunction
from replant.paper import figures, tables
from replant.paper.tables import Table, TableResult
from replant.signals import prbs
from support.cases import every
from support.command import call

LINES = sorted({line for examples in EXAMPLES.values() for _, line in examples})
SLOW = ("replant live", "replant demo", "replant reproduce")
SERVES = "replant open"  # until Ctrl-C: tests/workbench starts and ends it


def test_every_command_has_examples() -> None:
    assert set(EXAMPLES) == {"replant", *COMMANDS}


@every("command", EXAMPLES)
def test_help_ends_in_the_examples_line_by_line(capsys, command: str) -> None:
    code, out, err = call(capsys, *([] if command == "replant" else [command]), "--help")
    assert (code, err) == (0, "")
    shown = [line.strip() for line in out.partition("Examples:")[2].splitlines()]
    assert [line for line in shown if line and not line.startswith("#")] == [line for _, line in EXAMPLES[command]]


@every("line", LINES)
def test_every_example_is_a_command_with_options_that_there_are(line: str) -> None:
    _, name, *arguments = shlex.split(line)
    context = click.Context(cli)
    command = cli.get_command(context, name)
    assert command is not None
    assert command.make_context(name, arguments, parent=context).params


@cache
def model() -> rp.Model:
    return rp.fit(*signals(), 0.05, poles=1).model.of_log("u", "y", "log.csv")


@cache
def signals() -> tuple[np.ndarray, np.ndarray]:
    u = prbs(600, hold=10)
    return u, TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.05)


def working_folder(folder: Path) -> Path:
    """Return the folder, with a log of 2/(s + 0.5) under a PRBS, and its model."""
    u, y = signals()
    rows = [f"{0.05 * k:.2f},{u[k]:.9g},{y[k]:.9g}" for k in range(u.size)]
    (folder / "log.csv").write_text("t,u,y\n" + "\n".join(rows) + "\n")
    model().save(folder / "model.json")
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(working_folder(tmp_path))
    return tmp_path


def run_example(capsys, monkeypatch: pytest.MonkeyPatch, folder: Path, line: str) -> None:
    monkeypatch.chdir(working_folder(folder))
    code, out, _ = call(capsys, *shlex.split(line)[1:])
    assert code == 0
    assert out
    assert (folder / "plots").is_dir() == ("--out plots" in line)


@pytest.mark.usefixtures("unrendered")
@every("line", [line for line in LINES if not line.startswith((*SLOW, SERVES))], quick=2)
def test_examples_run(capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    run_example(capsys, monkeypatch, tmp_path, line)


@cache
def table(wanted: Table) -> TableResult:
    """A table of the article: two examples show it."""
    return tables.reproduce(wanted)


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("line", [line for line in LINES if line.startswith(SLOW)])
def test_long_examples_run(capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    """That for 20 s is left after 4."""
    monkeypatch.setattr(figures, "reproduce", lambda wanted, **_: table(wanted))
    run_example(capsys, monkeypatch, tmp_path, line.replace("--for 20s", "--for 4s"))


@every(
    ("arguments", "question"),
    [
        (["fti"], "did you mean 'fit'?"),
        (["comapre", "log.csv"], "did you mean 'compare'?"),
        (["fit", "log.csv", "--method", "srvic"], "did you mean 'srivc'?"),
        (["run", "log.csv", "--optimizer", "amsgrd"], "did you mean 'amsgrad'?"),
        (["compare", "log.csv", "--optimizer", "least-square"], "did you mean 'least_squares'?"),
        (["fit", "log.csv", "-i", "uu", "-o", "y", "-p", "1"], "(did you mean 'u'?); there are: u, t, y"),
        (["reproduce", "tabel1"], "did you mean 'table1'?"),
    ],
)
def test_a_misspelled_word_gets_the_nearest_one(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], question: str
) -> None:
    monkeypatch.chdir(working_folder(tmp_path))
    code, out, err = call(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert question in err


def test_a_word_like_no_other_gets_no_question(capsys, folder: Path) -> None:
    for arguments in (
        ["jump"],
        ["fit", "log.csv", "--method", "magic"],
        ["fit", "log.csv", "-i", "#", "-o", "y", "-p", 1],
    ):
        code, _, err = call(capsys, *arguments)
        assert code == 2
        assert "did you mean" not in err.lower()


@pytest.mark.parametrize("word", ["least-squares", "least_squares", "Least-Squares"])
def test_a_name_is_taken_with_either_line(capsys, folder: Path, word: str) -> None:
    assert call(capsys, "fit", "log.csv", "-i", "u", "-o", "y", "-p", 1, "--method", word, "--json")[0] == 0


@pytest.mark.parametrize("command", ["run", "fit"])
def test_the_size_of_the_record_is_printed(capsys, folder: Path, command: str) -> None:
    _, out, _ = call(capsys, command, "log.csv", "-i", "u", "-o", "y", "-p", 1)
    assert "\nRecord   600 samples, dt 50 ms, 30 s\n" in out
