"""The options that name columns: never is one of them dropped."""

from pathlib import Path

import pytest

from support.cases import every
from support.command import call, log_of_a_lag

COMMANDS = ("run", "compare", "look", "fleet")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return log_of_a_lag(tmp_path)


@pytest.mark.parametrize(
    ("command", "option", "words"),
    [
        *(
            (command, "-i", "only replant fit, run, validate, fleet and live take several inputs")
            for command in COMMANDS[1:-1]
        ),
        *((command, "-o", "only replant fit, run and validate take several outputs") for command in COMMANDS[1:]),
    ],
)
def test_a_second_column_is_an_error_of_one_line(capsys, log, command, option, words) -> None:
    code, out, err = call(capsys, command, log, option, "u", option, "t")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{option} u {option} t: {words}" in err


def test_the_same_column_twice_is_named(capsys, log) -> None:
    code, _, err = call(capsys, "fit", log, "-i", "u", "--input", "u", "-o", "y", "-p", 1)
    assert code == 2
    assert "-i u is given twice: name each column once" in err


@every(
    "typed, option",
    [
        (("fit", "LOG", "-i", "u", "-o", "y", "-p", "1", "--poles=2"), "-p/--poles"),
        (("fit", "LOG", "-i", "t", "-i", "u", "-o", "y", "-o", "x", "-p", "1,2", "-p", "1,1"), "-p/--poles"),
        (
            ("fit", "LOG", "-i", "t", "-i", "u", "-o", "y", "-p", "1,1", "--time", "r", "--time", "t"),
            "--time",
        ),
        (("run", "LOG", "-i", "u", "-o", "y", "-p1", "--delay", "0", "--delay", "0.1"), "--delay"),
        (("live", "-?columns=u,y", "--dt", "1", "-p", "1", "--dt", "2"), "--dt"),
        (("open", "--at", "127.0.0.1:1", "--at", "127.0.0.1:2"), "--at"),
    ],
)
def test_an_option_of_one_value_is_given_once(capsys, log, typed, option) -> None:
    code, out, err = call(capsys, *(log if word == "LOG" else word for word in typed))
    assert (code, out, err) == (2, "", f"replant: {option} is given twice: give it once\n")


def test_options_of_several_values_and_flags_may_be_repeated(capsys, log) -> None:
    asked = ("fit", log, "-i", "u", "-o", "y", "-p", 1, "--json", "--json", "--validate", log, "--validate", log)
    assert call(capsys, *asked)[0] == 0


def test_a_log_in_the_place_of_the_model_is_said_to_be_none(capsys, log) -> None:
    code, out, err = call(capsys, "validate", log)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{log}: it is no model that --save has written" in err


def test_a_model_without_a_log_asks_for_one(capsys, log, tmp_path) -> None:
    saved = tmp_path / "model.json"
    call(capsys, "fit", log, "-i", "u", "-o", "y", "-p", 1, "--save", saved)
    code, out, err = call(capsys, "validate", saved)
    assert (code, out) == (2, "")
    assert f"name the logs to compare the model with: replant validate {saved} LOG" in err
