"""The page for those who come from other tools: replant's code beside theirs runs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import replant as rp
from replant.cli import main
from support.places import ROOT

THEIRS = ("system_identification(", "linear_model.")  # SIPPY, river
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGE = (ROOT / "docs" / "coming-from.md").read_text(encoding="utf-8")
OURS = [block for block in BLOCK.findall(PAGE) if not any(name in block for name in THEIRS)]


def test_there_is_code_of_ours_beside_each_tool() -> None:
    assert len(OURS) > 3


@pytest.mark.parametrize("block", OURS)
def test_the_code_beside_another_tool_runs(block: str) -> None:
    log = rp.examples.motor()
    names: dict[str, Any] = {"rp": rp, "log": log, "u": log.input, "y": log.output}
    exec(compile(block, "page", "exec"), names)
    result = names.get("fit") or names.get("M") or names["ident"]
    assert result.transfer_function.dc_gain > 0.0


TASKS = PAGE.partition("### A day's tasks")[2].partition("### What is the difference")[0]
DONE = [
    entry
    for line in TASKS.splitlines()
    if line.startswith("| ")
    for entry in re.findall("`([^`]*)`", line.split("|")[3])
]


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_every_line_of_the_day_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Each command of the table in its order, and each Python expression on what they have saved."""
    control = pytest.importorskip("control", reason="python-control is installed by an extra")
    monkeypatch.chdir(tmp_path)
    main(["examples"])
    commands = [each for each in DONE if each.startswith("replant ")]
    assert len(commands) > 10
    for command in commands:
        main(shlex.split(command)[1:])
        assert capsys.readouterr().out, command
    names = {"rp": rp, "control": control, "m1": rp.load_model("m1.json"), "log": rp.examples.motor()}
    expressions = [each for each in DONE if each not in commands]
    assert len(expressions) > 5
    for expression in expressions:
        assert eval(expression, dict(names)) is not None, expression
