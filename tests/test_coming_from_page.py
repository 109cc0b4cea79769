"""The page for those who come from other tools: replant's code beside theirs runs."""

from __future__ import annotations

import re
from typing import Any

import pytest

import replant as rp
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
