"""docs/verdict.md explains each reason that the verdict gives, in its own words, and no other."""

from __future__ import annotations

import ast
import itertools
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from support.cases import every

ROOT = Path(__file__).parents[1]
ROWS = [line.split("|")[1].strip() for line in (ROOT / "docs" / "verdict.md").read_text("utf-8").splitlines()
        if line.startswith("| ") and not line.startswith("| reason")]  # fmt: skip


PACKAGE = ROOT / "src" / "replant"
OTHERS = ("fitting/other_causes", "fitting/structure_evidence", "fitting/miso_solve", "online/running_model")
SOURCES = [*sorted((PACKAGE / "verdict").glob("*.py")), *(PACKAGE / f"{name}.py" for name in OTHERS)]
ADVICE = {"ADVICE", "ALIKE", "MOVED_UP", "REMEDY", "TOO_EARLY"}  # constants that stand within reasons
UNKNOWN = "@"  # a figure, or words that are made elsewhere


def pieces(row: str) -> list[str]:
    """What stands in a row between figures and names of signals."""
    return [piece.strip() for piece in re.split(r"x %|the input could|the model explains", row)]


@cache
def said() -> str:
    """Every string of what gives reasons, figures left out, in one line."""
    parts = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts.append("".join(str(v.value) if isinstance(v, ast.Constant) else "@" for v in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                parts.append(node.value)
    return " ".join(" ".join(parts).split())


@every("reason", ROWS)
def test_each_reason_is_one_that_is_given(reason: str) -> None:
    """What stands between figures and names of signals occurs in the source, word by word."""
    for piece in pieces(reason):
        assert piece in said(), piece


Names = dict[str, ast.expr]


def assigned(tree: ast.AST, before: int) -> Names:
    """What is assigned to each name within a node, last before a line."""
    found: Names = {}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Assign) and node.lineno < before]
    for node in sorted(nodes, key=lambda each: each.lineno):
        for target in node.targets:
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if several else [(target, node.value)]
            found |= {one.id: value for one, value in pairs if isinstance(one, ast.Name)}
    return found


def texts(node: ast.expr, names: Names) -> list[str]:
    """Every text that an expression may be, with `UNKNOWN` for what only a run can tell."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value]
    if isinstance(node, ast.FormattedValue):
        return texts(node.value, names)
    if isinstance(node, ast.JoinedStr):
        parts = [texts(value, names) for value in node.values]
        return ["".join(each) for each in itertools.product(*parts)]
    if isinstance(node, ast.IfExp):
        return texts(node.body, names) + texts(node.orelse, names)
    if isinstance(node, ast.Name) and node.id in names:
        rest = {name: value for name, value in names.items() if name != node.id}
        return texts(names[node.id], rest)
    return [UNKNOWN]


def reasons_given() -> Iterator[tuple[str, str]]:
    """Yield where a reason is given, and its text: those of findings, and those that are kept as constants."""
    for path in SOURCES:
        tree = ast.parse(path.read_text("utf-8"))
        at_the_top = ast.Module([node for node in tree.body if isinstance(node, ast.Assign)], [])
        constants = assigned(at_the_top, sys.maxsize)
        for name in set(constants) - ADVICE:
            for text in texts(constants[name], constants):
                yield f"{path.name}: {name}", text
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef):
                for node in ast.walk(function):
                    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding":
                        for text in texts(node.args[1], constants | assigned(function, node.lineno)):
                            yield f"{path.name}: {function.name}", text


@cache
def given() -> list[tuple[str, str]]:
    """Return them in order; of what begins with another reason, that one is looked for where it is made."""
    return sorted(
        {(where, text) for where, text in reasons_given() if text != UNKNOWN and not text.startswith(("@: ", "@, "))}
    )


def test_the_reasons_are_found() -> None:
    """Else the test below would pass with nothing looked at."""
    assert len({where for where, _ in given()}) > 25
    assert any("the input is constant" in text for _, text in given())


@every(("where", "text"), given)
def test_each_reason_that_is_given_has_a_row(where: str, text: str) -> None:
    plain = " ".join(text.split())
    assert any(all(piece in plain for piece in pieces(row)) for row in ROWS), f"{where}: {plain}"
