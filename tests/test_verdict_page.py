"""docs/verdict.md explains reasons that the verdict gives, in its own words."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = [line.split("|")[1].strip() for line in (ROOT / "docs" / "verdict.md").read_text("utf-8").splitlines()
        if line.startswith("| ") and not line.startswith("| reason")]  # fmt: skip


def said() -> str:
    """Every string of the assessment, figures left out, in one line."""
    parts = []
    for path in sorted((ROOT / "src" / "replant" / "assessment").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts.append("".join(str(v.value) if isinstance(v, ast.Constant) else "@" for v in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                parts.append(node.value)
    return " ".join(" ".join(parts).split())


@pytest.mark.parametrize("reason", ROWS)
def test_each_reason_is_one_that_is_given(reason: str) -> None:
    """What stands between figures and names of signals occurs in the source, word by word."""
    for piece in re.split(r"x %|the input could|the model explains", reason):
        assert piece.strip() in said(), piece
